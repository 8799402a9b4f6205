"""What the report's page shows of a result besides its picture, kept beside it with what it was made by."""

from __future__ import annotations

from ..task import Task
from .artifact import digest
from .atomic import write_atomic
from .layout import WorkFolder
from .outside import read_outside


def kept_shown(work: WorkFolder, task: Task, key: str, code: str) -> bytes | None:
    """What was made of an artifact by the function as it is now; None where that was not kept, or is not whole.

    Parameters
    ----------
    work : WorkFolder
        Where it is kept.
    task : Task
        Whose result is shown.
    key : str
        Of that result.
    code : str
        Fingerprint of the function.
    """
    try:
        told, _, made = read_outside(work.view(task, key)).partition(b"\n")
    except OSError:
        return None
    return made if told == _head(code, made) else None


def keep_shown(work: WorkFolder, task: Task, key: str, code: str, made: bytes) -> None:
    """Keep what was made of an artifact.  Raises OSError: it can be made again.

    Parameters
    ----------
    work : WorkFolder
        Where it is kept.
    task : Task
        Whose result is shown.
    key : str
        Of that result.
    code : str
        Fingerprint of the function.
    made : bytes
        By the function.
    """
    write_atomic(work.view(task, key), _head(code, made) + b"\n" + made, lasts=False, ours=True)


def _head(code: str, made: bytes) -> bytes:
    return f"{code} {digest(made)}".encode()
