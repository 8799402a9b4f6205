"""The report of a run, and the page that compares two runs.

Each is one HTML file that contains its pictures and points, so it can be read without a network.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..cache.artifact import figures
from ..outcome.finished_run import MissingResult, Run
from ..pipeline.meanings import meaning
from ..pipeline.stages import CHANGES, stage_named
from ..pipeline.summaries import ChangesSummary
from ..plugins import load
from ..records.events import TaskEvent, WarningEvent
from ..records.record import RunRecord, moment
from ..site.models import Site
from ..words import counted, format_value
from . import render, sections
from .charts import camera_bars, tasks_of_stages, timetable, trends
from .data import ReportData
from .map import Map, layers_of
from .pictures import Pictures, Points, large_pictures, other_night, other_pictures, points_of, points_of_other, split
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
    return render("page.html", **_content(data, points_of(data) if data.record.cloud else []), beside=False)


def build_comparison(site: Site, tonight: Run, reference: Run, changes: Any) -> str:
    """Return the HTML that compares two runs of a site.

    Raises MissingResult if the points of one of them no longer exist.

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
        pictures = {name: data for name, data in load(products.files)(changes) if sections.is_picture(name)}
        for name, data in pictures.items():
            (Path(folder) / name).write_bytes(data)
        record = replace(
            tonight.record, reference=reference.id, verdict=None, results={CHANGES: replace(summary, files=tuple(pictures))}
        )
        events = [e for e in tonight.events if not (isinstance(e, TaskEvent) and e.task.stage == CHANGES)]
        shown = ReportData(tonight.cache, record, tuple(events), tonight.calibration, Path(folder), site)
        stream = load(products.drawings["view"])(changes)
        content = _content(shown, [*points_of(shown), Points(CHANGES, split(stream)[0], stream)])
    if [stream.kind for stream in content["points"]] != ["product", "change", "then"]:
        raise MissingResult("the cloud of one of the runs no longer exists", remedy="run the night again")
    title = counted(len(summary.objects), "change") if summary.objects else "Nothing has changed"
    headline = "good", title, f"{reference.record.date} beside {record.date}"
    head = {"headline": headline, "facts": list(sections.volume_facts(shown))}
    return render("page.html", **{**content, **head, "files": [], "other_nights": [], "warnings": []}, beside=True)


def _content(data: ReportData, points: list[Points]) -> dict[str, Any]:
    record, album = data.record, Pictures(data)
    reference_night = other_night(data, record.reference)
    scene = scene_of(data, [tuple(p) for p in points[0].head["sample"]] if points else [])
    site_map = Map(scene) if scene else None
    columns = sections.pair_columns(data)
    content = {
        "record": record,
        "nights": data.nights,
        "meaning": meaning,
        "format_value": format_value,
        "headline": sections.headline(data),
        "facts": list(sections.facts(data)),
        "findings": sections.findings(data, album),
        "parts": sections.parts(data, album),
        "points": points,
        "scene": scene,
        "map": site_map,
        "layers": layers_of(data, site_map) if site_map else [],
        "warnings": [event for event in data.events if isinstance(event, WarningEvent)],
        "cameras": sections.cameras(data),
        "camera_pictures": {camera.id: album.of_frame(camera.id, camera.id) for camera in record.cameras},
        "badges": sections.BADGES,
        "camera_words": partial(sections.camera_words, data),
        "camera_figures": partial(sections.camera_figures, data),
        "keypoints": partial(sections.keypoints, data),
        "bars": camera_bars(data),
        "columns": [meaning(name) for name in columns],
        "pairs": [(pair, [getattr(pair.figures, name) for name in columns]) for pair in record.pairs],
        "tried": partial(sections.tried, data),
        "pair_pictures": sections.pair_pictures(data, album),
        "charts": trends(data),
        "tasks_of_stages": list(tasks_of_stages(data)),
        "timetable": timetable(data),
        "settings": sections.settings(data),
        "notes": list(_pose_notes(record)),
        "other_nights": list(_other_nights(data)),
        "other": reference_night,
        "other_pictures": other_pictures(data, album, reference_night) if reference_night else {},
        "last_cloud": next(((night.date, data.report_of(night.run)) for night in data.earlier if night.cloud), None),
        "when": _when(data),
        "files": list(_files(data)),
    }
    row_bytes = _ROW_BYTES * (len(record.cameras) + len(record.pairs))
    other_points = points_of_other(reference_night) if reference_night and points else []
    bytes_left = MOST_BYTES - row_bytes - _base64_size(album.embedded_bytes + sum(len(stream.data) for stream in points))
    other_points = other_points if sum(_base64_size(len(stream.data)) for stream in other_points) <= bytes_left else []
    bytes_left -= sum(_base64_size(len(stream.data)) for stream in other_points)
    return {**content, "points": [*points, *other_points], "large_pictures": large_pictures(data, bytes_left)}


def _base64_size(size: int) -> int:
    return size * 4 // 3


def _other_nights(data: ReportData) -> Iterator[tuple[str, str]]:
    if data.earlier:
        previous = data.earlier[0]
        yield f"← {previous.date}", data.report_of(previous.run)
        if data.last_good and data.last_good.run != previous.run:
            yield f"last good night, {data.last_good.date}", data.report_of(data.last_good.run)
    later = [run for run in data.work.run_ids() if run > data.record.run]
    if later:
        yield "newest run →", data.report_of(later[-1])


def _when(data: ReportData) -> str:
    began, ended = (data.site.local(moment(at).timestamp()) for at in (data.record.started, data.record.finished))
    day = "" if began.date() == ended.date() else f"{ended:%Y-%m-%d} "
    return f"{began:%Y-%m-%d %H:%M %Z} to {day}{ended:%H:%M %Z}"


def _pose_notes(record: RunRecord) -> Iterator[str]:
    """Yield how the cameras' poses were found, with residuals of distances and control points."""
    if record.poses is None:
        return
    values = {name: value for name, value in vars(record.poses).items() if isinstance(value, str | int | float) and value != ""}
    texts = (f"{name.replace('_', ' ')} {format_value(value)}" for name, value in values.items())
    yield f"Positions of the cameras: {', '.join(texts)}."
    yield from record.poses.notes
    yield from record.poses.joins


def _files(data: ReportData) -> Iterator[tuple[str, str]]:
    record, paths = data.record, data.work.run(data.record.run)
    for cloud in (record.cloud, *record.other_clouds):
        if cloud:
            yield f"{cloud.path} ({cloud.points:,} points)", cloud.path
    product_files = {name for result in record.results.values() for name in result.files}
    pose_files = [paths.cameras.name] if data.cameras else []
    for name in (*pose_files, *sorted(product_files), paths.record.name, paths.log.name):
        yield name, name
