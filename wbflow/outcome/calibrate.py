"""`wbflow calibrate`: a calibration file made from pictures of a board."""

from __future__ import annotations

from pathlib import Path

from ..cache.atomic import write_atomic
from ..cache.untrusted import Unreadable, read_outside
from ..errors import UsageError
from ..site.locations import is_name
from .artifacts import function

FILES = "wbflow_stages.board:board_files"
MOST_BYTES = 1_000_000_000


def write_calibration(
    camera: str, pictures: Path, board: dict[str, float | str], model: str, out: Path
) -> tuple[list[Path], list[str]]:
    """Write the calibration of a camera and the plot of its coverage; which files, and what to say.

    Parameters
    ----------
    camera : str
        Its id.
    pictures : Path
        A folder of photographs, or a video.
    board : dict
        The board's fields by name.
    model : str
        Of the lens.
    out : Path
        The folder for the files.

    Raises
    ------
    UsageError
        There are no pictures, or they do not show the board well enough.
    """
    if not is_name(camera):
        raise UsageError(f"{camera!r} is not a camera id", remedy="use letters, digits, '_', '.', '-'")
    files = sorted(file for file in pictures.iterdir() if file.is_file()) if pictures.is_dir() else [pictures]
    try:
        data = {file.name: read_outside(file, MOST_BYTES) for file in files}
    except Unreadable as error:
        raise UsageError(f"{pictures}: {error.what}", remedy="name a folder of photographs, or a video") from None
    try:
        made, words = function(FILES)(camera, data, board, model)
    except ValueError as error:
        remedy = "5 sharp pictures and more, with the board near, far, turned, and in every corner of the picture"
        raise UsageError(f"{pictures}: {error}", remedy=remedy) from None
    for name, content in made.items():
        write_atomic(out / name, content)
    return [out / name for name in made], words
