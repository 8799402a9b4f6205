"""Another night of the site, shown beside the night of the page: its points, and its pictures laid over those of this night."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..cache.store import Cache
from ..pipeline.names import FRAMES, FUSE
from ..pipeline.stages import stage_named
from ..site.models import Site
from ..task import Task

_STILL = 5e-4
"""A picture that is off by less than this share of its size is not moved."""

Matrix = Sequence[Sequence[float]]


@dataclass(frozen=True)
class OtherNight:
    """A run of another night."""

    date: str
    keys: Mapping[Task, str] = field(repr=False)
    """The cache key of each result..."""
    cameras: Mapping[str, Any] = field(repr=False)
    """...and the cameras as cameras.json has them."""
    page_keys: Mapping[Task, str] = field(repr=False)
    """The same of the night of the page."""
    page_cameras: Mapping[str, Any] = field(repr=False)
    cache: Cache = field(repr=False)
    site: Site = field(repr=False)

    def points(self) -> bytes | None:
        """Return the stream of its cloud; None where it is gone, or would show what is private now."""
        task = Task(FUSE)
        stream = self.cache.drawing(task, self.keys[task], "view") if task in self.keys else None
        return stream if all(self.is_as_private(frame) for frame in self.keys if frame.stage == FRAMES) else None

    def is_as_private(self, frame: Task) -> bool:
        """Return whether a camera's picture of that night left out what is private on the night of the page."""
        stated = next((view for view in self.site.views if (view.id,) == frame.subject), None)
        if stated is None or not stated.privacy:
            return True
        then, now = (self.cache.by_key(frame, key) if (key := keys.get(frame)) else None for keys in (self.keys, self.page_keys))
        private = [name for name, need in stage_named(FRAMES).inputs.items() if (need.kind, need.name) == ("site", "privacy")]
        if then is None or now is None:
            return False
        return all(then.preimage.inputs.get(name) == now.preimage.inputs.get(name) for name in private)

    def onto(self, camera: str) -> str:
        """Return what lays a camera's picture of that night over this night's: a homography of the unit square, row by row.

        "" where it has not turned, or where that is not known.
        """
        then, now = self.cameras.get(camera), self.page_cameras.get(camera)
        if not then or not now or not all(one.get("R") and one.get("K") for one in (then, now)):
            return ""
        turn = _product(now["R"], list(zip(*then["R"], strict=True)))
        matrix = _product(_product(_to_unit(now), turn), _from_unit(then))
        rows = [[value / matrix[2][2] for value in row] for row in matrix]
        corners = [_seen(rows, x, y) for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0))]
        still = all(abs(x - k % 2) < _STILL and abs(y - k // 2) < _STILL for k, (x, y) in enumerate(corners))
        return "" if still else " ".join(f"{value:.7g}" for row in rows for value in row)


def _to_unit(camera: Mapping[str, Any]) -> Matrix:
    K, wide, high = camera["K"], camera["width"], camera["height"]
    return [[value / wide for value in K[0]], [value / high for value in K[1]], [0.0, 0.0, 1.0]]


def _from_unit(camera: Mapping[str, Any]) -> Matrix:
    K, wide, high = camera["K"], camera["width"], camera["height"]
    return [[wide / K[0][0], 0.0, -K[0][2] / K[0][0]], [0.0, high / K[1][1], -K[1][2] / K[1][1]], [0.0, 0.0, 1.0]]


def _product(a: Matrix, b: Matrix) -> Matrix:
    return [[sum(x * y for x, y in zip(row, column, strict=True)) for column in zip(*b, strict=True)] for row in a]


def _seen(rows: Matrix, x: float, y: float) -> tuple[float, float]:
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in rows)
    return u / w, v / w
