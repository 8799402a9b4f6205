"""The report of a run: one HTML file with its pictures and points inside, readable anywhere without a network."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..outcome.beside import spoken
from ..records.events import Event, WarningEvent
from ..records.record import RunRecord
from ..records.run_folder import RunFolder
from ..site.models import Site
from .charts import stage_times, timetable, trends
from .data import NIGHTS, ReportData
from .headline import findings, headline
from .map import map_of
from .pictures import Pictures, Points, large_pictures, layers_of, points_of
from .scene import scene_of
from .sections import camera_cards, cell, pair_columns, pair_pictures, pair_rows, parts, settings

if TYPE_CHECKING:
    from jinja2 import Template

ASSETS = files(__package__) / "assets"
_VIEWER = ("points.js", "view.js")
_SCRIPTS = ("large.js", "page.js")
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
    return _template().render(**_content(ReportData(cache, record, tuple(events), cameras, products, site)))


def _template() -> Template:
    """Return the template; it is compiled once a machine, not once a night."""
    from jinja2 import DictLoader, Environment, FileSystemBytecodeCache, StrictUndefined  # here: only pages need it

    compiled = None
    with suppress(OSError, RuntimeError):  # no folder for temporary files, or not this user's
        compiled = FileSystemBytecodeCache()
    page = DictLoader({"page": _asset("page.html")})
    environment = Environment(loader=page, autoescape=True, bytecode_cache=compiled, undefined=StrictUndefined, trim_blocks=True)
    return environment.get_template("page")


def _asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding="utf-8")


def _content(data: ReportData) -> dict[str, Any]:
    from markupsafe import Markup
    from rcssmin import cssmin
    from rjsmin import jsmin

    record, album = data.record, Pictures(data)
    points = points_of(data) if record.cloud else []
    scene = scene_of(data, [tuple(p) for p in points[0].head["sample"]] if points else [])
    drawn = map_of(data, scene) if scene else None
    content = {
        "record": record,
        "style": Markup(cssmin(_asset("style.css"))),
        "viewer": Markup(jsmin("\n".join(map(_asset, _VIEWER)))),
        "script": Markup(jsmin("\n".join(map(_asset, _SCRIPTS)))),
        "headline": headline(data),
        "findings": findings(data, album),
        "scene": scene,
        "map": drawn,
        "layers": layers_of(data, scene, drawn) if scene and drawn else [],
        "points": points,
        "modes": list(_modes(points)),
        "warnings": list(_warnings(data)),
        "cameras": camera_cards(data, album),
        "columns": [cell(name, None) for name in pair_columns(data)],
        "pair_rows": pair_rows(data),
        "pairs_words": _pairs_words(record),
        "parts": parts(data, album),
        "pair_pictures": pair_pictures(data, album),
        "charts": trends(data),
        "charts_nights": min(NIGHTS, len(data.nights)),
        "stages": stage_times(data),
        "timetable": timetable(data),
        "time_words": _time_words(record),
        "settings": settings(data),
        "notes": list(_pose_notes(record)),
        "links": {"nights": list(_other_nights(data)), "files": list(_files(data)), "cloud": _last_cloud(data)},
    }
    rows = _ROW_BYTES * (len(record.cameras) + len(record.pairs))
    held = (album.held + sum(len(stream.data) for stream in points)) * 4 // 3  # as Base64
    return {**content, "large_pictures": large_pictures(data, MOST_BYTES - rows - held)}


def _warnings(data: ReportData) -> Iterator[tuple[str, str]]:
    for event in data.events:
        if isinstance(event, WarningEvent):
            yield str(event.task or "run"), f"{event.what}; {event.remedy}" if event.remedy else event.what


def _modes(points: list[Points]) -> Iterator[tuple[str, str]]:
    """Yield the colourings of the cloud and their labels."""
    if not points:
        return
    yield "photograph", "photograph"
    yield "height", "height"
    for layer in points[0].head["layers"]:
        yield layer["name"], {"views": "number of views", "sigma": "uncertainty"}.get(layer["name"], layer["name"])
    if any(stream.kind == "change" and stream.head["n"] for stream in points):
        yield "change", "change"


def _pairs_words(record: RunRecord) -> str:
    if not record.pairs:
        return "No two cameras were matched."
    good = sum(pair.ok for pair in record.pairs)
    return f"{good} of {len(record.pairs)} could be used. Rest the pointer on a figure for its meaning."


def _time_words(record: RunRecord) -> str:
    seconds, tasks = record.seconds, record.tasks.to_json()
    counts = ", ".join(f"{count} {name}" for name, count in tasks.items() if count)
    memory = f"; peak {record.peak_rss_mb} MB a worker" if record.peak_rss_mb else ""
    return f"Wall {seconds.wall:.1f} s, CPU {seconds.cpu:.1f} s{memory}; tasks: {counts or 'none'}."


def _other_nights(data: ReportData) -> Iterator[dict[str, str]]:
    if data.earlier:
        earlier = data.earlier[0]
        yield {"href": data.report_of(earlier.run), "text": f"← {earlier.date}"}
        good = next((night for night in data.earlier if night.verdict and night.verdict.good), None)
        if good and good.run != earlier.run:
            yield {"href": data.report_of(good.run), "text": f"last good night, {good.date}"}
    later = [run for run in data.work.run_ids() if run > data.record.run]
    if later:
        yield {"href": data.report_of(later[-1]), "text": "newest run →"}


def _pose_notes(record: RunRecord) -> Iterator[str]:
    """Yield how the cameras were placed, with residuals of distances and control points."""
    if record.poses is None:
        return
    plain = {name: value for name, value in vars(record.poses).items() if isinstance(value, str | int | float) and value != ""}
    words = (f"{name.replace('_', ' ')} {spoken(value)}" for name, value in plain.items())
    yield f"The cameras' places: {', '.join(words)}."
    yield from record.poses.notes
    yield from record.poses.joins


def _last_cloud(data: ReportData) -> dict[str, str] | None:
    """Return the link to the last earlier cloud."""
    earlier = next((night for night in data.earlier if night.cloud), None)
    return {"href": data.report_of(earlier.run), "text": f"the last one is of {earlier.date}"} if earlier else None


def _files(data: ReportData) -> Iterator[dict[str, str]]:
    record, paths = data.record, data.work.run(data.record.run)
    clouds = [cloud for cloud in (record.cloud, *record.other_clouds) if cloud]
    for cloud in clouds:
        yield {"href": cloud.path, "text": f"{cloud.path} ({cloud.points:,} points)"}
    if data.cameras:
        yield {"href": paths.cameras.name, "text": paths.cameras.name}
    named = {name for result in record.results.values() for name in result.files}
    for name in (*sorted(named), paths.record.name, paths.log.name):
        yield {"href": name, "text": name}
