"""Where the cameras are: poses taken from the calibration."""

from __future__ import annotations

from collections.abc import Mapping

from .types import Camera, Geometry, Pair, Placement, Poses, Rejected, View


def solve_poses(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
) -> Poses | Rejected:
    """Put every camera whose rotation, centre and intrinsics are stated into the world of the calibration.

    Parameters
    ----------
    views
        The pinhole of each camera's frame, at working resolution.
    placements
        R and C as the site states them, where it does.
    geometries
        Two-view geometry of the pairs; not needed while poses come from the calibration.
    """
    cameras: dict[str, Camera] = {}
    unsolved: dict[str, str] = {}
    for name, view in views.items():
        stated = placements.get(name, Placement())
        if stated.R is None or stated.C is None:
            unsolved[name] = "no pose given"
        elif view.K is None:
            unsolved[name] = "no intrinsics given"
        else:
            cameras[name] = Camera(view.K, stated.R, stated.C, view.width, view.height)
    if not cameras:
        return Rejected("no camera has a pose and intrinsics", {"cameras": float(len(views)), "solved": 0.0})
    return Poses(cameras, unsolved, {}, metric=True, source="calibration")
