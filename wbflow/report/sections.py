"""Cameras, pairs and what site-wide stages tell: figures as people read them."""

from __future__ import annotations

import mimetypes
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..outcome.beside import shown
from ..outcome.record import reported
from ..pipeline.stages import STAGES
from ..pipeline.summaries import meaning
from ..records.record import CameraRecord, PairRecord
from ..task import Task
from .album import Album, Shown
from .nights import Bar, spark
from .since import Since, since_last_good
from .sources import Sources, state_of
from .tried import Step, tried

_BADGES = {"good": "as it should be", "warn": "look at it", "bad": "down"}


@dataclass(frozen=True)
class Cell:
    """A figure."""

    title: str
    words: str
    """What it means."""
    value: str
    grade: str
    raw: str = ""
    """To sort by."""


@dataclass(frozen=True)
class CameraCard:
    """A camera."""

    id: str
    number: int
    """In the site file, from 1."""
    state: str
    badge: str
    words: str
    notes: tuple[str, ...]
    picture: Shown | None
    spark: tuple[Bar, ...]
    seen: str
    """What was found in its picture."""
    main: tuple[Cell, ...]
    """What it gave."""
    figures: tuple[Cell, ...]
    """What was measured of it."""


@dataclass(frozen=True)
class PairRow:
    """A pair."""

    name: str
    ok: bool
    outcome: str
    reason: str
    cells: tuple[Cell, ...]
    tried: tuple[Step, ...]
    """Of one that could not be used."""


@dataclass(frozen=True)
class Thing:
    """One of the things that a stage tells of, each with figures of its own."""

    title: str
    size: str
    since: str
    """Was it there on the last good night, or not yet?"""
    words: tuple[str, ...]
    picture: Shown | None
    figures: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Part:
    """What a site-wide stage tells."""

    title: str
    reason: str
    picture: Shown | None
    rows: tuple[tuple[str, str], ...]
    things: tuple[Thing, ...]
    files: tuple[str, ...]
    since: str = ""
    """What is no more as it was on the last good night."""


@dataclass(frozen=True)
class Used:
    """How a stage was run."""

    function: str
    code: str
    parameters: tuple[tuple[str, str], ...]


def cell(name: str, value: Any) -> Cell:
    """A figure by its name."""
    known = meaning(name)
    raw = "" if value is None else str(value)
    return Cell(known.title, known.words, _shown(value), known.grade(value), raw)


