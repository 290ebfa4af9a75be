"""Claims hold within their bounds only, are told by their worst case, and survive the way to a file."""

import math
import os
import subprocess
import sys
from pathlib import Path

import print_claims
import pytest
from claims import Claim, hold_claim, load_claims, publish_claims, tabulate_claims, tell_failures

SOME = [
    Claim("sun: error", 0.5, high=2.0, unit="%", case="rays"),
    Claim("sun: error", 1.5, high=2.0, unit="%", case="photons"),
    Claim("slope: over size", 2.02, 1.85, 2.15, points=((1.0, 2.0), (2.0, 4.0))),
    Claim("bias: seen", 7.0, low=4.0, unit="sigmas"),
]


@pytest.mark.parametrize(
    ("measured", "low", "high", "holds"),
    [
        *[(1, 1, 2, True), (2, 1, 2, True), (2.1, 1, 2, False), (0.9, 1, math.inf, False), (9, 1, math.inf, True)],
        *[(0, -math.inf, 0, True), (1, -math.inf, 0, False), (math.nan, 0, 1, False), (3, 3, 3, True), (4, 3, 3, False)],
    ],
)
def test_a_claim_holds_within_its_bounds(measured, low, high, holds):
    claim = Claim("a: b", measured, low, high)
    assert claim.holds is holds
    if math.isfinite(measured):
        assert (claim.strain <= 1) is holds


def test_a_claim_that_fails_is_seen():
    failing = [*SOME, Claim("sun: error", 2.5, high=2.0, unit="%", case="sky")]
    assert tell_failures(SOME) == 0
    assert tell_failures(failing) == 1
    assert tell_failures([]) == 1
    assert tabulate_claims(failing).rows == [
        ["sun", "error", "3", "2.5 % (sky)", "at most 2 %", "**1 fail**"],
        ["slope", "over size", "1", "2.02", "1.85 to 2.15", "yes"],
        ["bias", "seen", "1", "7 sigmas", "at least 4 sigmas", "yes"],
    ]


def test_the_table_of_all_benchmarks_goes_into_the_page(tmp_path, monkeypatch):
    page = tmp_path / "accuracy.md"
    page.write_text("a\n<!-- table: claims -->\nold\n<!-- end -->\nb\n", encoding="utf-8")
    monkeypatch.setattr(print_claims, "PUBLISHED", tmp_path / "claims")
    monkeypatch.setattr(print_claims, "PAGE", page)
    monkeypatch.setattr(sys, "argv", ["print_claims.py", "--docs"])
    for name, claims in (("one", SOME[:2]), ("two", SOME[2:])):
        publish_claims(name, claims, tmp_path / "claims")
    assert print_claims.main() == 0
    assert page.read_text(encoding="utf-8") == f"a\n<!-- table: claims -->\n\n{tabulate_claims(SOME)}\n\n<!-- end -->\nb\n"


def test_a_claim_that_fails_is_kept_and_raised():
    kept = []
    with pytest.raises(AssertionError, match=r"sun: error \[sky\]: 3 %, claimed: at most 2 %"):
        hold_claim(kept, Claim("sun: error", 3.0, high=2.0, unit="%", case="sky"))
    assert [claim.holds for claim in kept] == [False]


@pytest.mark.slow  # as all that asks for claims; it starts a pytest of its own
@pytest.mark.parametrize("together", [[], ["--numprocesses", "2", "--dist", "load"]], ids=["alone", "together"])
def test_pytest_writes_the_claims_of_its_tests(tmp_path, together):
    """Of those that hold some, in their order, and tells how many tests failed."""
    test = tmp_path / "test_some.py"
    test.write_text(
        "import pytest\n"
        "@pytest.mark.parametrize('case', range(6))\n"
        "def test_held(hold, case): hold('sun: error', case, high=4)\n"
        "def test_that_holds_nothing(): assert False\n",
        encoding="utf-8",
    )
    conftest = Path(__file__).parents[1] / "conftest.py"
    command = [sys.executable, "-m", "pytest", "-p", "conftest", "-c", conftest.parents[1] / "pyproject.toml", "--rootdir", tmp_path, test]
    run = subprocess.run(
        [*command, *together, "--claims", tmp_path / "claims.json"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(conftest.parent)},
    )
    assert run.returncode == 1, run.stdout + run.stderr
    *held, failed = load_claims(tmp_path / "claims.json")
    assert [(claim.name, claim.measured, claim.case) for claim in held] == [("sun: error", case, str(case)) for case in range(6)]
    assert failed == Claim("tests: those of these claims, and slow ones, that fail", 1, high=0)
