"""Polygons of a site file: do they cross themselves, and how large are they?"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

Corner = Sequence[float]
"""x and y."""


def crossing(polygon: Sequence[Corner]) -> str:
    """Which two sides of a polygon cross each other, in words; "" if none do.  Sides that only touch do not cross."""
    sides = list(zip(polygon, [*polygon[1:], polygon[0]], strict=True))
    numbered = list(enumerate(sides, 1))
    for (i, (a, b)), (j, (c, d)) in itertools.combinations(numbered, 2):
        if _cross(a, b, c, d):
            first = f"the side from {_shown(a)} to {_shown(b)}"
            return f"{first} crosses that from {_shown(c)} to {_shown(d)} (sides {i} and {j})"
    return ""


def area(polygon: Sequence[Corner]) -> float:
    """The area of a polygon that does not cross itself (the shoelace formula)."""
    sides = zip(polygon, [*polygon[1:], polygon[0]], strict=True)
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in sides)) / 2


def diameter(polygon: Sequence[Corner]) -> float:
    """The largest distance between two corners."""
    return max(math.dist(a, b) for a, b in itertools.combinations(polygon, 2))


def _cross(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    """Does the segment from a to b cross that from c to d, in a point that is an end of neither?

    It does if the ends of each lie on different sides of the other.
    """
    return _side(a, b, c) * _side(a, b, d) < 0 and _side(c, d, a) * _side(c, d, b) < 0


def _side(a: Corner, b: Corner, point: Corner) -> int:
    """On which side of the line from a to b a point lies: 1, -1, or 0 if it is on the line."""
    area = (b[0] - a[0]) * (point[1] - a[1]) - (b[1] - a[1]) * (point[0] - a[0])
    return (area > 0) - (area < 0)


def _shown(corner: Corner) -> str:
    return f"{corner[0]:g}, {corner[1]:g}"
