"""Figures over time: charts with an axis, whose unit and labels a person can read, and the span of time of a thing."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..words import number

WIDTH = 360.0
HEIGHT = 150.0
"""Size of a chart, in units that are about a pixel on a phone."""
_LEFT = 46.0
"""Width of the column of the axis' labels."""
_EDGE = 8.0
_BOTTOM = 20.0
"""Height of the row of dates."""
_INTERVALS = 3
"""Number of intervals between the labels of an axis, at least."""
_HALF_DATE = 24.0
"""Half the width of a date."""
_MOST_DATES = 4
"""Largest number of dates below a chart."""
_SIZES = ((1e9, 1e9, "G"), (1e6, 1e6, "M"), (1e4, 1e3, "k"))
"""How large values are written: from which value on, in which unit."""
_STEPS_OF_DAYS = (1, 2, 3, 5, 7, 14)
_STEPS_OF_MONTHS = (1, 2, 3, 6, 12, 24, 60)


@dataclass(frozen=True)
class Period:
    """The days of a page, from the first night to the last."""

    first: datetime.date
    last: datetime.date

    def part(self, begin: datetime.date, end: datetime.date) -> tuple[float, float]:
        """Return where the nights from `begin` to `end` lie within it, and how much of it they take, in percent."""
        days = (self.last - self.first).days + 1
        return round(100 * (begin - self.first).days / days, 2), round(100 * ((end - begin).days + 1) / days, 2)

    def x(self, day: datetime.date) -> float:
        """Return where a day is in a chart."""
        share = (day - self.first).days / max((self.last - self.first).days, 1)
        return round(_LEFT + share * (WIDTH - _LEFT - _EDGE), 1)


@dataclass(frozen=True)
class Sample:
    """A figure on one night."""

    day: datetime.date
    value: float
    state: str
    """Of the night: good, degraded or failed."""
    least: float | None = None
    """Interval that holds the true value, if it is known."""
    most: float | None = None

    @property
    def low(self) -> float:
        """The lower end of the interval, or the value."""
        return self.value if self.least is None else self.least

    @property
    def high(self) -> float:
        """The upper end of the interval, or the value."""
        return self.value if self.most is None else self.most

    def words(self, unit: str) -> str:
        """Return the value with its unit and its interval."""
        words = f"{number(self.value)} {unit}".strip()
        if self.least is None or self.most is None:
            return words
        return f"{words} ({number(self.least)} to {number(self.most)})"


@dataclass(frozen=True)
class Dot:
    """A sample as it is drawn."""

    x: float
    y: float
    state: str
    date: str
    words: str


@dataclass(frozen=True)
class Chart:
    """A figure over time."""

    title: str
    now: str
    """The last value, with its unit."""
    dots: Sequence[Dot]
    band: str
    """Corners of the polygon of the intervals, for SVG; "" if there are none."""
    ticks: Sequence[tuple[float, str]]
    """y and label of the axis' lines."""
    dates: Sequence[tuple[float, str, str]]
    """x and label of days below the chart, and which part of the label is at x (SVG's text-anchor)."""


def chart(title: str, unit: str, samples: Sequence[Sample], period: Period) -> Chart | None:
    """Return the chart of a figure; None if it has fewer than two samples, or they are all 0.

    Parameters
    ----------
    title, unit : str, str
        Name of the figure, and the unit of its values; "" for none.
    samples : sequence of Sample
        Oldest first.
    period : Period
        The days from the chart's left to its right edge, the same for all charts of a page.
    """
    if len(samples) < 2 or not any(sample.value for sample in samples):
        return None
    # 1. The axis: from 0, unless all values are far above it.
    low = min(sample.low for sample in samples)
    high = max(sample.high for sample in samples)
    if 0 < low < 0.5 * high:
        low = 0.0
    axis = axis_of(low, high, whole=all(float(sample.value).is_integer() for sample in samples))
    span = axis[-1] - axis[0]
    decimals = _decimals(axis[1] - axis[0])

    def y(value: float) -> float:
        return round(HEIGHT - _BOTTOM - (value - axis[0]) / span * (HEIGHT - _BOTTOM - _EDGE), 1)

    # 2. The samples, and around them the polygon of their intervals: forwards along the upper ends, back along the lower ones.
    dots = []
    upper = []
    lower = []
    for sample in samples:
        x = period.x(sample.day)
        dots.append(Dot(x, y(sample.value), sample.state, sample.day.isoformat(), sample.words(unit)))
        upper.append(f"{x},{y(sample.high)}")
        lower.append(f"{x},{y(sample.low)}")
    has_intervals = all(sample.least is not None for sample in samples)
    band = " ".join([*upper, *reversed(lower)]) if has_intervals else ""

    # 3. The labels; a date at the right edge ends there.
    ticks = [(y(value), _label(value, decimals)) for value in axis]
    dates = []
    for day, words in _dates(period):
        x = period.x(day)
        anchor = "middle"
        if x > WIDTH - _HALF_DATE:
            anchor = "end"
        dates.append((x, words, anchor))
    name = f"{title}, {unit}" if unit else title
    now = f"{number(samples[-1].value)} {unit}".strip()
    return Chart(name, now, dots, band, ticks, dates)


def axis_of(low: float, high: float, whole: bool = False) -> list[float]:
    """Return the values at the lines of an axis from at most `low` to at least `high`: multiples of 1, 2 or 5 powers of ten.

    whole: only whole numbers.
    """
    most_step = (high - low or abs(high) or 1.0) / _INTERVALS
    decade = 10.0 ** math.floor(math.log10(most_step))
    step = decade
    for multiple in (2.0, 5.0):
        if multiple * decade <= most_step * (1 + 1e-9):
            step = multiple * decade
    if whole:
        step = max(step, 1.0)
    first = math.floor(low / step + 1e-9)
    last = max(math.ceil(high / step - 1e-9), first + 1)
    return [line * step for line in range(first, last + 1)]


def _dates(period: Period) -> list[tuple[datetime.date, str]]:
    """Return a few days of a period, with their labels: evenly spaced days, or first days of months."""
    first = period.first
    last = period.last
    span = (last - first).days
    for step in _STEPS_OF_DAYS:
        if span <= step * _MOST_DATES:
            count = min(span // step + 1, _MOST_DATES)
            days = [last - datetime.timedelta(days=step * k) for k in reversed(range(count))]
            return [(day, f"{day.day} {day:%b}") for day in days]
    # months are counted from the year 0: a January's number is a multiple of 12
    months = range(first.year * 12 + first.month, last.year * 12 + last.month)  # those that begin between the two days
    step = next((step for step in _STEPS_OF_MONTHS if len(months) <= step * _MOST_DATES), _STEPS_OF_MONTHS[-1])
    labelled = []
    for month in months:
        if month % step == 0:
            day = datetime.date(month // 12, month % 12 + 1, 1)
            labelled.append((day, f"{day:%Y}" if day.month == 1 else f"{day:%b}"))
    return labelled


def _decimals(step: float) -> int:
    return max(0, -math.floor(math.log10(step) + 1e-9))


def _label(value: float, decimals: int) -> str:
    """Return a value on an axis, at most six characters wide."""
    for least, size, letter in _SIZES:
        if abs(value) >= least:
            return f"{value / size:g} {letter}"
    return f"{value:,.{decimals}f}"