def _shown(value: Any) -> str:
    if value is None or value == "":
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.2f}" if abs(value) < 100 else f"{value:,.0f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def camera_cards(sources: Sources, album: Album) -> list[CameraCard]:
    """Each camera: those that have given nothing first, then those to look at; else in the order of the site file."""
    found = []
    for number, camera in enumerate(sources.record.cameras, 1):
        state = state_of(camera, sources.record)
        numbers = {name: value for name, value in camera.figures.items() if isinstance(value, int | float)}
        figures = tuple(cell(name, value) for name, value in numbers.items() if not isinstance(value, bool) and name != "points")
        pairs = sources.record.pairs_of(camera.id)
        used = Cell("used pairs", "of its pairs, those matched densely", f"{sum(p.ok for p in pairs)} of {len(pairs)}", "")
        badge = camera.health.state if camera.health and not camera.health.ok else _BADGES[state]
        picture = album.of_frame(camera.id, camera.id)
        bars = tuple(spark(sources, camera.id))
        main = (used, *(c for c in (cell("points", camera.figures.get("points")),) if c.value), *_given(sources, camera.id))
        counted = _seen(camera, pairs)
        told, notes = _words(camera, sources.record.reference is None), camera.notes
        found.append(CameraCard(camera.id, number, state, badge, told, notes, picture, bars, counted, main, figures))
    return sorted(found, key=lambda card: ("bad", "warn", "good").index(card.state))


def _seen(camera: CameraRecord, pairs: list[PairRecord]) -> str:
    """What was found in its picture, in words."""
    points, agreed = camera.figures.get("keypoints"), [p.figures.get("inliers") for p in pairs if p.figures.get("matched")]
    known = [count for count in agreed if count]
    said = [f"{points:,} keypoints"] if points else []
    return ", ".join([*said, *([f"{sum(known):,} inliers in {len(known)} pairs"] if known else [])])


def _words(camera: CameraRecord, alone: bool) -> str:
    """How it was; nothing of one that is well on a night that is compared with none."""
    health = camera.health.text if camera.health and not (alone and camera.health.ok) else ""
    said = health if camera.ok else camera.reason or camera.outcome
    return "; ".join(filter(None, (said, camera.down.told(left_out=not camera.ok) if camera.down else "")))


def _given(sources: Sources, camera: str) -> Iterator[Cell]:
    """What each camera adds to site-wide results."""
    for stage in STAGES:
        told = sources.record.later.get(stage.name)
        for name, value in told.items() if isinstance(told, Mapping) else ():
            if isinstance(value, Mapping) and isinstance(share := value.get(camera), float):
                yield Cell(meaning(name).title, meaning(name).words or f"{stage.title}: {name}", f"{100 * share:.1f} %", "")


def pair_columns(sources: Sources) -> list[str]:
    """The figures that any pair has."""
    return [n for n in reported("pair") if any(pair.figures.get(n) not in {None, ""} for pair in sources.record.pairs)]


def pair_rows(sources: Sources) -> list[PairRow]:
    """Each pair, in the order of the pair graph."""
    names = pair_columns(sources)
    return [
        PairRow(
            pair.name,
            pair.ok,
            pair.outcome,
            pair.reason or "",
            tuple(cell(n, pair.figures.get(n)) for n in names),
            tried(sources, pair),
        )
        for pair in sources.record.pairs
    ]


def pair_pictures(sources: Sources, album: Album) -> list[tuple[str, list[Shown]]]:
    """Pictures of each pair that has any."""
    found = []
    for pair in sources.record.pairs:
        tasks = (Task(stage.name, (pair.left, pair.right)) for stage in STAGES if stage.scope == "pair" and stage.picture)
        pictures = [picture for task in tasks if (picture := album.of_task(task, str(task)))]
        if pictures:
            found.append((pair.name, pictures))
    return found


def parts(sources: Sources, album: Album) -> list[Part]:
    """What each site-wide stage that run.json tells of has found."""
    found = []
    for stage in STAGES:
        told = sources.record.later.get(stage.name)
        if stage.scope == "site" and stage.reports and isinstance(told, Mapping) and told:
            files = tuple(told.get("files") or ())
            since = since_last_good(sources.record, sources, stage.name)
            unit = "m" if sources.record.poses is None or sources.record.poses.metric else ""
            things = tuple(thing for value in told.values() for thing in _things(value, files, album, since, unit))
            reason, over = str(told.get("reason") or ""), _over(since, unit) if since else ""
            if told.get("compared") is False:
                found.append(Part(stage.title, reason, None, (), (), files, "There was nothing to compare this night with."))
                continue
            picture = album.of_task(Task(stage.name), stage.title)
            found.append(Part(stage.title, reason, picture, tuple(shown(told)), things, files, over))
    return found


def _over(since: Since, unit: str) -> str:
    gone = [f"{thing.get('kind') or 'something'} ({_dimensions(thing, unit)})" for thing in since.over.values()]
    return f"No more as on {since.date}, the last good night, but as in the reference again: {', '.join(gone)}." if gone else ""


def _things(entries: Any, files: tuple[str, ...], album: Album, since: Since | None, unit: str) -> Iterator[Thing]:
    for name, entry in entries.items() if isinstance(entries, Mapping) else ():
        if not isinstance(entry, Mapping):
            continue
        file = next((f for f in files if f.rpartition(".")[0].endswith(f"-{name}") and _is_picture(f)), None)
        title = f"{name}: {entry.get('kind') or ''}".rstrip(": ")
        said = [f"{key}: {value.replace(',', ', ')}" for key, value in entry.items() if isinstance(value, str) and value]
        words = tuple(line for line in said if not line.startswith("kind: "))
        numbers = tuple((key.replace("_", " "), _shown(value)) for key, value in entry.items() if isinstance(value, int | float))
        picture = album.of_product(file, f"{title}: then and this night") if file else None
        then = since.then.get(name) if since else None
        told = "" if since is None else f"so already on {since.date}" if then else f"since {since.date}, the last good night"
        yield Thing(title, _dimensions(entry, unit), told, words, picture, numbers)


def _dimensions(entry: Mapping[str, Any], unit: str) -> str:
    """How large a thing is, and where, as far as it says so."""
    sides = [entry.get(name) for name in ("length", "width", "height")]
    size = " × ".join(f"{side:.1f}" for side in sides if isinstance(side, int | float))
    volume, sigma = entry.get("volume"), entry.get("volume_sigma")
    room = f"{volume:.1f}" + (f" ± {sigma:.1f}" if sigma else "") + (f" {unit}³" if unit else "") if volume else ""
    at = [entry.get(name) for name in ("x", "y", "z")]
    where = "at " + ", ".join(f"{v:.1f}" for v in at if isinstance(v, int | float)) if None not in at else ""
    return "; ".join(filter(None, (f"{size} {unit}".strip(), room and f"volume {room}", where)))


def _is_picture(file: str) -> bool:
    return (mimetypes.guess_type(file)[0] or "").startswith("image/")


def settings(sources: Sources) -> list[tuple[str, Used]]:
    """With which function and parameters each stage was run."""
    cache, found = sources.cache, dict[str, Used]()
    for task, event in sources.tasks.items():
        if task.stage in found or not event.key or not (receipt := cache.by_key(task, event.key)):
            continue
        made = receipt.preimage
        parameters = tuple((name, _plain(value)) for name, value in made.parameters.items())
        found[task.stage] = Used(made.function, made.code[:12], parameters)
    return [(stage.name, found[stage.name]) for stage in STAGES if stage.name in found]


def _plain(value: Any) -> str:
    return "none" if value is None else str(value)
