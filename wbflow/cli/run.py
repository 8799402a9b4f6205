"""The night: run it, and say what it would do."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ExitCode, UsageError, counted, worst
from .common import (
    BACKENDS,
    PATH,
    Clock,
    Day,
    date_option,
    each,
    force_option,
    jobs_option,
    json_option,
    load,
    say_json,
    site_argument,
    until_option,
    verbose_option,
    work_option,
)
from .words import findings, next_command, say, summary

if TYPE_CHECKING:
    import datetime

    from ..site.models import Site


@click.command()
@click.argument("sites", metavar="SITE.yaml...", type=PATH, nargs=-1, required=True)
@date_option
@click.option("--since", type=Day(), metavar="DAY", help="All nights from this day on that have captures, one after the other.")
@work_option
@jobs_option
@until_option
@force_option
@click.option("--dry-run", is_flag=True, help="Say what would run, and why; write nothing.")
@click.option("--wait", is_flag=True, help="Wait for another run of this work folder instead of giving up.")
@click.option("--stop-at", type=Clock(), metavar="HH:MM", help="Then put together and publish what there is, and end.")
@click.option("--json", "as_json", is_flag=True, help="Print run.json, and nothing else.")
@click.option("--backend", type=click.Choice(BACKENDS), default=BACKENDS[0], help="Where tasks run (loky: processes).")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, for --backend dask: tcp://host:8786.")
@click.option(
    "--worker-root", "worker_roots", multiple=True, metavar="HERE=THERE", help="What Dask's workers call a folder: /srv=/mnt/srv."
)
@click.option("--memory", metavar="SIZE", help="What all workers together may hold: 4GB (default: 80 % of what there is).")
@click.option("--time-limit", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Seconds a task may take.")
@verbose_option
@click.option("-q", "--quiet", is_flag=True, help="Only what went wrong.")
def run(sites: tuple[Path, ...], dry_run: bool, as_json: bool, verbose: bool, quiet: bool, **asked: Any) -> None:
    """The night's work: from captures to cloud and report.  What has not changed is taken from the cache.

    Several sites are worked through one after the other; what is wrong with one costs the others nothing.  With --since, the
    nights of a machine that was off are caught up with, one run for each.  The exit code is that of the worst.

    \b
    wbflow run site.yaml                          the newest night
    wbflow run site.yaml --date yesterday -q      for cron: says only what went wrong
    wbflow run sites/*.yaml -q                    several sites
    wbflow run site.yaml --force 'matches gate--roof' --until poses
    wbflow run site.yaml --since -7 --stop-at 06:00
    """
    if asked["date"] and asked["since"]:
        raise UsageError("--date and --since name two things to do", remedy="give one of them: wbflow run SITE.yaml --since DAY")
    if asked["work"] and len(sites) > 1:
        what = "--work is the folder of one site, and several are named"
        raise UsageError(what, remedy="name it as `work:` in each site file")
    if dry_run:
        code = each(sites, lambda site: _foretell(site, **asked))
        sys.exit(code)
    telling = _Telling(verbose, quiet or as_json, bool(asked["since"]) or len(sites) > 1, as_json)
    records: list[Any] = []
    code = each(sites, lambda site: _work_through(site, telling, records, **asked))
    if as_json:
        say_json(records if telling.several else records[0])
    sys.exit(code)


@dataclass(frozen=True)
class _Telling:
    """What is said of runs on the way."""

    verbose: bool
    quiet: bool
    """Nothing but what went wrong."""
    several: bool
    """Each run says which it is."""
    as_json: bool = False
    """For programs."""


def _foretell(
    path: Path, date: datetime.date | None, since: datetime.date | None, work: str | None, until: str | None, **asked: Any
) -> int:
    """What would run for a site."""
    site = load(path, work)
    for day in _nights(site, date, since):
        _explain(site, day, until, asked["force"])
    return ExitCode.GOOD


def _work_through(
    path: Path,
    telling: _Telling,
    records: list[Any],
    date: datetime.date | None,
    since: datetime.date | None,
    work: str | None,
    **asked: Any,
) -> int:
    """The nights of a site that were asked for.  Adds their records, and gives the worst exit code."""
    import json

    from ..records.events import OnlyWarnings
    from .watch import reading, watching

    with reading(path, telling.quiet):
        site = load(path, work, notes=False, look=False)  # a run tells of them, and looks, itself
        from ..api import run as work_through

    codes: list[int] = []
    nights = _nights(site, date, since)
    for day in nights:
        if codes and (at := asked["stop_at"]) and at <= type(at).now():
            say(f"{counted(len(nights) - len(codes), 'night')} not begun: the run was to stop at {at:%H:%M}", err=True)
            codes.append(ExitCode.DEGRADED)
            break
        with watching(site.name, telling.verbose, telling.quiet) as watch:
            listen = OnlyWarnings(watch.hear) if telling.quiet and not telling.verbose else watch.hear
            finished = work_through(site, date=day, listen=listen, watch=watch.hear, **asked)
        record = finished.record
        codes.append(record.exit_code)
        if telling.as_json:
            records.append(json.loads(finished.finished.folder.paths.record.read_bytes()))
        if telling.several and not telling.quiet:
            say(f"{record.site}, night {record.date}, run {record.run}:")
        if not telling.quiet:
            summary(finished)
        if record.exit_code or not telling.quiet:
            findings(record)
        if record.exit_code == ExitCode.INTERRUPTED:
            break
    if not telling.quiet:
        say(f"next    {next_command(finished, path)}")
    return worst(codes)


def _nights(site: Site, date: datetime.date | None, since: datetime.date | None) -> list[datetime.date | None]:
    from ..runner.captures import backlog

    return [date] if since is None else [*backlog(site, since)]


@click.command()
@site_argument
@date_option
@work_option
@until_option
@json_option
def status(site: Path, date: datetime.date | None, work: str | None, until: str | None, as_json: bool) -> None:
    """What is cached, what would run, and why.

    \b
    wbflow status site.yaml
    wbflow status site.yaml --date -1 --json
    """
    _explain(load(site, work), date, until, (), as_json)


@click.command()
@site_argument
@date_option
@work_option
def check(site: Path, date: datetime.date | None, work: str | None) -> None:
    """Site, captures and machine examined without running; every finding, with its remedy.

    \b
    wbflow check site.yaml
    wbflow check site.yaml --date yesterday
    """
    loaded = load(site, work)
    from ..outcome.check import check as examine
    from ..outcome.check import exit_code

    findings = examine(loaded, date)
    for finding in findings:
        say(f"{finding.severity}: {finding.what}\n  {finding.remedy}")
    if not findings:
        say(f"{site}: {len(loaded.cameras)} cameras, all captures whole, everything installed")
    sys.exit(exit_code(findings))


def _explain(site: Site, date: datetime.date | None, until: str | None, force: tuple[str, ...], as_json: bool = False) -> None:
    from dataclasses import asdict

    from ..outcome.status import explain, pairs_to_come, seconds_to_come, totals
    from ..runner.context import open_night
    from ..runner.options import Options

    options = Options(until=until, force=force)
    options.check()
    options.check_subjects(site)
    plan = open_night(site, date, until, force).plan
    plan.refresh()
    lines = explain(plan)
    seconds, counts = seconds_to_come(lines), totals(lines)
    if as_json:
        tasks = [asdict(line) for line in lines]
        known = {"tasks": tasks, "totals": counts, "cpu_seconds": seconds, "pairs_to_come": pairs_to_come(plan)}
        say_json({"site": site.name, "night": plan.night, **known})
        return
    if plan.misfit:
        say(f"the reference is not used: {plan.misfit}", err=True)
    for line in lines:
        say(f"{line.task:32} {line.state}{': ' + line.why if line.why else ''}")
    if pairs_to_come(plan):
        say("(tasks of pairs are listed once the pair graph is known)")
    about = f"; about {seconds:.0f} CPU s, as far as is known" if seconds is not None else ""
    say(f"night of {plan.night}: {', '.join(f'{count} {state}' for state, count in counts.items())}{about}")
