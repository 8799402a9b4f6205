"""What the report's page shows of a result besides its picture, kept beside it with what it was made by."""

from __future__ import annotations

from dataclasses import dataclass

from ..task import Task
from .artifact import digest
from .atomic import write_atomic
from .layout import WorkFolder
from .untrusted import read_outside


@dataclass(frozen=True)
class Shown:
    """What a function makes of a result."""

    work: WorkFolder
    """Where it is kept."""
    task: Task
    """Whose result is shown."""
    key: str
    """Of that result."""
    code: str
    """Fingerprint of the function."""

    def kept(self) -> bytes | None:
        """What was made by the function as it is now; None where that was not kept, or is not whole."""
        try:
            told, _, made = read_outside(self.work.view(self.task, self.key)).partition(b"\n")
        except OSError:
            return None
        return made if told == self._head(made) else None

    def keep(self, made: bytes) -> None:
        """Keep what was made.  Raises OSError: it can be made again."""
        write_atomic(self.work.view(self.task, self.key), self._head(made) + b"\n" + made, lasts=False, ours=True)

    def _head(self, made: bytes) -> bytes:
        return f"{self.code} {digest(made)}".encode()
