"""The pages: the report of a run, two runs beside each other, and several sites with their last nights.

Each is one HTML file with its pictures and points inside, readable anywhere without a network.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..cache.artifact import figures
from ..cache.fingerprint import load
from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..cache.untrusted import MOST_TEXT_BYTES, read_outside
from ..errors import WbflowError, counted
from ..outcome.artifacts import Gone, Run
from ..outcome.history import Entry, history
from ..pipeline.stages import CHANGES, FUSE, stage_named
from ..pipeline.summaries import ChangesSummary, meaning, spoken
from ..records.events import TaskEvent, WarningEvent
from ..records.findings import Finding
from ..records.record import RunRecord, moment
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.load import load_site
from ..site.models import Site
from ..task import Task
from . import render, sections
from .charts import camera_bars, tasks_of_stages, timetable, trends
from .data import NIGHTS, ReportData
from .map import Map, layers_of, scene_of
from .pictures import Pictures, Points, data_url, large_pictures, other_night, points_of, points_of_other, split, then_pictures

MOST_BYTES = 14_000_000
"""Of a page, about: large pictures get the room that nothing else needs."""
_ROW_BYTES = 4000
"""Of the text of a camera or a pair, about."""


def rebuild_report(site: Site, run: Run) -> str:
    """Return the report of a finished run.  Raises NoSuchRun for a folder that cannot be read."""
    return build_report(ReportData(run.cache, run.record, tuple(run.events), run.calibration, run.folder, site))


def build_report(data: ReportData) -> str:
    """Return the HTML of a run."""
    return render("page.html", **_content(data, points_of(data) if data.record.cloud else []), beside=False)


def build_comparison(site: Site, tonight: Run, then: Run, changes: Any) -> str:
    """Return the HTML of two runs of a site, one beside the other.

    Raises Gone where the points of one of them are not there any more.

    Parameters
    ----------
    site, tonight, then : Site, Run, Run
        Whose runs; the later one, and the earlier one.
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
            tonight.record, reference=then.id, verdict=None, results={CHANGES: replace(summary, files=tuple(pictures))}
        )
        events = [e for e in tonight.events if not (isinstance(e, TaskEvent) and e.task.stage == CHANGES)]
        shown = ReportData(tonight.cache, record, tuple(events), tonight.calibration, Path(folder), site)
        stream = load(products.drawings["view"])(changes)
        content = _content(shown, [*points_of(shown), Points(CHANGES, split(stream)[0], stream)])
    if [stream.kind for stream in content["points"]] != ["product", "change", "then"]:
        raise Gone("the points of one of the runs are not there any more", remedy="run the night again")
    title = counted(len(summary.objects), "change") if summary.objects else "Nothing has changed"
    first = {"headline": ("good", title, f"{then.record.date} beside {record.date}"), "facts": list(sections.volume_facts(shown))}
    return render("page.html", **{**content, **first, "files": [], "other_nights": [], "warnings": []}, beside=True)


def _content(data: ReportData, points: list[Points]) -> dict[str, Any]:
    record, album = data.record, Pictures(data)
    other = other_night(data, record.reference)
    scene = scene_of(data, [tuple(p) for p in points[0].head["sample"]] if points else [])
    drawn = Map(scene) if scene else None
    columns = sections.pair_columns(data)
    content = {
        "record": record,
        "nights": data.nights,
        "meaning": meaning,
        "spoken": spoken,
        "headline": sections.headline(data),
        "facts": list(sections.facts(data)),
        "findings": sections.findings(data, album),
        "parts": sections.parts(data, album),
        "points": points,
        "scene": scene,
        "map": drawn,
        "layers": layers_of(data, drawn) if drawn else [],
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
        "other": other,
        "then_pictures": then_pictures(data, album, other) if other else {},
        "last_cloud": next(((night.date, data.report_of(night.run)) for night in data.earlier if night.cloud), None),
        "when": _when(data),
        "files": list(_files(data)),
    }
    rows = _ROW_BYTES * (len(record.cameras) + len(record.pairs))
    then = points_of_other(other) if other and points else []
    room = MOST_BYTES - rows - _base64(album.held + sum(len(stream.data) for stream in points))
    then = then if sum(_base64(len(stream.data)) for stream in then) <= room else []
    room -= sum(_base64(len(stream.data)) for stream in then)
    return {**content, "points": [*points, *then], "large_pictures": large_pictures(data, room)}


def _base64(size: int) -> int:
    return size * 4 // 3


