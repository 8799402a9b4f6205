"""Robust estimation of F, E and homographies from correspondences with outliers; seeded, and accurate to a tenth of a pixel.

F: normalised 7- and 8-point algorithms inside MAGSAC++ (Barath et al., CVPR 2020; OpenCV's USAC), then Cauchy-weighted least
squares on the Sampson distance over F of rank 2 (poselib).  MAGSAC alone leaves up to twice the error.  E: the 5-point algorithm
(Nister, PAMI 2004) inside LO-RANSAC with the same refinement (poselib).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import poselib

from ..core.epipolar import apply_homography, essential_to_fundamental, homogeneous, sampson_distance, unit_norm
from ..core.rotations import nearest_rotation
from ..types import Bools, Camera, Float64s, View

CONFIDENCE = 0.9999
"""Probability of the random samples to include one without outliers; more samples are drawn for a higher one."""
MIN_ITERATIONS = 50
"""Fewest random samples; above it the share of inliers determines their number."""
MAX_ITERATIONS = 20000
"""Most random samples."""
INLIER_FACTOR = 1.5
"""Inlier threshold of the refined model, as a multiple of the given threshold, in Sampson distance."""
MOST_POSED = 500
"""Largest number of matches that enter the decomposition of F into a pose, and the search for a rival pose."""


@dataclass(frozen=True)
class TwoView:
    """A two-view geometry and its inliers."""

    F: Float64s
    """(3, 3) of unit norm."""
    inliers: Bools
    """(n,) which correspondences are inliers."""
    R: Float64s | None = None
    t: Float64s | None = None
    """`cam2_R_cam1` and unit `cam2_t_cam1`, None for a bare F."""


def estimate_fundamental(x1: Float64s, x2: Float64s, threshold_px: float, seed: int) -> TwoView | None:
    """F of (n, 2) correspondences; None if none with 8 inliers is found.

    Parameters
    ----------
    x1, x2 : (n, 2) pixels of the correspondences.
    threshold_px : noise of a correct match; inliers lie within `INLIER_FACTOR` times this, in Sampson distance.
    seed : random seed.
    """
    if len(x1) < 8:
        return None
    try:
        matrix, _ = cv2.findFundamentalMat(x1, x2, _usac(threshold_px, seed, MAX_ITERATIONS))
    except cv2.error:  # degenerate input: repeated or collinear points
        return None
    if matrix is None or matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        return None
    F = unit_norm(np.asarray(matrix, dtype=np.float64))
    for _ in range(2):  # the second time with the inliers of the first
        inliers = supporters(F, x1, x2, threshold_px)
        if inliers.sum() < 8:
            return None
        F = _refined(F, x1[inliers], x2[inliers], threshold_px)
    inliers = supporters(F, x1, x2, threshold_px)
    if inliers.sum() < 8:
        return None
    return TwoView(F, inliers)


def _refined(F: Float64s, x1: Float64s, x2: Float64s, threshold_px: float) -> Float64s:
    """The F of rank 2 near `F` that minimises the Cauchy-weighted Sampson distances."""
    loss = {"loss_type": "CAUCHY", "loss_scale": 0.5 * threshold_px}
    return unit_norm(poselib.refine_fundamental(x1, x2, F, loss)[0])


def estimate_essential(
    x1: Float64s, x2: Float64s, view1: View, view2: View, threshold_px: float, seed: int, max_iterations: int = MAX_ITERATIONS
) -> TwoView | None:
    """Relative pose and its F from known K; None if a K is missing or no pose with 8 inliers is found.

    Parameters
    ----------
    x1, x2 : (n, 2) float64, pixels in images 1 and 2.
    view1, view2 : views with known K.
    threshold_px : noise of a correct match; inliers lie within `INLIER_FACTOR` times this.
    seed : random seed.
    max_iterations : largest number of random samples.
    """
    if len(x1) < 8 or view1.K is None or view2.K is None:
        return None
    options = _lo_ransac(threshold_px, seed, max_iterations)
    pose, _ = poselib.estimate_relative_pose(x1, x2, pinhole(view1), pinhole(view2), options, {})
    t = np.asarray(pose.t, dtype=np.float64)
    if not np.isfinite(t).all() or np.linalg.norm(t) < 1e-12:
        return None
    R = np.asarray(pose.R, dtype=np.float64)
    t = t / np.linalg.norm(t)
    F = essential_to_fundamental(R, t, view1.K, view2.K)
    inliers = supporters(F, x1, x2, threshold_px)
    if inliers.sum() < 8:
        return None
    return TwoView(F, inliers, R, t)


def _lo_ransac(threshold_px: float, seed: int, limit: int) -> dict[str, Any]:
    """Settings of poselib's LO-RANSAC; limit: most random samples."""
    return {
        "max_epipolar_error": INLIER_FACTOR * threshold_px,
        "seed": seed,
        "max_iterations": limit,
        "min_iterations": min(MIN_ITERATIONS, limit),
    }


