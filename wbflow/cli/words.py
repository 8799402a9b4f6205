"""Words on the terminal: what a run came to, and how anything is said."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from ..errors import ExitCode, printable

LONGEST_WORDS = 100_000_000
"""Characters that are said at once: run.json as a whole is."""

if TYPE_CHECKING:
    from ..api import Run
    from ..records.record import Finding, RunRecord


LEVELS = {
    "good": "good: nothing to look at",
    "degraded": "degraded: a cloud was made, but look at this",
    "failed": "failed",
}
"""The verdict's levels in words."""

PUZZLING = {"fault", "too-slow", "worker-lost", "out-of-memory"}
"""Why tasks fail whose inputs are worth a look (see `runner.state.Cause`)."""

MOST_FINDINGS = 20
"""So many are said; the report has all."""
MOST_ALIKE = 4
"""So many of one kind, with the same remedy, are said in full."""


def findings(record: RunRecord) -> None:
    """What is to be looked at, and what to do about it: on stderr, so that cron sends it to somebody."""
    verdict = record.verdict
    if verdict is None or (verdict.good and not verdict.findings):
        return
    say(f"{record.site}, night of {record.date}: {LEVELS[verdict.level]}", err=True)
    told = list(_told(verdict.findings))
    shown = told[:MOST_FINDINGS]
    for (text, remedy), following in zip(shown, [*shown[1:], None], strict=True):
        say(f"  {text}", err=True)
        if remedy and not (following and following[1] == remedy):  # said once, after those it is for
            say(f"    {remedy}", err=True)
    if (left := len(told) - MOST_FINDINGS) > 0:
        say(f"  and {left} more: the report has them", err=True)


def _told(found: Iterable[Finding]) -> Iterator[tuple[str, str]]:
    """Text and remedy of findings; of many that are alike the first, and whose the others are."""
    for _, alike in groupby(found, key=lambda finding: (finding.kind, finding.remedy)):
        group = list(alike)
        few = len(group) <= MOST_ALIKE or not all(finding.subject for finding in group)
        yield from ((str(finding), finding.remedy) for finding in (group if few else group[: MOST_ALIKE - 1]))
        if not few:
            rest = [finding.about for finding in group[MOST_ALIKE - 1 :]]
            yield f"and {len(rest)} more like these: {', '.join(rest)}", group[-1].remedy


def summary(finished: Run) -> None:
    """What a run came to: verdict, figures, and where its files are."""
    record, paths = finished.record, finished.finished.folder.paths
    if record.verdict and record.verdict.good and not record.verdict.findings:
        say(f"{record.site}, night of {record.date}: {LEVELS[record.verdict.level]}")
    tasks = ", ".join(f"{count} {name}" for name, count in record.tasks.to_json().items() if count)
    say(f"{tasks or 'nothing to do'}; {record.seconds.wall:.1f} s, {record.seconds.cpu:.1f} CPU s")
    if record.cloud:
        say(f"cloud   {paths.cloud}  ({record.cloud.points:,} points)")
    say(f"report  {paths.report}")


def next_command(finished: Run, site: Path) -> str:
    """What somebody would type next, after a run of a site file."""
    record, file = finished.record, shlex.quote(str(site))
    if record.exit_code == ExitCode.INTERRUPTED:
        return f"wbflow run {file}"
    puzzling = [event.task for event in finished.finished.tasks.values() if event.outcome == "failed" and event.code in PUZZLING]
    if puzzling:
        return f"wbflow debug {file} {shlex.quote(str(puzzling[0]))} --out debug"
    if record.exit_code:
        return f"wbflow check {file}"
    return f"wbflow compare {file}" if len(finished.finished.work.run_ids()) > 1 else f"wbflow export {file} --mesh --out mesh"


def say(text: object, nl: bool = True, err: bool = False) -> None:
    """Print, without what a terminal would obey; a reader that went away (`wbflow run ... | head -1`) costs the words, not the
    night's work."""
    echo(printable(text, LONGEST_WORDS), nl, err)


def echo(text: str, nl: bool = True, err: bool = False) -> None:
    """Print as it is, what a terminal obeys too."""
    try:
        click.echo(text, nl=nl, err=err)
    except BrokenPipeError:
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), (sys.stderr if err else sys.stdout).fileno())


def stop(code: ExitCode, message: str) -> NoReturn:
    """Say a last word (on stderr, unless all is well), and end."""
    say(message, err=code is not ExitCode.GOOD)
    sys.exit(code)
