"""Looking behind, and over all: one task alone, the runs of several sites."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import UsageError
from .common import PATH, date_option, json_option, load, place_of, say_json, work_option
from .words import say

if TYPE_CHECKING:
    import datetime


@click.command()
@click.argument("words", metavar="[SITE.yaml] TASK", nargs=-1, required=True)
@click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the files.")
@date_option
@work_option
def debug(words: tuple[str, ...], out: Path, date: datetime.date | None, work: str | None) -> None:
    """One task's inputs as ordinary files, its parameters, and a short script that runs it alone.

    A task is a stage and what it works on. Images are PNG, tables CSV, clouds PLY, other arrays npy; task.json says where each
    is. The site is the one in this folder, if none is named.

    \b
    wbflow debug site.yaml 'disparity gate--roof' --out look
    wbflow debug site.yaml frames gate --date yesterday --out look
    python look/run.py          what it makes, and whether the cache has the same bytes
    """
    from ..outcome.artifacts import task_named
    from ..outcome.debug import write_task
    from ..pipeline.stages import STAGES

    stages = {row.name for row in STAGES}
    named = " ".join(words).split(" ")
    site = Path() if named[0] in stages else Path(words[0])
    task = " ".join(named if named[0] in stages else words[1:])
    if not task:
        raise UsageError("name a task", remedy=f"for example: wbflow debug {site} 'frames CAMERA' --out {out}")
    files = write_task(load(site, work), task_named(task), out, date)
    for file in files:
        say(file)
    say(f"now try  python {files[0]}")


@click.command()
@click.argument("sites", metavar="SITE.yaml...", type=PATH, nargs=-1, required=True)
@json_option
def runs(sites: tuple[Path, ...], as_json: bool) -> None:
    """Where the runs of one or several sites lie, for programs: folder, night, verdict, cloud, report.

    \b
    wbflow runs site.yaml --json
    wbflow runs sites/*.yaml
    """
    from ..outcome.history import places

    found = [(site, entry) for path in sites for site in [load(path, None)] for entry in places(place_of(site))]
    if as_json:
        say_json([{"site": site.name, **entry} for site, entry in found])
        return
    for site, entry in found:
        points = f"{entry['points']:,}" if entry["points"] else "-"
        gone = "" if entry["folder"] else "  cleaned"
        level = entry["level"] or "-"
        say(f"{site.name:20} {entry['night']} {level:9} {points:>11}  {entry['folder'] or entry['run']}{gone}")


@click.command("site-report")
@click.argument("sites", metavar="SITE.yaml...", type=PATH, nargs=-1, required=True)
@click.option("--out", type=PATH, default=Path("sites.html"), metavar="FILE", help="The page.")
def site_report(sites: tuple[Path, ...], out: Path) -> None:
    """One page over several sites and their last nights, with links to the reports.

    SITE.yaml may be a folder: then all site files in it, and in the folders in it, are meant.

    \b
    wbflow site-report /srv/sites --out /srv/www/sites.html
    wbflow site-report harbour/site.yaml yard/site.yaml
    """
    from ..cache.atomic import write_atomic
    from ..report.sites import page, site_files

    if not site_files(sites):
        raise UsageError(f"there is no site file in {', '.join(map(str, sites))}", remedy="name site files, or a folder of them")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(out, page(sites, out).encode(errors="backslashreplace"))
    say(out)
