"""Commands for the results of runs: report, history, comparison, reference, exports, a task's inputs, and disk space."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import ExitCode, UsageError, WbflowError, worst
from ..pipeline.exports import EXPORTS, SCANS
from ..words import counted
from . import common
from .common import Day, date_at, day, echo, echo_json, load, stop

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..records.finished_run import Run
    from ..records.record import RunRecord
    from ..site.models import Site


@click.command()
@common.site_argument
@common.run_argument
@common.work_option
def report(site: Path, run_id: str | None, work: str | None) -> None:
    """Build a run's report again.

    \b
    wbflow report site.yaml                       of the newest run
    wbflow report site.yaml 20261120T031500Z
    """
    from ..report.page import rebuild_report

    loaded = load(site, work)
    run = _run_of(loaded, run_id)
    echo(run.run_folder.write_report(rebuild_report(loaded, run)))


@click.command()
@common.site_argument
@common.json_option
@click.option("--changes", is_flag=True, help="Every change from its first night to its last, and the volumes of each zone.")
@click.option("--csv", is_flag=True, help="With --changes: volumes night by night, as a table for spreadsheets.")
@common.work_option
def history(site: Path, as_json: bool, changes: bool, csv: bool, work: str | None) -> None:
    """List all runs.  Each with night, seconds, tasks (cached/ran/failed), points, exit code, verdict; below, what was found.

    \b
    wbflow history site.yaml
    wbflow history site.yaml --json
    wbflow history site.yaml --changes            every change with its first and last night, also those that are gone
    wbflow history site.yaml --changes --csv      the same night by night, with cut and fill since the reference
    """
    from ..records.history import as_csv, compared_nights, growth
    from ..records.history import history as entries

    loaded = load(site, work)
    if csv and not changes:
        raise UsageError("--csv is for --changes", remedy=f"wbflow history {site} --changes --csv")
    if changes:
        nights = compared_nights(loaded.work_folder)
        if as_json:
            echo_json([row.to_json() for row in growth(nights)])
        elif csv:
            echo(as_csv(growth(nights)).rstrip("\n"))
        else:
            _print_things(loaded, nights)
        return
    past_runs = entries(loaded.work_folder)
    if as_json:
        echo_json([entry.to_json() for entry in past_runs])
        return
    if not past_runs:
        stop(ExitCode.GOOD, f"{loaded.name} has no runs yet: wbflow run {site}")
    echo(f"{'night':10} {'run':16} {'seconds':>7} {'tasks':>11} {'points':>10} exit verdict")
    reason = ""
    for entry in past_runs:
        row = entry.run
        tasks = f"{row.cached}/{row.ran}/{row.failed}"
        points = f"{row.points:,}" if row.points else "-"
        figures = f"{row.wall:7.1f} {tasks:>11} {points:>10} {row.exit_code:4}"
        is_same = bool(entry.reason) and entry.reason == reason
        words = entry.words
        if is_same and entry.verdict:
            words = f"{entry.verdict.level}, as before"
        echo(f"{row.date:10} {row.run:16} {figures} {words}".rstrip(), level=entry.verdict.level if entry.verdict else "")
        if entry.reason and not is_same:
            echo(f"           {entry.reason}", indent=11)
        reason = entry.reason


def _print_things(site: Site, nights: Sequence[RunRecord]) -> None:
    """Print every change, one to a line, and what the newest night has gained and lost."""
    from ..records.history import THINGS_HEAD, balance_lines, things
    from ..verdict.acknowledge import read

    if not nights:
        echo(f"{site.name}: no night has been compared with a reference yet")
        return
    newest = nights[-1]
    acknowledged = {entry.finding: entry for entry in read(site) if entry.holds(newest.date)}
    found = things(nights)
    if found:
        echo(THINGS_HEAD)
    for thing in found:
        echo(thing.line(newest.unit))
        entry = acknowledged.get(thing.change.id)
        if entry:
            echo(f"      {entry.words}", indent=6)
    since = f"since the reference, night of {newest.date}"
    echo(f"{since}:" if found else f"nothing has changed {since}:")
    for line in balance_lines(newest):
        echo(f"  {line}", indent=4)


@click.command()
@common.sites_argument
@common.json_option
def runs(sites: tuple[Path, ...], as_json: bool) -> None:
    """List the runs of sites, for programs.  Each with folder, night, verdict, cloud and report.

    \b
    wbflow runs site.yaml --json
    wbflow runs sites/*.yaml
    """
    from ..records.history import places

    loaded = [load(path, None) for path in sites]
    site_runs: list[dict[str, Any]] = []
    for site in loaded:
        for entry in places(site.work_folder):
            site_runs.append({"site": site.name, **entry})
    if as_json:
        echo_json(site_runs)
        return
    for entry in site_runs:
        points = f"{entry['points']:,}" if entry["points"] else "-"
        cleaned = "" if entry["folder"] else "  cleaned"
        level = entry["level"] or "-"
        echo(f"{entry['site']:20} {entry['night']} {level:9} {points:>11}  {entry['folder'] or entry['run']}{cleaned}")


@click.command()
@click.argument("nights", metavar="[SITE.yaml] [RUN_A RUN_B]", type=common.PATH, nargs=-1, required=True)
@click.option("--out", type=common.PATH, default=Path("deviation"), metavar="DIR", help="Folder for the deviation from a scan.")
@click.option("--page", type=common.PATH, metavar="FILE", help="Write a page with both nights in one view.")
@click.option("--changes", is_flag=True, help="Compare the clouds of both with each other, instead of each with the reference.")
@click.option("--figures", is_flag=True, help="Also print all figures that differ by more than noise.")
@common.json_option
@common.work_option
def compare(
    nights: tuple[Path, ...], out: Path, page: Path | None, changes: bool, figures: bool, as_json: bool, work: str | None
) -> None:
    """Compare two nights, or a night with a scan.  Prints what has changed, and how the nights differ.

    \b
    wbflow compare SITE.yaml                           the newest run, and the newest good one before it
    wbflow compare SITE.yaml --figures                 also all figures of cameras and pairs that differ
    wbflow compare SITE.yaml 2026-11-18 2026-11-19     runs by night, by id, or latest, latest-good
    wbflow compare RUN_A RUN_B                         folders of two runs, of any sites
    wbflow compare SITE.yaml --changes                 cut and fill between them
    wbflow compare SITE.yaml latest-good latest --page both.html
    wbflow compare SITE.yaml [RUN] scan.laz            the cloud's deviation from a scan or model
    """
    from ..cache.atomic import write_atomic
    from ..commands.compare import changed_lines, changed_since, changes_between, data_of, differing, lines_of
    from ..commands.compare import compare as rows_of

    if len(nights) > 3:
        raise UsageError("name two runs", remedy="wbflow compare SITE.yaml RUN_A RUN_B; wbflow history SITE.yaml  lists them")
    if len(nights) > 1 and nights[-1].suffix.lower() in SCANS:
        _compare_with_scan(load(nights[0], work), str(nights[1]) if len(nights) == 3 else None, nights[-1], out, as_json)
        return
    site = load(nights[0], work) if len(nights) != 2 else None
    if page and site is None:
        raise UsageError("a page needs the site of the runs", remedy=f"wbflow compare SITE.yaml RUN_A RUN_B --page {page}")
    earlier, later = _two_runs(site, nights)
    rows = rows_of(earlier.record, later.record)
    found = changes_between(earlier, later) if changes or page else None
    if page and site:
        from ..report.page import build_comparison

        write_atomic(page, build_comparison(site, later, earlier, found).encode(errors="backslashreplace"))
        echo(page, err=True)
    change_data = {"changes": data_of(found)} if found else {}
    if as_json:
        since = changed_since(earlier.record, later.record)
        data = {"a": earlier.id, "b": later.id, "changed": since.to_json() if since else None}
        echo_json({**data, "rows": [row.to_json() for row in rows], **change_data})
        return
    # 1. what has changed: from cloud to cloud if that was asked for, else as both nights saw it since the reference
    for line in lines_of(change_data["changes"]) if changes else changed_lines(earlier.record, later.record):
        echo(line, indent=4)
    # 2. how the nights differ
    technical = [row for row in differing(rows) if row.technical]
    for row in differing(rows):
        if figures or not row.technical:
            echo(row)
    if len(differing(rows)) == 3:
        echo("nothing else differs by more than noise")
    elif technical and not figures:
        echo(f"and {counted(len(technical), 'figure')} of stages, cameras and pairs: --figures lists them")


def _two_runs(site: Site | None, nights: tuple[Path, ...]) -> tuple[Run, Run]:
    from ..commands.compare import last_two
    from ..records.finished_run import Run
    from ..records.run_folder import RunFolder

    if site is None:
        return Run.at(RunFolder.at(nights[0])), Run.at(RunFolder.at(nights[1]))
    if len(nights) == 3:
        return _run_of(site, str(nights[1])), _run_of(site, str(nights[2]))
    earlier, later = last_two(site.work_folder)
    return Run.at(earlier), Run.at(later)


def _run_of(site: Site, name: str | None) -> Run:
    """A run by its name, as `RunFolder.of` takes it."""
    from ..records.finished_run import Run
    from ..records.run_folder import RunFolder

    return Run.at(RunFolder.of(site.work_folder, name))


def _compare_with_scan(site: Site, night: str | None, scan: Path, out: Path, as_json: bool) -> None:
    from ..commands.compare import compare_with_scan

    run = _run_of(site, night or site.work_folder.latest_good.name)
    result = compare_with_scan(run, scan, out)
    if as_json:
        echo_json(result)
        return
    echo(f"night of {result['night']} against {result['scan']}: the scan covers {result['overlap']:.0%} of the cloud")
    echo(f"they agree on {result['agreeing']:.0%} of that, to {1000 * result['residual']:.0f} mm (median)")
    significant = f"{result['beyond_detection']:.0%} deviate by more than can be noise"
    median, p90 = 1000 * result["median_deviation"], 1000 * result["p90_unsigned"]
    echo(f"deviation: median {median:+.0f} mm, nine in ten within {p90:.0f} mm; {significant}")
    for name in ("deviation.ply", "deviation.json"):
        echo(out / name)


@click.command()
@common.site_argument
@click.argument("words", metavar="[FINDING]", nargs=-1)
@click.option("--until", type=day, metavar="DAY", help="Last night for which it is acknowledged (default: until dropped).")
@click.option("--note", default="", metavar="TEXT", help="Why.")
@click.option("--drop", is_flag=True, help="Withdraw the acknowledgement.")
@common.json_option
def acknowledge(site: Path, words: tuple[str, ...], until: Day | None, note: str, drop: bool, as_json: bool) -> None:
    """Acknowledge a finding or a change.  It stays in the report, but no longer degrades a night or sends notifications.

    A finding is named by its code and camera, a change by its id.

    \b
    wbflow acknowledge site.yaml                  lists what is found, and what is acknowledged
    wbflow acknowledge site.yaml camera-lost crane-2 --until 2026-12-04 --note "new cable on Friday"
    wbflow acknowledge site.yaml camera-lost crane-2 --drop
    wbflow acknowledge site.yaml C17 --note "the crane is here for good"
    """
    from ..verdict import acknowledge as known

    loaded, finding = load(site, None), " ".join(words)
    if not finding:
        _list_acknowledged(loaded, as_json)
        return
    entry = known.drop(loaded, finding) if drop else known.add(loaded, finding, date_at(loaded, until), note)
    named = f"{entry.finding} {entry.what}".rstrip()
    if as_json:
        echo_json({**entry.to_json(), "dropped": drop})
    elif drop:
        echo(f"{named} counts again, from the next run on")
    else:
        echo(f"{named}: {entry.words}; from the next run on", indent=4)


def _list_acknowledged(site: Site, as_json: bool) -> None:
    """Print what the newest nights have found that nobody has acknowledged, then what somebody has."""
    from ..records.changes import open_changes
    from ..records.findings import UNEXPECTED_CHANGE
    from ..records.run_folder import newest_compared, newest_runs
    from ..verdict import acknowledge as known

    newest = next((record for _, record in newest_runs(site.work_folder)), None)
    compared = newest_compared(site.work_folder)
    acknowledged = known.read(site)
    findings = newest.verdict.findings if newest and newest.verdict else ()
    changes = open_changes(known.with_known(compared, acknowledged)) if compared else []
    if as_json:
        data = {"findings": findings, "changes": changes, "acknowledged": acknowledged}
        echo_json({name: [entry.to_json() for entry in entries] for name, entries in data.items()})
        return
    for finding in findings:
        if finding.kind != UNEXPECTED_CHANGE:  # it is among the changes
            echo(f"{known.name_of(finding)}: {finding.text}", indent=4)
    for change in changes:
        unit = compared.unit if compared else ""
        echo(f"{change.id}: {change.words(unit)}; {change.volume_words(unit)}; since {change.first}", indent=4)
    for entry in acknowledged:
        echo(f"{entry.finding}: {f'{entry.what}; ' if entry.what else ''}{entry.words}", indent=4)
    if not findings and not changes and not acknowledged:
        echo("there is nothing to acknowledge")


@click.command()
@common.site_argument
@common.run_argument
@click.option("--list", "listed", is_flag=True, help="Print the reference.")
@click.option("--drop", is_flag=True, help="Forget the reference.")
@click.option("--refine", is_flag=True, help="Refine the reference with the measurements of later nights.")
@common.work_option
def pin(site: Path, run_id: str | None, listed: bool, drop: bool, refine: bool, work: str | None) -> None:
    """Make a run the reference of later nights.  Without RUN, the newest good run is taken.

    The first good run is pinned automatically, unless the site file says `pin: none`.

    \b
    wbflow pin site.yaml                          the newest good run
    wbflow pin site.yaml 20261120T031500Z
    wbflow pin site.yaml --list
    """
    from ..cache.store import Cache
    from ..records.reference import read_reference
    from ..records.run_folder import hold_to_write
    from ..reference import create
    from ..reference.folder import drop_reference

    if listed + drop + refine + (run_id is not None) > 1:
        remedy = "wbflow pin SITE.yaml --list  prints the reference"
        raise UsageError("--list, --drop, --refine and RUN exclude each other", remedy=remedy)
    loaded = load(site, work)
    folder = loaded.work_folder
    if listed:
        pinned = read_reference(folder)
        lines = pinned.lines() if pinned else [f"{loaded.name} has no reference"]
        for line in lines:
            echo(line)
        return
    with hold_to_write(folder, wait=False):
        if drop:
            was_there = drop_reference(folder)
            echo("the reference is dropped" if was_there else f"{loaded.name} has no reference")
        elif refine:
            _refine_reference(loaded)
        else:
            reference = create.pin(Cache(folder), create.good_run(folder, run_id))
            echo(f"run {reference.run} (night of {reference.date}) is the reference now: {folder.reference}")
            if loaded.settings.pin == "none":
                echo("the site file says `pin: none`: nothing is compared with it until that is changed", err=True)


def _refine_reference(site: Site) -> None:
    """Pool the measurements of later nights into the reference, and print of which tasks."""
    from ..cache.store import Cache
    from ..records.reference import read_reference
    from ..reference.aggregate import aggregate_nights
    from ..reference.restore import restore

    folder = site.work_folder
    reference = read_reference(folder)
    if reference is None:
        raise UsageError(f"{site.name} has no reference to refine", remedy=f"first: wbflow pin {site.file}")
    restore(Cache(folder), reference)
    pooled = aggregate_nights(folder, reference, site)
    for task, nights in pooled.items():
        echo(f"{task}: pooled from {nights} nights")
    if not pooled:
        echo("nothing to pool yet")


def _export_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add an option for each export; click lists those first that are added last."""
    for row in reversed(EXPORTS):
        command = click.option(f"--{row.name}", is_flag=True, help=row.help)(command)
    return command


@click.command()
@common.site_argument
@common.run_argument
@common.out_option
@_export_options
@common.work_option
def export(site: Path, run_id: str | None, out: Path, work: str | None, **wanted: bool) -> None:
    """Write a run's results for other programs.  Without RUN, those of the newest run with a cloud.

    An export that cannot be made does not stop the others; it is named, and the exit code is not 0.

    \b
    wbflow export site.yaml --laz --heights --out maps
    wbflow export site.yaml 20261120T031500Z --colmap --out model
    """
    rows = [row for row in EXPORTS if wanted[row.name]]
    if not rows:
        known = ", ".join(f"--{row.name}" for row in EXPORTS)
        example = f"for example: wbflow export {site} --{EXPORTS[0].name} --out {out}"
        raise UsageError(f"name what to export: {known}", remedy=example)
    from ..commands.export import export as write

    loaded = load(site, work)
    run = _run_of(loaded, run_id or loaded.work_folder.latest_good.name)
    exit_codes = []
    for row in rows:
        try:
            for file in write(run, out, frozenset({row.name})):
                echo(file)
        except WbflowError as error:
            if len(rows) == 1:
                raise
            echo(f"--{row.name} was not made: {error}", err=True)
            exit_codes.append(error.exit_code)
    if exit_codes:
        stop(ExitCode(worst(exit_codes)), f"{len(exit_codes)} of {len(rows)} exports not made; the others are in {out}")


@click.command()
@click.argument("words", metavar="[SITE.yaml] TASK", nargs=-1, required=True)
@common.out_option
@common.date_option
@common.work_option
def debug(words: tuple[str, ...], out: Path, date: Day | None, work: str | None) -> None:
    """Write one task's inputs as ordinary files.  With its parameters, and a short script that runs it alone.

    A task is a stage and its subject. Images are PNG, tables CSV, clouds PLY, other arrays npy; task.json says where each is.
    Without SITE.yaml, the site file in this folder is used.

    \b
    wbflow debug site.yaml 'disparity gate--roof' --out look
    wbflow debug site.yaml frames gate --date yesterday --out look
    python look/run.py          prints the result, and whether the cache has the same bytes
    """
    from ..commands.debug import write_task
    from ..pipeline.stages import STAGES
    from ..records.finished_run import task_named

    site, task = Path(words[0]), " ".join(words[1:])
    if words[0].split(" ")[0] in {row.name for row in STAGES}:
        site, task = Path(), " ".join(words)
    if not task:
        raise UsageError("name a task", remedy=f"for example: wbflow debug {site} 'frames CAMERA' --out {out}")
    loaded = load(site, work)
    files = write_task(loaded, task_named(task), out, date_at(loaded, date))
    for file in files:
        echo(file)
    echo(f"now try  python {files[0]}")


@click.command()
@common.site_argument
@click.option("--keep", type=click.IntRange(min=1), required=True, metavar="N", help="Latest runs whose artifacts are kept.")
@click.option("--clouds", type=click.IntRange(min=1), metavar="N", help="Also remove clouds, except those of N nights.")
@click.option("--reports", type=click.IntRange(min=1), metavar="N", help="Also remove reports and logs except those of N nights.")
@click.option("--dry-run", is_flag=True, help="Only print how much would be removed.")
@common.work_option
def clean(site: Path, keep: int, clouds: int | None, reports: int | None, dry_run: bool, work: str | None) -> None:
    """Remove artifacts that the last N runs do not use.  Published clouds and reports stay, unless an option says otherwise.

    \b
    wbflow clean site.yaml --keep 7 --dry-run     print how much would be removed
    wbflow clean site.yaml --keep 7 --clouds 30
    """
    from ..records.cleanup import clean as remove
    from ..records.keep import Keep
    from ..records.run_folder import NoSuchRun, hold_to_write
    from ..report.site_page import write_site_page

    loaded = load(site, work)
    folder = loaded.work_folder
    with hold_to_write(folder, wait=False):
        cleaning = remove(folder, Keep(runs=keep, clouds=clouds, reports=reports), dry_run=dry_run)
        if not dry_run:
            with contextlib.suppress(NoSuchRun):
                write_site_page(loaded)  # so that it links to no report that is gone
    verb = "would remove" if dry_run else "removed"
    echo(f"{verb} {counted(cleaning.files, 'file')}, {cleaning.bytes / 1e6:,.1f} MB, and {counted(len(cleaning.runs), 'run')}")


@click.command("site-report")
@common.sites_argument
@click.option("--out", type=common.PATH, metavar="FILE", help="The page (default: site.html in the work folder; sites.html).")
def site_report(sites: tuple[Path, ...], out: Path | None) -> None:
    """Make one page about all nights of a site, or about several sites.

    That of one site shows a calendar with verdicts, all changes from their first night to their last, and trends; each run makes
    it, too.  That of several sites shows their last nights.  Both link to the reports.  If SITE.yaml is a folder, all site files
    in it and in its subfolders are used.

    \b
    wbflow site-report yard/site.yaml
    wbflow site-report /srv/sites --out /srv/www/sites.html
    """
    from ..cache.atomic import write_atomic
    from ..report.site_page import write_site_page
    from ..report.sites import site_files, sites_page

    files = site_files(sites)
    if not files:
        raise UsageError(f"there is no site file in {', '.join(map(str, sites))}", remedy="name site files, or a folder of them")
    if len(files) == 1:
        echo(write_site_page(load(files[0], None), out))
        return
    page = out or Path("sites.html")
    write_atomic(page, sites_page(sites, page).encode(errors="backslashreplace"))
    echo(page)
