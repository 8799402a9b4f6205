"""Do distances, control points and units agree with where the cameras stand in the end?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..core.cameras import camera_id
from ..types import Float64s, Placement, Poses, Survey, View

DISTANCE_SHARE = 0.03
"""A stated distance may differ from that of the cameras by this share, and three standard deviations of their positions."""
POINT_SHARE = 0.02
"""A control point may lie off by this share of its distance from the cameras, and as many standard deviations."""
NEAREST_M = (0.05, 1000.0)
"""Metres from a camera to the nearest other one, median over a site: less than two housings take, more than any site of local
coordinates has."""


def check_survey(poses: Poses, views: Mapping[str, View], placements: Mapping[str, Placement], survey: Survey) -> Poses:
    """Return the poses with what the site states, and the cameras contradict.

    Parameters
    ----------
    poses, views : the cameras as they are in the end, and the pinhole of each one's frame.
    placements, survey : what is stated of the poses, by id, and of distances and control points.
    """
    cameras = poses.main_cameras()
    if not poses.metric or len(cameras) < 2:
        return poses
    sigma = 3 * max((placements[name].sigma_m for name in cameras if name in placements), default=0.0)
    centres = {camera_id(name, camera): camera.C for name, camera in cameras.items()}
    distances: dict[str, tuple[float, float]] = {}
    points: dict[str, tuple[float, float]] = {}
    units: dict[str, tuple[float, float]] = {}
    for i, j, stated in survey.distances:
        a, b = survey.cameras[int(i)], survey.cameras[int(j)]
        if a in centres and b in centres:
            found = float(np.linalg.norm(centres[a] - centres[b]))
            if abs(found - stated) > DISTANCE_SHARE * min(stated, found) + np.sqrt(2) * sigma:
                distances[f"{a}--{b}"] = float(stated), found
    if len(survey.points):
        from .world import control_landmarks  # here: few sites have control points, and it takes what solves poses

        names = list(views)
        numbered = {names.index(name): camera for name, camera in cameras.items()}
        for mark in control_landmarks(numbered, names, list(views.values()), survey):
            off = float(np.linalg.norm(mark.model_X - mark.world_X))
            away = float(np.median([np.linalg.norm(C - mark.world_X) for C in centres.values()]))
            if off > (tolerated := POINT_SHARE * away + sigma):
                points[mark.name] = off, tolerated
    if not survey.crs and len(centres) > 1 and not NEAREST_M[0] <= (nearest := _nearest(centres)) <= NEAREST_M[1]:
        units["nearest"] = nearest, NEAREST_M[nearest > 1]
    return replace(poses, distances_off=distances, points_off=points, units_off=units)


def _nearest(centres: Mapping[str, Float64s]) -> float:
    """Median distance from a camera to the nearest other one."""
    C = np.array([*centres.values()])
    return float(np.median(cKDTree(C).query(C, 2)[0][:, 1]))  # the nearest of all is itself
