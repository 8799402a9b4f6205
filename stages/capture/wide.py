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
    if max(left + right, up + down) <= WIDEST_DEG + _TOLERATED_DEG:
        return []
    lens_x = (-left, right)
    lens_y = (-up, down)
    views = []
    for x, y in _layout(lens_x, lens_y):
        turn = _turn(0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]))
        window = [*_borders(x, lens_x), *_borders(y, lens_y)]
        if _visible_share(lens, turn, window) >= _LEAST_VISIBLE:
            views.append((turn.tolist(), window))
    if len(views) < 2:
        return []
    # turn[2][2] is the cosine of the angle between the axes; rounded, so that symmetric views keep their order
    views.sort(key=lambda view: -round(view[0][2][2], 6))
    return views


def _layout(x: Span, y: Span) -> list[tuple[Span, Span]]:
    """Horizontal and vertical span of each view: from left to right and from top to bottom, or the middle first in a cross."""
    columns = _split_span(x)
    rows = _split_span(y)
    if min(len(columns), len(rows)) == 1 or len(columns) == len(rows) == 2:
        views = []
        for row in rows:
            views += [(column, row) for column in columns]
        return views
    # a cross: the views at the sides are as long as a pinhole allows, so that they cover the corners, too
    middle = (_limited(x, _MIDDLE_DEG), _limited(y, _MIDDLE_DEG))
    full_x = _limited(x, 0.5 * WIDEST_DEG)
    full_y = _limited(y, 0.5 * WIDEST_DEG)
    inner = _MIDDLE_DEG - _OVERLAP_DEG
    sides = [((x[0], -inner), full_y), ((inner, x[1]), full_y), (full_x, (y[0], -inner)), (full_x, (inner, y[1]))]
    return [middle, *sides]


def _limited(span: Span, most_deg: float) -> Span:
    """The part of a span that is at most so far from the axis."""
    return max(span[0], -most_deg), min(span[1], most_deg)


def _split_span(span: Span) -> list[Span]:
    """The spans of one, two or three views that cover a span together."""
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
    half_deg = 0.5 * (span[1] - span[0])
    reaches = []
    for edge in span:
        reach = half_deg
        if edge in lens_span:
            reach += _BORDER_DEG
        reaches.append(min(reach, 0.5 * WIDEST_DEG))
    low, high = reaches
    return [-float(np.tan(np.deg2rad(low))), float(np.tan(np.deg2rad(high)))]


def _visible_share(lens: Lens, turn: Float64s, window: list[float]) -> float:
    """Share of a view that the lens sees, from a grid of its pixels."""
    x, y = np.meshgrid(np.linspace(window[0], window[1], 24), np.linspace(window[2], window[3], 24))
    pixels = lens_pixels(lens, np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]) @ turn)
    return float(((pixels > -0.5) & (pixels < (lens.width - 0.5, lens.height - 0.5))).all(axis=1).mean())
