"""Random scenes, files and words through the command line: whatever comes in, what comes out is a bake or a sentence.

python tests/fuzz/run_fuzz.py [--count N] [--first SEED] [--seeds A B ...] [--seconds S] [--servers N] [--docs]

Each seed is a case (fuzz_cases.py): an odd scene, a damaged file, a damaged state beside a good scene, or odd words. It is run by the
function behind both command lines, in processes that load Blender once, every twentieth in a process of its own; then it is judged
(fuzz_judge.py). The folders of cases that fail are kept, and the exit code is 1. Without --first the date decides on the seeds.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))

from tables import Table, fill_page

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs" / "reliability.md"
PATIENCE_S = 150.0  # for one case


@dataclass
class Outcome:
    """What became of one case."""

    seed: int
    code: int
    about: str
    wrong: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def kind(self) -> str:
        """Its family."""
        first, *_ = self.about.split(";")
        if first.startswith("damaged "):
            return "damaged scene file" if first.startswith("damaged .") and ":" not in first else "damaged state, note or page"
        return first.split(":")[0]


class Server:
    """A process of fuzz_server.py, started anew where a case ends it."""

    def __init__(self, kit: Path) -> None:
        self._kit = kit
        self._process: subprocess.Popen[str] | None = None
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def start(self) -> None:
        """Returns once it has loaded Blender."""
        script = Path(__file__).with_name("fuzz_server.py")
        process = subprocess.Popen(
            [sys.executable, str(script), str(self._kit)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            encoding="utf-8",
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])},
        )
        self._process, self._lines = process, queue.SimpleQueue()
        threading.Thread(target=_read, args=(process, self._lines), daemon=True).start()
        if self._lines.get(timeout=PATIENCE_S).strip() != "ready":
            raise RuntimeError("the process that runs cases does not start; run fuzz_server.py by hand to see why")

    def run(self, seed: int, folder: Path, apart: bool = False) -> Outcome:
        """The case of a seed, in a folder that is made; where that ends Blender, what the command line makes of it."""
        if self._process is None:
            self.start()
        process = self._process
        assert process is not None
        assert process.stdin is not None
        process.stdin.write(json.dumps({"seed": seed, "folder": str(folder), "apart": apart}) + "\n")
        process.stdin.flush()
        try:
            line = self._lines.get(timeout=PATIENCE_S)
        except queue.Empty:
            self.stop()
            return Outcome(seed, -1, "hang", [f"not done after {PATIENCE_S:g} s"], PATIENCE_S)
        if line:
            found: dict[str, Any] = json.loads(line)
            return Outcome(**found)
        code = process.wait()
        self.stop()
        if not (folder / "words.json").exists():
            return Outcome(seed, code, "not made", [f"the case cannot be made: Blender ended ({code})"])
        if apart:
            return Outcome(seed, code, "crash", [f"the process that runs cases ended ({code})"])
        shutil.rmtree(folder)
        return self.run(seed, folder, apart=True)

    def stop(self) -> None:
        """End it, with all that it has started in its session."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def _read(process: subprocess.Popen[str], lines: queue.SimpleQueue[str]) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line)
    lines.put("")


def run_cases(
    seeds: Iterable[int], folder: Path, servers: int = 1, seconds: float = 0.0, tell: Callable[[Outcome], None] = lambda _: None
) -> list[Outcome]:
    """The outcome of each seed, in the order in which they end; folders of cases that pass are taken away.

    seconds   after which no further case is begun; 0: all are run
    """
    waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
    for seed in seeds:
        waiting.put(seed)
    kit, outcomes = folder / "kit", []
    first = Server(kit)
    first.start()  # it makes the kit
    limit = time.monotonic() + seconds if seconds else float("inf")

    def work(server: Server) -> None:
        try:
            while time.monotonic() < limit:
                seed = waiting.get_nowait()
                place = folder / str(seed)
                shutil.rmtree(place, ignore_errors=True)
                outcome = server.run(seed, place)
                outcomes.append(outcome)
                tell(outcome)
                if not outcome.wrong:
                    shutil.rmtree(place)
        except queue.Empty:
            pass
        finally:
            server.stop()

    threads = [threading.Thread(target=work, args=(server,)) for server in [first, *(Server(kit) for _ in range(servers - 1))]]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return outcomes


def tabulate(outcomes: Sequence[Outcome]) -> Table:
    """Counts by family, and how they ended."""
    rows = []
    for kind in [*sorted({one.kind for one in outcomes}), "all"]:
        found = [one for one in outcomes if kind in (one.kind, "all")]
        codes = Counter(one.code for one in found)
        passed = sum(not one.wrong for one in found)
        rows.append([kind, str(len(found)), str(codes[0]), str(codes[1]), str(codes[2]), f"{passed} of {len(found)}"])
    return Table(["cases", "run", "baked", "refused with a sentence", "wrong words", "as they should be"], rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=datetime.date.today().toordinal() * 10_000)
    parser.add_argument("--seeds", type=int, nargs="+")
    parser.add_argument("--seconds", type=float, default=0.0, help="begin no further case after so many")
    parser.add_argument("--servers", type=int, default=max(os.cpu_count() or 1, 1))
    parser.add_argument("--folder", type=Path, help="for the cases; those that fail stay there")
    parser.add_argument("--docs", action="store_true", help="write the counts into docs/reliability.md")
    asked = parser.parse_args()
    folder = asked.folder or Path(tempfile.mkdtemp(prefix="leaflight_fuzz_"))
    seeds = asked.seeds or range(asked.first, asked.first + asked.count)
    begin = time.monotonic()

    def tell(outcome: Outcome) -> None:
        if outcome.wrong:
            print(f"seed {outcome.seed}, {outcome.about}, exit code {outcome.code}, in {folder / str(outcome.seed)}:", flush=True)
            for text in outcome.wrong:
                print(f"  {text}", flush=True)

    outcomes = run_cases(seeds, folder, asked.servers, asked.seconds, tell)
    failed = sorted(one.seed for one in outcomes if one.wrong)
    table = tabulate(outcomes)
    longest = max((one.seconds for one in outcomes), default=0.0)
    took = f"{len(outcomes)} cases in {time.monotonic() - begin:.0f} s; the longest took {longest:.0f} s"
    print(table, "", took, sep="\n")
    if failed:
        print(f"failed, kept in {folder}: --seeds {' '.join(map(str, failed))}")
    else:
        shutil.rmtree(folder, ignore_errors=True)
    if asked.docs and not asked.seeds:
        note = Table(["seeds", "date"], [[f"{seeds[0]} to {seeds[-1]}", datetime.date.today().isoformat()]])
        fill_page(DOCS, {"fuzz": table, "seeds": note})
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
