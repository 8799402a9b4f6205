"""Cut and fill: the volumes that changes have gained and lost on parts of the ground, with standard deviations.

Only changes count, which lie beyond the level of detection and are confirmed by free space and photographs: heights alone differ
at the edges of walls by as much as a container.  Errors of two kinds are kept apart, as they add up differently: those of single
changes, and the height of one night against the other, which all places share and nothing averages out (Wheaton, Brasington,
Darby, Sear, Accounting for uncertainty in DEMs from repeat topographic surveys, Earth Surf. Process. Landforms 35, 2010).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from ..core.ground_grid import cells_inside
from ..types import Bools, CutFill, Float32s, GroundGrid
from .clusters import ChangeCluster
from .evidence import Evidence
from .footprint import OPEN

_GAP = 2
"""So many cells between seen ones, to either side, are gaps between points and no place that was not seen."""


@dataclass(frozen=True)
class Detection:
    """What a comparison of two nights can tell."""

    level: float
    """Surfaces that lie less apart count as the same, world lengths."""
    common_sigma: float
    """Standard deviation of one night's heights against the other's."""
    least_area: float
    """A change that covers less is not reported."""


def detection_of(now: Evidence, before: Evidence, *, sigmas: float, registration: float, least_area: float) -> Detection:
    """What a comparison can tell, by the places that both nights measured.

    Parameters
    ----------
    now, before : the judged evidence of both nights.
    sigmas, registration, least_area : as of `changes.find_changes`.
    """
    sigma = np.concatenate([side.sigma[side.measured] for side in (now, before)])
    apart = [sign * side.distance[side.measured & ~side.changed] for sign, side in ((1.0, now), (-1.0, before))]
    shift = float(np.median(np.concatenate(apart))) if len(sigma) else 0.0
    level = sigmas * float(np.median(sigma)) if len(sigma) else 0.0
    return Detection(level, float(np.hypot(registration, shift)), least_area)


def counts(cluster: ChangeCluster, zone: Mapping[str, Any]) -> bool:
    """Is a change large enough for a zone?"""
    return max(cluster.change.length, cluster.change.height) >= float(zone.get("least_m", 0.0))


def volumes(
    grid: GroundGrid,
    tops: Sequence[Float32s],
    clusters: Sequence[ChangeCluster],
    zones: Sequence[Mapping[str, Any]],
    detection: Detection,
) -> tuple[CutFill, dict[str, CutFill]]:
    """What was gained and lost on the whole site, or in all zones together where there are any; and in each zone.

    Parameters
    ----------
    grid : of the ground.
    tops : (rows, columns) heights of tonight's surface, and of that of then; nan where none is known.
    clusters : the changes, wherever they are, and what may be one.
    zones : see `find_changes`.
    detection : what the comparison can tell.
    """
    seen = [np.pad(np.isfinite(heights), _GAP + 1) for heights in tops]
    tonight, then = (ndimage.binary_closing(known, iterations=_GAP)[_GAP + 1 : -_GAP - 1, _GAP + 1 : -_GAP - 1] for known in seen)
    both = tonight & then
    if not zones:
        everywhere = np.ones(both.shape, bool)
        return _cut_and_fill(grid, everywhere, both, (tonight ^ then).sum() * grid.cell**2, clusters, detection), {}
    insides = [cells_inside(grid, zone["polygon"]) for zone in zones]
    parts = {
        str(zone["name"]): _cut_and_fill(
            grid, inside, both, _unseen(grid, zone, inside, both), [c for c in clusters if counts(c, zone)], detection
        )
        for zone, inside in zip(zones, insides, strict=True)
    }
    any_zone = [c for c in clusters if any(counts(c, zone) for zone in zones)]
    unseen = sum(part.unseen for part in parts.values())
    return _cut_and_fill(grid, np.any(insides, axis=0), both, unseen, any_zone, detection), parts


def _unseen(grid: GroundGrid, zone: Mapping[str, Any], inside: Bools, seen: Bools) -> float:
    """Area of a zone, which may reach beyond the grid, that was not seen on both nights."""
    corners = np.array(zone["polygon"], np.float32)
    low, high = (grid.left, grid.top - grid.rows * grid.cell), (grid.left + grid.columns * grid.cell, grid.top)
    reaches_beyond = bool(np.any(corners < low) or np.any(corners > high))
    beyond = cv2.contourArea(corners) - inside.sum() * grid.cell**2 if reaches_beyond else 0.0
    return max(0.0, beyond) + float((inside & ~seen).sum() * grid.cell**2)


def _cut_and_fill(
    grid: GroundGrid, within: Bools, seen: Bools, unseen: float, clusters: Sequence[ChangeCluster], detection: Detection
) -> CutFill:
    gained, lost = (_volume([c for c in clusters if c.of_then is gone], within, grid, detection) for gone in (False, True))
    area = float((seen & within).sum() * grid.cell**2)
    return CutFill(*gained, *lost, detection.level, detection.common_sigma, area, float(unseen))


def _volume(clusters: Sequence[ChangeCluster], within: Bools, grid: GroundGrid, detection: Detection) -> tuple[float, float]:
    """Volume of the parts of changes that lie inside, and its standard deviation: no less than the least change's volume.

    What is not confirmed may be there or not, or a part of it.
    """
    volume, area, variance = 0.0, 0.0, (detection.least_area * detection.level) ** 2
    for cluster in clusters:
        footprint, change = cluster.footprint, cluster.change
        share = np.where(within.ravel()[footprint.cells], footprint.share, 0.0)
        part = float((share * footprint.height).sum() * grid.cell**2)
        if not cluster.confirmed:
            variance += (OPEN * part) ** 2
            continue
        volume += part
        area += float(share.sum() * grid.cell**2)
        variance += (change.volume_sigma * part / max(change.volume, 1e-9)) ** 2
    return volume, float(np.sqrt(variance + (area * detection.common_sigma) ** 2))
