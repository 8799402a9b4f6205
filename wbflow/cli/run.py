"""`wbflow run`, `capture`, `status` and `check`: process a night, or show what would be done."""

from __future__ import annotations

import datetime
import json
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ExitCode, UsageError, WbflowError, worst
from ..words import counted
from . import common
from .common import Day, date_at, day, echo, echo_json, load
from .display import display

if TYPE_CHECKING:
    from ..api import Run
    from ..capture.take import Delivery
    from ..commands.status import Status
    from ..records.findings import Finding
    from ..records.record import RunRecord
    from ..site.models import Site

BACKENDS = ("processes", "loky", "threading", "dask")
LEVELS = {"good": "good: nothing to look at", "degraded": "degraded: look at this", "failed": "failed"}
"""Printed text of each verdict level."""
MOST_FINDINGS = 20
"""Largest number of findings that are printed; the report has all."""
MOST_ALIKE = 4
"""Largest number of findings of one kind with the same remedy that are printed in full; larger groups are summarized."""
DEBUGGABLE = {"fault", "too-slow", "worker-lost", "out-of-memory"}
"""Failure codes after which `wbflow debug` is suggested."""


@click.command()
@common.sites_argument
@common.date_option
@click.option("--since", type=day, metavar="DAY", help="Work through all nights with captures from this day on.")
@click.option("--capture", "capture_first", is_flag=True, help="Take tonight's pictures first (see `wbflow capture`).")
@common.work_option
@common.jobs_option
@common.until_option
@click.option("--force", multiple=True, metavar="STAGE_OR_TASK", help="Run it again: `fuse`, or `'matches gate--roof'`.")
@click.option("--dry-run", is_flag=True, help="Print what would run, and why; write nothing.")
@click.option("--wait", is_flag=True, help="Wait for another run of this work folder instead of giving up.")
@click.option("--stop-at", type=common.next_time, metavar="HH:MM", help="Stop at this time, and publish what is done.")
@click.option("--json", "as_json", is_flag=True, help="Print run.json, and nothing else.")
@click.option("--backend", type=click.Choice(BACKENDS), default=BACKENDS[0], help="Where tasks run (loky: processes).")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, for --backend dask: tcp://host:8786.")
@click.option(
    "--worker-root", "worker_roots", multiple=True, metavar="HERE=THERE", help="Folder's path on Dask workers: /srv=/mnt/srv."
)
@click.option("--memory", metavar="SIZE", help="Limit for all workers together: 4GB (default: 80 % of the machine's memory).")
@click.option("--time-limit", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Seconds a task may take.")
@common.verbose_option
@click.option("-q", "--quiet", is_flag=True, help="Print only what went wrong.")
def run(
    sites: tuple[Path, ...],
    date: Day | None,
    since: Day | None,
    capture_first: bool,
    work: str | None,
    dry_run: bool,
    as_json: bool,
    verbose: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Do the night's work, from captures to cloud and report.  What has not changed comes from the cache.

    Several sites run one after the other; a fault of one does not affect the others. With --since, each missed night gets a
    run of its own.  The exit code is that of the worst run.

    \b
    wbflow run site.yaml                          the newest night
    wbflow run site.yaml --date yesterday -q      for cron: prints only what went wrong
    wbflow run sites/*.yaml -q                    several sites
    wbflow run site.yaml --force 'matches gate--roof' --until poses
    wbflow run site.yaml --since -7 --stop-at 06:00
    """
    if date is not None and since is not None:
        raise UsageError("--date and --since exclude each other", remedy="give one of them: wbflow run SITE.yaml --since DAY")
    if capture_first and (date is not None or since is not None or dry_run):
        what = "--capture takes pictures now: it excludes --date, --since and --dry-run"
        raise UsageError(what, remedy="wbflow run SITE.yaml --capture")
    if work and len(sites) > 1:
        what = "--work is the folder of one site, and several are named"
        raise UsageError(what, remedy="name it as `work:` in each site file")
    from .. import api

    quiet = quiet or as_json
    several = since is not None or len(sites) > 1
    stop_at = options["stop_at"]
    records: list[Any] = []

    def run_site(path: Path) -> int:
        site = load(path, work, for_run=not dry_run)
        deliveries = _capture(site, quiet) if capture_first else []
        not_captured = {delivery.camera: delivery.fault for delivery in deliveries if delivery.fault}
        nights = _nights(site, date, since)
        if dry_run:
            for night in nights:
                _print_status(_status(site, night, options["until"], options["force"]))
            return ExitCode.GOOD
        exit_codes: list[int] = []
        for night in nights:
            if exit_codes and stop_at and stop_at <= datetime.datetime.now():
                echo(f"{counted(len(nights) - len(exit_codes), 'night')} not begun: --stop-at {stop_at:%H:%M}", err=True)
                exit_codes.append(ExitCode.DEGRADED)
                break
            with display(site.name, verbose, quiet) as progress:
                finished = api.run(site, date=night, not_captured=not_captured, listen=progress.receive, **options)
            exit_codes.append(finished.record.exit_code)
            if as_json:
                records.append(json.loads(finished.run_folder.paths.record.read_bytes()))
            _print_run(finished, several, quiet)
            if finished.record.exit_code == ExitCode.INTERRUPTED:
                break
        if not quiet:
            echo(f"next    {_next_command(finished, path)}")
        return worst(exit_codes)

    code = _for_each(sites, run_site)
    if as_json and not dry_run:
        echo_json(records if several else records[0])
    sys.exit(code)


def _nights(site: Site, date: Day | None, since: Day | None) -> Sequence[datetime.date | None]:
    """The nights to work on; None is the newest one with captures."""
    from ..site.captures import backlog

    first_night = date_at(site, since)
    return backlog(site, first_night) if first_night else [date_at(site, date)]


def _for_each(sites: Sequence[Path], work: Callable[[Path], int]) -> int:
    """Call `work` for each site, and return the worst exit code.

    With several sites, an error of one is printed and the others go on; with a single site it is raised.
    """
    if len(sites) == 1:
        return work(sites[0])
    exit_codes = []
    for site in sites:
        try:
            exit_codes.append(work(site))
        except WbflowError as error:
            echo(f"{site}: {error}", err=True)
            exit_codes.append(error.exit_code)
        except Exception as error:  # a bug in wbflow
            echo(f"{site}: wbflow itself failed: {type(error).__name__}: {error}\n  wbflow run {site} -v  shows where", err=True)
            exit_codes.append(ExitCode.FAILED)
        if exit_codes[-1] == ExitCode.INTERRUPTED:
            break
    return worst(exit_codes)


def _print_run(finished: Run, several: bool, quiet: bool) -> None:
    from ..records.record import STATE_SCALE

    record, paths = finished.record, finished.run_folder.paths
    if not quiet:
        if several:
            echo(f"{record.site}, night {record.date}, run {record.run}:")
        if record.verdict and record.verdict.good and not record.verdict.findings:
            echo(_verdict_line(record))
        tasks = ", ".join(f"{count} {name}" for name, count in record.tasks.to_json().items() if count)
        echo(f"{tasks or 'nothing to do'}; {record.seconds.wall:.1f} s, {record.seconds.cpu:.1f} CPU s")
        if record.cloud:
            echo(f"cloud   {paths.cloud}  ({record.cloud.points:,} points)")
        echo(f"report  {paths.report}")
        if record.unscaled:
            echo(f"scale   unknown: {STATE_SCALE}")
    if record.exit_code or not quiet:
        print_findings(record)


def print_findings(record: RunRecord) -> None:
    """Print the findings and their remedies on stderr, so that cron mails them."""
    verdict = record.verdict
    if verdict is None or (verdict.good and not verdict.findings):
        return
    echo(_verdict_line(record), err=True)
    texts = list(_finding_texts(verdict.findings))
    for remedy, with_this_remedy in groupby(texts[:MOST_FINDINGS], key=itemgetter(1)):
        for text, _ in with_this_remedy:
            echo(f"  {text}", err=True)
        if remedy:
            echo(f"    {remedy}", err=True)
    if (omitted := len(texts) - MOST_FINDINGS) > 0:
        echo(f"  and {omitted} more: the report has them", err=True)


def _verdict_line(record: RunRecord) -> str:
    """Return the line that says how the night was, and whether lengths in its cloud are metres."""
    from ..records.record import NO_SCALE

    verdict = LEVELS[record.verdict.level] if record.verdict else "no verdict"
    scale = f"; {NO_SCALE}" if record.unscaled else ""
    return f"{record.site}, night of {record.date}: {verdict}{scale}"


def _finding_texts(findings: Iterable[Finding]) -> Iterator[tuple[str, str]]:
    """Yield text and remedy of each finding; for a large group of the same kind, the first ones and the subjects of the rest."""
    for _, similar in groupby(findings, key=lambda finding: (finding.kind, finding.remedy)):
        group = list(similar)
        is_short = len(group) <= MOST_ALIKE or not all(finding.subject for finding in group)
        in_full = group if is_short else group[: MOST_ALIKE - 1]
        yield from ((str(finding), finding.remedy) for finding in in_full)
        if rest := group[len(in_full) :]:
            yield f"and {len(rest)} more like these: {', '.join(finding.about for finding in rest)}", group[-1].remedy


def _next_command(finished: Run, site: Path) -> str:
    """Return the command to suggest after a run."""
    record, file = finished.record, shlex.quote(str(site))
    if record.exit_code == ExitCode.INTERRUPTED:
        return f"wbflow run {file}"
    for task, event in finished.task_events.items():
        if event.outcome == "failed" and event.code in DEBUGGABLE:
            return f"wbflow debug {file} {shlex.quote(str(task))} --out debug"
    if record.exit_code:
        return f"wbflow check {file}"
    return f"wbflow compare {file}" if len(finished.cache.work.run_ids()) > 1 else f"wbflow export {file} --mesh --out mesh"


@click.command()
@common.site_argument
@click.option("-q", "--quiet", is_flag=True, help="Print only what went wrong.")
def capture(site: Path, quiet: bool) -> None:
    """Take pictures with all cameras that have a `url`.  All at the same time; `run` finds them by their names.

    \b
    wbflow capture site.yaml
    wbflow run site.yaml --capture -q             both, for cron
    """
    captured = _capture(load(site, None), quiet)
    if not any(delivery.files for delivery in captured):
        sys.exit(ExitCode.FAILED)
    sys.exit(ExitCode.DEGRADED if any(delivery.fault for delivery in captured) else ExitCode.GOOD)


def _capture(site: Site, quiet: bool) -> list[Delivery]:
    from ..capture.take import capture

    def print_delivery(delivery: Delivery) -> None:
        if delivery.fault or not quiet:
            echo(f"{delivery.camera:10} {delivery}", err=bool(delivery.fault))

    return capture(site, print_delivery)


@click.command()
@common.site_argument
@common.date_option
@common.work_option
@common.until_option
@common.json_option
def status(site: Path, date: Day | None, work: str | None, until: str | None, as_json: bool) -> None:
    """Show what is cached, what would run, and why.

    \b
    wbflow status site.yaml
    wbflow status site.yaml --date -1 --json
    """
    loaded = load(site, work)
    night_status = _status(loaded, date_at(loaded, date), until)
    if as_json:
        echo_json(asdict(night_status))
    else:
        _print_status(night_status)


def _status(site: Site, date: datetime.date | None, until: str | None, force: tuple[str, ...] = ()) -> Status:
    from ..commands.status import explain
    from ..runner.options import Options
    from ..runner.plan import Plan
    from ..runner.tonight import read_night

    options = Options(date, until=until, force=force)
    options.check(site)
    plan = Plan(read_night(site, options))
    plan.refresh()
    if plan.night.reference_fault:
        echo(f"the reference is not used: {plan.night.reference_fault}", err=True)
    return explain(plan)


def _print_status(status: Status) -> None:
    for line in status.tasks:
        echo(f"{line.task:32} {line.state}{': ' + line.why if line.why else ''}")
    if status.pairs_to_come:
        echo("(tasks of pairs are listed once the pair graph is known)")
    estimate = f"; about {status.cpu_seconds:.0f} CPU s, as far as is known" if status.cpu_seconds is not None else ""
    echo(f"night of {status.night}: {', '.join(f'{count} {state}' for state, count in status.totals.items())}{estimate}")


@click.command()
@common.site_argument
@common.date_option
@common.work_option
@click.option("--no-network", is_flag=True, help="Do not ask cameras with a url for a picture.")
def check(site: Path, date: Day | None, work: str | None, no_network: bool) -> None:
    """Check site file, captures, cameras on the network, and machine.  Prints each problem with its remedy, and runs nothing.

    \b
    wbflow check site.yaml
    wbflow check site.yaml --date yesterday
    """
    from ..commands import check as checks

    loaded = load(site, work)
    findings = checks.check(loaded, date_at(loaded, date), not no_network)
    for finding in findings:
        echo(f"{finding.severity}: {finding.what}\n  {finding.remedy}")
    if not findings:
        echo(f"{site}: {len(loaded.cameras)} cameras, all captures whole, everything installed")
    sys.exit(checks.exit_code(findings))
