"""For lenses: a calibration from pictures of a board."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import UsageError
from .common import PATH
from .words import say


@click.command()
@click.argument("camera", metavar="CAMERA")
@click.argument("pictures", metavar="PICTURES", type=PATH)
@click.option("--board", required=True, metavar="9x6", help="Inner corners of a checkerboard; squares of a ChArUco board.")
@click.option("--square", type=click.FloatRange(min=0, min_open=True), default=1.0, metavar="M", help="Edge of a square.")
@click.option("--marker", type=click.FloatRange(min=0), default=0.0, metavar="M", help="Edge of a marker: a ChArUco board.")
@click.option(
    "--dictionary",
    type=click.Choice([f"{n}X{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)]),
    default="4X4_50",
    metavar="NAME",
    help="Of its markers: 4X4_50 to 7X7_1000.",
)
@click.option(
    "--model",
    type=click.Choice(["brown", "rational", "fisheye", "division", "fov", "eucm", "double-sphere"]),
    default="brown",
    help="Of the lens; fisheye: of wide ones.",
)
@click.option("--out", type=PATH, default=Path(), metavar="DIR", help="Folder for CAMERA.json and CAMERA-coverage.png.")
def calibrate(
    camera: str, pictures: Path, board: str, square: float, marker: float, dictionary: str, model: str, out: Path
) -> None:
    """Find the lens of CAMERA from PICTURES of a board: a folder of photographs, or a video.

    Writes CAMERA.json, which a site file's `calibration:` takes, with the residuals of each picture, and a plot of where corners
    were seen: the lens is only known there.

    \b
    wbflow calibrate gate photographs --board 9x6 --square 0.03
    wbflow calibrate dome board.mp4 --board 8x11 --marker 0.02 --square 0.03 --model fisheye
    """
    from ..outcome.calibrate import write_calibration

    columns, cross, rows = board.partition("x")
    if not (cross and columns.isdigit() and rows.isdigit() and 2 < int(columns) < 100 and 2 < int(rows) < 100):
        raise UsageError(f"{board!r} is no board", remedy="give columns x rows, such as --board 9x6")
    if marker >= square:
        raise UsageError(f"a marker of {marker:g} does not fit in a square of {square:g}", remedy="give both in the same unit")
    fields: dict[str, float | str] = {"columns": int(columns), "rows": int(rows), "square": square, "marker": marker}
    written, words = write_calibration(camera, pictures, fields | {"dictionary": dictionary}, model, out)
    say("\n".join([*map(str, written), *words]))
