"""The command line: commands, options and exit codes; nothing else.  Imports only what a command needs, when it needs it."""

from __future__ import annotations

import json
import os
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

import click

from . import __version__
from .errors import ExitCode, UsageError, WbflowError
from .screen import listener, say, stop, summary

if TYPE_CHECKING:
    import datetime

    from .config.site import Site
    from .store.layout import WorkFolder

_PATH = click.Path(path_type=Path)
_site = click.argument("site", metavar="SITE.yaml", type=_PATH)
_run_id = click.argument("run_id", metavar="[RUN]", required=False)
_work = click.option(
    "--work", type=_PATH, metavar="DIR", help="Work folder (default: `work:` of the site, else .wbflow/<site>/ beside it)."
)
_date = click.option(
    "--date", type=click.DateTime(["%Y-%m-%d"]), help="Night to work on (default: the newest that has captures)."
)
_jobs = click.option(
    "--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, metavar="N", help="Workers (default: all cores)."
)
_verbose = click.option("-v", "--verbose", is_flag=True, help="Every task, and tracebacks.")
_until = click.option("--until", metavar="STAGE", help="Stop after this stage.")
_force = click.option("--force", multiple=True, metavar="STAGE_OR_TASK", help="Do this again: `fuse`, or `'matches gate--roof'`.")


class _Plain(click.Group):
    """A group whose faults reach the user as one line and what to do; with -v, as a traceback."""

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except KeyboardInterrupt:
            sys.exit(ExitCode.INTERRUPTED)
        except WbflowError as error:
            if _tracebacks_wanted() and error.__cause__:
                traceback.print_exception(error.__cause__)
            stop(error.exit_code, str(error))
        except Exception as error:
            if _tracebacks_wanted():
                raise
            stop(ExitCode.FAILED, f"wbflow itself failed: {type(error).__name__}: {error}\n  again with -v shows where")


@click.group(cls=_Plain, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="wbflow")
def main() -> None:
    """A metric, coloured point cloud of a site, every night, from fixed cameras far apart.

    Exit codes: 0 complete; 1 no cloud could be made; 2 wrong usage or site file; 3 a cloud, but something failed;
    4 another run holds the work folder; 130 interrupted (everything finished is kept).
    """


@main.command()
@_site
@_date
@_work
@_jobs
@_until
@_force
@click.option("--dry-run", is_flag=True, help="Say what would run, and why; write nothing.")
@click.option("--wait", is_flag=True, help="Wait for another run of this work folder instead of giving up.")
@click.option("--json", "as_json", is_flag=True, help="Print run.json, and nothing else.")
@click.option("--backend", type=click.Choice(["loky", "threading", "dask"]), default="loky", help="Where tasks run.")
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, for --backend dask: tcp://host:8786.")
@_verbose
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
    verbose: bool,
    quiet: bool,
) -> None:
    """The night's work: from captures to cloud and report.  What has not changed is taken from the cache."""
    loaded = _load(site, work, notes=dry_run)
    if dry_run:
        _explain(loaded, date, until, force)
        return
    from .api import run as work_through

    finished = work_through(
        loaded,
        date=_day(date),
        jobs=jobs,
        until=until,
        force=force,
        wait=wait,
        backend=backend,
        scheduler=scheduler,
        listen=listener(loaded, verbose, quiet or as_json),
    )
    if as_json:
        say(json.dumps(finished.record.to_json(), indent=1))
    elif not quiet:
        summary(finished)
    if finished.record.reason:
        say(f"no cloud: {finished.record.reason}", err=True)
    sys.exit(finished.record.exit_code)


@main.command()
@_site
@_date
@_work
@_until
def status(site: Path, date: datetime.datetime | None, work: Path | None, until: str | None) -> None:
    """What is cached, what would run, and why."""
    _explain(_load(site, work), date, until, ())


@main.command()
@_site
@_date
@_work
def check(site: Path, date: datetime.datetime | None, work: Path | None) -> None:
    """Site, captures and machine examined without running; every finding, with its remedy."""
    loaded = _load(site, work)
    from .results.check import check as examine
    from .results.check import exit_code

    findings = examine(loaded, _day(date))
    for finding in findings:
        say(f"{finding.severity}: {finding.what}\n  {finding.remedy}")
    if not findings:
        say(f"{site}: {len(loaded.cameras)} cameras, all captures whole, everything installed")
    sys.exit(exit_code(findings))


