"""The exit codes of wbflow, and the base class of all its exceptions."""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum

Location = tuple[str | int, ...]
"""Path to a value in a file of settings: keys and list indices from the top."""


class ExitCode(IntEnum):
    """The exit codes of every command."""

    GOOD = 0
    """Nothing needs attention."""
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
    """The worst exit code of several runs: interrupted, then failed, usage, locked, degraded, good."""
    order = (ExitCode.GOOD, ExitCode.DEGRADED, ExitCode.LOCKED, ExitCode.USAGE, ExitCode.FAILED, ExitCode.INTERRUPTED)
    return max(codes, key=lambda code: order.index(ExitCode(code)), default=ExitCode.GOOD)


class WbflowError(Exception):
    """The base of all errors that wbflow raises on purpose.

    what: the fault, in one line.  where: a file (with line and column), a task or a folder; "" if the fault has no place.
    remedy: what to do about it; "" if nothing can be done.
    """

    exit_code: ExitCode = ExitCode.FAILED
    """Exit code of the command line if the error is not caught."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        super().__init__(str(self))

    def __str__(self) -> str:
        head = f"{self.where}: {self.what}" if self.where else self.what
        return f"{head}\n  {self.remedy}" if self.remedy else head


class UsageError(WbflowError, ValueError):
    """Wrong usage: invalid options, site file or arguments."""

    exit_code = ExitCode.USAGE
