"""The sections of the report: cameras, pairs with what was tried, results of site-wide stages, and settings."""

from __future__ import annotations

import mimetypes
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from ..cache.store import Preimage, Receipt
from ..outcome.beside import number, shown
from ..pipeline.stages import STAGES, Stage
from ..pipeline.summaries import Change, ChangesSummary, PairFigures, SiteSummary, meaning
from ..records.record import CameraRecord, PairRecord
from ..task import Task
from .charts import Bar, camera_bars
from .data import Comparison, ReportData, since_last_good, state_of
from .pictures import Picture, Pictures

_BADGES = {"good": "as it should be", "warn": "look at it", "bad": "down"}
_MOST_FIGURES = 8
"""Figures of a step that was tried."""


@dataclass(frozen=True)
class Cell:
    """A figure."""

    title: str
    words: str
    """Its meaning."""
    value: str
    grade: str
    raw: str = ""
    """Sort key."""


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
    picture: Picture | None
    spark: tuple[Bar, ...]
    keypoints: str
    """How many keypoints and inliers its picture has."""
    main: tuple[Cell, ...]
    figures: tuple[Cell, ...]


@dataclass(frozen=True)
class PairRow:
    """A pair."""

    pair: PairRecord
    cells: tuple[Cell, ...]
    tried: tuple[tuple[str, str, str], ...]
    """Stage, outcome and figures of each step, for a pair that could not be used."""


@dataclass(frozen=True)
class Thing:
    """An object that a stage reports, with its own figures."""

    title: str
    size: str
    since: str
    """Whether it was there on the last good night."""
    words: tuple[str, ...]
    picture: Picture | None
    figures: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Part:
    """The results of a site-wide stage."""

    title: str
    reason: str
    picture: Picture | None
    rows: tuple[tuple[str, str], ...]
    things: tuple[Thing, ...]
    files: tuple[str, ...]
    since: str = ""
    """Objects of the last good night that are gone."""


def cell(name: str, value: Any) -> Cell:
    """Return a figure by its name."""
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


def camera_cards(data: ReportData, album: Pictures) -> list[CameraCard]:
    """Return the cameras: those that gave nothing first, then those to look at; else in the order of the site file."""
    found, bars = [], camera_bars(data)
    for k, camera in enumerate(data.record.cameras, 1):
        state = state_of(camera, data.record)
        numbers = {name: value for name, value in vars(camera.figures).items() if isinstance(value, int | float)}
        figures = tuple(cell(name, value) for name, value in numbers.items() if not isinstance(value, bool) and name != "points")
        pairs = data.record.pairs_of(camera.id)
        used = Cell("used pairs", "of its pairs, those matched densely", f"{sum(p.ok for p in pairs)} of {len(pairs)}", "")
        badge = camera.health.state if camera.health and not camera.health.ok else _BADGES[state]
        picture = album.of_frame(camera.id, camera.id)
        main = (used, *(c for c in (cell("points", camera.figures.points),) if c.value), *_shares(data, camera.id))
        words = _words(camera, data.record.reference is None), camera.notes
        counts = _keypoint_counts(camera, pairs)
        found.append(CameraCard(camera.id, k, state, badge, *words, picture, bars[camera.id], counts, main, figures))
    return sorted(found, key=lambda card: ("bad", "warn", "good").index(card.state))


def _keypoint_counts(camera: CameraRecord, pairs: list[PairRecord]) -> str:
    points, agreed = camera.figures.keypoints, [p.figures.inliers for p in pairs if p.matched]
    known = [count for count in agreed if count]
    words = [f"{points:,} keypoints"] if points else []
    return ", ".join([*words, *([f"{sum(known):,} inliers in {len(known)} pairs"] if known else [])])


def _words(camera: CameraRecord, alone: bool) -> str:
    """Return how it was; "" for one that is well on a night without a reference."""
    health = camera.health.text if camera.health and not (alone and camera.health.ok) else ""
    words = health if camera.ok else camera.reason or camera.outcome
    return "; ".join(filter(None, (words, camera.down.words(left_out=not camera.ok) if camera.down else "")))


def _shares(data: ReportData, camera: str) -> Iterator[Cell]:
    """Yield a camera's shares in site-wide results."""
    for result in data.record.results.values():
        for name, value in vars(result).items():
            if isinstance(value, Mapping) and isinstance(share := value.get(camera), float):
                yield Cell(meaning(name).title, meaning(name).words, f"{100 * share:.1f} %", "")


def pair_columns(data: ReportData) -> list[str]:
    """Return the names of the figures that any pair has."""
    names = [field.name for field in fields(PairFigures)]
    return [name for name in names if any(getattr(pair.figures, name) not in {None, ""} for pair in data.record.pairs)]


def pair_rows(data: ReportData) -> list[PairRow]:
    """Return the pairs in the order of the pair graph."""
    names = pair_columns(data)
    return [
        PairRow(pair, tuple(cell(n, getattr(pair.figures, n)) for n in names), () if pair.ok else tuple(_tried(data, pair)))
        for pair in data.record.pairs
    ]


