"""Do stated distances, control points and units agree with the final positions of the cameras?"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from ..core.cameras import camera_id
from ..types import Camera, Float64s, Placement, Poses, Survey, View

DISTANCE_SHARE = 0.03
"""Tolerance of a stated distance: this share of it, plus three standard deviations of the camera positions."""
POINT_SHARE = 0.02
"""Tolerance of a control point: this share of its distance from the cameras, plus three standard deviations of positions."""
NEAREST_LEAST_M = 0.05
"""Smallest plausible median distance from a camera to its nearest neighbour, in metres: two housings are not nearer."""
NEAREST_MOST_M = 1000.0
"""Largest plausible such distance, in metres: no site in local coordinates is more widely spaced."""
SIGMAS = 3.0
"""Standard deviations of the camera positions that a contradiction must exceed."""


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
    position_sigmas = [placements[name].sigma_m for name in cameras if name in placements]
    slack = SIGMAS * max(position_sigmas, default=0.0)
    centres = {camera_id(name, camera): camera.C for name, camera in cameras.items()}
    distances = _distances_off(centres, survey, slack)
    points: dict[str, tuple[float, float]] = {}
    if survey.points:
        points = _points_off(cameras, centres, views, survey, slack)
    units: dict[str, tuple[float, float]] = {}
    if not survey.crs:
        units = _units_off(centres)
    return replace(poses, distances_off=distances, points_off=points, units_off=units)


def _distances_off(centres: Mapping[str, Float64s], survey: Survey, slack: float) -> dict[str, tuple[float, float]]:
    """By pair of cameras: stated distances that their positions contradict, and the measured ones."""
    off = {}
    for i, j, stated in survey.distances:
        a = survey.cameras[i]
        b = survey.cameras[j]
        if a not in centres or b not in centres:
            continue
        measured = float(np.linalg.norm(centres[a] - centres[b]))
        # Both ends are uncertain, hence the square root of two.
        if abs(measured - stated) > DISTANCE_SHARE * min(stated, measured) + np.sqrt(2) * slack:
            off[f"{a}--{b}"] = (stated, measured)
    return off


def _points_off(
    cameras: Mapping[str, Camera], centres: Mapping[str, Float64s], views: Mapping[str, View], survey: Survey, slack: float
) -> dict[str, tuple[float, float]]:
    """By control point: its distance from where the cameras see it, if that exceeds the tolerance, and the tolerance."""
    from .world import control_landmarks  # imported here: few sites have control points, and it loads the pose solver

    names = list(views)
    solved = {names.index(name): camera for name, camera in cameras.items()}
    off = {}
    for landmark in control_landmarks(solved, names, list(views.values()), survey):
        error = float(np.linalg.norm(landmark.model_X - landmark.world_X))
        distance = float(np.median([np.linalg.norm(C - landmark.world_X) for C in centres.values()]))
        tolerated = POINT_SHARE * distance + slack
        if error > tolerated:
            off[landmark.name] = (error, tolerated)
    return off


def _units_off(centres: Mapping[str, Float64s]) -> dict[str, tuple[float, float]]:
    """The median distance to the nearest camera, and the limit that it exceeds, as "nearest"; {} if it is plausible."""
    if len(centres) < 2:
        return {}
    C = np.array(list(centres.values()))
    distances, _ = cKDTree(C).query(C, 2)  # the first neighbour of each is itself
    nearest = float(np.median(distances[:, 1]))
    if nearest < NEAREST_LEAST_M:
        return {"nearest": (nearest, NEAREST_LEAST_M)}
    if nearest > NEAREST_MOST_M:
        return {"nearest": (nearest, NEAREST_MOST_M)}
    return {}
