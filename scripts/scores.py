"""Scores of results against the truth: clouds, poses, epipolar geometry, and matches against exact depth.

Clouds are compared as in the multi-view benchmarks of Knapitsch et al. (Tanks and Temples, ACM TOG 2017) and Schöps et al.
(ETH3D, CVPR 2017): accuracy (precision) is the share of the reconstruction within tau of the reference, completeness (recall)
the share of the reference within tau of the reconstruction, F their harmonic mean.  The score is strict: every point near the
reference's bounding box counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wbflow_demo.render.reference import count_views
from wbflow_stages.core.cameras import backproject, project
from wbflow_stages.core.epipolar import symmetric_epipolar_distance
from wbflow_stages.core.rotations import Similarity, angle_between_deg, nearest_rotation, with_rotation
from wbflow_stages.types import Bools, Camera, Float32s, Float64s

Points = npt.NDArray[np.floating]


@dataclass(frozen=True)
class CloudScore:
    """How close a cloud is to a reference."""

    tau: Float64s
    """(k,) float64, distance thresholds, in the reference's unit."""
    accuracy: Float64s
    completeness: Float64s
    F: Float64s
    """(k,) float64 each, accuracy, completeness and F (0 to 1) at each tau."""
    accuracy_median: float
    completeness_median: float
    """Median distances from the cloud to the reference, and from the reference to the cloud; nan for an empty cloud."""
    points: int
    reference_points: int
    """Numbers of points compared, after thinning."""


def compare_clouds(
    points: Points, reference: Points, taus: Sequence[float], *, voxel: float = 0.01, margin: float = 0.5
) -> CloudScore:
    """Score a cloud, in the reference's frame and unit.

    Parameters
    ----------
    points, reference : (n, 3) and (m, 3).
    taus : distances at which to score.
    voxel : both clouds are thinned to one mean point per cell of this size, so that density has no weight; 0: no thinning.
    margin : points farther than this outside the reference's bounding box are ignored.

    Raises
    ------
    ValueError
        The reference is empty.
    """
    if not len(reference):
        raise ValueError("the reference has no points")
    low, high = reference.min(axis=0) - margin, reference.max(axis=0) + margin
    inside = ((points >= low) & (points <= high)).all(axis=1)  # nan is not inside
    cloud, truth = voxel_means(points[inside], voxel), voxel_means(reference, voxel)
    to_truth, to_cloud = _nearest(cloud, truth), _nearest(truth, cloud)
    tau = np.asarray(taus, np.float64)
    accuracy = np.array([(to_truth <= t).mean() if len(cloud) else 0.0 for t in tau])
    completeness = np.array([(to_cloud <= t).mean() for t in tau])
    F = 2 * accuracy * completeness / np.maximum(accuracy + completeness, 1e-12)
    medians = [float(np.median(d)) if len(cloud) else float("nan") for d in (to_truth, to_cloud)]
    return CloudScore(tau, accuracy, completeness, F, medians[0], medians[1], len(cloud), len(truth))


def voxel_means(points: Points, size: float) -> Float64s:
    """The mean of the points in each cell of a grid anchored at 0, in the order of the cells; size 0: all points."""
    exact = points.astype(np.float64)
    if size <= 0 or not len(points):
        return exact
    cell = np.floor(exact / size).astype(np.int64)
    cell -= cell.min(axis=0)
    span = cell.max(axis=0) + 1
    key = (cell[:, 2] * span[1] + cell[:, 1]) * span[0] + cell[:, 0]
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    return np.column_stack([np.bincount(inverse, exact[:, k]) / count for k in range(3)])


def _nearest(points: Float64s, others: Float64s) -> Float64s:
    """Distance of each point to the nearest of the others; infinite if there are no others."""
    from scipy.spatial import cKDTree

    if not len(points) or not len(others):
        return np.full(len(points), np.inf)
    return np.asarray(cKDTree(others).query(points, workers=-1)[0], np.float64)


@dataclass(frozen=True)
class PoseErrors:
    """Pose errors of solved cameras against the true ones."""

    cameras: tuple[str, ...]
    """Ids of the compared cameras."""
    rotation_deg: Float64s
    """(n,) angle between orientations."""
    position: Float64s
    """(n,) distance between centres, in the truth's unit."""
    alignment: Similarity | None
    """Alignment that was applied to the estimate before the comparison; None without alignment."""


def similarity_between(source: Float64s, target: Float64s, *, with_scale: bool = True) -> Similarity:
    """The least-squares similarity from (n, 3) points to their counterparts.

    Raises ValueError for fewer than three points, and for points that coincide or lie on a line.

    References
    ----------
    S. Umeyama, Least-squares estimation of transformation parameters between two point patterns, PAMI 1991.
    """
    count = max(len(source), 1)
    weight = np.full(len(source), 1 / count)
    a, b = source - weight @ source, target - weight @ target
    M = b.T @ a / count
    spread = np.linalg.svd(M, compute_uv=False)
    open_turn = len(source) < 3 or spread[1] <= 1e-9 * spread[0]  # `<=`: coinciding points have zero spread
    found = None if open_turn else with_rotation(nearest_rotation(M), source, target, weight, None if with_scale else 1.0)
    if found is None:
        raise ValueError("an alignment needs three points that are not on a line")
    return found


