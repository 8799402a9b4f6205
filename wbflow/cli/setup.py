"""Commands to get started: demo, site file, editor, pair of photographs, lens calibration, and the stages' parameters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from wbflow_stages.contracts.defaults import RESOLUTION

from ..errors import ExitCode, UsageError
from .common import PATH, echo, echo_json, jobs_option, load, site_argument, stop, verbose_option, work_option
from .observe import board_fields, board_options

_DEFAULTS = {"scene": "yard", "light": "day", "lenses": "standard", "surfaces": "standard"}
"""Options that --nights does not take, with their defaults."""


@click.command()
@click.argument("folder", metavar="DIR", type=PATH)
@click.option("--scene", default="yard", metavar="NAME", help="yard, square or carpark.")
@click.option("--small", is_flag=True, help="320x180 (the yard with 4 cameras): rendered in seconds.")
@click.option("--light", type=click.Choice(["day", "dusk", "night", "dark"]), default="day", help="Time of day; dark: no lamps.")
@click.option("--lenses", default="standard", metavar="KIND", help="fisheye, brown or mixed: other cameras.")
@click.option("--surfaces", default="standard", metavar="KIND", help="weak: the yard with white walls, wet asphalt and snow.")
@click.option("--cameras", type=click.IntRange(min=1), metavar="N", help="Number of cameras.")
@click.option("--seed", type=click.IntRange(min=0), default=0, metavar="N", help="Seed of the scene.")
@click.option("--nights", type=click.IntRange(min=1), metavar="N", help="Render nights of the yard (640x360).")
@click.option("--frames", type=click.IntRange(min=1), default=3, metavar="K", help="Frames of each camera and night.")
@click.option("--walk", is_flag=True, help="The yard without poses, and recordings of a lamp that is carried through it.")
def demo(folder: Path, nights: int | None, frames: int, walk: bool, **options: Any) -> None:
    """Render the demo site (captures, site.yaml, truth) into DIR.

    With --nights, each night has its own light and traffic; cameras are turned, covered, frozen and swapped, things appear and
    vanish, and truth/nights.json says what, where and when.

    \b
    wbflow demo yard                              eight cameras
    wbflow demo market --scene square --light dusk
    wbflow demo wide --lenses fisheye             every second camera sees 180 degrees
    wbflow demo winter --surfaces weak            white walls, wet asphalt, snow
    wbflow demo harbour --nights 7 --small
    wbflow demo new --walk                        no poses: wbflow observe new/site.yaml new/walk/night
    """
    from ..commands.demo import write_demo

    if nights is None:
        write_demo(folder, walk=walk, **options)
    elif walk:
        raise UsageError("--nights has no walk", remedy="leave out --nights or --walk")
    elif tuple(options.pop(name) for name in _DEFAULTS) != tuple(_DEFAULTS.values()):
        remedy = "leave out --scene, --light, --lenses and --surfaces"
        raise UsageError("--nights renders the yard, each night in its own light", remedy=remedy)
    else:
        write_demo(folder, nights=nights, frames=frames, **options)
    command = f"wbflow run {folder / 'site.yaml'}"
    if walk:
        command = f"wbflow observe {folder / 'site.yaml'} {folder / 'walk' / 'night'}"
    echo(f"{folder / 'site.yaml'}: now try  {command}")


@click.command()
@click.argument("folder", metavar="[FOLDER]", type=PATH, default=Path())
@click.option("--out", type=PATH, metavar="DIR", help="Folder for the site file (default: FOLDER); results go there, too.")
@click.option("--systemd", is_flag=True, help="For an existing site: write a systemd service and timer that run it every night.")
def init(folder: Path, out: Path | None, systemd: bool) -> None:
    """Write a site file for a folder of photographs.

    FOLDER (this one, if none is named) holds one photograph of each camera, or one folder for each camera with its photographs
    (several are several captures of one night). The site file is FOLDER/site.yaml; one that exists is left alone.

    \b
    wbflow init photographs        (photographs/gate.jpg, photographs/roof.jpg, ...)
    wbflow init photographs        (photographs/gate/1.jpg, photographs/roof/1.jpg, ...)
    wbflow init /mnt/recorder --out harbour      photographs on a disk that cannot be written
    wbflow init /srv/harbour --systemd
    """
    if systemd:
        from ..commands.init import write_units

        units = write_units(load(folder, None))
        echo("\n".join(map(str, units)))
        echo(f"now try  sudo systemctl link {' '.join(map(str, units))}  and  sudo systemctl enable --now {units[-1].name}")
        return
    from ..commands.init import write_site

    file, cameras, note = write_site(folder, out)
    echo(f"{file}: {len(cameras)} cameras: {', '.join(cameras)}")
    if note:
        echo(note)
    echo(f"now try  wbflow check {file}  and  wbflow run {file}")


@click.command()
@site_argument
@work_option
def edit(site: Path, work: str | None) -> None:
    """Draw masks, polygons, zones and control points.  The page is served on this machine only.

    Open the address that is printed; the page is not accessible without it.  It writes the site file, with its comments, when you
    save, and shows captures unmasked, including private areas.

    \b
    wbflow edit site.yaml
    ssh -L PORT:127.0.0.1:PORT station     from another machine, with the port of the address
    """
    import contextlib

    from ..edit.server import EditServer
    from ..edit.session import Session

    with EditServer(Session(load(site, work))) as server, contextlib.suppress(KeyboardInterrupt):
        # wbflow does not start the browser itself: other users of this machine can read the arguments of processes
        echo(f"{server.address}\nopen this in a browser on this machine; Ctrl-C, or Done in the page, ends it")
        server.serve_forever()


@click.command()
@click.argument("left", type=PATH)
@click.argument("right", type=PATH)
@click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the results (and the cache).")
@click.option(
    "--resolution", type=click.IntRange(min=64), default=RESOLUTION, metavar="N", help="Long side in pixels to work at."
)
@jobs_option
@verbose_option
def pair(left: Path, right: Path, out: Path, resolution: int, jobs: int, verbose: bool) -> None:
    """Process two photographs without a site.  Writes matches, F, rectified pair, disparity, and a page that shows each step.

    \b
    wbflow pair left.jpg right.jpg --out pair
    wbflow pair left.jpg right.jpg --out pair --resolution 2400
    """
    from ..api import run
    from ..commands.pair import LAST_STAGE, failure, pair_site, write_pair
    from .display import display

    site = pair_site(left, right, out, resolution)
    with display(site.name, verbose) as progress:
        finished = run(site, jobs=jobs, until=LAST_STAGE, listen=progress.receive)
    for file in write_pair(finished, out):
        echo(file)
    reason = failure(finished)
    if reason:
        stop(ExitCode.FAILED, f"no disparity: {reason}")


@click.command()
@click.argument("camera", metavar="CAMERA")
@click.argument("pictures", metavar="PICTURES", type=PATH)
@board_options(required=True)
@click.option(
    "--model",
    type=click.Choice(["brown", "rational", "fisheye", "division", "fov", "eucm", "double-sphere"]),
    default="brown",
    help="Lens model; fisheye: for wide lenses.",
)
@click.option("--out", type=PATH, default=Path(), metavar="DIR", help="Folder for CAMERA.json and CAMERA-coverage.png.")
def calibrate(camera: str, pictures: Path, model: str, out: Path, **board: Any) -> None:
    """Calibrate a lens from pictures of a board.  PICTURES is a folder of photographs, or a video.

    Writes CAMERA.json, which a site file's `calibration:` takes, with the residuals of each picture, and a plot of where corners
    were seen: the model holds only there.

    \b
    wbflow calibrate gate photographs --board 9x6 --square 0.03
    wbflow calibrate dome board.mp4 --board 8x11 --marker 0.02 --square 0.03 --model fisheye
    """
    from ..commands.init import write_calibration

    files, notes = write_calibration(camera, pictures, board_fields(**board), model, out)
    echo("\n".join([*map(str, files), *notes]))


@click.command()
@click.argument("stage", metavar="[STAGE]", required=False)
def stages(stage: str | None) -> None:
    """List the parameters of stages.  Each with default, unit and meaning.

    \b
    wbflow stages
    wbflow stages disparity
    """
    from ..pipeline.functions import FunctionReader
    from ..pipeline.parameter_docs import describe
    from ..pipeline.stages import STAGES

    chosen = [row for row in STAGES if row.name == stage]
    if stage and not chosen:
        remedy = f"wbflow stages  shows all; there are {', '.join(row.name for row in STAGES)}"
        raise UsageError(f"there is no stage {stage!r}", remedy=remedy)
    reader = FunctionReader()
    for number, row in enumerate(chosen or STAGES):
        if number:
            echo("")
        echo("\n".join(describe(row, reader)))


@click.command()
def schema() -> None:
    """Print the JSON schema of a site file.  Editors complete and check keys with it.

    \b
    wbflow schema > site.schema.json
    # yaml-language-server: $schema=site.schema.json      (first line of a site file)
    """
    from ..site.models import site_schema

    echo_json(site_schema())
