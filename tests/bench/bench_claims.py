"""Measures what the tests claim, slow ones included, and draws the convergence; docs/accuracy.md shows both.

python tests/bench/bench_claims.py [--docs]     some minutes on two cores; --docs needs matplotlib
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from claims import Claim, load_claims, publish_claims

TESTS = Path(__file__).resolve().parents[1]
PICTURE = TESTS.parent / "docs" / "accuracy" / "convergence.png"


def measure_claims(*selection: str) -> list[Claim]:
    """All that pytest's tests claim, or those of the files in `selection`."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "claims.json"
        together = ["--numprocesses", "2", "--dist", "loadfile"]  # most tests keep one core busy
        command = [sys.executable, "-m", "pytest", *together, "--claims", path]
        subprocess.run([*command, *(selection or [TESTS])], cwd=TESTS.parent, check=False)
        return load_claims(path)


def draw_convergence(claims: list[Claim], path: Path) -> None:
    """Errors over node size and over photons, with the slopes that are claimed of them."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for axis, (what, label) in zip(axes, (("node size", "side of a node, texels"), ("photons", "photons")), strict=True):
        drawn = [claim for claim in claims if claim.points and f"log {what}" in claim.name]
        for claim in drawn:
            x, y = zip(*claim.points, strict=True)
            axis.loglog(x, y, "o-", label=f"{claim.name.rpartition(', ')[2]}: slope {claim.measured:.2f}", linewidth=1, markersize=4)
        axis.set_xlabel(label)
        axis.set_xticks(sorted({x for claim in drawn for x, _ in claim.points}), minor=False)
        axis.xaxis.set_major_formatter(EngFormatter())
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.set_ylabel("root mean square error" + (" / mean" if what == "photons" else ""))
        axis.grid(which="both", linewidth=0.3)
        axis.legend(frameon=False, fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--docs", action="store_true", help="draw the pictures of docs/accuracy.md")
    arguments = parser.parse_args()
    claims = measure_claims()
    if arguments.docs:
        draw_convergence(claims, PICTURE)
    return publish_claims("claims", claims)


if __name__ == "__main__":
    sys.exit(main())
