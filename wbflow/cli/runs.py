"""What runs have left: reports, history, comparison, exports, room on the disk."""

from __future__ import annotations

from pathlib import Path

import click

from ..errors import ExitCode, UsageError, counted
from .common import PATH, json_option, load, place_of, run_argument, say_json, site_argument, work_option
from .words import say, stop


@click.command()
@site_argument
@run_argument
@work_option
def report(site: Path, run_id: str | None, work: str | None) -> None:
    """(Re)build a run's report.

    \b
    wbflow report site.yaml                       of the newest run
    wbflow report site.yaml 20261120T031500Z
    """
    loaded = load(site, work)
    place = place_of(loaded)
    from ..records.run_folder import RunFolder
    from ..report.page import rebuild_report

    folder = RunFolder.of(place, run_id)
    say(folder.write_report(rebuild_report(loaded, place, folder)))


@click.command()
@site_argument
@json_option
@work_option
def history(site: Path, as_json: bool, work: str | None) -> None:
    """Runs: when, how long, cached/ran/failed, cloud size, exit code, verdict and first finding.

    \b
    wbflow history site.yaml
    wbflow history site.yaml --json
    """
    loaded = load(site, work)
    place = place_of(loaded)
    from ..outcome.history import history as entries

    runs = entries(place) if place.run_ids() else []
    if as_json:
        say_json([entry.to_json() for entry in runs])
        return
    if not runs:
        stop(ExitCode.GOOD, f"{loaded.name} has no runs yet: wbflow run {site}")
    head = f"{'wall s':>8} {'CPU s':>8} {'cached':>6} {'ran':>5} {'rejected':>8} {'failed':>6}"
    say(f"{'run':17} {'night':10} {head} {'points':>11} exit  verdict")
    for entry in runs:
        r = entry.run
        points = f"{r.points:,}" if r.points else "-"
        figures = f"{r.wall:8.1f} {r.cpu:8.1f} {r.cached:6} {r.ran:5} {r.rejected:8} {r.failed:6}"
        say(f"{r.run:17} {r.date:10} {figures} {points:>11} {r.exit_code:4}  {entry.words}".rstrip())


@click.command()
@click.argument("nights", metavar="[SITE.yaml] [RUN_A RUN_B]", type=PATH, nargs=-1, required=True)
@json_option
@work_option
def compare(nights: tuple[Path, ...], as_json: bool, work: str | None) -> None:
    """Two nights side by side: what differs by more than noise.

    \b
    wbflow compare SITE.yaml                           the newest run, and the newest good one before it
    wbflow compare SITE.yaml 2026-11-18 2026-11-19     runs by night, by id, or latest, latest-good
    wbflow compare RUN_A RUN_B                         folders of two runs, of whatever sites
    """
    from ..outcome.compare import compare as rows_of
    from ..outcome.compare import last_two, run_named, told
    from ..records.run_folder import RunFolder

    if len(nights) == 2:
        a, b = (RunFolder.at(folder) for folder in nights)
    elif len(nights) == 1:
        a, b = last_two(place_of(load(nights[0], work)))
    elif len(nights) == 3:
        place = place_of(load(nights[0], work))
        a, b = (run_named(place, str(name)) for name in nights[1:])
    else:
        raise UsageError("name two runs", remedy="wbflow compare SITE.yaml RUN_A RUN_B; wbflow history SITE.yaml  lists them")
    rows = rows_of(a.record(), b.record())
    if as_json:
        say_json({"a": a.id, "b": b.id, "rows": [row.to_json() for row in rows]})
        return
    for row in told(rows):
        say(row)
    if len(told(rows)) == 3:
        say("nothing else differs by more than noise")


@click.command()
@site_argument
@run_argument
@click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the files.")
@click.option("--laz", is_flag=True, help="The cloud as LAZ, on the map where positions are known by latitude and longitude.")
@click.option("--e57", is_flag=True, help="The cloud as E57, on the map like LAZ; intensity is the confidence.")
@click.option("--heights", is_flag=True, help="Heights seen from above: GeoTIFF where the site is on the map, else PNG, PFM.")
@click.option("--depth", is_flag=True, help="Depth map of each camera: 16-bit PNG and PFM.")
@click.option("--mesh", is_flag=True, help="The surface through the cloud (Poisson): PLY, and OBJ with the photographs on it.")
@click.option("--orthophoto", is_flag=True, help="The site from straight above: GeoTIFF, or PNG with its world file.")
@click.option("--colmap", is_flag=True, help="Cameras, images and points as a COLMAP model.")
@work_option
def export(site: Path, run_id: str | None, out: Path, work: str | None, **asked: bool) -> None:
    """A run's results for other programs; the newest run that made a cloud, if no RUN is named.

    \b
    wbflow export site.yaml --laz --heights --out maps
    wbflow export site.yaml 20261120T031500Z --colmap --out model
    """
    forms = frozenset(name for name, wanted in asked.items() if wanted)
    if not forms:
        first = f"wbflow export {site} --{next(iter(asked))} --out {out}"
        raise UsageError(f"say what to export: {', '.join(f'--{name}' for name in asked)}", remedy=f"for example: {first}")
    place = place_of(load(site, work))
    from ..outcome.artifacts import FinishedRun
    from ..outcome.export import export as write
    from ..records.run_folder import RunFolder

    folder = RunFolder.of(place, run_id or place.latest_good.name)
    for file in write(FinishedRun.open(place, folder), out, forms):
        say(file)


@click.command()
@site_argument
@click.option("--keep", type=click.IntRange(min=1), required=True, metavar="N", help="Runs whose artifacts stay.")
@click.option("--clouds", type=click.IntRange(min=1), metavar="N", help="Remove published clouds, too, but those of N nights.")
@click.option("--reports", type=click.IntRange(min=1), metavar="N", help="Remove reports and logs, too, but those of N nights.")
@click.option("--dry-run", is_flag=True, help="Only say how much would go.")
@work_option
def clean(site: Path, keep: int, clouds: int | None, reports: int | None, dry_run: bool, work: str | None) -> None:
    """Remove artifacts that the last N runs don't use.  What has been published stays, unless it is named.

    \b
    wbflow clean site.yaml --keep 7 --dry-run     says how much
    wbflow clean site.yaml --keep 7 --clouds 30
    """
    place = place_of(load(site, work))
    from ..cache.cleanup import clean as remove
    from ..cache.keep import Keep
    from ..cache.writing import hold_to_write

    with hold_to_write(place, wait=False):
        done = remove(place, Keep(runs=keep, clouds=clouds, reports=reports), dry_run=dry_run)
    verb = "would remove" if dry_run else "removed"
    say(f"{verb} {counted(done.files, 'file')}, {done.bytes / 1e6:,.1f} MB, and {counted(len(done.runs), 'run')}")