@main.command()
@_site
@_run_id
@_work
def report(site: Path, run_id: str | None, work: Path | None) -> None:
    """(Re)build a run's report."""
    place = _place(_load(site, work))
    from .results.report.page import rebuild_report
    from .store.run_folder import RunFolder

    folder = RunFolder.of(place, run_id)
    say(folder.write_report(rebuild_report(place, folder)))


@main.command()
@_site
@_work
def history(site: Path, work: Path | None) -> None:
    """Runs: when, how long, cached/ran/failed, cloud size, exit code."""
    loaded = _load(site, work)
    place = _place(loaded)
    if not place.run_ids():
        stop(ExitCode.GOOD, f"{loaded.name} has no runs yet: wbflow run {site}")
    from .store.ledger import Ledger

    with Ledger(place) as ledger:
        runs = ledger.runs()
    head = f"{'wall s':>8} {'CPU s':>8} {'cached':>6} {'ran':>5} {'rejected':>8} {'failed':>6}"
    say(f"{'run':17} {'night':10} {head} {'points':>11} exit")
    for r in runs:
        points = f"{r.points:,}" if r.points else "-"
        figures = f"{r.wall:8.1f} {r.cpu:8.1f} {r.cached:6} {r.ran:5} {r.rejected:8} {r.failed:6}"
        say(f"{r.run:17} {r.date:10} {figures} {points:>11} {r.exit_code:4}")


@main.command()
@_site
@click.option("--keep", type=click.IntRange(min=1), required=True, metavar="N", help="Runs whose artifacts stay.")
@click.option("--dry-run", is_flag=True, help="Only say how much would go.")
@_work
def clean(site: Path, keep: int, dry_run: bool, work: Path | None) -> None:
    """Remove artifacts that the last N runs don't use."""
    place = _place(_load(site, work))
    from .store.clean import clean as remove
    from .store.lock import hold

    with hold(place.lock, wait=False):
        done = remove(place, keep, dry_run)
    verb = "would remove" if dry_run else "removed"
    say(f"{verb} {done.files} files, {done.bytes / 1e6:,.1f} MB, and {len(done.runs)} runs")


@main.command()
@click.argument("folder", metavar="DIR", type=_PATH)
@click.option(
    "--scene", default="yard", metavar="NAME", show_default=True, help="yard, square, hall, hall-2, hall-4, houses, ..."
)
@click.option("--small", is_flag=True, help="320x180 (the yard with 4 cameras): rendered in seconds.")
@click.option("--light", type=click.Choice(["day", "dusk", "night", "dark"]), default="day", help="Hour; dark: no lamps.")
@click.option("--cameras", type=click.IntRange(min=1), metavar="N", help="So many of the scene's cameras.")
@click.option("--seed", type=click.IntRange(min=0), default=0, metavar="N", help="Another scene of the same kind.")
def demo(folder: Path, scene: str, small: bool, light: str, cameras: int | None, seed: int) -> None:
    """Render the demo site (captures, site.yaml, truth) into DIR."""
    from .results.demo import write_demo

    write_demo(folder, scene=scene, small=small, light=light, cameras=cameras, seed=seed)
    say(f"{folder / 'site.yaml'}: now try  wbflow run {folder / 'site.yaml'}")


@main.command()
@click.argument("folder", metavar="[FOLDER]", type=_PATH, default=Path())
def init(folder: Path) -> None:
    """Write a site file from a folder of photographs.

    Either one photograph of each camera, or one folder for each camera with its photographs (several are several captures of
    one night). The site file is put into FOLDER (here, if none is named) as site.yaml; one that is there is left alone.

    \b
    photographs/gate.jpg photographs/roof.jpg ...            wbflow init photographs
    photographs/gate/1.jpg photographs/roof/1.jpg ...        wbflow init photographs
    """
    from .results.init import write_site

    made = write_site(folder)
    say(f"{made.file}: {len(made.cameras)} cameras: {', '.join(made.cameras)}")
    for note in made.notes:
        say(note)
    say(f"now try  wbflow check {made.file}  and  wbflow run {made.file}")


@main.command()
@click.argument("run_a", type=_PATH)
@click.argument("run_b", type=_PATH)
def compare(run_a: Path, run_b: Path) -> None:
    """Two nights side by side: folders of two runs."""
    from .results.compare import compare as rows
    from .store.run_folder import RunFolder

    for row in rows(RunFolder.at(run_a).record(), RunFolder.at(run_b).record()):
        say(f"{'*' if row.changed else ' '} {row.what:24} {row.a:>32}   {row.b}")


