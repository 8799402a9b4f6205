"""Options and arguments that several commands share, loading the site, and printing."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from ..errors import ExitCode, UsageError, printable

if TYPE_CHECKING:
    import datetime

    from ..cache.layout import WorkFolder
    from ..site.models import Site

    _DateType = click.ParamType[datetime.date]
    _TimeType = click.ParamType[datetime.datetime]
else:
    _DateType = _TimeType = click.ParamType

LONGEST_TEXT = 100_000_000
"""Characters that are printed at once: run.json is, as a whole."""


class Day(_DateType):
    """A day: 2026-11-19, today, yesterday, or -1 (yesterday), -2, ..."""

    name = "day"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> datetime.date:
        import datetime

        if isinstance(value, datetime.date):
            return value
        today = datetime.date.today()
        if value in {"today", "yesterday"} or re.fullmatch(r"-\d{1,5}", value):
            offset = int(value) if value.startswith("-") else {"today": 0, "yesterday": -1}[value]
            return today + datetime.timedelta(days=offset)
        try:
            return datetime.date.fromisoformat(value)
        except ValueError:
            self.fail(f"{value!r} is no day; write 2026-11-19, yesterday, or -1", param, ctx)


class Clock(_TimeType):
    """The next time that the clock shows 06:00."""

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> datetime.datetime:
        import datetime

        if isinstance(value, datetime.datetime):
            return value
        try:
            time = datetime.time.fromisoformat(value)
        except ValueError:
            self.fail(f"{value!r} is no time of day; write 06:00", param, ctx)
        now = datetime.datetime.now()
        moment = datetime.datetime.combine(now.date(), time)
        return moment if moment > now else moment + datetime.timedelta(days=1)


PATH = click.Path(path_type=Path)
site_argument = click.argument("site", metavar="SITE.yaml", type=PATH)
sites_argument = click.argument("sites", metavar="SITE.yaml...", type=PATH, nargs=-1, required=True)
run_argument = click.argument("run_id", metavar="[RUN]", required=False)
work_option = click.option(
    "--work",
    metavar="DIR",
    help="Work folder, or s3://bucket/prefix (default: `work:` of the site, else .wbflow/<site>/ beside it).",
)
out_option = click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the files.")
date_option = click.option(
    "--date", type=Day(), metavar="DAY", help="Night to work on: 2026-11-19, yesterday, -1 (default: the newest with captures)."
)
jobs_option = click.option(
    "--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, show_default="all cores", metavar="N", help="Workers."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON, and nothing else.")
verbose_option = click.option("-v", "--verbose", is_flag=True, help="Print every task, and tracebacks.")
until_option = click.option("--until", metavar="STAGE", help="Stop after this stage.")


def load(path: Path, work: str | None, notes: bool = True, pull: bool = True) -> Site:
    """Load a site.

    Parameters
    ----------
    path : Path
        Its file, or the folder of a `site.yaml`.
    work : str, optional
        A work folder, or object store, instead of the one that the file names.
    notes : bool
        Print what is out of date in the file (a run reports that itself).
    pull : bool
        Bring the runs of other machines from the object store first.
    """
    from ..site.load import load_site
    from ..site.locations import SiteError

    try:
        site = load_site(path, work)
    except SiteError as error:
        count = len(error.problems)
        what = f"{error}\n{count} problem{'s' * (count != 1)} in {path}; nothing was done"
        raise UsageError(what, remedy=f"then: wbflow check {path}") from None
    if site.work_folder.store and pull:
        _pull(site.work_folder)
    for note in site.notes if notes else ():
        echo(f"note: {note}", err=True)
    return site


def _pull(work: WorkFolder) -> None:
    from ..records.run_folder import refresh
    from ..remote import StoreError

    try:
        refresh(work)
    except StoreError as error:
        echo(f"note: {error}\n  only what this machine knows is shown", err=True)


def echo(text: object, err: bool = False) -> None:
    """Print text with its control characters escaped.

    A reader that has gone away (`wbflow run ... | head -1`) costs the output, not the night's work.
    """
    try:
        click.echo(printable(text, LONGEST_TEXT), err=err)
    except BrokenPipeError:
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), (sys.stderr if err else sys.stdout).fileno())


def echo_json(data: Any) -> None:
    """Print JSON."""
    import json

    echo(json.dumps(data, indent=1))


def stop(code: ExitCode, message: str) -> NoReturn:
    """Print a last message (on stderr, unless all is well), and exit."""
    echo(message, err=code is not ExitCode.GOOD)
    sys.exit(code)
