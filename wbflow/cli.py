"""The command line: commands, options and exit codes; nothing else.  Imports only what a command needs, when it needs it."""

from __future__ import annotations

import importlib.util
import json
import os
import sys
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from . import __version__

if TYPE_CHECKING:
    import datetime

    from .config.load import Site
    from .night.plan import State
    from .night.run import Finished, Listener, Options

USAGE = 2
FAILED = 1
LOCKED = 4
INTERRUPTED = 130


_PATH = click.Path(path_type=Path)
_site = click.argument("site", metavar="SITE.yaml", type=_PATH)
_work = click.option(
    "--work", type=_PATH, metavar="DIR", help="Work folder (default: `work:` of the site, else .wbflow/<site>/ beside it)."
)
_date = click.option(
    "--date", type=click.DateTime(["%Y-%m-%d"]), help="Night to work on (default: the newest that has captures)."
)
_verbose = click.option("-v", "--verbose", is_flag=True, help="Every task, and tracebacks.")
_until = click.option("--until", metavar="STAGE", help="Stop after this stage.")
_force = click.option("--force", multiple=True, metavar="STAGE_OR_TASK", help="Do this again: `fuse`, or `'matches gate--roof'`.")


class _Plain(click.Group):
    """A group whose faults reach the user as one line; with -v, as a traceback."""

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except KeyboardInterrupt:
            sys.exit(INTERRUPTED)
        except Exception as error:
            if {"-v", "--verbose"} & set(sys.argv):
                raise
            _stop(FAILED, f"wbflow itself failed: {type(error).__name__}: {error}\n  again with -v shows where")


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
@click.option(
    "--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, metavar="N", help="Workers (default: all cores)."
)
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
    loaded = _load(site, work)
    _check_names(loaded, until, force)
    if backend == "dask" and not scheduler:
        _stop(USAGE, "--backend dask needs --scheduler ADDRESS, e.g. tcp://host:8786")
    if backend == "dask" and importlib.util.find_spec("distributed") is None:
        _stop(USAGE, "--backend dask needs Dask: pip install 'wbflow[dask]'")
    if dry_run:
        _explain(loaded, date, until, force)
        return
    from .night.run import Options

    options = Options(_day(date), jobs, until, force, wait, backend, scheduler)
    finished = _run(loaded, options, verbose, quiet or as_json)
    if as_json:
        _say(json.dumps(finished.record, indent=1))
    elif not quiet:
        _summary(finished)
    if finished.record["reason"]:
        _say(f"no cloud: {finished.record['reason']}", err=True)
    sys.exit(finished.record["exit_code"])


@main.command()
@_site
@_date
@_work
@_until
def status(site: Path, date: datetime.datetime | None, work: Path | None, until: str | None) -> None:
    """What is cached, what would run, and why."""
    loaded = _load(site, work)
    _check_names(loaded, until, ())
    _explain(loaded, date, until, ())


@main.command()
@_site
@_date
@_work
def check(site: Path, date: datetime.datetime | None, work: Path | None) -> None:
    """Site, captures and machine examined without running; every finding, with its remedy."""
    loaded = _load(site, work)
    from .results.check import check as examine

    findings = examine(loaded, _day(date))
    for finding in findings:
        _say(f"{finding.severity}: {finding.what}\n  {finding.remedy}")
    if not findings:
        _say(f"{site}: {len(loaded.cameras)} cameras, all captures whole, everything installed")
    sys.exit(min((f.code for f in findings if f.severity == "error"), default=0))


@main.command()
@_site
@click.argument("run_id", metavar="[RUN]", required=False)
@_work
def report(site: Path, run_id: str | None, work: Path | None) -> None:
    """(Re)build a run's report."""
    loaded = _load(site, work)
    from .results.report.page import build_report
    from .store.atomic import write_atomic

    folder = _run_folder(loaded, run_id)
    write_atomic(folder / "report.html", build_report(loaded.work, folder).encode())
    _say(folder / "report.html")


