"""What the page shows of a result besides its picture: made once of each, by a function of the vision, and kept beside it."""

from __future__ import annotations

from dataclasses import dataclass, field

from ...errors import WbflowError
from ...graph.codec import result_of
from ...graph.functions import FunctionReader
from ...graph.pipeline import stage_named
from ...store.artifact import digest
from ...store.atomic import write_atomic
from ...store.cache import Cache
from ...store.outside import read_outside
from ...task import Task
from ..artifacts import function


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
        cache, code = self.cache, self._code(dotted)
        path = cache.work.view(task, key)
        try:
            kept = read_outside(path)
            told, _, data = kept.partition(b"\n")
            if told == code + b" " + digest(data).encode():
                return data
        except OSError:
            pass
        receipt = cache.by_key(task, key)
        try:
            if receipt is None or receipt.file is None:
                return None
            result = result_of(cache.read(task, cache.path(receipt), receipt.digest), stage_named(task.stage).table)
            made = bytes(function(dotted)(result))
            write_atomic(path, b"%s %s\n%s" % (code, digest(made).encode(), made), lasts=False, ours=True)
            return made
        except (WbflowError, ValueError, LookupError, TypeError, ArithmeticError, AttributeError, ImportError, OSError):
            return None  # the page does without

    def _code(self, dotted: str) -> bytes:
        if dotted not in self._codes:
            self._codes[dotted] = self.reader.read(dotted).code.encode()
        return self._codes[dotted]
