#!/usr/bin/env python3
"""Stores the results of benches as one JSON file per table in scripts/results/, and writes all tables to scripts/RESULTS.md.

scripts/results.py                                        rewrites RESULTS.md
scripts/results.py record NAME ROWS.json --title TITLE --command COMMAND [--columns a b ...] [--note TEXT]
                                                          stores rows that a bench wrote with --json, with today's date, this
                                                          commit and this machine, then rewrites RESULTS.md
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
    """The results of one execution of a bench."""

    title: str
    command: str
    """Command that repeats the measurement."""
    date: str
    commit: str
    """Commit of the measured code, or the first commit that contains the figures."""
    machine: str
    columns: list[str]
    rows: list[list[str | float | None]]
    note: str = ""


def read_tables() -> dict[str, Table]:
    """All tables by the name of their file, sorted by name."""
    return {file.stem: Table(**json.loads(file.read_text())) for file in sorted(FOLDER.glob("*.json"))}


def markdown(tables: dict[str, Table]) -> str:
    """The text of RESULTS.md."""
    return "\n".join([HEAD, *(_section(table) for table in tables.values())])


def _section(table: Table) -> str:
    lines = [f"## {table.title}", "", f"`{table.command}` · {table.date} · commit {table.commit} · {table.machine}", ""]
    lines += [_row(table.columns), _row(["---"] * len(table.columns)), *(_row(row) for row in table.rows), ""]
    return "\n".join([*lines, table.note, ""] if table.note else lines)


def _row(cells: list[str] | list[str | float | None]) -> str:
    return f"| {' | '.join('' if cell is None else f'{cell:g}' if isinstance(cell, float) else str(cell) for cell in cells)} |"


def table_of(rows: list[dict[str, str | float | None]], asked: argparse.Namespace) -> Table:
    """A table of a bench's rows, with today's date, this commit and this machine."""
    git = ["git", "-C", str(SCRIPTS), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    columns = asked.columns or list(rows[0])
    cells = [[row.get(column) for column in columns] for row in rows]
    machine = f"{platform.machine()}, {os.cpu_count()} cores"
    return Table(asked.title, asked.command, datetime.date.today().isoformat(), commit, machine, columns, cells, asked.note)


def main() -> None:
    """Record a table if requested, and write RESULTS.md."""
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
