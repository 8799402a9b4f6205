"""Shared options and arguments of commands, loading of sites, and printing."""

from __future__ import annotations

import datetime
import os
import re
import shutil
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from ..errors import ExitCode, UsageError
from ..words import counted, printable

if TYPE_CHECKING:
    from ..site.models import Site

LONGEST_TEXT = 100_000_000
"""Most characters that are printed at once; it must hold a whole run.json."""
LEAST_COLUMNS = 80
"""Narrower terminals wrap lines themselves."""
LEVEL_COLOURS = {"good": "green", "degraded": "yellow", "failed": "red"}
"""Colours of the levels of verdicts on a terminal."""

Day = datetime.date | int
"""A date, or an offset in days from today, which is resolved later because today depends on the site's time zone."""


def day(text: str) -> Day:
    """Parse a day: 2026-11-19, today, yesterday, or -1 (yesterday), -2, ..."""
    offsets = {"today": 0, "yesterday": -1}
    if text in offsets:
        return offsets[text]
    if re.fullmatch(r"-\d{1,5}", text):
        return int(text)
    try:
        return datetime.date.fromisoformat(text)
    except ValueError:
        raise click.BadParameter(f"{text!r} is no day; write 2026-11-19, yesterday, or -1") from None


def date_at(site: Site, given: Day | None) -> datetime.date | None:
    """Return the date that a day means at a site; None for None."""
    if isinstance(given, int):
        return site.today() + datetime.timedelta(days=given)
    return given


def next_time(text: str) -> datetime.datetime:
    """Parse a time of day such as 06:00, and return its next occurrence (local time)."""
    try:
        moment = datetime.datetime.combine(datetime.date.today(), datetime.time.fromisoformat(text))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a time of day; write 06:00") from None
    if moment > datetime.datetime.now():
        return moment
    return moment + datetime.timedelta(days=1)


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
    "--date", type=day, metavar="DAY", help="Night to work on: 2026-11-19, yesterday, -1 (default: the newest with captures)."
)
jobs_option = click.option(
    "--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, show_default="all cores", metavar="N", help="Workers."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON, and nothing else.")
verbose_option = click.option("-v", "--verbose", is_flag=True, help="Print every task, and tracebacks.")
until_option = click.option("--until", metavar="STAGE", help="Stop after this stage.")


def load(path: Path, work: str | None, for_run: bool = False) -> Site:
    """Load a site from its file, or from a folder with a `site.yaml`.

    work: a work folder or object store that replaces the one in the file.  for_run: skip the notes on obsolete names in the file,
    and the download of other machines' runs from the object store, since a run does both itself.
    """
    from ..records.run_folder import refresh
    from ..remote import StoreError
    from ..site.load import load_site
    from ..site.yaml_document import SiteError

    try:
        site = load_site(path, work)
    except SiteError as error:
        if not any(problem.line for problem in error.problems):  # there is no file, or none that can be read
            raise
        what = f"{error}\n{counted(len(error.problems), 'problem')} in {path}; nothing was done"
        raise UsageError(what, remedy=f"then: wbflow check {path}") from None
    if for_run:
        return site
    try:
        refresh(site.work_folder)
    except StoreError as error:
        echo(f"note: {error}\n  only what is on this machine is shown", err=True)
    for note in site.notes:
        echo(f"note: {note}", err=True)
    return site


def columns(err: bool = False) -> int:
    """Return how many columns lines may have: those of the terminal, at least 80; in a pipe or a file, any number.

    err: of stderr instead of stdout.  The environment variable COLUMNS replaces the terminal's number.
    """
    stream = sys.stdout
    if err:
        stream = sys.stderr
    if not stream.isatty() and "COLUMNS" not in os.environ:
        return LONGEST_TEXT
    return max(LEAST_COLUMNS, shutil.get_terminal_size().columns)


def fitted(line: str, most: int) -> str:
    """Return a line with at most this many characters; the end of a longer one is left out."""
    if len(line) <= most:
        return line
    return f"{line[: most - 3].rstrip()}..."


def echo(text: object, err: bool = False, *, level: str = "", indent: int | None = None, fold: bool = False) -> None:
    """Print text with its control characters escaped.

    If the reader has closed the pipe (`wbflow run ... | head -1`), further output is dropped and the run continues.

    Parameters
    ----------
    text, err : object, bool
        The text; whether it goes to stderr.
    level : str
        Level of a verdict, in whose colour a terminal shows the text; "" for none.
    indent : int, optional
        Wrap a line that is longer than the terminal; the lines after the first have so many spaces before them.
    fold : bool
        Leave out the end of a line that is longer than the terminal.
    """
    shown = printable(text, LONGEST_TEXT)
    if fold:
        shown = fitted(shown, columns(err))
    if indent is not None:
        own_indent = " " * (len(shown) - len(shown.lstrip(" ")))
        lines = textwrap.wrap(
            shown.strip(),
            columns(err),
            initial_indent=own_indent,
            subsequent_indent=" " * indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        shown = "\n".join(lines)
    if level in LEVEL_COLOURS and "NO_COLOR" not in os.environ:
        shown = click.style(shown, fg=LEVEL_COLOURS[level])
    try:
        click.echo(shown, err=err)
    except BrokenPipeError:
        # Python itself would complain at its end: what it still has to write goes nowhere
        with Path(os.devnull).open("w") as null_file:
            os.dup2(null_file.fileno(), (sys.stderr if err else sys.stdout).fileno())


def echo_json(data: Any) -> None:
    """Print JSON."""
    import json

    echo(json.dumps(data, indent=1))


def stop(code: ExitCode, message: str) -> NoReturn:
    """Print a last message (on stdout if the code is GOOD, else on stderr), and exit."""
    echo(message, err=code is not ExitCode.GOOD)
    sys.exit(code)
