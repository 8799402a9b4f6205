"""How wbflow ends, and how it says that something is wrong: the exit codes, and the base of all its exceptions."""

from __future__ import annotations

import re
from collections.abc import Iterable
from enum import IntEnum

LONGEST = 500
"""Characters of a reason or a name from outside that are kept."""
LONGEST_TRACE = 8000
"""Of a traceback."""
_UNFIT = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters but for the end of a line and the tabulator, what turns the direction of writing, halves of characters."""


class ExitCode(IntEnum):
    """The exit codes of every command."""

    GOOD = 0
    """Nothing to look at."""
    FAILED = 1
    """No cloud could be made."""
    USAGE = 2
    """Wrong usage or site file; nothing was done."""
    DEGRADED = 3
    """A cloud was made, but something failed or is poorer than it should be."""
    LOCKED = 4
    """Another run holds the work folder."""
    INTERRUPTED = 130
    """Stopped from outside; everything finished is kept."""


def worst(codes: Iterable[int]) -> int:
    """The exit code of several runs: interrupted, else no cloud, else a site not begun, else degraded, else good."""
    order = (ExitCode.GOOD, ExitCode.DEGRADED, ExitCode.LOCKED, ExitCode.USAGE, ExitCode.FAILED, ExitCode.INTERRUPTED)
    return max(codes, key=lambda code: order.index(ExitCode(code)), default=ExitCode.GOOD)


class WbflowError(Exception):
    """The base of all errors that wbflow raises on purpose.

    what: is wrong, in one line.  where: a file (with line and column), a task, a folder; "" where there is no place.  remedy:
    what to do about it; "" where nothing can be.
    """

    exit_code: ExitCode = ExitCode.FAILED
    """What the command line ends with when nobody catches it."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        super().__init__(str(self))

    def __str__(self) -> str:
        head = f"{self.where}: {self.what}" if self.where else self.what
        return f"{head}\n  {self.remedy}" if self.remedy else head


class UsageError(WbflowError, ValueError):
    """What was asked for cannot be meant."""

    exit_code = ExitCode.USAGE


def printable(text: object, most: int = LONGEST) -> str:
    """Words from outside (a file's name, an id, what a stage raised) as they may be shown, logged and published.

    Control characters, which a terminal would obey, and bytes that are no text are written as escapes; of what is longer than
    `most` characters the middle is left out.
    """
    words = str(text)
    if len(words) > most:
        half = most // 2
        words = f"{words[:half]} ... ({len(words):,} characters) ... {words[-half:]}"
    return words if words.isprintable() else _UNFIT.sub(_escaped, words)


def counted(number: float, thing: str) -> str:
    """So many of a thing: 1 pair, 1,204 points."""
    return f"{number:,.0f} {thing}{'s' * (round(number) != 1)}"


def _escaped(found: re.Match[str]) -> str:
    code = ord(found.group())
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a file's name that is no text (PEP 383)
        return f"\\x{code - 0xDC00:02x}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
