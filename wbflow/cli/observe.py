"""`wbflow observe`, and the options that describe a board."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ..errors import UsageError
from .common import PATH, echo, echo_json, json_option, load, site_argument, work_option


def board_options(required: bool) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The options that describe a board.  required: must a board be given?"""
    length = click.FloatRange(min=0)
    edge = click.FloatRange(min=0, min_open=True)
    dictionaries = "Dictionary of the markers: 4X4_50 to 7X7_1000, APRILTAG_36h11 and so on."
    corners = "Inner corners of a checkerboard; squares of a ChArUco board."
    options = [
        click.option("--board", required=required, metavar="9x6", help=corners),
        click.option("--square", type=edge, default=1.0, metavar="M", help="Edge of a square."),
        click.option("--marker", type=length, default=0.0, metavar="M", help="Edge of a marker, for a ChArUco board."),
        click.option("--dictionary", default="4X4_50", metavar="NAME", help=dictionaries),
    ]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def board_fields(board: str, square: float, marker: float, dictionary: str) -> dict[str, float | str]:
    """The fields of a board by name.  Raises UsageError.

    Parameters
    ----------
    board, square, marker, dictionary : str, float, float, str
        Values of the options.
    """
    counts = re.fullmatch(r"(\d+)x(\d+)", board)
    columns = 0
    rows = 0
    if counts:
        columns = int(counts[1])
        rows = int(counts[2])
    if not (2 < columns < 100 and 2 < rows < 100):
        raise UsageError(f"{board!r} is not a board", remedy="give columns x rows, such as --board 9x6")
    if marker >= square:
        raise UsageError(f"a marker of {marker:g} does not fit in a square of {square:g}", remedy="give both in the same unit")
    return {"columns": columns, "rows": rows, "square": square, "marker": marker, "dictionary": dictionary}


@click.command()
@site_argument
@click.argument("recordings", metavar="[RECORDINGS]...", nargs=-1)
@board_options(required=False)
@click.option("--times", type=PATH, metavar="FILE", help="Table of camera, frame, seconds, if the videos tell no times.")
@click.option("--out", type=PATH, metavar="DIR", help="Folder for pictures and cameras.json (default: in the work folder).")
@click.option("--wait", is_flag=True, help="Wait for a run of the same site to end.")
@work_option
@json_option
def observe(
    site: Path,
    recordings: tuple[str, ...],
    times: Path | None,
    out: Path | None,
    wait: bool,
    work: str | None,
    as_json: bool,
    **board: Any,
) -> None:
    """Place cameras by a lamp or a board that is carried through their views.

    RECORDINGS are short videos of all cameras at the same time: files named after their camera (gate.mp4), CAMERA=FILE, or a
    folder of such. What is seen is written to observations.csv beside the site file, which then names it; a picture for each
    camera shows it. Without recordings, the observations that the site file names are solved again.

    \b
    wbflow observe site.yaml walk/                                    a lamp, at night
    wbflow observe site.yaml gate=a.mp4 roof=b.mp4 --board 4x5 --square 0.054 --marker 0.04
    wbflow observe site.yaml                                          the tables of the site file
    """
    from ..commands.observe import place_cameras, report_lines

    loaded = load(site, work)
    files: list[Path] = []
    lines: list[str] = []
    if recordings:
        from ..commands.recordings import read_times, recordings_of, summary_line, write_observations

        found = recordings_of(loaded, recordings)
        lines.append(summary_line(found, loaded))
        fields = None
        if board["board"]:
            fields = board_fields(**board)
        by_camera = {}
        if times is not None:
            by_camera = read_times(times)
        files, said = write_observations(loaded, found, fields, by_camera, out or loaded.work_folder.observed)
        lines += said
        loaded = load(site, work)
    placed = place_cameras(loaded, out, wait)
    if placed.file:
        files.append(placed.file)
    if as_json:
        echo_json({**placed.to_json(), "files": [str(file) for file in files], "messages": lines})
        sys.exit(placed.exit_code)
    for line in (*lines, *report_lines(loaded, placed.summary)):
        echo(line, indent=2)
    for file in files:
        echo(file)
    if placed.file:
        echo(f"now try  wbflow run {site}")
    sys.exit(placed.exit_code)
