"""`wbflow run` and `capture`: process nights, or take their pictures."""

from __future__ import annotations

import datetime
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ExitCode, UsageError, WbflowError, worst
from ..words import counted
from . import common
from .common import Day, date_at, day, echo, echo_json, load
from .display import display
from .status import planned_night, print_plan, totals_of

if TYPE_CHECKING:
    from ..capture.take import Delivery
    from ..records.record import RunRecord
    from ..site.models import Site

BACKENDS = ("processes", "loky", "threading", "dask")


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
    from ..commands.status import explain
    from .ended import next_step, print_night, print_table

    quiet = quiet or as_json
    several = since is not None or len(sites) > 1
    stop_at = options["stop_at"]
    records: list[RunRecord] = []
    documents: list[Any] = []

    def run_site(path: Path) -> int:
        site = load(path, work, for_run=not dry_run)
        deliveries = _capture(site, quiet) if capture_first else []
        not_captured = {delivery.camera: delivery.fault for delivery in deliveries if delivery.fault}
        nights = _nights(site, date, since)
        if dry_run:
            for night in nights:
                planned = explain(planned_night(site, night, options["until"], options["force"]))
                if "would run" in planned.totals:
                    print_plan(planned)
                else:
                    echo(f"night of {planned.night}: nothing would run: {totals_of(planned)}")
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
            records.append(finished.record)
            if as_json:
                documents.append(json.loads(finished.run_folder.paths.record.read_bytes()))
            print_night(finished, quiet)
            if finished.record.exit_code == ExitCode.INTERRUPTED:
                break
        if not quiet:
            following = next_step(finished, path)
            is_command = following.startswith("wbflow ")  # a command is copied: it stays on one line
            echo(f"next    {following}", indent=None if is_command else 8)
        return worst(exit_codes)

    code = _for_each(sites, run_site)
    if as_json and not dry_run:
        echo_json(documents if several else documents[0])
    if len(records) > 1 and not quiet:
        print_table(records)
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