@main.command()
@_site
@_work
def history(site: Path, work: Path | None) -> None:
    """Runs: when, how long, cached/ran/failed, cloud size, exit code."""
    loaded = _load(site, work)
    if not (loaded.work / "runs").is_dir():
        _stop(0, f"{loaded.name} has no runs yet: wbflow run {site}")
    from .store.ledger import Ledger

    with Ledger(loaded.work) as ledger:
        runs = ledger.runs()
    head = f"{'wall s':>8} {'CPU s':>8} {'cached':>6} {'ran':>5} {'rejected':>8} {'failed':>6}"
    _say(f"{'run':17} {'night':10} {head} {'points':>11} exit")
    for r in runs:
        points = f"{r['points']:,}" if r["points"] else "-"
        figures = f"{r['wall']:8.1f} {r['cpu']:8.1f} {r['cached']:6} {r['ran']:5} {r['rejected']:8} {r['failed']:6}"
        _say(f"{r['run']:17} {r['date']:10} {figures} {points:>11} {r['exit_code']:4}")


@main.command()
@_site
@click.option("--keep", type=click.IntRange(min=1), required=True, metavar="N", help="Runs whose artifacts stay.")
@click.option("--dry-run", is_flag=True, help="Only say how much would go.")
@_work
def clean(site: Path, keep: int, dry_run: bool, work: Path | None) -> None:
    """Remove artifacts that the last N runs don't use."""
    loaded = _load(site, work)
    from .store.clean import clean as remove
    from .store.lock import Locked, hold

    try:
        with hold(loaded.work / "lock", wait=False):
            done = remove(loaded.work, keep, dry_run)
    except Locked as locked:
        _stop(LOCKED, str(locked))
    verb = "would remove" if dry_run else "removed"
    _say(f"{verb} {done.files} files, {done.bytes / 1e6:,.1f} MB, and {len(done.runs)} runs")


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

    try:
        write_demo(folder, scene=scene, small=small, light=light, cameras=cameras, seed=seed)
    except (FileExistsError, ValueError) as error:
        _stop(USAGE, str(error))
    _say(f"{folder / 'site.yaml'}: now try  wbflow run {folder / 'site.yaml'}")


@main.command()
@click.argument("run_a", type=_PATH)
@click.argument("run_b", type=_PATH)
def compare(run_a: Path, run_b: Path) -> None:
    """Two nights side by side: folders of two runs."""
    from .results.compare import compare as rows
    from .results.compare import read_run

    try:
        table = rows(read_run(run_a), read_run(run_b))
    except ValueError as error:
        _stop(USAGE, str(error))
    for row in table:
        _say(f"{'*' if row.changed else ' '} {row.what:24} {row.a:>32}   {row.b}")


@main.command()
@click.argument("left", type=_PATH)
@click.argument("right", type=_PATH)
@click.option("--out", type=_PATH, required=True, metavar="DIR", help="Folder for the results (and the cache).")
@click.option("--resolution", type=click.IntRange(min=64), default=1600, metavar="N", help="Long side in pixels to work at.")
@click.option(
    "--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, metavar="N", help="Workers (default: all cores)."
)
@_verbose
def pair(left: Path, right: Path, out: Path, resolution: int, jobs: int, verbose: bool) -> None:
    """Two photographs and nothing else: matches, F, rectified pair, disparity, and a picture of each step."""
    from .config.positions import SiteError
    from .results.pair import match_pair, pair_site
    from .store.lock import Locked

    for photograph in (left, right):
        if not photograph.is_file():
            _stop(USAGE, f"{photograph}: there is no such file")
    try:
        site = pair_site(left, right, out, resolution)
        result = match_pair(site, out, jobs, _listener(site, verbose, quiet=False))
    except SiteError as error:
        _stop(USAGE, str(error))
    except Locked as locked:
        _stop(LOCKED, str(locked))
    for file in result.files:
        _say(file)
    if result.failure:
        _stop(FAILED, f"no disparity: {result.failure}")


@main.command()
@_site
@click.argument("run_id", metavar="[RUN]", required=False)
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
        _stop(USAGE, f"say what to export: {', '.join(f'--{name}' for name in asked)}")
    loaded = _load(site, work)
    from .results.export import MissingExtra, NothingToExport
    from .results.export import export as write
    from .store.cache import DamagedArtifact

    latest = (loaded.work / "runs" / "latest").exists()
    try:
        for file in write(loaded.work, _run_folder(loaded, run_id or ("latest" if latest else None)), out, forms):
            _say(file)
    except MissingExtra as missing:
        _stop(USAGE, str(missing))
    except NothingToExport as nothing:
        _stop(FAILED, f"nothing to export: {nothing}")
    except DamagedArtifact as damage:
        _stop(FAILED, f"{damage} by the next  wbflow run {site}")


def _day(date: datetime.datetime | None) -> datetime.date | None:
    return date.date() if date else None


