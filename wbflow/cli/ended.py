"""What `wbflow run` prints about nights that have ended: verdict, findings and what follows from them, files, what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ExitCode
from ..records.changes import change_words, news_words, open_changes
from ..records.findings import Verdict
from ..records.record import NO_SCALE, STATE_SCALE
from ..words import counted
from .common import echo

if TYPE_CHECKING:
    from ..records.findings import Finding
    from ..records.finished_run import Run
    from ..records.record import RunRecord

LEVELS = {"good": "good: nothing to look at", "degraded": "degraded: look at this", "failed": "failed"}
"""Printed text of each verdict level on a night on which nothing has changed."""
INTERRUPTED = "interrupted; everything finished is kept"
"""Printed text of the verdict on a run that was interrupted."""
MOST_FINDINGS = 20
"""Largest number of findings that are printed; the report has all."""
MOST_ALIKE = 4
"""Largest number of findings of one kind with the same remedy that are printed in full; larger groups are summarized."""
DEBUGGABLE = {"fault", "too-slow", "worker-lost", "out-of-memory"}
"""Failure codes after which `wbflow debug` is suggested."""


def print_night(finished: Run, quiet: bool) -> None:
    """Print a night: its verdict first.

    Everything goes to stdout.  With `quiet`, only the verdict and the findings are printed, on stderr, if the exit code is not 0
    or if something has changed that nobody has acknowledged: cron mails them, and stdout stays empty for programs.
    """
    record = finished.record
    if quiet:
        if record.exit_code or open_changes(record):
            print_findings(record, err=True)
        return
    print_findings(record, err=False)
    counts = [f"{count} {name}" for name, count in record.tasks.to_json().items() if count]
    tasks = ", ".join(counts) or "nothing to do"
    paths = finished.run_folder.paths
    echo(f"tasks   {tasks}; {record.seconds.wall:.1f} s, {record.seconds.cpu:.1f} CPU s")
    if record.cloud:
        echo(f"cloud   {paths.cloud}  ({record.cloud.points:,} points)")
    echo(f"report  {paths.report}")
    if record.unscaled:
        echo(f"scale   unknown: {STATE_SCALE}", indent=8)


def print_findings(record: RunRecord, err: bool) -> None:
    """Print the verdict, then the findings with their remedies; those that follow from others are one paragraph under these.

    err: on stderr.
    """
    verdict = record.verdict
    if verdict is None:
        return
    line = f"{record.site}, night of {record.date}: {_level_words(record, verdict.level)}"
    if record.unscaled:
        line += f"; {NO_SCALE}"
    echo(line, err=err, level=verdict.level, indent=2)
    # 1. the findings up to the last one about a camera that others follow from
    others: list[Finding] = []
    following: list[Finding] = []
    cause_count = 0
    causes: set[str] = set()
    for finding in verdict.findings:
        causes.update(finding.follows)
    for finding in verdict.findings:
        if finding.follows:
            following.append(finding)
        elif finding.kind != "interrupted":  # the head says it
            others.append(finding)
            if causes.intersection(finding.subject):
                cause_count = len(others)
    _print_findings(others[:cause_count], err)
    # 2. what follows from these, which needs no remedy of its own
    if following:
        texts = [finding.text for finding in following]
        echo(f"  which leaves {'; '.join(texts)}", err=err, indent=6)
    # 3. everything else
    _print_findings(others[cause_count:], err)


def _level_words(record: RunRecord, level: str) -> str:
    """Return the level of a night, and what has changed: "good, 1 change: C17 new 2.0 x 1.4 x 2.6 m at 11.3, 15.0"."""
    if record.exit_code == ExitCode.INTERRUPTED:
        return INTERRUPTED
    changes = change_words(record)
    words = f"{level}, {changes}" if changes else LEVELS[level]
    if record.changes and not open_changes(record):
        words += f"; {counted(len(record.changes), 'change')} acknowledged"
    if record.recovered:
        words += f"; no more {', '.join(record.recovered)}"
    return words


def _print_findings(findings: Sequence[Finding], err: bool) -> None:
    """Print findings; those one after another that have the same remedy have it once."""
    texts = list(_finding_texts(findings))
    for remedy, with_this_remedy in groupby(texts[:MOST_FINDINGS], key=itemgetter(1)):
        for text, _ in with_this_remedy:
            echo(f"  {text}", err=err, indent=6)
        if remedy:
            echo(f"    {remedy}", err=err, indent=4)
    omitted = len(texts) - MOST_FINDINGS
    if omitted > 0:
        echo(f"  and {omitted} more: the report has them", err=err)


def print_table(records: Sequence[RunRecord]) -> None:
    """Print several nights, one to a line."""
    echo("")
    width = max(len(record.site) for record in records)
    echo(f"{'site':{width}}  {'night':10}  {'verdict':8}  {'points':>11}  first finding")
    for record in records:
        verdict = record.verdict or Verdict("failed")
        points = f"{record.cloud.points:,}" if record.cloud else "-"
        reason = str(verdict.findings[0]) if verdict.findings else news_words(record)
        line = f"{record.site:{width}}  {record.date:10}  {verdict.level:8}  {points:>11}  {reason}"
        echo(line.rstrip(), level=verdict.level, fold=True)


def next_step(finished: Run, site: Path) -> str:
    """Return what to do after a run: what its first finding says, or a command.

    site: the site file as the user named it.
    """
    record = finished.record
    file = shlex.quote(str(site))
    if record.exit_code == ExitCode.INTERRUPTED:
        night = f" --date {record.date}" if record.dated else ""
        return f"wbflow run {file}{night}"
    if record.exit_code:
        return _remedy(finished, file) or f"look at the report, or: wbflow check {file}"
    changes = open_changes(record)
    if changes:
        return f"look at the report; for what is as it should be: wbflow acknowledge {file} {changes[0].id} --note WHY"
    if len(finished.cache.work.run_ids()) > 1:
        return f"wbflow compare {file}"
    return f"wbflow export {file} --mesh --out mesh"


def _remedy(finished: Run, file: str) -> str:
    """Return the remedy of a run's first finding that stands by itself and has one; "" if there is none."""
    verdict = finished.record.verdict or Verdict("failed")
    for finding in verdict.findings:
        if finding.follows:
            continue
        debug = _debug_command(finished, finding, file)
        if debug:
            return debug
        if finding.remedy:
            remedy = finding.remedy.replace("SITE.yaml", file)
            return f"{finding.about}: {remedy}" if finding.subject else remedy
    return ""


def _debug_command(finished: Run, finding: Finding, file: str) -> str:
    """Return the command that looks into the task that a finding is about, if that failed for a reason of its own; else ""."""
    is_of_any = finding.kind in {"no-cloud", "no-result", "task-failed"}
    for task, event in finished.task_events.items():
        is_cause = is_of_any or (finding.kind == "camera-lost" and finding.subject == task.subject)
        if is_cause and event.outcome == "failed" and event.code in DEBUGGABLE:
            return f"wbflow debug {file} {shlex.quote(str(task))} --out debug"
    return ""


def _finding_texts(findings: Iterable[Finding]) -> Iterator[tuple[str, str]]:
    """Yield text and remedy of each finding; for a large group of the same kind, the first ones and the subjects of the rest."""
    for _, similar in groupby(findings, key=lambda finding: (finding.kind, finding.remedy)):
        group = list(similar)
        is_short = len(group) <= MOST_ALIKE or not all(finding.subject for finding in group)
        in_full = len(group) if is_short else MOST_ALIKE - 1
        for finding in group[:in_full]:
            yield str(finding), finding.remedy
        rest = [finding.about for finding in group[in_full:]]
        if rest:
            yield f"and {len(rest)} more like these: {', '.join(rest)}", group[-1].remedy
