"""Tables in text files as people and programs write them: commas, semicolons or tabs between columns, decimal points or commas.

The first row names the columns, in any case and order.  Faults of rows are collected by kind: a file with 30,000 rows that all
lack something has one problem, not 30,000.
"""

from __future__ import annotations

import csv
import io
import math
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..words import counted, printable
from .yaml_document import Problem, SiteError, read_text

_SEPARATORS = (";", "\t", ",")
"""Separators of columns; a comma last, since it may also be a decimal comma."""
_MISSING = {"", "nan", "na", "n/a", "none", "null", "-"}
"""What programs write where they have no value, in lower case."""


@dataclass
class RowFaults:
    """The faults of a table's rows: of each kind the first one, with the number of rows that have it."""

    path: Path
    lines: set[int] = field(default_factory=set)
    """Lines of the rows that have a fault."""
    _first: dict[str, Problem] = field(default_factory=dict)
    _counts: dict[str, int] = field(default_factory=dict)

    def add(self, kind: str, line: int, what: str, remedy: str) -> None:
        """Add a fault of a row.

        Parameters
        ----------
        kind : str
            Faults of the same kind are reported once.
        line : int
            The row's line in the file, from 1.
        what, remedy : str
            What is wrong, and how to fix it.
        """
        self.lines.add(line)
        self._first.setdefault(kind, Problem(self.path, what, remedy, line))
        self._counts[kind] = self._counts.get(kind, 0) + 1

    def raise_any(self) -> None:
        """Raise SiteError if there is any fault."""
        problems = []
        for kind, problem in self._first.items():
            others = self._counts[kind] - 1
            what = problem.what
            if others:
                what += f"; the same in {counted(others, 'more row')}"
            problems.append(Problem(problem.file, what, problem.remedy, problem.line))
        if problems:
            raise SiteError(*problems)


@dataclass(frozen=True)
class CsvTable:
    """The rows of a table, with what its columns mean."""

    path: Path
    titles: Mapping[str, str]
    """Title of a column as written, by its meaning."""
    positions: Mapping[str, int]
    """Position of a column in the rows, by its meaning."""
    rows: Sequence[list[str]]
    lines: Sequence[int]
    """Line of each row in the file, from 1."""
    separator: str
    faults: RowFaults

    def has(self, meaning: str) -> bool:
        """Is there such a column?"""
        return meaning in self.positions

    def texts(self, meaning: str) -> list[str]:
        """The values of a column."""
        position = self.positions[meaning]
        return [row[position] for row in self.rows]

    def number(self, text: str) -> float | None:
        """The number that a cell holds, nan if it is empty; None if it holds something else."""
        if self.separator != ",":
            text = text.replace(",", ".")
        try:
            value = float(text)
        except ValueError:
            return math.nan if text.strip().lower() in _MISSING else None
        return None if math.isinf(value) else value

    def numbers(self, meaning: str) -> array[float]:
        """The numbers in a column, nan where it is empty; other cells are added to `faults`."""
        numbers = array("d")
        for line, text in zip(self.lines, self.texts(meaning), strict=True):
            value = self.number(text)
            if value is None:
                value = math.nan
                remedy = "write a number, or leave the cell empty"
                if self.separator == "," and re.fullmatch(r"-?\d+(\.\d+)?[a-zA-Z]+", text):
                    remedy = "write the number without its unit"
                self.faults.add(meaning, line, f"{self.titles[meaning]} is {printable(repr(text), 60)}, not a number", remedy)
            numbers.append(value)
        return numbers


def read_csv(path: Path, meanings: Mapping[str, Sequence[str]], wanted: str) -> CsvTable:
    """Read a table.

    Raises SiteError if the file cannot be read, is empty, does not name its columns, or has a row with too few cells.

    Parameters
    ----------
    path : Path
        The file.
    meanings : mapping
        Titles of columns (lower case, words joined by `_`) by what they mean; of two columns with the same meaning, the one with
        the earlier title counts.  Other columns are ignored.
    wanted : str
        How such a file is written, for remedies.
    """
    text = read_text(path, "check the path; it is relative to the site file")
    faults = RowFaults(path)
    lines = _numbered_rows(text, path)
    line, titles, separator = next(lines, (1, [], ","))
    if not titles:
        raise SiteError(Problem(path, "is empty", wanted, 1))
    names = [_plain_title(title) for title in titles]
    positions: dict[str, int] = {}
    for meaning, choices in meanings.items():
        for choice in choices:
            if choice in names and meaning not in positions:
                positions[meaning] = names.index(choice)
    if not positions:
        shown = printable(", ".join(titles), 80)
        raise SiteError(Problem(path, f"does not name its columns in the first row, which is {shown}", wanted, line))

    # cells at the end of a row may be missing if no column that counts is there
    needed = max(positions.values()) + 1
    rows: list[list[str]] = []
    numbers: list[int] = []
    for line, row, _ in lines:
        if len(row) < needed:
            what = f"has {counted(len(row), 'value')}; {needed} are needed, as the columns are {', '.join(titles[:needed])}"
            faults.add("cells", line, what, "complete or remove the row")
            continue
        rows.append(row)
        numbers.append(line)
    titles_by_meaning = {meaning: printable(titles[position].strip(), 40) for meaning, position in positions.items()}
    return CsvTable(path, titles_by_meaning, positions, rows, numbers, separator, faults)


def _numbered_rows(text: str, path: Path) -> Iterator[tuple[int, list[str], str]]:
    """Line, cells and separator of each row that is neither empty nor a comment.  Raises SiteError."""
    # Excel names the separator in a line of its own
    stated = re.match(r"\s*sep=(.)\s*$", text.partition("\n")[0])
    separator = stated[1] if stated else _separator(text)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, skipinitialspace=True)
    try:
        for row in reader:
            is_comment = bool(row) and row[0].startswith("#")
            if is_comment or (stated and reader.line_num == 1) or not any(map(str.strip, row)):
                continue
            yield reader.line_num, row, separator
    except csv.Error as error:
        what = f"is no table of text: {printable(error)}"
        raise SiteError(Problem(path, what, "export it as CSV", reader.line_num)) from None


def _separator(text: str) -> str:
    """The separator of the row that names the columns."""
    for line in text.splitlines():
        if line.strip() and not line.startswith("#"):
            for separator in _SEPARATORS:
                if separator in line:
                    return separator
            break
    return ","


def _plain_title(title: str) -> str:
    """A column's title in lower case, its words joined by `_`, without a unit in brackets."""
    without_unit = re.sub(r"[\[(].*?[\])]", "", title)
    return re.sub(r"\W+", "_", without_unit.strip().lower()).strip("_")