def pose_errors(estimated: Mapping[str, Camera], truth: Mapping[str, Camera], *, aligned: bool = False) -> PoseErrors:
    """Compare the poses of common cameras; `aligned`: after the best similarity of the centres (for poses without scale)."""
    names = tuple(name for name in truth if name in estimated)
    centres = np.array([estimated[n].C for n in names]).reshape(-1, 3)
    true_centres = np.array([truth[n].C for n in names]).reshape(-1, 3)
    moved = similarity_between(centres, true_centres) if aligned else None
    if moved is not None:
        centres = moved.points(centres)
    turn = np.eye(3) if moved is None else moved.R
    rotation = np.array([angle_between_deg(estimated[n].R @ turn.T, truth[n].R) for n in names])
    return PoseErrors(names, rotation, np.linalg.norm(centres - true_centres, axis=1), moved)


def turn_errors_deg(estimated: Mapping[str, Camera], truth: Mapping[str, Camera]) -> Float64s:
    """(n,) angles in degrees between orientations, after the best common rotation of all cameras.

    `pose_errors` takes this rotation from the centres: if these are nearly collinear, their errors rotate all cameras.
    """
    names = [name for name in truth if name in estimated]
    turn = nearest_rotation(np.sum([estimated[n].R.T @ truth[n].R for n in names], axis=0))
    return np.array([angle_between_deg(estimated[n].R @ turn, truth[n].R) for n in names])


def true_correspondences(
    camera1: Camera, depth1: Float32s, camera2: Camera, depth2: Float32s, *, step: int = 8
) -> tuple[Float64s, Float64s]:
    """Pixels x1, x2 (n, 2) of the surface points in image 1 that camera 2 also sees.

    Parameters
    ----------
    camera1, camera2 : the true cameras.
    depth1, depth2 : (h, w) float32, true depths, 0 where unknown.
    step : every `step`-th pixel of image 1 is used, in both directions.
    """
    v, u = np.mgrid[step // 2 : camera1.height : step, step // 2 : camera1.width : step].reshape(2, -1)
    known = depth1[v, u] > 0
    x1 = np.column_stack([u, v])[known].astype(np.float64)
    X = backproject(camera1, x1, depth1[v, u][known].astype(np.float64))
    seen = count_views(X, [camera2], [depth2]) > 0
    return x1[seen], project(camera2, X[seen])[0]


@dataclass(frozen=True)
class EpipolarErrors:
    """Symmetric epipolar distances, in pixels, of true correspondences."""

    mean_px: float
    median_px: float
    p95_px: float
    points: int
    """Number of correspondences."""


def epipolar_errors(F: Float64s, x1: Float64s, x2: Float64s) -> EpipolarErrors:
    """How well F explains true correspondences (see `true_correspondences`).  Raises ValueError if there are none."""
    if not len(x1):
        raise ValueError("there are no true correspondences to judge F by")
    d = symmetric_epipolar_distance(F, x1, x2)
    return EpipolarErrors(float(d.mean()), float(np.median(d)), float(np.percentile(d, 95)), len(d))


def correct_matches(
    x1: Float64s, x2: Float64s, camera1: Camera, depth1: Float32s, camera2: Camera, *, tolerance_px: float = 3.0
) -> Bools:
    """(n,) bool: does the surface point seen at x1 project within `tolerance_px` of x2?  False where depth is unknown.

    A keypoint near a silhouette may belong to either side of it: the best of the four pixels around x1 counts.

    Parameters
    ----------
    x1, x2 : (n, 2) float64, pixels in images 1 and 2.
    camera1, camera2 : the true cameras.
    depth1 : (h, w) float32, true depth in image 1, 0 where unknown.
    tolerance_px : largest distance from x2 in image 2, in pixels.
    """
    best = np.full(len(x1), np.inf)
    for dx in (0, 1):
        for dy in (0, 1):
            u = np.clip(np.floor(x1[:, 0]).astype(np.intp) + dx, 0, camera1.width - 1)
            v = np.clip(np.floor(x1[:, 1]).astype(np.intp) + dy, 0, camera1.height - 1)
            z = depth1[v, u].astype(np.float64)
            x, ahead = project(camera2, backproject(camera1, x1, z))
            distance = np.where((z > 0) & (ahead > 0), np.hypot(*(x - x2).T), np.inf)
            best = np.minimum(best, distance)
    return np.asarray(best <= tolerance_px)
