"""Pictures of artifacts, and what they were drawn by: a repaired picture function reaches artifacts that are cached."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from ..task import Task
from .artifact import digest, file_digest
from .atomic import write_atomic
from .layout import WorkFolder
from .signed import Damaged, read_signed, write_signed
from .store import Cache
from .untrusted import read_outside


@dataclass(frozen=True)
class Drawing:
    """What became of a picture."""

    digest: str
    """Of all that determines it."""
    failure: str | None = None
    """Why it could not be drawn."""
    picture: str | None = None
    """Digest of the picture itself."""


def is_drawn(cache: Cache, task: Task, key: str, by: str) -> bool:
    """Has the picture of an artifact been drawn (or tried), and is it still as it was drawn?

    Parameters
    ----------
    cache : Cache
        Where it is kept; is told of damage.
    task : Task
        Whose result is shown.
    key : str
        Of that result.
    by : str
        Digest of all that determines the picture now.
    """
    path, file = cache.work.drawing_name(task, key), cache.work.picture_name(task, key)
    try:
        told = read_signed(path, cache.work.place(path))
        drawing = Drawing(**told) if told else None
        if drawing is None or drawing.digest != by:
            return False
        if drawing.picture and drawing.picture != file_digest(Path(file)):
            raise Damaged(f"{file} is damaged")
    except OSError:
        cache.note(f"{file} is gone", task)
        return False
    except Damaged as damage:
        cache.note(damage.what, task)
        return False
    except TypeError:  # by another version
        return False
    return True


def write_drawing(work: WorkFolder, task: Task, key: str, drawing: Drawing, picture: bytes | None) -> None:
    """Keep a picture, or that there is none.

    Parameters
    ----------
    work : WorkFolder
        Where it is kept.
    task : Task
        Whose result is shown.
    key : str
        Of that result.
    drawing : Drawing
        By what it was drawn, and why it could not be.
    picture : bytes, optional
        The JPEG file; None where there is none.
    """
    if picture is None:
        work.picture(task, key).unlink(missing_ok=True)
    else:
        write_atomic(work.picture_name(task, key), picture, lasts=False, ours=True)  # one that is found in part is drawn again
    path = work.drawing_name(task, key)
    known = replace(drawing, picture=digest(picture) if picture is not None else None)
    write_signed(path, work.place(path), vars(known), lasts=False)


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
