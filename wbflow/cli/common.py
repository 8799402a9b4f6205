"""Arguments, options and first steps that several commands share."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ExitCode, UsageError, WbflowError, worst
from .words import say

if TYPE_CHECKING:
    import datetime

    from ..cache.layout import WorkFolder
    from ..site.models import Site

    _Type = click.ParamType[datetime.date]
    _Moment = click.ParamType[datetime.datetime]
else:
    _Type = _Moment = click.ParamType

BACKENDS = ("processes", "loky", "threading", "dask")
PATH = click.Path(path_type=Path)
site_argument = click.argument("site", metavar="SITE.yaml", type=PATH)
run_argument = click.argument("run_id", metavar="[RUN]", required=False)
work_option = click.option(
    "--work",
    metavar="DIR",
    help="Work folder, or s3://bucket/prefix (default: `work:` of the site, else .wbflow/<site>/ beside it).",
)


class Day(_Type):
    """A day: 2026-11-19, today, yesterday, or -1 (yesterday), -2, ..."""

    name = "day"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> datetime.date:
        import datetime

        if isinstance(value, datetime.date):
            return value
        today = datetime.date.today()
        if value in {"today", "yesterday"} or re.fullmatch(r"-\d{1,5}", value):
            back = int(value) if value.startswith("-") else {"today": 0, "yesterday": -1}[value]
            return today + datetime.timedelta(days=back)
        try:
            return datetime.date.fromisoformat(value)
        except ValueError:
            self.fail(f"{value!r} is no day; write 2026-11-19, yesterday, or -1", param, ctx)


class Clock(_Moment):
    """A time of day, the next that comes: 06:00."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> datetime.datetime:
        import datetime

        if isinstance(value, datetime.datetime):
            return value
        try:
            at = datetime.time.fromisoformat(value)
        except ValueError:
            self.fail(f"{value!r} is no time of day; write 06:00", param, ctx)
        now = datetime.datetime.now()
        moment = datetime.datetime.combine(now.date(), at)
        return moment if moment > now else moment + datetime.timedelta(days=1)


date_option = click.option(
    "--date", type=Day(), metavar="DAY", help="Night to work on: 2026-11-19, yesterday, -1 (default: the newest with captures)."
)
jobs_option = click.option(
    "--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, show_default="all cores", metavar="N", help="Workers."
)
json_option = click.option("--json", "as_json", is_flag=True, help="The same as JSON, and nothing else.")
verbose_option = click.option("-v", "--verbose", is_flag=True, help="Every task, and tracebacks.")
until_option = click.option("--until", metavar="STAGE", help="Stop after this stage.")
force_option = click.option(
    "--force", multiple=True, metavar="STAGE_OR_TASK", help="Do this again: `fuse`, or `'matches gate--roof'`."
)


def load(path: Path, work: str | None, notes: bool = True, look: bool = True) -> Site:
    """The site.

    Parameters
    ----------
    path : Path
        Its file.
    work : str, optional
        Another work folder, or object store, than that names.
    notes : bool
        Say what of its file is out of date (a run tells it itself, and logs it).
    look : bool
        Bring what others have done from the object store first.
    """
    from ..site.locations import SiteError

    try:
        from ..site.load import load_site

        site = load_site(path, work)
        if site.store and look:
            _look(site.work_folder)
        for note in site.notes if notes else ():
            say(f"note: {note}", err=True)
        return site
    except SiteError as error:
        count = len(error.problems)
        what = f"{error}\n{count} problem{'s' * (count != 1)} in {path}; nothing was done"
        raise UsageError(what, remedy=f"then: wbflow check {path}") from None


def _look(work: WorkFolder) -> None:
    """Bring what others have done; where the store does not answer, what is known here has to do."""
    from ..remote.courier import look
    from ..remote.objects import StoreError

    try:
        look(work)
    except StoreError as error:
        say(f"note: {error}\n  what follows is what this machine knows", err=True)


def each(sites: Sequence[Path], work: Callable[[Path], int]) -> int:
    """Do something for several sites, one after the other: the worst exit code.  What is wrong with one is said, and costs the
    others nothing; what is wrong with the only one is raised."""
    if len(sites) == 1:
        return work(sites[0])
    codes = []
    for site in sites:
        try:
            codes.append(work(site))
        except WbflowError as error:
            say(f"{site}: {error}", err=True)
            codes.append(error.exit_code)
        except Exception as error:  # a fault of ours
            say(f"{site}: wbflow itself failed: {type(error).__name__}: {error}\n  wbflow run {site} -v  shows where", err=True)
            codes.append(ExitCode.FAILED)
        if codes[-1] == ExitCode.INTERRUPTED:
            break
    return worst(codes)


def place_of(site: Site) -> WorkFolder:

    return site.work_folder


def say_json(told: Any) -> None:
    """Print for programs."""
    import json

    say(json.dumps(told, indent=1))
