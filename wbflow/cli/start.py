"""For a start, and for who looks behind it: a demo, a site file, two photographs, the stages."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import ExitCode, UsageError
from .common import PATH, jobs_option, verbose_option
from .words import say, stop

if TYPE_CHECKING:
    pass


@click.command()
@click.argument("folder", metavar="DIR", type=PATH)
@click.option("--scene", default="yard", metavar="NAME", help="yard, square, hall, hall-2, hall-4, houses, ...")
@click.option("--small", is_flag=True, help="320x180 (the yard with 4 cameras): rendered in seconds.")
@click.option("--light", type=click.Choice(["day", "dusk", "night", "dark"]), default="day", help="Hour; dark: no lamps.")
@click.option("--lenses", default="standard", metavar="KIND", help="fisheye, brown, mixed or infrared: other cameras.")
@click.option("--surfaces", default="standard", metavar="KIND", help="weak: the yard with white walls, wet asphalt and snow.")
@click.option("--cameras", type=click.IntRange(min=1), metavar="N", help="So many of the scene's cameras.")
@click.option("--seed", type=click.IntRange(min=0), default=0, metavar="N", help="Another scene of the same kind.")
@click.option("--nights", type=click.IntRange(min=1), metavar="N", help="Nights of the yard (640x360); what happens is in truth.")
@click.option("--frames", type=click.IntRange(min=1), default=3, metavar="K", help="Of each camera and night.")
def demo(
    folder: Path,
    scene: str,
    small: bool,
    light: str,
    lenses: str,
    surfaces: str,
    cameras: int | None,
    seed: int,
    nights: int | None,
    frames: int,
) -> None:
    """Render the demo site (captures, site.yaml, truth) into DIR.

    With --nights, each night has its own light and traffic; cameras are turned, covered, frozen and swapped, things appear and
    vanish, and truth/nights.json says what, where and when.

    \b
    wbflow demo yard                              eight cameras
    wbflow demo hall --scene hall-2 --light dusk
    wbflow demo wide --lenses fisheye             every second camera sees 180 degrees
    wbflow demo winter --surfaces weak            white walls, wet asphalt, snow
    wbflow demo harbour --nights 7 --small
    """
    from ..outcome.demo import write_demo, write_nights

    if nights is None:
        write_demo(folder, scene=scene, small=small, light=light, cameras=cameras, seed=seed, lenses=lenses, surfaces=surfaces)
    elif (scene, light, lenses, surfaces) != ("yard", "day", "standard", "standard"):
        raise UsageError(
            "--nights renders the yard, each night in its own light", remedy="leave out --scene, --light, --lenses and --surfaces"
        )
    else:
        write_nights(folder, nights, frames=frames, small=small, cameras=cameras, seed=seed)
    say(f"{folder / 'site.yaml'}: now try  wbflow run {folder / 'site.yaml'}")


@click.command()
@click.argument("folder", metavar="[FOLDER]", type=PATH, default=Path())
def init(folder: Path) -> None:
    """Write a site file from a folder of photographs.

    Either one photograph of each camera, or one folder for each camera with its photographs (several are several captures of
    one night). The site file is put into FOLDER (here, if none is named) as site.yaml; one that is there is left alone.

    \b
    wbflow init photographs        (photographs/gate.jpg, photographs/roof.jpg, ...)
    wbflow init photographs        (photographs/gate/1.jpg, photographs/roof/1.jpg, ...)
    """
    from ..outcome.init import write_site

    made = write_site(folder)
    say(f"{made.file}: {len(made.cameras)} cameras: {', '.join(made.cameras)}")
    for note in made.notes:
        say(note)
    say(f"now try  wbflow check {made.file}  and  wbflow run {made.file}")


@click.command()
@click.argument("left", type=PATH)
@click.argument("right", type=PATH)
@click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the results (and the cache).")
@click.option("--resolution", type=click.IntRange(min=64), default=1600, metavar="N", help="Long side in pixels to work at.")
@jobs_option
@verbose_option
def pair(left: Path, right: Path, out: Path, resolution: int, jobs: int, verbose: bool) -> None:
    """Two photographs and nothing else: matches, F, rectified pair, disparity, and a page with a picture of each step.

    \b
    wbflow pair left.jpg right.jpg --out pair
    wbflow pair left.jpg right.jpg --out pair --resolution 2400
    """
    from ..api import run as work_through
    from ..outcome.pair import LAST_STAGE, failure, pair_site, write_pair
    from .watch import watching

    site = pair_site(left, right, out, resolution)
    with watching(site.name, verbose) as watch:
        finished = work_through(site, jobs=jobs, until=LAST_STAGE, listen=watch.hear, watch=watch.hear).finished
    for file in write_pair(finished, out):
        say(file)
    if why := failure(finished):
        stop(ExitCode.FAILED, f"no disparity: {why}")


@click.command()
@click.argument("stage", metavar="[STAGE]", required=False)
def stages(stage: str | None) -> None:
    """Every parameter of every stage, with default, unit and meaning; of one stage, if it is named.

    \b
    wbflow stages
    wbflow stages disparity
    """
    from ..cache.functions import FunctionReader
    from ..pipeline.describe import describe, describe_all, lines
    from ..pipeline.stages import STAGES

    chosen = [row for row in STAGES if row.name == stage]
    if stage and not chosen:
        remedy = f"wbflow stages  shows all; there are {', '.join(row.name for row in STAGES)}"
        raise UsageError(f"there is no stage {stage!r}", remedy=remedy)
    reader = FunctionReader()
    rows = [describe(row, reader) for row in chosen] or describe_all(reader)
    say("\n\n".join("\n".join(lines(row)) for row in rows))
