"""What the page shows of a result besides its picture: made once of each, by a function of the vision, and kept beside it."""

from __future__ import annotations

from dataclasses import field

from ...errors import WbflowError
from ...graph.codec import result_of
from ...graph.functions import FunctionReader
from ...graph.pipeline import stage_named
from ...lean import dataclass
from ...store.artifact import digest
from ...store.atomic import write_atomic
from ...store.cache import Cache
from ...store.outside import read_outside
from ...task import Task
from ..artifacts import function

SMALL = 16_000
"""Bytes of a camera's or a pair's result below which making something of it anew is quicker than keeping it."""


@dataclass(frozen=True)
class Maker:
    """Makes bytes of results, or finds those that were made."""

    cache: Cache
    """Holds results, and what was made of them."""
    reader: FunctionReader
    """Knows whether bytes were made by the function as it is now."""
    _codes: dict[str, bytes] = field(default_factory=dict, repr=False)
    """Fingerprints of functions by dotted name: one function makes something of many results."""

    def made(self, dotted: str, task: Task, key: str) -> bytes | None:
        """What a function makes of a result; None where the result is not there any more, or the function cannot.

        Parameters
        ----------
        dotted : str
            The function.
        task : Task
            Whose result.
        key : str
            Of the result.
        """
        cache, receipt = self.cache, self.cache.by_key(task, key)
        small = bool(task.subject) and receipt is not None and receipt.bytes < SMALL
        if not small and (kept := self._kept(dotted, task, key)) is not None:
            return kept
        try:
            if receipt is None or receipt.file is None:
                return None
            result = result_of(cache.read(task, cache.path(receipt), receipt.digest), stage_named(task.stage).table)
            made = bytes(function(dotted)(result))
            if not small:
                head = b"%s %s\n" % (self._code(dotted), digest(made).encode())
                write_atomic(cache.work.view(task, key), head + made, lasts=False, ours=True)
            return made
        except (WbflowError, ValueError, LookupError, TypeError, ArithmeticError, AttributeError, ImportError, OSError):
            return None  # the page does without

    def _kept(self, dotted: str, task: Task, key: str) -> bytes | None:
        """What was made by the function as it is now, if it was kept."""
        try:
            told, _, data = read_outside(self.cache.work.view(task, key)).partition(b"\n")
        except OSError:
            return None
        return data if told == self._code(dotted) + b" " + digest(data).encode() else None

    def _code(self, dotted: str) -> bytes:
        if dotted not in self._codes:
            self._codes[dotted] = self.reader.read(dotted).code.encode()
        return self._codes[dotted]
