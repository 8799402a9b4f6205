"""Pictures of artifacts, and what they were drawn by: a repaired picture function reaches artifacts that are cached.

cache/<stage>/<subject>/<key>.jpg      the picture
cache/<stage>/<subject>/<key>.drawn    what determined it, and why there is none where it could not be drawn
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from .atomic import write_atomic


@dataclass(frozen=True)
class Drawing:
    """What became of a picture."""

    digest: str
    """Of all that determines it."""
    failure: str | None = None
    """Why it could not be drawn."""


def read_drawing(folder: Path, key: str) -> Drawing | None:
    """What became of the picture of an artifact in its cache folder; None where nobody has tried."""
    try:
        return Drawing(**json.loads((folder / f"{key}.drawn").read_bytes()))
    except (OSError, ValueError, TypeError):
        return None


def write_drawing(folder: Path, key: str, drawing: Drawing, picture: bytes | None) -> None:
    """Keep a picture, or that there is none."""
    file = folder / f"{key}.jpg"
    if picture is None:
        file.unlink(missing_ok=True)
    else:
        write_atomic(file, picture, settle=False)
    write_atomic(folder / f"{key}.drawn", json.dumps(asdict(drawing)).encode(), settle=False)
