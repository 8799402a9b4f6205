"""Pictures of artifacts, and what they were drawn by: a repaired picture function reaches artifacts that are cached."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from ..task import Task
from .atomic import write_atomic
from .layout import WorkFolder


@dataclass(frozen=True)
class Drawing:
    """What became of a picture."""

    digest: str
    """Of all that determines it."""
    failure: str | None = None
    """Why it could not be drawn."""


def read_drawing(work: WorkFolder, task: Task, key: str) -> Drawing | None:
    """What became of the picture of an artifact; None where nobody has tried."""
    try:
        return Drawing(**json.loads(work.drawing(task, key).read_bytes()))
    except (OSError, ValueError, TypeError):
        return None


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
    file = work.picture(task, key)
    if picture is None:
        file.unlink(missing_ok=True)
    else:
        write_atomic(file, picture, settle=False)
    write_atomic(work.drawing(task, key), json.dumps(asdict(drawing)).encode(), settle=False)