def _load(path: Path, work: Path | None) -> Site:
    from .config.load import load_site
    from .config.positions import SiteError

    try:
        return load_site(path, work.resolve() if work else None)
    except SiteError as error:
        count = len(error.problems)
        _stop(USAGE, f"{error}\n{count} problem{'s' * (count != 1)} in {path}; nothing was done")


def _check_names(site: Site, until: str | None, force: tuple[str, ...]) -> None:
    from .graph.pipeline import STAGES

    names = [stage.name for stage in STAGES]
    if until and until not in names:
        _stop(USAGE, f"--until {until}: there is no such stage; stages are {', '.join(names)}")
    for name in force:
        if name.split(" ")[0] not in names:
            _stop(USAGE, f"--force {name!r}: name a stage ({', '.join(names)}) or a task such as 'matches gate--roof'")


def _run(site: Site, options: Options, verbose: bool, quiet: bool) -> Finished:
    from .night.run import run as work
    from .store.lock import Locked

    try:
        return work(site, options, _listener(site, verbose, quiet))
    except Locked as locked:
        _stop(LOCKED, f"{locked}\n  wait for it (--wait), or stop it")
    except OSError as error:
        if verbose:
            traceback.print_exc()
        _stop(
            FAILED,
            f"{error.filename or site.work}: {error.strerror or error}\n  check the disk and the rights on the work folder",
        )


def _listener(site: Site, verbose: bool, quiet: bool) -> Listener:
    """What is said of tasks as they end: failures and rejections, everything with -v; a counter where somebody watches."""
    watched = sys.stderr.isatty() and not quiet
    count = 0

    def listen(task: str, state: State, trace: str | None) -> None:
        nonlocal count
        count += 1
        if watched:
            _say("\r\x1b[K", nl=False, err=True)
        if verbose or state.outcome == "failed" or (state.outcome == "rejected" and not quiet):
            stage, _, subject = task.partition(" ")
            line = f"{subject or site.name:20} {stage:10} {state.outcome:9} {state.reason or ''}"
            _say(line.rstrip(), err=state.outcome == "failed")
        if trace and verbose:
            _say(trace, err=True)
        if watched:
            _say(f"{count} tasks, last {task}", nl=False, err=True)

    return listen


def _summary(finished: Finished) -> None:
    record = finished.record
    if sys.stderr.isatty():
        _say("\r\x1b[K", nl=False, err=True)
    tasks = ", ".join(f"{count} {name}" for name, count in record["tasks"].items() if count)
    _say(f"{tasks or 'nothing to do'}; {record['seconds']['wall']:.1f} s, {record['seconds']['cpu']:.1f} CPU s")
    if record["cloud"]:
        _say(f"cloud   {finished.folder / 'cloud.ply'}  ({record['cloud']['points']:,} points)")
    _say(f"report  {finished.folder / 'report.html'}")


def _explain(site: Site, date: datetime.datetime | None, until: str | None, force: tuple[str, ...]) -> None:
    from .night.night import open_night
    from .results.status import explain

    plan = open_night(site, _day(date), until, force).plan
    plan.refresh()
    for line in explain(plan):
        _say(f"{line.task:32} {line.state}{': ' + line.why if line.why else ''}")
    if not plan.pairs_known() and any(stage.name == "pairs" for stage in plan.stages()):
        _say("(tasks of pairs are listed once the pair graph is known)")


def _run_folder(site: Site, run_id: str | None) -> Path:
    runs = site.work / "runs"
    known = sorted(p.name for p in runs.glob("*") if (p / "run.json").is_file() and not p.is_symlink())
    if not known:
        _stop(USAGE, f"{site.name} has no runs yet")
    if run_id in (None, "latest"):
        return runs / known[-1] if run_id is None else (runs / "latest").resolve()
    if run_id not in known:
        _stop(USAGE, f"there is no run {run_id!r}; the last ones are {', '.join(known[-3:])}")
    return runs / str(run_id)


def _say(text: object, nl: bool = True, err: bool = False) -> None:
    """Print; a reader that went away (`wbflow run ... | head -1`) costs the words, not the night's work."""
    try:
        click.echo(text, nl=nl, err=err)
    except BrokenPipeError:
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), (sys.stderr if err else sys.stdout).fileno())


def _stop(code: int, message: str) -> NoReturn:
    _say(message, err=code != 0)
    sys.exit(code)
