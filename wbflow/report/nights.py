"""The night among others: figures over the last nights, and how each camera was."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ..outcome.beside import titled
from ..outcome.past import figures_of
from ..pipeline.stages import STAGES
from ..pipeline.summaries import meaning
from ..records.record import CameraRecord, RunRecord
from ..site.models import Measure
from .charts import Chart, Value, chart
from .sources import Sources, state_of

SPARK = 14
"""So many nights of a camera are shown."""


@dataclass(frozen=True)
class Bar:
    """A camera on one night."""

    night: str
    state: str
    height: float
    """0 to 1."""
    title: str


def trends(sources: Sources) -> list[Chart]:
    """What the nights came to, one figure each."""
    nights = sources.nights
    titles = {str(Measure.POINTS): "points in the cloud", str(Measure.PAIRS): "pairs that were used"}
    found = [_chart(sources, titles.get(name, name), [figures_of(n).get(name) for n in nights]) for name in _names(nights)]
    for title, stage, name in _told(nights):
        values = [_number((night.later.get(stage) or {}).get(name)) for night in nights]
        if meaning(name).share:
            found.append(_chart(sources, title, [None if value is None else 100 * value for value in values], "%"))
        else:
            found.append(_chart(sources, title, values))
    found.append(_chart(sources, "time", [night.seconds.wall for night in nights], "s"))
    found.append(_chart(sources, "CPU", [night.seconds.cpu for night in nights], "s"))
    found.append(_chart(sources, "size of the night's files", [_bytes(sources, night) for night in nights], "MB"))
    return [entry for entry in found if entry]


def _names(nights: list[RunRecord]) -> list[str]:
    names = dict.fromkeys(name for night in nights for name in figures_of(night))
    return [name for name in names if name not in {stage.name for stage in STAGES}]  # those follow, under their own words


def _told(nights: list[RunRecord]) -> Iterator[tuple[str, str, str]]:
    """Title, stage and name of each number that a site-wide stage reports."""
    for stage in STAGES:
        if stage.scope != "site" or not stage.reports:
            continue
        for name in stage.reports.fields:
            if any(_number((night.later.get(stage.name) or {}).get(name)) is not None for night in nights):
                yield titled(name), stage.name, name


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _chart(sources: Sources, title: str, values: list[float | None], unit: str = "") -> Chart | None:
    rows = []
    for night, value in zip(sources.nights, values, strict=True):
        link = "" if night.run == sources.record.run else f"../{night.run}/{sources.work.run(night.run).report.name}"
        rows.append(Value(night.date, value, night.verdict.level if night.verdict else "", link))
    return chart(title, rows, unit)


def _bytes(sources: Sources, night: RunRecord) -> float | None:
    folder = sources.files if night.run == sources.record.run else sources.work.run(night.run).folder
    try:
        return sum(path.stat().st_size for path in folder.iterdir()) / 1e6
    except OSError:
        return None


def spark(sources: Sources, camera: str) -> list[Bar]:
    """How a camera was in the last nights: the share of its pairs that found common points, and its state."""
    bars = []
    for night, cameras, looks in sources.cameras_of_nights[-SPARK:]:
        if (entry := cameras.get(camera)) is not None:
            share = looks.get(camera, {}).get("matched_share", 1.0 if entry.ok else 0.0)
            state = state_of(entry, night)
            bars.append(Bar(night.date, state, max(0.12, share), f"{night.date}: {_words(entry, share)}"))
    return bars


def _words(camera: CameraRecord, share: float) -> str:
    if not camera.ok:
        return camera.reason or camera.outcome
    health = camera.health.state if camera.health and not camera.health.ok else "as it should be"
    return f"{health}, {100 * share:.0f} % of its pairs find common points"
