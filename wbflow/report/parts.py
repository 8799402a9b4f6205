"""The sections of site-wide stages: figures, files, and what has changed."""

from __future__ import annotations

import mimetypes
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..pipeline.meanings import shown
from ..pipeline.stages import CHANGES, STAGES
from ..pipeline.summaries import ChangesSummary, RecordedChange, SiteSummary, volume_words
from ..task import Task
from .data import ReportData
from .pictures import Picture, Pictures

_SAID_OF_CHANGES = {"id", "kind", "first", "last", "grown", "news_most", "seen", "acknowledged"}
"""What a change's title and text say; all else is listed with its figures."""


@dataclass(frozen=True)
class Thing:
    """A change since the reference."""

    name: str
    title: str
    size: str
    since: str
    known: str
    """Who has acknowledged it; "" if it is not acknowledged."""
    picture: Picture | None
    figures: Mapping[str, Any]


@dataclass(frozen=True)
class Part:
    """The result of a site-wide stage."""

    title: str
    reason: str
    files: tuple[str, ...]
    since: str = ""
    """What is different from the last good night."""
    picture: Picture | None = None
    sentences: tuple[str, ...] = ()
    rows: tuple[tuple[str, str], ...] = ()
    table: tuple[tuple[str, ...], ...] = ()
    """The first row has the titles."""
    volumes: tuple[tuple[str, ...], ...] = ()
    things: tuple[Thing, ...] = ()


def parts_of(data: ReportData, album: Pictures) -> list[Part]:
    """Return the results of each site-wide stage in run.json; changes that are not acknowledged come first."""
    rows = []
    for stage in STAGES:
        result = data.record.results.get(stage.name)
        if result is None:
            continue
        title = stage.products.title
        reason = result.reason or ""
        if isinstance(result, ChangesSummary) and result.compared is False:
            rows.append(Part(title, reason, result.files, since="There was nothing to compare this night with."))
            continue
        # what somebody has acknowledged is no news
        things = sorted(_things(data, result, album), key=lambda thing: bool(thing.known))
        picture = album.of_task(Task(stage.name), title)
        gone_text = ""
        if stage.name == CHANGES:
            gone_text = _gone_text(data)
        # the highest id is for the next night, not for people
        figures = tuple(shown({name: value for name, value in vars(result).items() if name != "highest_id"}))
        if result.sentences:
            figures = ()
        part = Part(
            title,
            reason,
            result.files,
            since=gone_text,
            picture=picture,
            sentences=result.sentences,
            rows=figures,
            table=result.table,
            volumes=tuple(volume_rows(result, data.unit)),
            things=tuple(things),
        )
        rows.append(part)
    return rows


def _gone_text(data: ReportData) -> str:
    """Return which changes of the last good night are there no more; "" if there are none."""
    since = data.since_last_good
    if since is None or not since.gone:
        return ""
    gone = []
    for change in since.gone.values():
        gone.append(f"{change.id} {change.kind} ({_dimensions(change, data.unit)})")
    return f"Differed on {since.date}, the last good night, and are as in the reference again: {', '.join(gone)}."


def _things(data: ReportData, result: SiteSummary, album: Pictures) -> Iterator[Thing]:
    # the largest change comes first
    for name, change in result.objects.items():
        title = f"{name}: {change.kind}".rstrip(": ")
        picture = None
        for file in result.files:
            # such as change-C17.jpg
            if file.rpartition(".")[0].endswith(f"-{name}") and is_picture(file):
                picture = album.of_product(file, f"{title}: then and this night")
                break
        figures = {}
        for key, value in vars(change).items():
            if key not in _SAID_OF_CHANGES:
                figures[key.replace("_", " ")] = value
        when = _since(change, data.record.date)
        yield Thing(name, title, _dimensions(change, data.unit), when, change.acknowledged, picture, figures)


def _since(change: RecordedChange, night: str) -> str:
    """Return since when a change is there."""
    texts = []
    if change.first == night:
        texts.append("new this night")
    elif change.first:
        texts.append(f"since {change.first}")
    if change.grown == night:
        texts.append("grown this night")
    elif change.grown:
        texts.append(f"grew on {change.grown}")
    if not change.seen:
        texts.append(f"not seen this night, last on {change.last}")
    return "; ".join(texts)


def volume_rows(result: SiteSummary, unit: str) -> Iterator[tuple[str, ...]]:
    """Yield name, volume gained and lost, area that was compared, and area that was not seen, of the site and of each zone."""

    def area(value: float) -> str:
        return f"{value:,.1f} {unit}²" if unit else f"{value:,.1f}"

    for zone, part in result.volumes.items():
        gained = volume_words((part.gained_least, part.gained_most), (part.gained, part.gained_sigma), unit)
        lost = volume_words((part.lost_least, part.lost_most), (part.lost, part.lost_sigma), unit)
        yield zone or "whole site", gained, lost, area(part.area), area(part.unseen)


def _dimensions(change: RecordedChange, unit: str) -> str:
    """Return the size, volume and place of a change."""
    size = " × ".join(f"{side:.1f}" for side in (change.length, change.width, change.height))
    texts = [f"{size} {unit}".strip()]
    if change.volume or change.volume_most:
        texts.append(f"volume {change.volume_words(unit)}")
    texts.append(f"at {change.x:.1f}, {change.y:.1f}, {change.z:.1f}")
    return "; ".join(texts)


def is_picture(file: str) -> bool:
    """Return whether a file is a picture, by its name."""
    return (mimetypes.guess_type(file)[0] or "").startswith("image/")
