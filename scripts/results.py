#!/usr/bin/env python3
"""Keeps what benches measured: one JSON file a table in scripts/results/, all of them as tables in scripts/RESULTS.md.

scripts/results.py                                        writes RESULTS.md anew
scripts/results.py record NAME ROWS.json --title TITLE --command COMMAND [--columns a b ...] [--note TEXT]
                                                          keeps rows that a bench wrote with --json, with today's date, this
                                                          commit and this machine, then writes RESULTS.md anew
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import subprocess
from dataclasses import asdict, dataclass
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parent
FOLDER = SCRIPTS / "results"
PAGE = SCRIPTS / "RESULTS.md"

HEAD = """\
# What the benches measured

Written by `scripts/results.py` from the files in `scripts/results/`; edit those, or record anew. Seconds are CPU seconds unless a
column says otherwise; the commit is the one that was measured, or the first that holds the figures.
[scripts/README.md](README.md) says what each bench answers.
"""


@dataclass(frozen=True)
class Table:
    """What one bench measured once."""

    title: str
    command: str
    """That measures it again."""
    date: str
    commit: str
    """Of the code that was measured, or the first that holds the figures."""
    machine: str
    columns: list[str]
    rows: list[list[str | float | None]]
    note: str = ""


def read_tables() -> dict[str, Table]:
    """All tables by the name of their file, in the order of names."""
    return {file.stem: Table(**json.loads(file.read_text())) for file in sorted(FOLDER.glob("*.json"))}


def markdown(tables: dict[str, Table]) -> str:
    """The page."""
    return "\n".join([HEAD, *(_section(table) for table in tables.values())])


def _section(table: Table) -> str:
    lines = [f"## {table.title}", "", f"`{table.command}` · {table.date} · commit {table.commit} · {table.machine}", ""]
    lines += [_row(table.columns), _row(["---"] * len(table.columns)), *(_row(row) for row in table.rows), ""]
    return "\n".join([*lines, table.note, ""] if table.note else lines)


def _row(cells: list[str] | list[str | float | None]) -> str:
    return f"| {' | '.join('' if cell is None else f'{cell:g}' if isinstance(cell, float) else str(cell) for cell in cells)} |"


def table_of(rows: list[dict[str, str | float | None]], asked: argparse.Namespace) -> Table:
    """Rows of a bench as a table of today, of this commit and this machine."""
    git = ["git", "-C", str(SCRIPTS), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    columns = asked.columns or list(rows[0])
    cells = [[row.get(column) for column in columns] for row in rows]
    machine = f"{platform.machine()}, {os.cpu_count()} cores"
    return Table(asked.title, asked.command, datetime.date.today().isoformat(), commit, machine, columns, cells, asked.note)


def main() -> None:
    """Record what is asked for, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    record = parser.add_subparsers(dest="action").add_parser("record")
    record.add_argument("name")
    record.add_argument("rows", type=Path)
    record.add_argument("--title", required=True)
    record.add_argument("--command", required=True)
    record.add_argument("--columns", nargs="+")
    record.add_argument("--note", default="")
    asked = parser.parse_args()
    if asked.action == "record":
        table = table_of(json.loads(asked.rows.read_text()), asked)
        (FOLDER / f"{asked.name}.json").write_text(json.dumps(asdict(table), indent=1, ensure_ascii=False) + "\n")
    PAGE.write_text(markdown(read_tables()))


if __name__ == "__main__":
    main()
