"""The run's report: one HTML file with its pictures and points inside, readable anywhere, without a network."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..outcome.beside import spoken
from ..pipeline.rows import Role
from ..pipeline.stages import STAGES, stage_with
from ..records.events import Event, WarningEvent
from ..records.record import RunRecord
from ..records.run_folder import RunFolder
from ..site.models import Site
from .album import Album
from .headline import findings, headline
from .layers import layers
from .made import Maker
from .map import plan_of
from .nights import trends
from .place import laid_out
from .points import Points, points_of
from .sections import camera_cards, cell, pair_columns, pair_pictures, pair_rows, parts, settings
from .seen import seen
from .sources import NIGHTS, Sources
from .times import stage_times, timetable

if TYPE_CHECKING:
    from jinja2 import Template

_ASSETS = files(__package__) / "assets"
_VIEWER = ("points.js", "view.js")
_SCRIPTS = ("seen.js", "page.js")
MOST = 14_000_000
"""Bytes of a page, about: pictures as large as they are have the room that nothing else needs."""
_A_ROW = 4000
"""Bytes that the words of a camera or a pair take, about."""


def rebuild_report(site: Site, work: WorkFolder, folder: RunFolder) -> str:
    """The report of a finished run.  Raises NoSuchRun for a folder that cannot be read."""
    return build_report(site, Cache(work), folder.record(), folder.events(), folder.cameras(), folder.paths.folder)


def build_report(
    site: Site, cache: Cache, record: RunRecord, events: Iterable[Event], cameras: Mapping[str, Any], products: Path
) -> str:
    """HTML of a run.

    Parameters
    ----------
    site : Site
        Whose run.
    cache : Cache
        Holds the pictures.
    record : RunRecord
        The run in figures.
    events : iterable of Event
        What happened.
    cameras : mapping
        The cameras that the cloud rests on by id, in the form of a calibration.
    products : Path
        The folder in which the run's products lie now.
    """
    return _template().render(**_content(Sources(cache, record, tuple(events), cameras, products, site)))


def _template() -> Template:
    """The page without its content; compiled once a machine, not once a night."""
    from jinja2 import DictLoader, Environment, FileSystemBytecodeCache, StrictUndefined  # here: only pages need it

    compiled = None
    with suppress(OSError, RuntimeError):  # no folder for temporary files, or not this user's
        compiled = FileSystemBytecodeCache()
    page = DictLoader({"page": _asset("page.html")})
    words = Environment(loader=page, autoescape=True, bytecode_cache=compiled, undefined=StrictUndefined, trim_blocks=True)
    return words.get_template("page")


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _content(sources: Sources) -> dict[str, Any]:
    from markupsafe import Markup
    from rcssmin import cssmin
    from rjsmin import jsmin

    record, album = sources.record, Album(sources)
    keys = {task: event.key for task, event in sources.tasks.items() if event.usable and event.key}
    maker = Maker(sources.cache, sources.site.reader)
    points = points_of(maker, keys) if record.cloud else []
    layout = laid_out(sources, points)
    charts = trends(sources)
    plan = plan_of(sources, layout) if layout else None
    content = {
        "record": record,
        "style": Markup(cssmin(_asset("style.css"))),
        "viewer": Markup(jsmin("\n".join(map(_asset, _VIEWER)))),
        "script": Markup(jsmin("\n".join(map(_asset, _SCRIPTS)))),
        "headline": headline(sources),
        "findings": findings(sources, album),
        "layout": layout,
        "plan": plan,
        "on_map": layers(maker, keys, layout, plan) if layout and plan else [],
        "points": points,
        "streams": [{"kind": _kind(stream), "base64": base64.b64encode(stream.data).decode()} for stream in points],
        "modes": list(_modes(points)),
        "told": [(str(e.task or "run"), f"{e.what}{'; ' if e.remedy else ''}{e.remedy}") for e in _warnings(sources)],
        "cameras": camera_cards(sources, album),
        "columns": [cell(name, None) for name in pair_columns(sources)],
        "pair_rows": pair_rows(sources),
        "pairs_words": _pairs_words(record),
        "parts": parts(sources, album),
        "pair_pictures": pair_pictures(sources, album),
        "charts": charts,
        "charts_nights": min(NIGHTS, len(sources.nights)),
        "stages": stage_times(sources),
        "timetable": timetable(sources),
        "time_words": _time_words(record),
        "settings": settings(sources),
        "notes": list(_of_the_world(record)),
        "links": {"nights": list(_other_nights(sources)), "files": list(_files(sources)), "cloud": _last_cloud(sources)},
    }
    taken = (album.held + sum(len(stream.data) for stream in points)) * 4 // 3
    return {**content, "seen": seen(maker, sources, keys, MOST - taken - _A_ROW * (len(record.cameras) + len(record.pairs)))}


def _warnings(sources: Sources) -> list[WarningEvent]:
    """What went wrong and was survived."""
    return [event for event in sources.events if isinstance(event, WarningEvent)]


def _kind(stream: Points) -> str:
    return "product" if stream.name == stage_with(Role.PRODUCT).name else "change"


def _modes(points: list[Points]) -> Iterator[tuple[str, str]]:
    """What the cloud can be coloured by, and how that is called."""
    if not points:
        return
    yield "photograph", "photograph"
    yield "height", "height"
    for layer in points[0].head["layers"]:
        yield layer["name"], {"views": "number of views", "sigma": "uncertainty"}.get(layer["name"], layer["name"])
    if any(_kind(stream) == "change" and stream.head["n"] for stream in points):
        yield "change", "change"


def _pairs_words(record: RunRecord) -> str:
    if not record.pairs:
        return "No two cameras were matched."
    good = sum(pair.ok for pair in record.pairs)
    return f"{good} of {len(record.pairs)} could be used. Figures are explained where the pointer rests on them."


def _time_words(record: RunRecord) -> str:
    seconds, tasks = record.seconds, record.tasks.to_json()
    counts = ", ".join(f"{count} {name}" for name, count in tasks.items() if count)
    memory = f"; peak {record.peak_rss_mb} MB a worker" if record.peak_rss_mb else ""
    return f"Wall {seconds.wall:.1f} s, CPU {seconds.cpu:.1f} s{memory}; tasks: {counts or 'none'}."


def _other_nights(sources: Sources) -> Iterator[dict[str, str]]:
    if sources.before:
        earlier = sources.before[0]
        yield {"href": _report_of(sources, earlier.run), "text": f"← {earlier.date}"}
        good = next((night for night in sources.before if night.verdict and night.verdict.good), None)
        if good and good.run != earlier.run:
            yield {"href": _report_of(sources, good.run), "text": f"last good night, {good.date}"}
    later = [run for run in sources.work.run_ids() if run > sources.record.run]
    if later:
        yield {"href": _report_of(sources, later[-1]), "text": "newest run →"}


def _of_the_world(record: RunRecord) -> Iterator[str]:
    """How the cameras were placed, and what there is to say of it: residuals of distances and control points among others."""
    if record.poses is None:
        return
    plain = {name: value for name, value in record.poses.figures.items() if isinstance(value, str | int | float) and value != ""}
    told = (f"{name.replace('_', ' ')} {spoken(value)}" for name, value in plain.items())
    yield f"The cameras' places: {', '.join(told)}."
    yield from record.poses.notes
    yield from record.poses.joins


def _last_cloud(sources: Sources) -> dict[str, str] | None:
    """Where the last cloud before this night is shown."""
    earlier = next((night for night in sources.before if night.cloud), None)
    return {"href": _report_of(sources, earlier.run), "text": f"the last one is of {earlier.date}"} if earlier else None


def _report_of(sources: Sources, run: str) -> str:
    return f"../{run}/{sources.work.run(run).report.name}"


def _files(sources: Sources) -> Iterator[dict[str, str]]:
    record, paths = sources.record, sources.work.run(sources.record.run)
    clouds = [cloud for cloud in (record.cloud, *record.other_clouds) if cloud]
    for cloud in clouds:
        yield {"href": cloud.path, "text": f"{cloud.path} ({cloud.points:,} points)"}
    if sources.cameras:
        yield {"href": paths.cameras.name, "text": paths.cameras.name}
    told = {name for stage in STAGES for name in (_told_files(record, stage.name))}
    for name in (*sorted(told), paths.record.name, paths.log.name):
        yield {"href": name, "text": name}


def _told_files(record: RunRecord, stage: str) -> tuple[str, ...]:
    figures = record.later.get(stage)
    return tuple(figures.get("files") or ()) if isinstance(figures, Mapping) else ()