def estimate_with_one_lens(
    x1: Float64s, x2: Float64s, view1: View, view2: View, threshold_px: float, seed: int
) -> TwoView | None:
    """F of two views with one unknown focal length and centred principal points (six points inside LO-RANSAC, poselib); None if
    none with 8 inliers is found.  It has one degree of freedom less than a bare F, so wrong matches bend it less.

    Parameters
    ----------
    x1, x2 : (n, 2) float64, pixels in images 1 and 2.
    view1, view2 : only their sizes are used; the focal length is the same in units of their long sides.
    threshold_px : noise of a correct match; inliers lie within `INLIER_FACTOR` times this.
    seed : random seed.
    """
    if len(x1) < 8:
        return None
    # poselib's solver wants centred coordinates and one focal length: pixels of image 1, to which image 2 is scaled
    unit1 = float(max(view1.width, view1.height))
    T1 = _from_centred(view1, unit1)
    T2 = _from_centred(view2, unit1)
    centred1 = (x1 - T1[:2, 2]) / T1[0, 0]
    centred2 = (x2 - T2[:2, 2]) / T2[0, 0]
    options = _lo_ransac(threshold_px, seed, MAX_ITERATIONS)
    estimate, _ = poselib.estimate_shared_focal_relative_pose(centred1, centred2, np.zeros(2), options, {})
    f = float(estimate.camera1.focal())
    R = np.asarray(estimate.pose.R)
    t = np.asarray(estimate.pose.t)
    if not np.isfinite([f, *t]).all() or f <= 0 or np.linalg.norm(t) < 1e-12:
        return None
    K = np.diag([f, f, 1.0])
    F = unit_norm(np.linalg.inv(T2).T @ essential_to_fundamental(R, t, K, K) @ np.linalg.inv(T1))
    inliers = supporters(F, x1, x2, threshold_px)
    if inliers.sum() < 8:
        return None
    return TwoView(F, inliers)


def _from_centred(view: View, unit: float) -> Float64s:
    """(3, 3) transform to the pixels of a view, from coordinates relative to its centre in which its long side is `unit`."""
    scale = float(max(view.width, view.height)) / unit
    return np.array([[scale, 0, (view.width - 1) / 2], [0, scale, (view.height - 1) / 2], [0, 0, 1]])


