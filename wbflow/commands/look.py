"""Looking behind: one task alone, the runs of several sites."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import UsageError
from ..screen import say
from .common import PATH, date_option, load, work_option

if TYPE_CHECKING:
    import datetime


@click.command()
@click.argument("words", metavar="[SITE.yaml] TASK", nargs=-1, required=True)
@click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the files.")
@date_option
@work_option
def debug(words: tuple[str, ...], out: Path, date: datetime.date | None, work: Path | None) -> None:
    """One task's inputs as ordinary files, its parameters, and a short script that runs it alone.

    A task is a stage and what it works on. Images are PNG, tables CSV, clouds PLY, other arrays npy; task.json says where each
    is. The site is the one in this folder, if none is named.

    \b
    wbflow debug site.yaml 'disparity gate--roof' --out look
    wbflow debug site.yaml frames gate --date yesterday --out look
    python look/run.py          what it makes, and whether the cache has the same bytes
    """
    from ..graph.pipeline import STAGES
    from ..results.artifacts import task_named
    from ..results.debug import write_task

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
