"""The report of a run, and the page that compares two runs.

Each is one HTML file that contains its pictures and points, so it can be read without a network.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..cache.artifact import figures
from ..errors import WbflowError
from ..pipeline.meanings import meaning
from ..pipeline.stages import CHANGES, stage_named
from ..pipeline.summaries import ChangesSummary
from ..plugins import load
from ..records.events import TaskEvent, WarningEvent
from ..records.finished_run import Run
from ..records.record import RunRecord, moment
from ..site.models import Site
from ..words import counted, format_value
from . import charts, first_screen, place_of, render, sections
from .data import ReportData
from .map import Map, layers_of
from .parts import is_picture, parts_of, volume_rows
from .pictures import Pictures, Points, large_pictures, other_night, other_pictures, points_of, points_of_other
from .scene import scene_of

MOST_BYTES = 14_000_000
"""Approximate limit on the size of a page: large pictures get the bytes that everything else leaves."""
_ROW_BYTES = 4000
"""Approximate size of the text of a camera or a pair."""


def rebuild_report(site: Site, run: Run) -> str:
    """Return the report of a finished run.  Raises NoSuchRun for a folder that cannot be read."""
    return build_report(ReportData(run.cache, run.record, tuple(run.events), run.calibration, run.folder, site))


def build_report(data: ReportData) -> str:
    """Return the HTML of a run."""
    points = []
    if data.record.cloud:
        points = points_of(data)
    return render("page.html", **_content(data, points), beside=False)


def build_comparison(site: Site, tonight: Run, reference: Run, changes: Any) -> str:
    """Return the HTML that compares two runs of a site.

    Raises WbflowError if the points of one of them no longer exist.

    Parameters
    ----------
    site, tonight, reference : Site, Run, Run
        The site; its later run, and its earlier run.
    changes : wbflow_stages.types.Changes
        What changed between them.
    """
    products = stage_named(CHANGES).products
    summary = ChangesSummary.from_json(figures(changes))
    with TemporaryDirectory() as folder:
        # 1. The pictures of the changes, as a run would publish them.
        pictures = []
        for name, content in load(products.files)(changes):
            if is_picture(name):
                (Path(folder) / name).write_bytes(content)
                pictures.append(name)

        # 2. Tonight's run, with these changes instead of its own.
        results = {CHANGES: replace(summary, files=tuple(pictures))}
        record = replace(tonight.record, reference=reference.id, verdict=None, results=results)
        events = []
        for event in tonight.events:
            if not (isinstance(event, TaskEvent) and event.task.stage == CHANGES):
                events.append(event)
        shown = ReportData(tonight.cache, record, tuple(events), tonight.calibration, Path(folder), site)
        changed_points = Points("change", load(products.product_files["view"])(changes))
        # their own changes are left out above; how cameras were placed is the same for both
        points = [stream for stream in points_of(shown) if stream.kind != "track"]
        content = _content(shown, [*points, changed_points])
    if [stream.kind for stream in content["points"]] != ["product", "change", "then"]:
        raise WbflowError("the cloud of one of the runs no longer exists", remedy="run the night again")
    title = "Nothing has changed"
    if summary.objects:
        title = counted(len(summary.objects), "change")
    headline = "good", title, f"{reference.record.date} beside {record.date}"
    head = {"headline": headline, "facts": list(_volume_facts(shown))}
    return render("page.html", **{**content, **head, "files": [], "other_nights": [], "warnings": []}, beside=True)


def _volume_facts(data: ReportData) -> Iterator[first_screen.Fact]:
    """Yield the volumes that changed, as main figures."""
    for result in data.record.results.values():
        for ground, gained, lost, seen_area, unseen_area in volume_rows(result, data.unit):
            yield first_screen.Fact(gained, f"gained, {ground}")
            yield first_screen.Fact(lost, f"lost, {ground}")
            yield first_screen.Fact(seen_area, "seen on both nights", f"not seen: {unseen_area}")


def _content(data: ReportData, points: list[Points]) -> dict[str, Any]:
    """Return the variables of the template.  What comes first is embedded first: small pictures, other points, large pictures."""
    record = data.record
    # 1. Small pictures, in the order of the page.
    album = Pictures(data)
    findings, folded = first_screen.findings(data, album)
    parts = parts_of(data, album)
    camera_pictures = {camera.id: album.of_task(data.frame(camera.id), camera.id) for camera in record.cameras}
    pair_pictures = sections.pair_pictures(data, album)
    other = other_night(data, record.reference)
    pictures_then = {}
    if other:
        pictures_then = other_pictures(album, other)

    # 2. The other night's points, if there is room for them.
    row_bytes = _ROW_BYTES * (len(record.cameras) + len(record.pairs))
    point_bytes = sum(len(stream.data) for stream in points)
    bytes_left = MOST_BYTES - row_bytes - _base64_size(album.embedded_bytes + point_bytes)
    # what follows has less priority: the other night's points are worth more than large pictures
    points_then = None
    if other and points:
        points_then = points_of_other(data, other)
    if points_then and _base64_size(len(points_then.data)) <= bytes_left:
        points = [*points, points_then]
        bytes_left -= _base64_size(len(points_then.data))

    # 3. The scene, of some of the night's points; large pictures get the room that is left.
    # without points, the scene is that of the cameras or of an earlier night
    sample = []
    if points:
        sample = [tuple(point) for point in points[0].head["sample"]]
    scene = scene_of(data, sample)
    site_map = None
    layers: list[dict[str, Any]] = []
    if scene:
        site_map = Map(scene)
        layers = layers_of(data, site_map)
    return {
        "data": data,
        "record": record,
        "sections": sections,
        "charts": charts,
        "meaning": meaning,
        "format_value": format_value,
        "headline": first_screen.headline(data),
        "facts": list(first_screen.facts(data)),
        "findings": findings,
        "folded": folded,
        "parts": parts,
        "points": points,
        "scene": scene,
        "map": site_map,
        "layers": layers,
        "warnings": [event for event in data.events if isinstance(event, WarningEvent)],
        "camera_pictures": camera_pictures,
        "pair_pictures": pair_pictures,
        "notes": list(_pose_notes(record)),
        "other_nights": list(_other_nights(data)),
        "reports": {night.date: data.report_of(night.run) for night in data.earlier},
        "other": other,
        "other_pictures": pictures_then,
        "last_cloud": _last_cloud(data),
        "when": _when(data),
        "files": list(_files(data)),
        "site_page": place_of(data.work),
        "large_pictures": large_pictures(data, bytes_left),
    }


def _base64_size(size: int) -> int:
    # three bytes are written as four letters
    return size * 4 // 3


def _last_cloud(data: ReportData) -> tuple[str, str] | None:
    """Return date and report of the last earlier night with a cloud; None if there is none."""
    for night in data.earlier:
        if night.cloud:
            return night.date, data.report_of(night.run)
    return None


def _other_nights(data: ReportData) -> Iterator[tuple[str, str]]:
    if data.earlier:
        previous = data.earlier[0]
        yield f"← {previous.date}", data.report_of(previous.run)
        if data.last_good and data.last_good.run != previous.run:
            yield f"last good night, {data.last_good.date}", data.report_of(data.last_good.run)
    yield "all nights", f"../../{data.work.site_page.name}#night-{data.record.date}"
    # the link always leads to the newest night, however old this page is; a file stands for it where there are no links
    if data.work.latest.is_symlink() or not data.work.latest.exists():
        yield "newest night →", data.report_of(data.work.latest.name)


def _when(data: ReportData) -> str:
    began = data.site.local(moment(data.record.started).timestamp())
    ended = data.site.local(moment(data.record.finished).timestamp())
    if began.date() == ended.date():
        return f"{began:%Y-%m-%d %H:%M %Z} to {ended:%H:%M %Z}"
    return f"{began:%Y-%m-%d %H:%M %Z} to {ended:%Y-%m-%d %H:%M %Z}"


def _pose_notes(record: RunRecord) -> Iterator[str]:
    """Yield how the cameras' poses were found, with residuals of distances and control points."""
    if record.poses is None:
        return
    texts = []
    for name, value in vars(record.poses).items():
        if isinstance(value, str | int | float) and value != "":
            texts.append(f"{name.replace('_', ' ')} {format_value(value)}")
    yield f"Positions of the cameras: {', '.join(texts)}."
    yield from record.poses.notes
    yield from record.poses.joins


def _files(data: ReportData) -> Iterator[tuple[str, str]]:
    record = data.record
    paths = data.work.run(record.run)
    for cloud in (record.cloud, *record.other_clouds):
        if cloud:
            yield f"{cloud.path} ({cloud.points:,} points)", cloud.path
    product_files: set[str] = set()
    for result in record.results.values():
        product_files.update(result.files)
    names = []
    if data.cameras:
        names.append(paths.cameras.name)
    names += sorted(product_files)
    names += [paths.record.name, paths.log.name]
    for name in names:
        yield name, name
