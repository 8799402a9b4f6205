"""The night: run it, and say what it would do."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..screen import findings, listener, say, summary
from .common import (
    BACKENDS,
    date_option,
    day_of,
    force_option,
    jobs_option,
    load,
    site_argument,
    until_option,
    verbose_option,
    work_option,
)

if TYPE_CHECKING:
    import datetime

    from ..config.site import Site


@click.command()
@site_argument
@date_option
@work_option
@jobs_option
@until_option
@force_option
@click.option("--dry-run", is_flag=True, help="Say what would run, and why; write nothing.")
@click.option("--wait", is_flag=True, help="Wait for another run of this work folder instead of giving up.")
@click.option("--json", "as_json", is_flag=True, help="Print run.json, and nothing else.")
@click.option("--backend", type=click.Choice(BACKENDS), default=BACKENDS[0], help="Where tasks run (loky: processes).")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, for --backend dask: tcp://host:8786.")
@click.option("--memory", metavar="SIZE", help="What all workers together may hold: 4GB (default: 80 % of what there is).")
@click.option("--time-limit", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Seconds a task may take.")
@verbose_option
@click.option("-q", "--quiet", is_flag=True, help="Only what went wrong.")
def run(
    site: Path,
    date: datetime.datetime | None,
    work: Path | None,
    jobs: int,
    until: str | None,
    force: tuple[str, ...],
    dry_run: bool,
    wait: bool,
    as_json: bool,
    backend: str,
    scheduler: str | None,
    memory: str | None,
    time_limit: float | None,
    verbose: bool,
    quiet: bool,
) -> None:
    """The night's work: from captures to cloud and report.  What has not changed is taken from the cache."""
    loaded = load(site, work, notes=dry_run)
    if dry_run:
        _explain(loaded, date, until, force)
        return
    from ..api import run as work_through

    finished = work_through(
        loaded,
        date=day_of(date),
        jobs=jobs,
        until=until,
        force=force,
        wait=wait,
        backend=backend,
        scheduler=scheduler,
        memory=memory,
        time_limit=time_limit,
        listen=listener(loaded, verbose, quiet or as_json),
    )
    if as_json:
        say(json.dumps(finished.record.to_json(), indent=1))
    elif not quiet:
        summary(finished)
    if finished.record.exit_code or not (quiet or as_json):
        findings(finished.record)
    sys.exit(finished.record.exit_code)


@click.command()
@site_argument
@date_option
@work_option
@until_option
def status(site: Path, date: datetime.datetime | None, work: Path | None, until: str | None) -> None:
    """What is cached, what would run, and why."""
    _explain(load(site, work), date, until, ())


@click.command()
@site_argument
@date_option
@work_option
def check(site: Path, date: datetime.datetime | None, work: Path | None) -> None:
    """Site, captures and machine examined without running; every finding, with its remedy."""
    loaded = load(site, work)
    from ..results.check import check as examine
    from ..results.check import exit_code

    findings = examine(loaded, day_of(date))
    for finding in findings:
        say(f"{finding.severity}: {finding.what}\n  {finding.remedy}")
    if not findings:
        say(f"{site}: {len(loaded.cameras)} cameras, all captures whole, everything installed")
    sys.exit(exit_code(findings))


def _explain(site: Site, date: datetime.datetime | None, until: str | None, force: tuple[str, ...]) -> None:
    from ..night.night import open_night
    from ..night.options import Options
    from ..results.status import explain, pairs_to_come

    Options(until=until, force=force).check()
    plan = open_night(site, day_of(date), until, force).plan
    plan.refresh()
    for line in explain(plan):
        say(f"{line.task:32} {line.state}{': ' + line.why if line.why else ''}")
    if pairs_to_come(plan):
        say("(tasks of pairs are listed once the pair graph is known)")
