"""Output of benchmarks: rows as JSON, curves as SVG (without a plotting library), and the exit code."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

Curve = Sequence[tuple[float, float]]

COLOURS = ("#3070b0", "#d07020", "#3a9a50", "#b04040", "#8060b0", "#707070", "#c050a0", "#909020")
WIDE, HIGH, LEFT, ROOM = 300, 200, 46, 44
"""Pixels: width and height of a panel's axes, space for the numbers to their left, and for the text above and below them."""


def write_rows(rows: Sequence[object], keys: Sequence[str], file: Path) -> None:
    """Write the named fields of each row as a JSON object, with null for nan and infinity."""
    objects = [{key: _json_value(getattr(row, key)) for key in keys} for row in rows]
    file.write_text(json.dumps(objects, indent=1))


def exit_status(faults: Sequence[str]) -> int:
    """Print the faults; return 1 if there are any, else 0."""
    for fault in faults:
        print(fault)
    return 1 if faults else 0


def _json_value(value: object) -> object:
    return None if isinstance(value, float) and not math.isfinite(value) else value


@dataclass(frozen=True)
class Panel:
    """Curves y(x) by name, with y from 0 up; words: labels of the x axis at 0, 1, 2, ..., instead of numbers."""

    title: str
    along_x: str
    curves: Mapping[str, Curve]
    words: Sequence[str] = ()


def draw(panels: Sequence[Panel], file: Path) -> None:
    """Write the panels as SVG, three in a row; a curve's name has the same colour in all of them."""
    names = list(dict.fromkeys(name for panel in panels for name in panel.curves))
    colours = {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(names)}
    parts = []
    for k, name in enumerate(names):
        x, y = LEFT + 130 * (k % 7), 14 + 14 * (k // 7)
        parts.append(f'<text x="{x}" y="{y}" fill="{colours[name]}" font-weight="bold">{escape(name)}</text>')
    head = 20 + 14 * math.ceil(len(names) / 7)
    for k, panel in enumerate(panels):
        x, y = (k % 3) * (WIDE + LEFT + 20) + LEFT, head + (k // 3) * (HIGH + 2 * ROOM)
        parts.append(f'<g transform="translate({x},{y + 20})">{_drawn(panel, colours)}</g>')
    width, height = 3 * (WIDE + LEFT + 20), head + math.ceil(len(panels) / 3) * (HIGH + 2 * ROOM)
    size = f'width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
    page = f'<rect width="{width}" height="{height}" fill="white"/>'
    file.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" font-size="10">{page}{"".join(parts)}</svg>'
    )


def _drawn(panel: Panel, colours: Mapping[str, str]) -> str:
    points = [p for curve in panel.curves.values() for p in curve if all(map(math.isfinite, p))]
    if not points:
        return f"<text>{escape(panel.title)}: nothing measured</text>"
    xs = [x for x, _ in points]
    low, high = min(xs), max(max(xs), min(xs) + 1e-9)
    top = _round_up(max(y for _, y in points))

    def at(x: float, y: float) -> str:
        return f"{WIDE * (x - low) / (high - low):.1f},{HIGH * (1 - y / top):.1f}"

    parts = [f'<text y="-6" font-weight="bold">{escape(panel.title)}</text>']
    for k in range(5):
        y = HIGH * (1 - k / 4)
        parts.append(
            f'<path d="M0 {y}h{WIDE}" stroke="#ddd"/><text x="-6" y="{y + 3}" text-anchor="end">{top * k / 4:.3g}</text>'
        )
    ticks = list(enumerate(panel.words)) if panel.words else [(x, f"{x:.3g}") for x in _ticks(low, high)]
    for x, word in ticks:
        parts.append(f'<text x="{at(x, 0).split(",")[0]}" y="{HIGH + 14}" text-anchor="middle">{escape(word)}</text>')
    parts.append(f'<text x="{WIDE / 2}" y="{HIGH + 30}" text-anchor="middle">{escape(panel.along_x)}</text>')
    for name, curve in panel.curves.items():
        known = [at(x, y) for x, y in curve if math.isfinite(x) and math.isfinite(y)]
        parts.append(f'<polyline points="{" ".join(known)}" fill="none" stroke="{colours[name]}" stroke-width="1.5"/>')
        parts += [f'<circle cx="{p.split(",")[0]}" cy="{p.split(",")[1]}" r="2.5" fill="{colours[name]}"/>' for p in known]
    return "".join(parts)


def _round_up(value: float) -> float:
    """The next 1, 1.2, 1.5, 2, 3, 4, 5, 6, 8 times a power of ten, for the end of an axis or the spacing of its ticks."""
    if value <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return power * next(step for step in (1, 1.2, 1.5, 2, 3, 4, 5, 6, 8, 10) if step * power >= value * 0.9999)


def _ticks(low: float, high: float) -> list[float]:
    step = _round_up((high - low) / 6)
    return [step * k for k in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)]