def pose_of_fundamental(F: Float64s, x1: Float64s, x2: Float64s, view1: View, view2: View) -> tuple[Float64s, Float64s] | None:
    """`cam2_R_cam1`, `cam2_t_cam1` nearest to F: of the four decompositions of K2^T F K1, the one with points in front of both.

    Parameters
    ----------
    F : (3, 3).
    x1, x2 : (n, 2) pixels of the correspondences.
    view1, view2 : views; None is returned if a K is missing, or if fewer than 8 points are in front.
    """
    if view1.K is None or view2.K is None:
        return None
    sample = slice(None, None, max(-(-len(x1) // MOST_POSED), 1))  # at most `MOST_POSED`, evenly spread over the rows
    n1 = (homogeneous(x1[sample]) @ np.linalg.inv(view1.K).T)[:, :2]
    n2 = (homogeneous(x2[sample]) @ np.linalg.inv(view2.K).T)[:, :2]
    in_front, R, t, _ = cv2.recoverPose(view2.K.T @ F @ view1.K, n1, n2, np.eye(3))
    if in_front < 8:
        return None
    return np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64).ravel()


def rotation_support(x1: Float64s, x2: Float64s, view1: View, view2: View, R: Float64s, threshold_px: float) -> float:
    """Share of the correspondences that a rotation of the camera alone explains.

    Parameters
    ----------
    x1, x2 : (n, 2) float64, pixels in images 1 and 2.
    view1, view2 : views with known K; the result is 0 if one is missing.
    R : (3, 3) float64, initial rotation.
    threshold_px : largest error of an explained match, in pixels of image 2.
    """
    if view1.K is None or view2.K is None:
        return 0.0
    ray1 = _unit_rows(homogeneous(x1) @ np.linalg.inv(view1.K).T)
    ray2 = _unit_rows(homogeneous(x2) @ np.linalg.inv(view2.K).T)
    tolerance = threshold_px / view2.K[0, 0]
    share = 0.0
    # weighted least squares over rotations: errors beyond the median, or beyond the tolerance if that is larger, count less
    for _ in range(10):
        error = np.linalg.norm(ray2 - ray1 @ R.T, axis=1)
        share = float((error < tolerance).mean())
        weight = 1 / (1 + (error / max(tolerance, float(np.median(error)))) ** 2)
        R = nearest_rotation((ray2 * weight[:, None]).T @ ray1)
    return share


def homography_support(x1: Float64s, x2: Float64s, threshold_px: float, seed: int) -> Bools:
    """(n,) which correspondences the best homography explains, within `INLIER_FACTOR` thresholds in both directions.

    Parameters
    ----------
    x1, x2 : (n, 2) pixels of the correspondences.
    threshold_px : noise of a correct match, pixels.
    seed : random seed.
    """
    no_inliers = np.zeros(len(x1), dtype=bool)
    if len(x1) < 8:
        return no_inliers
    try:
        matrix, _ = cv2.findHomography(x1, x2, _usac(threshold_px, seed, 2000))
    except cv2.error:
        return no_inliers
    if matrix is None or matrix.shape != (3, 3):
        return no_inliers
    H = np.array(matrix, dtype=np.float64)
    if abs(np.linalg.det(H)) < 1e-15:
        return no_inliers
    forward = _transfer_errors(H, x1, x2)
    backward = _transfer_errors(np.linalg.inv(H).astype(np.float64), x2, x1)
    return np.asarray(np.maximum(forward, backward) < INLIER_FACTOR * threshold_px)


def _usac(threshold_px: float, seed: int, iterations: int) -> Any:
    """MAGSAC settings with their own random seed: `cv2.setRNGSeed` does not reach USAC."""
    params = cv2.UsacParams()
    params.randomGeneratorState = seed
    params.threshold = threshold_px
    params.confidence = CONFIDENCE
    params.maxIterations = iterations
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.sampler = cv2.SAMPLING_UNIFORM
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    params.loIterations = 10
    params.loSampleSize = 14
    params.final_polisher = cv2.LSQ_POLISHER
    params.isParallel = False
    return params


def pinhole(view: View | Camera) -> dict[str, Any]:
    """A view or camera with known K in poselib's format."""
    assert view.K is not None
    K = view.K
    params = [float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])]
    return {"model": "PINHOLE", "width": view.width, "height": view.height, "params": params}


def supporters(F: Float64s, x1: Float64s, x2: Float64s, threshold_px: float) -> Bools:
    """(n,) which correspondences lie within `INLIER_FACTOR` thresholds of F, in Sampson distance.

    Parameters
    ----------
    F : (3, 3).
    x1, x2 : (n, 2) pixels of the correspondences.
    threshold_px : noise of a correct match, pixels.
    """
    return np.asarray(np.abs(sampson_distance(F, x1, x2)) < INLIER_FACTOR * threshold_px)


def _transfer_errors(H: Float64s, x1: Float64s, x2: Float64s) -> Float64s:
    """(n,) distance in pixels of x2 from the transformed x1; inf where the homography maps x1 to infinity."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.linalg.norm(apply_homography(H, x1) - x2, axis=1)
    return np.asarray(np.nan_to_num(distance, nan=np.inf), dtype=np.float64)


def _unit_rows(v: Float64s) -> Float64s:
    """The rows of v (n, d), each scaled to unit length."""
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True), dtype=np.float64)
