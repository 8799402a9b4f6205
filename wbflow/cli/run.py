"""`wbflow run` and `capture`: process nights, or take their pictures."""

from __future__ import annotations

import datetime
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ExitCode, UsageError, WbflowError, worst
from ..words import LONGEST_TRACE, counted, printable
from . import common
from .common import Day, date_at, day, echo, echo_json, load
from .display import display
from .status import planned_night, print_plan, totals_of

if TYPE_CHECKING:
    from ..capture.take import Delivery
    from ..records.finished_run import Run
    from ..records.record import RunRecord
    from ..site.models import Site

BACKENDS = ("processes", "loky", "threading", "dask")
"""Where tasks can run; loky is another word for processes."""


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
    if dry_run:
        sys.exit(_for_each(sites, lambda path: _print_plans(load(path, work), date, since, options)))

    from .ended import print_table

    session = _Session(date, since, capture_first, work, as_json, verbose, quiet or as_json, options)
    code = _for_each(sites, session.run_site)
    if as_json:
        is_list = since is not None or len(sites) > 1
        echo_json(session.documents if is_list else session.documents[0])
    elif len(session.records) > 1 and not quiet:
        print_table(session.records)
    sys.exit(code)


@dataclass
class _Session:
    """The runs of one command, with its options."""

    date: Day | None
    since: Day | None
    capture_first: bool
    work: str | None
    as_json: bool
    verbose: bool
    quiet: bool
    """Print only what went wrong; also if stdout gets JSON."""
    options: Mapping[str, Any]
    """Further options of `wbflow.run`."""
    records: list[RunRecord] = field(default_factory=list)
    """Records of the runs so far."""
    documents: list[Any] = field(default_factory=list)
    """The content of their run.json, if JSON is wanted."""

    def run_site(self, path: Path) -> int:
        """Work on the nights of a site; returns the worst exit code.  path: the site file as the user named it."""
        from .ended import next_step

        site = load(path, self.work, for_run=True)
        not_captured: dict[str, str] = {}
        if self.capture_first:
            for delivery in _capture(site, self.quiet):
                if delivery.fault:
                    not_captured[delivery.camera] = delivery.fault
        nights = _nights(site, self.date, self.since)
        stop_at = self.options["stop_at"]
        exit_codes: list[int] = []
        for night in nights:
            if exit_codes and stop_at and stop_at <= datetime.datetime.now():
                echo(f"{counted(len(nights) - len(exit_codes), 'night')} not begun: --stop-at {stop_at:%H:%M}", err=True)
                exit_codes.append(ExitCode.DEGRADED)
                break
            finished = self._run_night(site, night, not_captured)
            exit_codes.append(finished.record.exit_code)
            if finished.record.exit_code == ExitCode.INTERRUPTED:
                break
        if not self.quiet:
            following = next_step(finished, path)
            is_command = following.startswith("wbflow ")  # a command is copied: it stays on one line
            echo(f"next    {following}", indent=None if is_command else 8)
        return worst(exit_codes)

    def _run_night(self, site: Site, night: datetime.date | None, not_captured: Mapping[str, str]) -> Run:
        """Work on one night, and print what came of it."""
        from .. import api
        from ..records.events import OutputEvent, now
        from .ended import print_night
        from .libraries import without_library_output

        with without_library_output() as printed, display(site.name, self.verbose, self.quiet) as progress:
            finished = api.run(site, date=night, not_captured=not_captured, listen=progress.receive, **self.options)
            text = printable(printed().strip(), LONGEST_TRACE)
        if text:
            finished.run_folder.add(OutputEvent(None, text, now()))
        self.records.append(finished.record)
        if self.as_json:  # now: a later run may clean up
            self.documents.append(json.loads(finished.run_folder.paths.record.read_bytes()))
        print_night(finished, self.quiet)
        return finished


def _print_plans(site: Site, date: Day | None, since: Day | None, options: Mapping[str, Any]) -> int:
    """Print what would run, and why, for each night; nothing is written."""
    from ..commands.status import explain

    for night in _nights(site, date, since):
        planned = explain(planned_night(site, night, options["until"], options["force"]))
        if "would run" in planned.totals:
            print_plan(planned)
        else:
            echo(f"night of {planned.night}: nothing would run: {totals_of(planned)}")
    return ExitCode.GOOD


def _nights(site: Site, date: Day | None, since: Day | None) -> Sequence[datetime.date | None]:
    """The nights to work on; None is the newest one with captures."""
    from ..site.captures import backlog

    first_night = date_at(site, since)
    if first_night is None:
        return [date_at(site, date)]
    return backlog(site, first_night)


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
    code = ExitCode.GOOD
    if not any(delivery.files for delivery in captured):
        code = ExitCode.FAILED
    elif any(delivery.fault for delivery in captured):
        code = ExitCode.DEGRADED
    sys.exit(code)


def _capture(site: Site, quiet: bool) -> list[Delivery]:
    from ..capture.take import capture

    def print_delivery(delivery: Delivery) -> None:
        if delivery.fault or not quiet:
            echo(f"{delivery.camera:10} {delivery}", err=bool(delivery.fault))

    return capture(site, print_delivery)
