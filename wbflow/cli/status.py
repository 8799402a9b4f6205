"""`wbflow status` and `check`: how a site is and what would be done, without doing it."""

from __future__ import annotations

import datetime
import shlex
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from . import common
from .common import Day, date_at, echo, echo_json, load

if TYPE_CHECKING:
    from ..commands.overview import Overview
    from ..commands.status import Line, Status
    from ..runner.plan import Plan
    from ..site.models import Site

_TASK_COLUMNS = 32
"""Width of the column with stages and tasks."""


@click.command()
@common.site_argument
@common.date_option
@common.work_option
@common.until_option
@common.json_option
def status(site: Path, date: Day | None, work: str | None, until: str | None, as_json: bool) -> None:
    """Show how a site is, what is cached, what would run, and why.

    \b
    wbflow status site.yaml
    wbflow status site.yaml --date -1 --json
    """
    from ..commands.overview import overview
    from ..commands.status import explain

    loaded = load(site, work)
    plan = planned_night(loaded, date_at(loaded, date), until)
    planned = explain(plan)
    seen = overview(plan.night)
    if as_json:
        echo_json({**asdict(planned), "overview": asdict(seen)})
        return
    _print_overview(seen, site)
    echo("")
    print_plan(planned)


def planned_night(site: Site, date: datetime.date | None, until: str | None, force: tuple[str, ...] = ()) -> Plan:
    """Return the plan of a night, as far as it is known before anything has run.

    Parameters
    ----------
    site, date : Site, date
        The site, and the night; None is the newest one with captures.
    until, force : str, tuple of str
        As for `wbflow run`.
    """
    from ..runner.options import Options
    from ..runner.plan import Plan
    from ..runner.tonight import read_night

    options = Options(date, until=until, force=force)
    options.check(site)
    plan = Plan(read_night(site, options))
    plan.refresh()
    if plan.night.reference_fault:
        echo(f"the reference is not used: {plan.night.reference_fault}", err=True)
    return plan


def _print_overview(seen: Overview, site: Path) -> None:
    """Print the five lines.  site: the site file as the user named it."""
    file = shlex.quote(str(site))
    echo(f"night     {seen.night}", level=seen.level, fold=True)
    echo(f"cameras   {seen.cameras}", fold=True)
    echo(f"changes   {seen.changes}", fold=True)
    for name, words in (("disk", seen.disk), ("next run", seen.next_run)):  # these may have commands to copy
        echo(f"{name:9} {words}".replace("SITE.yaml", file), indent=10)


def print_plan(planned: Status) -> None:
    """Print the tasks of a night, those with the same reason as one line with their number, and the totals last."""
    for stage, lines in _by_stage(planned.tasks).items():
        groups: dict[tuple[str, str], list[Line]] = {}
        for line in lines:
            groups.setdefault((line.state, line.why), []).append(line)
        for (state, why), group in groups.items():
            name = group[0].task
            words = state
            if len(group) > 1:
                name = stage
                words = f"{len(group)} {state}"
            if why:
                words += f": {why}"
            echo(f"{name:{_TASK_COLUMNS}} {words}", indent=_TASK_COLUMNS + 1)
    for cause, count in _skipped(planned.tasks).items():
        echo(f"{'skipped':{_TASK_COLUMNS}} {count}: {cause}", indent=_TASK_COLUMNS + 1)
    if planned.pairs_to_come:
        echo("(tasks of pairs are listed once the pair graph is known)")
    estimate = ""
    if planned.cpu_seconds is not None:
        estimate = f"; about {planned.cpu_seconds:.0f} CPU s, as far as is known"
    echo(f"night of {planned.night}: {totals_of(planned)}{estimate}", indent=4)


def totals_of(planned: Status) -> str:
    """Return how many tasks are in each state, in words."""
    return ", ".join(f"{count} {state}" for state, count in planned.totals.items())


def _by_stage(lines: Iterable[Line]) -> dict[str, list[Line]]:
    """Return the tasks by stage, without those that are skipped."""
    by_stage: dict[str, list[Line]] = {}
    for line in lines:
        if line.state != "skipped":
            by_stage.setdefault(line.task.partition(" ")[0], []).append(line)
    return by_stage


def _skipped(lines: Iterable[Line]) -> dict[str, int]:
    """Return the number of skipped tasks by their cause: the reason of the first task that was skipped."""
    counts: dict[str, int] = {}
    for line in lines:
        if line.state == "skipped":
            counts[line.cause] = counts.get(line.cause, 0) + 1
    return counts


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
    from .libraries import without_library_output

    loaded = load(site, work)
    with without_library_output():  # what a library prints about a file has no name of the file
        findings = checks.check(loaded, date_at(loaded, date), not no_network)
    for finding in findings:
        echo(f"{finding.severity}: {finding.what}\n  {finding.remedy}")
    if not findings:
        echo(f"{site}: {len(loaded.cameras)} cameras, all captures whole, everything installed")
    sys.exit(checks.exit_code(findings))
