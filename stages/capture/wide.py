"""The pinhole views of a lens that sees more than one pinhole can show: their orientations and extents.

A lens that is wide in one direction only (a frame that cuts off the circle of a fisheye) gets two or three views side by side.
One that is wide in both directions gets four views, or a cross of five: one for the middle, which other cameras mostly see, and
one on each side of it.  Neighbours overlap slightly, so that matching windows at the border of one lie inside the other.
"""

from __future__ import annotations

import numpy as np

from ..core.lenses import WIDEST_DEG, lens_pixels, sides_deg
from ..types import Float64s, Lens

_TOLERATED_DEG = 2.0
"""A lens whose field of view exceeds `WIDEST_DEG` by at most this keeps a single view."""
_THREE_VIEWS_DEG = 150.0
"""A field of view wider than this is split into three views, the middle and both sides, instead of two."""
_MIDDLE_DEG = 45.0
"""Half the width of a middle view."""
_OVERLAP_DEG = 3.0
"""Overlap: each of two views reaches this far over their border; of three, the side views reach this far into the middle one."""
_MOST_OFF_AXIS_DEG = 95.0
"""Largest angle off the axis that is used: beyond it wide lenses see their own housing, and calibration is worst."""
_BORDER_DEG = 10.0
"""How much farther a view may reach at the border of the image, whose corners lie farther out than the middles of its sides."""
_LEAST_VISIBLE = 0.05
"""A view is left out if the lens sees less than this share of it."""

Span = tuple[float, float]
"""Smallest and largest angle, degrees."""


def views_of_lens(
    K: list[list[float]], distortion: list[float], width: int, height: int, model: str
) -> list[tuple[list[list[float]], list[float]]]:
    """`Lens.turn` and `Lens.window` of each view as plain numbers, nearest to the axis first; none if one pinhole suffices.

    Parameters
    ----------
    K, distortion, width, height, model : as of `Lens`.
    """
    lens = Lens(np.array(K, dtype=np.float64), np.array(distortion, dtype=np.float64), None, width, height, model)
    left, right, up, down = np.minimum(sides_deg(lens, width, height), _MOST_OFF_AXIS_DEG).tolist()
    width_deg, height_deg = left + right, up + down
    if max(width_deg, height_deg) <= WIDEST_DEG + _TOLERATED_DEG:
        return []
    views = []
    for x, y in _layout((-left, right), (-up, down)):
        turn, window = _turn(0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1])), [*_borders(x, (-left, right)), *_borders(y, (-up, down))]
        if _visible_share(lens, turn, window) >= _LEAST_VISIBLE:
            views.append((turn.tolist(), window))
    views.sort(key=lambda view: -round(view[0][2][2], 6))
    return views if len(views) > 1 else []


def _layout(x: Span, y: Span) -> list[tuple[Span, Span]]:
    """Horizontal and vertical span of each view: from left to right and from top to bottom, or the middle first in a cross."""
    columns, rows = _split_span(x), _split_span(y)
    if min(len(columns), len(rows)) == 1 or len(columns) == len(rows) == 2:
        return [(column, row) for row in rows for column in columns]
    half_deg = 0.5 * WIDEST_DEG
    middle = (max(x[0], -_MIDDLE_DEG), min(x[1], _MIDDLE_DEG)), (max(y[0], -_MIDDLE_DEG), min(y[1], _MIDDLE_DEG))
    inner = _MIDDLE_DEG - _OVERLAP_DEG
    full_y, full_x = (max(y[0], -half_deg), min(y[1], half_deg)), (max(x[0], -half_deg), min(x[1], half_deg))
    sides = [((x[0], -inner), full_y), ((inner, x[1]), full_y), (full_x, (y[0], -inner)), (full_x, (inner, y[1]))]
    return [middle, *sides]


def _split_span(span: Span) -> list[Span]:
    low, high = span
    if high - low <= WIDEST_DEG:
        return [span]
    if high - low <= _THREE_VIEWS_DEG:
        middle = 0.5 * (low + high)
        return [(low, middle + _OVERLAP_DEG), (middle - _OVERLAP_DEG, high)]
    inner = _MIDDLE_DEG - _OVERLAP_DEG
    return [(low, -inner), (-_MIDDLE_DEG, _MIDDLE_DEG), (inner, high)]


def _turn(right_deg: float, down_deg: float) -> Float64s:
    """(3, 3) rotation from camera axes to those of a view that is turned to the right and then down by these angles."""
    a, b = np.deg2rad([right_deg, down_deg])
    about_y = np.array([[np.cos(a), 0.0, -np.sin(a)], [0.0, 1.0, 0.0], [np.sin(a), 0.0, np.cos(a)]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(b), -np.sin(b)], [0.0, np.sin(b), np.cos(b)]])
    return np.asarray(about_x @ about_y, dtype=np.float64)


def _borders(span: Span, lens_span: Span) -> list[float]:
    """Tangents at both borders of a view that looks at the middle of its span, to which `_BORDER_DEG` is added at borders of
    the image (`lens_span`)."""
    half_deg, most_deg = 0.5 * (span[1] - span[0]), 0.5 * WIDEST_DEG
    low, high = (min(half_deg + (_BORDER_DEG if edge in lens_span else 0.0), most_deg) for edge in span)
    return [-float(np.tan(np.deg2rad(low))), float(np.tan(np.deg2rad(high)))]


def _visible_share(lens: Lens, turn: Float64s, window: list[float]) -> float:
    x, y = np.meshgrid(np.linspace(window[0], window[1], 24), np.linspace(window[2], window[3], 24))
    pixels = lens_pixels(lens, np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]) @ turn)
    return float(((pixels > -0.5) & (pixels < (lens.width - 0.5, lens.height - 0.5))).all(axis=1).mean())
