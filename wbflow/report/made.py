"""What the page shows of a result besides its picture: made once of each, by a function of the vision, and kept beside it."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..cache.codec import result_of
from ..cache.functions import FunctionReader
from ..cache.shown import Shown
from ..cache.store import Cache
from ..errors import WbflowError
from ..outcome.artifacts import function
from ..pipeline.stages import stage_named
from ..task import Task

SMALL = 16_000
"""Bytes of a camera's or a pair's result below which making something of it anew is quicker than keeping it."""

_FORESEEN = (WbflowError, ValueError, LookupError, TypeError, ArithmeticError, AttributeError, ImportError, OSError, MemoryError)


@dataclass(frozen=True)
class Maker:
    """Makes bytes of results, or finds those that were made."""

    cache: Cache
    """Holds results, and what was made of them."""
    reader: FunctionReader
    """Knows whether bytes were made by the function as it is now."""
    _codes: dict[str, str] = field(default_factory=dict, repr=False)
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
        shown = Shown(cache.work, task, key, self._code(dotted))
        if not small and (kept := shown.kept()) is not None:
            return kept
        try:
            if receipt is None or receipt.file is None:
                return None
            result = result_of(cache.read(task, cache.path(receipt), receipt.digest), stage_named(task.stage).table)
            made = bytes(function(dotted)(result))
            if not small:
                shown.keep(made)
            return made
        except _FORESEEN:
            return None  # the page does without

    def _code(self, dotted: str) -> str:
        if dotted not in self._codes:
            self._codes[dotted] = self.reader.read(dotted).code
        return self._codes[dotted]
