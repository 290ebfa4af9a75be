"""Tables of text, and their places in the pages of docs/."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Table:
    """Rows of text under a head."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def __str__(self) -> str:
        lines = [self.head, ["---"] * len(self.head), *self.rows]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def put_tables(text: str, tables: dict[str, Table]) -> str:
    """The text with each table between its marks, `<!-- table: name -->` and `<!-- end -->`."""
    for name, table in tables.items():
        marks = re.compile(rf"(<!-- table: {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
        text = marks.sub(lambda found, table=table: f"{found[1]}\n{table}\n\n{found[2]}", text)
    return text


def fill_page(page: Path, tables: dict[str, Table]) -> None:
    """put_tables, in a file."""
    page.write_text(put_tables(page.read_text(encoding="utf-8"), tables), encoding="utf-8")
