"""Where everything stands in a file, and what is wrong at a place of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.digests import Stamp
from ..errors import LONGEST, ExitCode, WbflowError, printable

Place = tuple[str | int, ...]
"""Where a value is: keys and list positions from the top."""


@dataclass(frozen=True)
class SiteProblem:
    """One thing that is wrong with an input file."""

    file: Path
    line: int
    """From 1; 0 where there is no such place."""
    column: int
    where: str
    """The place in words: `cameras[3].intrinsics`."""
    what: str
    remedy: str = ""

    def __str__(self) -> str:
        return printable(self._words(), 4 * LONGEST)

    def _words(self) -> str:
        place = f"{self.file}:{self.line}:{self.column}" if self.line else f"{self.file}"
        head = f"{place}: {self.where}: {self.what}" if self.where else f"{place}: {self.what}"
        return f"{head}\n  {self.remedy}" if self.remedy else head


class SiteError(WbflowError, ValueError):
    """The site file, or a file that it names, cannot be used.  `problems` holds everything found, not just the first."""

    exit_code = ExitCode.USAGE

    def __init__(self, problems: list[SiteProblem]) -> None:
        super().__init__("\n".join(map(str, problems)))
        self.problems = problems


@dataclass(frozen=True)
class Document:
    """A YAML file, and where everything stands in it."""

    path: Path
    data: Any
    """The YAML as Python."""
    marks: dict[Place, tuple[int, int]] = field(default_factory=dict)
    """(line, column) of each value."""
    key_marks: dict[Place, tuple[int, int]] = field(default_factory=dict)
    """Of each key."""
    texts: dict[Place, str] = field(default_factory=dict)
    """Scalars as written."""
    digest: str = ""
    """Of the text."""
    stated: dict[str, Stamp | None] = field(default_factory=dict)
    """What lies under the paths that the file states, when they were looked at; None: nothing."""

    def problem(self, place: Place, what: str, remedy: str = "", key: bool = False) -> SiteProblem:
        """A problem at a place; where that place is not in the file, at the nearest one around it.

        Parameters
        ----------
        place : Place
            Keys and indices that lead there.
        what : str
            What is wrong.
        remedy : str
            What to do.
        key : bool
            Point at the key and not at its value?
        """
        marks = self.key_marks if key else self.marks
        at = place
        while at and at not in marks:
            at = at[:-1]
        line, column = marks.get(at, (1, 1))
        return SiteProblem(self.path, line, column, spell(place), what, remedy)


def spell(place: Place) -> str:
    """A place in words: `cameras[3].intrinsics`."""
    words = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in place)
    return words.removeprefix(".")
