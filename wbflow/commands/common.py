"""Arguments, options and first steps that several commands share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import UsageError
from ..screen import say

if TYPE_CHECKING:
    import datetime

    from ..config.site import Site
    from ..store.layout import WorkFolder

BACKENDS = ("processes", "loky", "threading", "dask")
PATH = click.Path(path_type=Path)
site_argument = click.argument("site", metavar="SITE.yaml", type=PATH)
run_argument = click.argument("run_id", metavar="[RUN]", required=False)
work_option = click.option(
    "--work", type=PATH, metavar="DIR", help="Work folder (default: `work:` of the site, else .wbflow/<site>/ beside it)."
)
date_option = click.option(
    "--date", type=click.DateTime(["%Y-%m-%d"]), help="Night to work on (default: the newest that has captures)."
)
jobs_option = click.option(
    "--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, metavar="N", help="Workers (default: all cores)."
)
verbose_option = click.option("-v", "--verbose", is_flag=True, help="Every task, and tracebacks.")
until_option = click.option("--until", metavar="STAGE", help="Stop after this stage.")
force_option = click.option(
    "--force", multiple=True, metavar="STAGE_OR_TASK", help="Do this again: `fuse`, or `'matches gate--roof'`."
)


def day_of(date: datetime.datetime | None) -> datetime.date | None:
    return date.date() if date else None


def load(path: Path, work: Path | None, notes: bool = True) -> Site:
    """The site; notes: say what of its file is out of date (a run tells it itself, and logs it)."""
    from ..config.load import load_site
    from ..config.positions import SiteError

    try:
        site = load_site(path, work.resolve() if work else None)
        for note in site.notes if notes else ():
            say(f"note: {note}", err=True)
        return site
    except SiteError as error:
        count = len(error.problems)
        raise UsageError(f"{error}\n{count} problem{'s' * (count != 1)} in {path}; nothing was done") from None


def place_of(site: Site) -> WorkFolder:
    from ..store.layout import WorkFolder

    return WorkFolder(site.work)