def _other_nights(data: ReportData) -> Iterator[tuple[str, str]]:
    if data.earlier:
        before = data.earlier[0]
        yield f"← {before.date}", data.report_of(before.run)
        if data.last_good and data.last_good.run != before.run:
            yield f"last good night, {data.last_good.date}", data.report_of(data.last_good.run)
    later = [run for run in data.work.run_ids() if run > data.record.run]
    if later:
        yield "newest run →", data.report_of(later[-1])


def _when(data: ReportData) -> str:
    began, ended = (data.site.local(moment(at).timestamp()) for at in (data.record.started, data.record.finished))
    day = "" if began.date() == ended.date() else f"{ended:%Y-%m-%d} "
    return f"{began:%Y-%m-%d %H:%M %Z} to {day}{ended:%H:%M %Z}"


def _pose_notes(record: RunRecord) -> Iterator[str]:
    """Yield how the cameras were placed, with residuals of distances and control points."""
    if record.poses is None:
        return
    plain = {name: value for name, value in vars(record.poses).items() if isinstance(value, str | int | float) and value != ""}
    words = (f"{name.replace('_', ' ')} {spoken(value)}" for name, value in plain.items())
    yield f"The cameras' places: {', '.join(words)}."
    yield from record.poses.notes
    yield from record.poses.joins


def _files(data: ReportData) -> Iterator[tuple[str, str]]:
    record, paths = data.record, data.work.run(data.record.run)
    for cloud in (record.cloud, *record.other_clouds):
        if cloud:
            yield f"{cloud.path} ({cloud.points:,} points)", cloud.path
    named = {name for result in record.results.values() for name in result.files}
    places = [paths.cameras.name] if data.cameras else []
    for name in (*places, *sorted(named), paths.record.name, paths.log.name):
        yield name, name


@dataclass(frozen=True)
class Row:
    """A site on the page."""

    name: str
    file: Path
    fault: str = ""
    """Why the site cannot be shown."""
    nights: tuple[tuple[Entry, str, str], ...] = ()
    """Of each night, oldest first: its last run, the level of its verdict, and the link to its report; "" where there is none."""
    picture: str = ""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Those of the last night."""
        verdict = self.nights[-1][0].verdict if self.nights else None
        return verdict.findings if verdict else ()

    @property
    def order(self) -> tuple[int, str]:
        """Sites that need attention come first."""
        level = "failed" if self.fault else self.nights[-1][1] if self.nights else ""
        return ({"failed": 0, "degraded": 1}.get(level, 2), self.name)


def site_files(places: Sequence[Path]) -> list[Path]:
    """Return the named site files; of a folder its site.yaml, else all site files in it and one level below."""
    found: list[Path] = []
    for place in places:
        own = place / "site.yaml"
        if not place.is_dir() or own.is_file():
            found.append(own if place.is_dir() else place)
        else:
            found += [path for path in sorted([*place.glob("*.yaml"), *place.glob("*/site.yaml")]) if _describes_site(path)]
    return list(dict.fromkeys(found))


def page(places: Sequence[Path], out: Path) -> str:
    """Return the HTML of all sites.  out: its file, for the links in it."""
    rows = sorted((_row(file, out.resolve().parent) for file in site_files(places)), key=lambda row: row.order)
    return render("sites.html", rows=rows)


def _describes_site(file: Path) -> bool:
    """Return whether a YAML file describes a site, valid or not."""
    try:
        text = read_outside(file, MOST_TEXT_BYTES).decode(errors="replace")
    except OSError:
        return False
    return re.search(r"""^[{\s]*["']?site["']?\s*:""", text, re.MULTILINE) is not None


def _row(file: Path, folder: Path) -> Row:
    try:
        site = load_site(file)
        work = site.work_folder
        by_night = {entry.run.date: entry for entry in (history(work) if work.run_ids() else [])}
    except WbflowError as error:
        return Row(file.parent.name, file, fault=str(error))
    nights = [_night(work, by_night[date], folder) for date in sorted(by_night)[-NIGHTS:]]
    return Row(site.name, site.file, "", tuple(nights), _picture(work))


def _night(work: WorkFolder, entry: Entry, folder: Path) -> tuple[Entry, str, str]:
    report = work.run(entry.run.run).report
    href = Path(os.path.relpath(report, folder)).as_posix() if report.is_file() else ""
    return entry, entry.verdict.level if entry.verdict else "", href


def _picture(work: WorkFolder) -> str:
    task = Task(FUSE)
    try:
        event = RunFolder.of(work, work.latest_good.name).tasks().get(task)
    except NoSuchRun:
        return ""
    picture = Cache(work).drawing(task, event.key, "picture") if event and event.key else None
    return data_url(picture) if picture else ""