def _tried(data: ReportData, pair: PairRecord) -> Iterator[tuple[str, str, str]]:
    """Yield the stages of a pair as far as it came, with their figures."""
    for stage in (stage for stage in STAGES if stage.scope == "pair"):
        event = data.tasks.get(Task(stage.name, (pair.left, pair.right)))
        if event is None or event.outcome == "skipped":
            continue
        receipt = data.cache.by_key(event.task, event.key) if event.key else None
        method = receipt.preimage.parameters.get(stage.method.parameter) if stage.method and receipt else None
        figures = ", ".join(_step_figures(stage, receipt)) if receipt else ""
        words = "; ".join(filter(None, (f"by {method}" if method else "", event.reason, figures)))
        yield stage.name, "done" if event.usable else event.outcome, words


def _step_figures(stage: Stage, receipt: Receipt) -> Iterator[str]:
    """Yield the numbers of a result by the names of run.json; of a rejection those behind the reason."""
    made = stage.summary if receipt.outcome != "rejected" else None
    figures = vars(made.from_json(receipt.figures)) if made else receipt.figures
    numbers = {name: v for name, v in figures.items() if isinstance(v, int | float) and not isinstance(v, bool)}
    for name, value in list(numbers.items())[:_MOST_FIGURES]:
        if value == value:  # not nan
            yield f"{meaning(name).title} {number(value) if isinstance(value, float) else f'{value:,}'}"


def pair_pictures(data: ReportData, album: Pictures) -> list[tuple[str, list[Picture]]]:
    """Return the pictures of each pair that has any."""
    found = []
    drawn = [stage.name for stage in STAGES if stage.scope == "pair" and stage.products.picture]
    for pair in data.record.pairs:
        tasks = (Task(name, (pair.left, pair.right)) for name in drawn)
        pictures = [picture for task in tasks if (picture := album.of_task(task, str(task)))]
        if pictures:
            found.append((pair.name, pictures))
    return found


def parts(data: ReportData, album: Pictures) -> list[Part]:
    """Return the results of each site-wide stage in run.json."""
    found = []
    for stage in STAGES:
        if result := data.record.results.get(stage.name):
            since = since_last_good(data, stage.name)
            unit = "m" if data.record.poses is None or data.record.poses.metric else ""
            things = tuple(_things(result, album, since, unit))
            reason, gone = result.reason or "", _gone(since, unit) if since else ""
            title, files = stage.products.title, result.files
            if isinstance(result, ChangesSummary) and result.compared is False:
                found.append(Part(title, reason, None, (), (), files, "There was nothing to compare this night with."))
                continue
            picture = album.of_task(Task(stage.name), title)
            found.append(Part(title, reason, picture, tuple(shown(vars(result))), things, files, gone))
    return found


def _gone(since: Comparison, unit: str) -> str:
    gone = [f"{thing.kind or 'something'} ({_dimensions(thing, unit)})" for thing in since.gone.values()]
    return f"Differed on {since.date}, the last good night, and are as in the reference again: {', '.join(gone)}." if gone else ""


def _things(result: SiteSummary, album: Pictures, since: Comparison | None, unit: str) -> Iterator[Thing]:
    for name, entry in result.objects.items():
        file = next((f for f in result.files if f.rpartition(".")[0].endswith(f"-{name}") and _is_picture(f)), None)
        title, fields_of = f"{name}: {entry.kind}".rstrip(": "), vars(entry).items()
        texts = [f"{key}: {value.replace(',', ', ')}" for key, value in fields_of if isinstance(value, str) and value]
        words = tuple(line for line in texts if not line.startswith("kind: "))
        numbers = tuple((key.replace("_", " "), _shown(value)) for key, value in fields_of if isinstance(value, int | float))
        picture = album.of_product(file, f"{title}: then and this night") if file else None
        known = since.known.get(name) if since else None
        when = "" if since is None else f"already so on {since.date}" if known else f"since {since.date}, the last good night"
        yield Thing(title, _dimensions(entry, unit), when, words, picture, numbers)


def _dimensions(entry: Change, unit: str) -> str:
    """Return the size and place of an object, as far as it has them."""
    size = " × ".join(f"{side:.1f}" for side in (entry.length, entry.width, entry.height) if side is not None)
    volume, sigma = entry.volume, entry.volume_sigma
    room = f"{volume:.1f}" + (f" ± {sigma:.1f}" if sigma else "") + (f" {unit}³" if unit else "") if volume else ""
    where = f"at {entry.x:.1f}, {entry.y:.1f}, {entry.z:.1f}"
    return "; ".join(filter(None, (f"{size} {unit}".strip(), room and f"volume {room}", where)))


def _is_picture(file: str) -> bool:
    return (mimetypes.guess_type(file)[0] or "").startswith("image/")


def settings(data: ReportData) -> list[tuple[str, Preimage]]:
    """Return the function, code and parameters of each stage."""
    found: dict[str, Preimage] = {}
    for task, event in data.tasks.items():
        if task.stage not in found and event.key and (receipt := data.cache.by_key(task, event.key)):
            found[task.stage] = receipt.preimage
    return [(stage.name, found[stage.name]) for stage in STAGES if stage.name in found]
