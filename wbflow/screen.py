"""What the command line says while a run works, and at its end."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from .errors import ExitCode, printable

LONGEST_WORDS = 100_000_000
"""Characters that are said at once: run.json as a whole is."""

if TYPE_CHECKING:
    from .api import Run
    from .config.site import Site
    from .store.events import Event, Listener
    from .store.record import RunRecord


def listener(site: Site, verbose: bool, quiet: bool) -> Listener:
    """What is said of events: failures, rejections and warnings, everything with -v; a counter where somebody watches.

    quiet: warnings only; what failed is among the findings, at the end.
    """
    from .store.events import WarningEvent

    watched = sys.stderr.isatty() and not quiet
    count = 0

    def listen(event: Event) -> None:
        nonlocal count
        if watched:
            _echo("\r\x1b[K", nl=False, err=True)
        if isinstance(event, WarningEvent):
            say(f"warning: {event}", err=True)
        else:
            count += 1
            failed = event.outcome == "failed"
            if verbose or ((failed or event.outcome == "rejected") and not quiet):
                subject = "--".join(event.task.subject) or site.name
                line = f"{subject:20} {event.task.stage:10} {event.outcome:9} {event.reason or ''}"
                say(line.rstrip(), err=failed)
        if event.trace and verbose:
            say(event.trace, err=True)
        if watched:
            say(f"{count} tasks, last {event.task}", nl=False, err=True)

    return listen


LEVELS = {
    "good": "good: nothing to look at",
    "degraded": "degraded: a cloud was made, but look at this",
    "failed": "failed",
}
"""The verdict's levels in words."""

MOST_FINDINGS = 20
"""So many are said; the report has all."""


def findings(record: RunRecord) -> None:
    """What is to be looked at, and what to do about it: on stderr, so that cron sends it to somebody."""
    verdict = record.verdict
    if verdict is None or (verdict.good and not verdict.findings):
        return
    say(f"{record.site}, night of {record.date}: {LEVELS[verdict.level]}", err=True)
    shown = verdict.findings[:MOST_FINDINGS]
    for finding, following in zip(shown, [*shown[1:], None], strict=True):
        say(f"  {finding}", err=True)
        if finding.remedy and not (following and following.remedy == finding.remedy):  # said once, after those it is for
            say(f"    {finding.remedy}", err=True)
    if (left := len(verdict.findings) - MOST_FINDINGS) > 0:
        say(f"  and {left} more: the report has them", err=True)


def summary(finished: Run) -> None:
    """What a run came to, in three lines."""
    record, paths = finished.record, finished.finished.folder.paths
    if sys.stderr.isatty():
        _echo("\r\x1b[K", nl=False, err=True)
    tasks = ", ".join(f"{count} {name}" for name, count in record.tasks.to_json().items() if count)
    say(f"{tasks or 'nothing to do'}; {record.seconds.wall:.1f} s, {record.seconds.cpu:.1f} CPU s")
    if record.cloud:
        say(f"cloud   {paths.cloud}  ({record.cloud.points:,} points)")
    say(f"report  {paths.report}")


def say(text: object, nl: bool = True, err: bool = False) -> None:
    """Print, without what a terminal would obey; a reader that went away (`wbflow run ... | head -1`) costs the words, not the
    night's work."""
    _echo(printable(text, LONGEST_WORDS), nl, err)


def _echo(text: str, nl: bool = True, err: bool = False) -> None:
    try:
        click.echo(text, nl=nl, err=err)
    except BrokenPipeError:
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), (sys.stderr if err else sys.stdout).fileno())


def stop(code: ExitCode, message: str) -> NoReturn:
    """Say a last word (on stderr, unless all is well), and end."""
    say(message, err=code is not ExitCode.GOOD)
    sys.exit(code)
