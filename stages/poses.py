"""Where the cameras are: taken from the calibration, solved from the pairs' geometries, or both at once.

Solved: rotations of all pairs are compared and contradictions dropped; what is left is grown into models view by view, with
bundle adjustment; each model is put into the world by whatever is known of it.  Known poses then stay where they are, unless the
images contradict them: a wrong one is named and solved like an unknown one.
"""

from __future__ import annotations

from collections.abc import Mapping

from .epipolar import camera_of
from .types import Camera, Frame, Geometry, Pair, Placement, Poses, Rejected, Survey, View


def solve_poses(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    geometries: Mapping[Pair, Geometry],
    survey: Survey | None = None,
    frames: Mapping[str, Frame] | None = None,
    *,
    max_rotation_error_deg: float = 4.0,
    max_epipolar_px: float = 2.0,
) -> Poses | Rejected:
    """Put the cameras into one world.

    Parameters
    ----------
    views
        The pinhole of each camera's frame, at working resolution.
    placements
        R and C as the site states them, where it does.
    geometries
        Two-view geometry of the pairs; not looked at where all poses and intrinsics are stated.
    survey
        Known distances and control points.
    frames
        Pixels of all cameras, to sharpen what the poses rest on; without them the keypoints stay where they were found.
    max_rotation_error_deg
        A pair whose relative rotation is farther than this from what the other pairs agree on is dropped, in degrees.
    max_epipolar_px
        So is a pair whose inliers lie farther than this from the epipolar lines of the solved cameras (median), in pixels.

    Returns
    -------
    Poses, or Rejected where not even two cameras can be placed.
    """
    if len(views) < 2:
        return Rejected("one camera makes no cloud: two or more that see the same things are needed", {"cameras": len(views)})
    stated = stated_cameras(views, placements)
    exact = [name for name in stated if placements[name].sigma_m == 0]
    if len(exact) == len(views) or not geometries:
        return _as_stated(views, placements, stated, survey or Survey())
    # here, so that a night whose poses are all known does not wait for what solves poses
    from .sfm.solve import solve_from_pairs

    args = views, placements, geometries, survey or Survey(), stated
    found = solve_from_pairs(*args, frames or {}, max_rotation_error_deg, max_epipolar_px)
    return (
        _as_stated(views, placements, stated, survey or Survey()) if isinstance(found, Rejected) and len(stated) >= 2 else found
    )


def stated_cameras(views: Mapping[str, View], placements: Mapping[str, Placement]) -> dict[str, Camera]:
    """The cameras whose intrinsics and pose are both known."""
    found = {}
    for name, view in views.items():
        stated = placements.get(name, Placement())
        if view.K is not None and view.focal_known and stated.R is not None and stated.C is not None:
            found[name] = camera_of(view, view.K, stated.R, stated.C)
    return found


def _as_stated(
    views: Mapping[str, View], placements: Mapping[str, Placement], stated: dict[str, Camera], survey: Survey
) -> Poses | Rejected:
    """No image has a say."""
    unsolved = {}
    for name, view in views.items():
        if name not in stated:
            lacks_lens = view.K is None or not view.focal_known
            unsolved[name] = ("no intrinsics" if lacks_lens else "no pose") + " given, and no pair to solve it from"
    if not stated:
        return Rejected("no camera has a pose and intrinsics", {"cameras": float(len(views)), "solved": 0.0})
    metric = all(placements[name].metric for name in stated)
    scale = "calibration" if metric else "calibration, not metric"
    return Poses(stated, unsolved, {}, metric, "calibration", components=(tuple(stated),), scale=scale, crs=survey.crs)
