"""Do stated distances, control points and units agree with the final positions of the cameras?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..core.cameras import camera_id
from ..types import Placement, Poses, Survey, View

DISTANCE_SHARE = 0.03
"""Tolerance of a stated distance: this share of it, plus three standard deviations of the camera positions."""
POINT_SHARE = 0.02
"""Tolerance of a control point: this share of its distance from the cameras, plus three standard deviations of positions."""
NEAREST_M = (0.05, 1000.0)
"""Plausible range of the median distance from a camera to its nearest neighbour, in metres: two housings are not
nearer, and no site in local coordinates is more widely spaced."""


def check_survey(poses: Poses, views: Mapping[str, View], placements: Mapping[str, Placement], survey: Survey) -> Poses:
    """Return the poses with the statements of the site that the cameras contradict.

    Parameters
    ----------
    poses, views : the final cameras, and the view of each.
    placements, survey : stated poses by id; stated distances and control points.
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
        a, b = survey.cameras[i], survey.cameras[j]
        if a in centres and b in centres:
            measured = float(np.linalg.norm(centres[a] - centres[b]))
            if abs(measured - stated) > DISTANCE_SHARE * min(stated, measured) + np.sqrt(2) * sigma:
                distances[f"{a}--{b}"] = stated, measured
    if survey.points:
        from .world import control_landmarks  # imported here: few sites have control points, and it loads the pose solver

        names = list(views)
        solved = {names.index(name): camera for name, camera in cameras.items()}
        for landmark in control_landmarks(solved, names, list(views.values()), survey):
            error = float(np.linalg.norm(landmark.model_X - landmark.world_X))
            distance = float(np.median([np.linalg.norm(C - landmark.world_X) for C in centres.values()]))
            if error > (tolerated := POINT_SHARE * distance + sigma):
                points[landmark.name] = error, tolerated
    if not survey.crs and len(centres) > 1:
        C = np.array([*centres.values()])
        nearest = float(np.median(cKDTree(C).query(C, 2)[0][:, 1]))  # the first neighbour of each is itself
        if not NEAREST_M[0] <= nearest <= NEAREST_M[1]:
            units["nearest"] = nearest, NEAREST_M[nearest > 1]
    return replace(poses, distances_off=distances, points_off=points, units_off=units)
