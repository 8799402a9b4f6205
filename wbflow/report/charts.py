"""Small charts: numbers over nights, as places in a drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..outcome.beside import number

WIDTH, HEIGHT, EDGE = 260.0, 76.0, 8.0


@dataclass(frozen=True)
class Value:
    """What was on one night."""

    night: str
    value: float | None
    """None where there is nothing to say."""
    state: str
    """good, degraded, failed: the night's verdict."""
    link: str
    """The night's report, seen from this one; "" for this night."""


@dataclass(frozen=True)
class Point:
    """A night in the drawing."""

    x: float
    y: float
    state: str
    title: str
    link: str


@dataclass(frozen=True)
class Chart:
    """A figure over nights."""

    title: str
    now: str
    usual: str
    points: tuple[Point, ...]
    path: str
    low: str
    high: str
    usual_y: float | None = None


def chart(title: str, values: Sequence[Value], unit: str = "") -> Chart | None:
    """The chart of a figure; None where fewer than two nights have it, or it says nothing.

    Parameters
    ----------
    title : str
        What the figure is.
    values : sequence of Value
        The oldest night first.
    unit : str
        Of the figure.
    """
    known = [entry.value for entry in values if entry.value is not None]
    if len(known) < 2 or not any(known):
        return None
    low, high = min(0.0, *known) if min(known) < 0.5 * max(known) else min(known), max(known)
    spread = high - low or abs(high) or 1.0

    def y(value: float) -> float:
        return HEIGHT - EDGE - (value - low) / spread * (HEIGHT - 2 * EDGE)

    step = (WIDTH - 2 * EDGE) / max(1, len(values) - 1)
    points = tuple(
        Point(EDGE + k * step, y(e.value), e.state, f"{e.night}: {number(e.value)} {unit}".strip(), e.link)
        for k, e in enumerate(values)
        if e.value is not None
    )
    middle = sorted(known)[len(known) // 2]
    path = " ".join(f"{p.x:.1f},{p.y:.1f}" for p in points)
    last = values[-1].value
    now = "–" if last is None else f"{number(last)} {unit}".strip()
    return Chart(title, now, f"{number(middle)} {unit}".strip(), points, path, number(low), number(high), y(middle))


def size(count: float) -> str:
    """Bytes in words."""
    for unit, step in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= step:
            return f"{count / step:.1f} {unit}"
    return f"{count:.0f} bytes"
