"""Can the cameras of a site tell depth at all?  Found from the angles at which the rays of their matches meet."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..core.cameras import rays
from ..reasons import Reason, Rejected
from ..twoview.pair_score import hardly_converging
from ..types import Camera, Float64s, Geometry, Pair
from .pose_check import BELIEVED, MIN_SHARED


def without_baseline(
    names: Mapping[str, object],
    known: Mapping[str, Camera],
    geometries: Mapping[Pair, Geometry],
    min_angle_deg: float,
    metric: bool,
) -> Rejected | None:
    """Why a site whose cameras are all (almost) at one place makes no cloud; None where some pair has a baseline.

    Parameters
    ----------
    names : all cameras.
    known : those whose poses are known.
    geometries : of the pairs.  As long as a camera is in no pair of matches that agree and whose angle is known, nothing is said.
    min_angle_deg : a pair has a baseline if the rays of its matches meet at this or more (median), in degrees.
    metric : known positions are in metres.
    """
    angles = {}
    for pair, geometry in geometries.items():
        matched = geometry.good_probability >= BELIEVED or hardly_converging(geometry.angle_deg, geometry.agreement)
        if matched and len(geometry.x1) >= MIN_SHARED:
            both = set(pair) <= set(known)
            angle = _angle_deg(known[pair[0]], known[pair[1]], geometry) if both else geometry.angle_deg
            if np.isfinite(angle):
                angles[pair] = angle
    if {name for pair in angles for name in pair} != set(names) or max(angles.values()) >= min_angle_deg:
        return None
    widest = max(angles, key=angles.__getitem__)
    figures = {
        "angle_deg": angles[widest],
        "needed_deg": min_angle_deg,
        "baselines": float(1 / np.radians(max(angles[widest], 1e-3))),
    }
    if not metric or not set(widest) <= set(known):
        return Rejected(Reason.NO_USABLE_BASELINE, figures)
    left, right = (known[name] for name in widest)
    ahead = _unit(left, geometries[widest].x1).mean(axis=1)
    across = np.cross(right.C - left.C, ahead / np.linalg.norm(ahead))
    figures["baseline_m"] = float(np.linalg.norm(right.C - left.C))
    figures["distance_m"] = float(np.linalg.norm(across)) * figures["baselines"]
    return Rejected(Reason.NO_USABLE_BASELINE_M, figures)


def _angle_deg(left: Camera, right: Camera, geometry: Geometry) -> float:
    """Median angle at which the rays of a pair's matches meet."""
    a, b = _unit(left, geometry.x1), _unit(right, geometry.x2)
    return float(np.degrees(np.median(np.arccos(np.clip((a * b).sum(axis=0), -1, 1)))))


def _unit(camera: Camera, x: Float64s) -> Float64s:
    direction = rays(camera, x)
    return np.asarray(direction / np.linalg.norm(direction, axis=0), dtype=np.float64)
