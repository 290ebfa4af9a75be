"""Claims hold within their bounds only, are told by their worst case, and survive the way to a file."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
from claims import Claim, all_hold, hold_claim, load_claims, save_claims, tabulate_claims

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


def test_a_table_shows_the_worst_case_of_each_name():
    assert tabulate_claims(SOME).rows == [
        ["sun", "error", "2", "1.5 % (photons)", "at most 2 %", "yes"],
        ["slope", "over size", "1", "2.02", "1.85 to 2.15", "yes"],
        ["bias", "seen", "1", "7 sigmas", "at least 4 sigmas", "yes"],
    ]


def test_a_claim_that_fails_is_seen():
    failing = [*SOME, Claim("sun: error", 2.5, high=2.0, unit="%", case="sky")]
    assert all_hold(SOME)
    assert not all_hold(failing)
    assert tabulate_claims(failing).rows[0][3:] == ["2.5 % (sky)", "at most 2 %", "**1 fail**"]


def test_claims_come_back_from_a_file(tmp_path):
    save_claims(SOME, tmp_path / "new" / "claims.json")
    assert load_claims(tmp_path / "new" / "claims.json") == SOME


def test_a_claim_that_fails_is_kept_and_raised():
    kept = []
    with pytest.raises(AssertionError, match=r"sun: error \[sky\]: 3 %, claimed: at most 2 %"):
        hold_claim(kept, Claim("sun: error", 3.0, high=2.0, unit="%", case="sky"))
    assert [claim.holds for claim in kept] == [False]


def test_pytest_writes_the_claims_of_its_tests(tmp_path):
    """Of those that hold some, and tells how many tests failed."""
    test = Path(__file__).with_name("test_basis.py")
    run = subprocess.run([sys.executable, "-m", "pytest", test, "--claims", tmp_path / "claims.json"], capture_output=True, text=True)
    assert run.returncode == 0, run.stdout
    claims = load_claims(tmp_path / "claims.json")
    assert len({claim.name for claim in claims}) == 2
    assert claims[-1].name.startswith("tests: ")
    assert all_hold(claims)
