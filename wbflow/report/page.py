"""The report of a run: one HTML file with its pictures and points inside, readable anywhere without a network."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..pipeline.summaries import meaning, spoken
from ..records.events import Event, WarningEvent
from ..records.record import RunRecord
from ..records.run_folder import RunFolder
from ..site.models import Site
from .charts import camera_bars, tasks_of_stages, timetable, trends
from .data import ReportData
from .map import Map, scene_of
from .pictures import Pictures, large_pictures, layers_of, points_of
from .sections import camera_cards, findings, headline, pair_columns, pair_pictures, parts, settings, tried

MOST_BYTES = 14_000_000
"""Of a page, about: large pictures get the room that nothing else needs."""
_ROW_BYTES = 4000
"""Of the text of a camera or a pair, about."""


def rebuild_report(site: Site, work: WorkFolder, folder: RunFolder) -> str:
    """Return the report of a finished run.  Raises NoSuchRun for a folder that cannot be read."""
    return build_report(site, Cache(work), folder.record(), folder.events(), folder.cameras(), folder.paths.folder)


def build_report(
    site: Site, cache: Cache, record: RunRecord, events: Iterable[Event], cameras: Mapping[str, Any], products: Path
) -> str:
    """Return the HTML of a run.

    Parameters
    ----------
    site : Site
        Whose run.
    cache : Cache
        It holds the pictures.
    record : RunRecord
        The run in figures.
    events : iterable of Event
        What happened.
    cameras : mapping
        The cameras of the cloud by id, as cameras.json has them.
    products : Path
        The folder in which the run's products lie now.
    """
    return render("page.html", **_content(ReportData(cache, record, tuple(events), cameras, products, site)))


def render(template: str, **content: Any) -> str:
    """Return the page of a template in `assets`; all that is put in is escaped, but for the assets."""
    from jinja2 import Environment, FileSystemBytecodeCache, FunctionLoader, StrictUndefined  # here: only pages need it
    from markupsafe import Markup

    compiled = None
    with contextlib.suppress(RuntimeError, OSError):  # a machine without a folder for it compiles the template each time
        compiled = FileSystemBytecodeCache()
    environment = Environment(
        loader=FunctionLoader(_asset), autoescape=True, bytecode_cache=compiled, undefined=StrictUndefined, trim_blocks=True
    )
    environment.globals["asset"] = lambda name: Markup(_asset(name))
    return environment.get_template(template).render(content)


def _asset(name: str) -> str:
    return (files(__package__) / "assets" / name).read_text(encoding="utf-8")


def _content(data: ReportData) -> dict[str, Any]:
    record, album = data.record, Pictures(data)
    points = points_of(data) if record.cloud else []
    scene = scene_of(data, [tuple(p) for p in points[0].head["sample"]] if points else [])
    drawn = Map(scene) if scene else None
    columns = pair_columns(data)
    content = {
        "record": record,
        "nights": data.nights,
        "meaning": meaning,
        "spoken": spoken,
        "headline": headline(data),
        "findings": findings(data, album),
        "parts": parts(data, album),
        "points": points,
        "scene": scene,
        "map": drawn,
        "layers": layers_of(data, drawn) if drawn else [],
        "warnings": [event for event in data.events if isinstance(event, WarningEvent)],
        "cameras": camera_cards(data, album),
        "bars": camera_bars(data),
        "columns": columns,
        "pairs": [(pair, [getattr(pair.figures, name) for name in columns]) for pair in record.pairs],
        "tried": lambda pair: list(tried(data, pair)),
        "pair_pictures": pair_pictures(data, album),
        "charts": trends(data),
        "tasks_of_stages": list(tasks_of_stages(data)),
        "timetable": timetable(data),
        "settings": settings(data),
        "notes": list(_pose_notes(record)),
        "other_nights": list(_other_nights(data)),
        "last_cloud": next(((night.date, data.report_of(night.run)) for night in data.earlier if night.cloud), None),
        "files": list(_files(data)),
    }
    rows = _ROW_BYTES * (len(record.cameras) + len(record.pairs))
    held = (album.held + sum(len(stream.data) for stream in points)) * 4 // 3  # as Base64
    return {**content, "large_pictures": large_pictures(data, MOST_BYTES - rows - held)}


def _other_nights(data: ReportData) -> Iterator[tuple[str, str]]:
    """Yield text and link of the reports before and after this one."""
    if data.earlier:
        before = data.earlier[0]
        yield f"← {before.date}", data.report_of(before.run)
        if data.last_good and data.last_good.run != before.run:
            yield f"last good night, {data.last_good.date}", data.report_of(data.last_good.run)
    later = [run for run in data.work.run_ids() if run > data.record.run]
    if later:
        yield "newest run →", data.report_of(later[-1])


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
    """Yield text and name of the run's files."""
    record, paths = data.record, data.work.run(data.record.run)
    for cloud in (record.cloud, *record.other_clouds):
        if cloud:
            yield f"{cloud.path} ({cloud.points:,} points)", cloud.path
    named = {name for result in record.results.values() for name in result.files}
    cameras = [paths.cameras.name] if data.cameras else []
    for name in (*cameras, *sorted(named), paths.record.name, paths.log.name):
        yield name, name
