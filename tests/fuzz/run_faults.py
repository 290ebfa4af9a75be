"""Every fault of fault_rows.py, all of its stages: what passed goes into the table in docs/reliability.md.

python tests/fuzz/run_faults.py [WORD ...] [--docs]

With words only the rows whose test has one of them in its name; the results of others stay as they are.
The exit code is 1 where a row fails.
"""

from __future__ import annotations

import argparse
import datetime
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))

from fault_rows import FAULTS, read_results, tabulate_faults
from tables import put_tables

TESTS = Path(__file__).resolve().parents[1]
DOCS = TESTS.parent / "docs" / "reliability.md"


def run_row(test: str) -> tuple[str, bool]:
    """The result of a test with all of its parameters, slow ones too, for the table; and whether all passed."""
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "found.xml"
        subprocess.run([sys.executable, "-m", "pytest", str(TESTS / test), "-q", f"--junitxml={found}"], cwd=TESTS.parent, check=False)
        return count_passed(found, datetime.date.today()) if found.exists() else ("could not be run", False)


def count_passed(found: Path, today: datetime.date) -> tuple[str, bool]:
    """As run_row, from pytest's file in the form of JUnit."""
    cases = list(ElementTree.parse(found).getroot().iter("testcase"))
    failed = sum(_has(case, ("failure", "error")) for case in cases)
    skipped = sum(_has(case, ("skipped",)) for case in cases)
    run = len(cases) - skipped
    text = f"{run - failed} of {run}, {today.isoformat()}" + (f"; {skipped} need what this machine lacks" if skipped else "")
    return text, failed == 0 and run > 0


def _has(case: ElementTree.Element, kinds: Iterable[str]) -> bool:
    return any(case.find(kind) is not None for kind in kinds)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", metavar="WORD")
    parser.add_argument("--docs", action="store_true", help="write the results into docs/reliability.md")
    asked = parser.parse_args()
    tests = [one.test for one in FAULTS if not asked.words or any(word in one.test for word in asked.words)]
    all_passed = True
    for test in tests:
        result, passed = run_row(test)
        print(f"{test}: {result}", flush=True)
        all_passed &= passed
        if asked.docs:  # after each: some take minutes
            page = DOCS.read_text(encoding="utf-8")
            DOCS.write_text(put_tables(page, {"faults": tabulate_faults(read_results(page) | {test: result})}), encoding="utf-8")
    return 0 if all_passed else 1


if __name__ == "__main__":
    sys.exit(main())
