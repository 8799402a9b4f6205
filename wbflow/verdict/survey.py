"""Stated distances, control points and units against the cameras' positions."""

from __future__ import annotations

import math
from collections.abc import Iterator

from ..pipeline.summaries import PosesSummary
from ..records.findings import Finding, finding
from ..records.record import RunRecord
from .facts import Facts
from .wording import listed


def check_survey(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Do stated distances, control points and units agree with the cameras' positions?"""
    poses = record.poses
    if poses is None:
        return
    if poses.distances_off:
        yield _distances_finding(poses)
    if poses.points_off:
        error, tolerated = max(poses.points_off.values())
        points = listed(poses.points_off)
        figures = {"off_m": error}
        expected = {"off_m": tolerated}
        yield finding("control-contradicted", (), figures, expected, off=error, points=points, tolerated=tolerated)
    if "nearest" in poses.units_off:
        nearest, limit = poses.units_off["nearest"]
        # there is a limit for cameras that are too close together, and one for those too far apart
        unit = "kilometres" if nearest < limit else "millimetres"
        figures = {"nearest_m": nearest}
        expected = {"nearest_m": limit}
        yield finding("units-implausible", (), figures, expected, nearest=nearest, limit=limit, unit=unit)


def _distances_finding(poses: PosesSummary) -> Finding:
    """Return the finding about the distance that is off by the largest factor; the others are counted."""

    def log_ratio(pair: str) -> float:
        stated, measured = poses.distances_off[pair]
        return abs(math.log(measured / stated))

    pair = max(poses.distances_off, key=log_ratio)
    stated, measured = poses.distances_off[pair]
    others = len(poses.distances_off) - 1
    more = f"; {others} more distances are off as well" if others else ""
    figures = {"metres": measured}
    expected = {"metres": stated}
    subject = tuple(pair.split("--"))
    return finding("distances-contradicted", subject, figures, expected, pair=pair, stated=stated, found=measured, more=more)