@main.command()
@click.argument("left", type=_PATH)
@click.argument("right", type=_PATH)
@click.option("--out", type=_PATH, required=True, metavar="DIR", help="Folder for the results (and the cache).")
@click.option("--resolution", type=click.IntRange(min=64), default=1600, metavar="N", help="Long side in pixels to work at.")
@_jobs
@_verbose
def pair(left: Path, right: Path, out: Path, resolution: int, jobs: int, verbose: bool) -> None:
    """Two photographs and nothing else: matches, F, rectified pair, disparity, and a picture of each step."""
    from .api import run as work_through
    from .results.pair import LAST_STAGE, failure, pair_site, write_pair

    site = pair_site(left, right, out, resolution)
    finished = work_through(site, jobs=jobs, until=LAST_STAGE, listen=listener(site, verbose, quiet=False)).finished
    for file in write_pair(finished, out):
        say(file)
    if why := failure(finished):
        stop(ExitCode.FAILED, f"no disparity: {why}")


@main.command()
@_site
@_run_id
@click.option("--out", type=_PATH, required=True, metavar="DIR", help="Folder for the files.")
@click.option("--laz", is_flag=True, help="The cloud as LAZ, on the map where positions are known by latitude and longitude.")
@click.option("--heights", is_flag=True, help="Heights seen from above: GeoTIFF where the site is on the map, else PNG, PFM.")
@click.option("--depth", is_flag=True, help="Depth map of each camera: 16-bit PNG and PFM.")
@click.option("--mesh", is_flag=True, help="The surface through the cloud (Poisson), as PLY.")
@click.option("--colmap", is_flag=True, help="Cameras, images and points as a COLMAP model.")
@_work
def export(site: Path, run_id: str | None, out: Path, work: Path | None, **asked: bool) -> None:
    """A run's results for other programs; the newest run that made a cloud, if no RUN is named."""
    forms = frozenset(name for name, wanted in asked.items() if wanted)
    if not forms:
        raise UsageError(f"say what to export: {', '.join(f'--{name}' for name in asked)}")
    place = _place(_load(site, work))
    from .results.artifacts import FinishedRun
    from .results.export import export as write
    from .store.run_folder import RunFolder

    folder = RunFolder.of(place, run_id or (place.latest.name if place.latest.exists() else None))
    for file in write(FinishedRun.open(place, folder), out, forms):
        say(file)


@main.command()
@click.argument("stage", metavar="[STAGE]", required=False)
def stages(stage: str | None) -> None:
    """Every parameter of every stage, with default, unit and meaning; of one stage, if it is named."""
    from .graph.describe import describe, describe_all, lines
    from .graph.functions import FunctionReader
    from .graph.pipeline import STAGES

    chosen = [row for row in STAGES if row.name == stage]
    if stage and not chosen:
        raise UsageError(f"there is no stage {stage!r}; stages are {', '.join(row.name for row in STAGES)}")
    reader = FunctionReader()
    rows = [describe(row, reader) for row in chosen] or describe_all(reader)
    say("\n\n".join("\n".join(lines(row)) for row in rows))


def _day(date: datetime.datetime | None) -> datetime.date | None:
    return date.date() if date else None


def _load(path: Path, work: Path | None, notes: bool = True) -> Site:
    """The site; notes: say what of its file is out of date (a run tells it itself, and logs it)."""
    from .config.load import load_site
    from .config.positions import SiteError

    try:
        site = load_site(path, work.resolve() if work else None)
        for note in site.notes if notes else ():
            say(f"note: {note}", err=True)
        return site
    except SiteError as error:
        count = len(error.problems)
        raise UsageError(f"{error}\n{count} problem{'s' * (count != 1)} in {path}; nothing was done") from None


def _place(site: Site) -> WorkFolder:
    from .store.layout import WorkFolder

    return WorkFolder(site.work)


def _explain(site: Site, date: datetime.datetime | None, until: str | None, force: tuple[str, ...]) -> None:
    from .night.night import open_night
    from .night.options import Options
    from .results.status import explain, pairs_to_come

    Options(until=until, force=force).check()
    plan = open_night(site, _day(date), until, force).plan
    plan.refresh()
    for line in explain(plan):
        say(f"{line.task:32} {line.state}{': ' + line.why if line.why else ''}")
    if pairs_to_come(plan):
        say("(tasks of pairs are listed once the pair graph is known)")


def _tracebacks_wanted() -> bool:
    return bool({"-v", "--verbose"} & set(sys.argv))
