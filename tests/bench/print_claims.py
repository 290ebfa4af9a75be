"""Prints the claims of all benchmarks that were run as one table; exits 1 where one fails. What `make bench` ends with.

python tests/bench/print_claims.py [--docs]     --docs puts it into docs/accuracy.md
"""

import argparse
import sys
from pathlib import Path

from claims import PUBLISHED, load_claims, tabulate_claims, tell_failures
from tables import fill_page

PAGE = Path(__file__).resolve().parents[2] / "docs" / "accuracy.md"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--docs", action="store_true", help="put the table into docs/accuracy.md")
    arguments = parser.parse_args()
    claims = [claim for path in sorted(PUBLISHED.glob("*.json")) for claim in load_claims(path)]
    table = tabulate_claims(claims)
    print(table)
    if arguments.docs:
        fill_page(PAGE, {"claims": table})
    return tell_failures(claims)


if __name__ == "__main__":
    sys.exit(main())
