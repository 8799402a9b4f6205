"""Compare two pictures of one camera that do not align near their old positions: was it turned far, moved, or exchanged?

SIFT keypoints (Lowe 2004) are matched over the whole picture.  A homography of a pure rotation, or else a fundamental matrix,
shows whether the pictures have scene content in common at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..types import Bools, Float32s, Float64s, Uint8s
from .image_grid import covered_cells

_LONG_SIDE = 1000
"""Long side of the pictures in which keypoints are detected, pixels: larger ones are reduced."""
_MOST_KEYPOINTS = 2500
"""Keypoints of each picture, the strongest."""
_MOST_RATIO = 0.75
"""A match counts only if its descriptor distance is below this share of the second nearest's."""
_INLIER_PX = 3.0
"""Largest distance of a match that agrees, pixels."""
_FEWEST = 20
"""Fewest matches that must agree with a homography; twice as many with a fundamental matrix."""
_LEAST_SHARE = 0.25
"""Smallest share of the matches that must agree with a homography; twice as much with a fundamental matrix."""
_FEWEST_CELLS = 5
"""Fewest cells of a 6 x 4 grid that must hold the agreeing matches: a clock burnt into the picture covers one or two."""
_DETAILED = 300
"""Pictures with this many keypoints have enough detail for shared content to be found."""


@dataclass(frozen=True)
class GlobalMatch:
    """What two pictures have in common, at any position."""

    keypoints: int
    """Number of keypoints in the second picture."""
    matches: int
    agreeing: int
    """Matches that agree with the best homography or epipolar geometry."""
    turn_deg: float | None
    """Angle of the rotation between them, None if no homography explains the matches."""
    shared: bool
    """Whether both pictures show the same scene."""
    distinct: bool
    """Whether both have enough detail for shared content to be found."""


def search_globally(grey1: Uint8s, grey2: Uint8s, mask1: Bools, mask2: Bools, K: Float64s) -> GlobalMatch:
    """Search for the content of the first picture anywhere in the second.

    Parameters
    ----------
    grey1, grey2 : (h, w) uint8, of the same size.
    mask1, mask2 : (h, w), True where a pixel may be used.
    K : (3, 3) intrinsics of both, pixels.
    """
    scale = min(1.0, _LONG_SIDE / max(grey1.shape))
    xy1, d1 = _keypoints(grey1, mask1, scale)
    xy2, d2 = _keypoints(grey2, mask2, scale)
    distinct = min(len(xy1), len(xy2)) >= _DETAILED
    x1, x2 = _matched(xy1, d1, xy2, d2)
    n = len(x1)
    if n < _FEWEST:
        return GlobalMatch(len(xy2), n, 0, None, False, distinct)
    # 1. Did the camera only turn?
    needed = max(_FEWEST, _LEAST_SHARE * n)
    H, H_inliers = _fit(cv2.findHomography, x1, x2)
    if H is not None and H_inliers.sum() >= needed and _spread(x1[H_inliers], grey1.shape):
        # the homography of a rotation is K R K^-1, up to scale
        rotation = np.linalg.inv(K) @ H @ K
        U, _, Vt = np.linalg.svd(rotation / np.cbrt(np.linalg.det(rotation)))
        R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
        angle = float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1.0, 1.0))))
        return GlobalMatch(len(xy2), n, int(H_inliers.sum()), angle, True, distinct)
    # 2. Else, does it see the same scene from another place?  F has more freedom than H, so it needs twice as many matches.
    F, F_inliers = _fit(cv2.findFundamentalMat, x1, x2)
    has_enough = F is not None and F_inliers.sum() >= 2 * needed
    if has_enough and _spread(x1[F_inliers], grey1.shape):
        return GlobalMatch(len(xy2), n, int(max(H_inliers.sum(), F_inliers.sum())), None, True, distinct)
    return GlobalMatch(len(xy2), n, int(H_inliers.sum()), None, False, distinct)


def _keypoints(grey: Uint8s, mask: Bools, scale: float) -> tuple[Float64s, Float32s]:
    """Positions (n, 2) in pixels of the full picture, and descriptors (n, 128), of keypoints in a picture reduced by `scale`."""
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    allowed = cv2.resize(mask.astype(np.uint8), (small.shape[1], small.shape[0]), interpolation=cv2.INTER_NEAREST)
    # local contrast is equalised, so that night and day give similar keypoints
    equalised = cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(small)
    points, descriptors = cv2.SIFT.create(nfeatures=_MOST_KEYPOINTS).detectAndCompute(equalised, allowed)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    positions = np.array([point.pt for point in points], dtype=np.float64) / scale
    return positions, np.asarray(descriptors, dtype=np.float32)


def _matched(xy1: Float64s, d1: Float32s, xy2: Float64s, d2: Float32s) -> tuple[Float64s, Float64s]:
    """Positions (n, 2) of mutual nearest keypoints that also pass the ratio test from the first picture to the second."""
    if min(len(d1), len(d2)) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    nearest_in_1 = {m.queryIdx: m.trainIdx for m in matcher.match(d2, d1)}
    pairs = []
    for best, next_best in matcher.knnMatch(d1, d2, k=2):
        is_clear = best.distance < _MOST_RATIO * next_best.distance
        if is_clear and nearest_in_1[best.trainIdx] == best.queryIdx:
            pairs.append((best.queryIdx, best.trainIdx))
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return xy1[rows[:, 0]], xy2[rows[:, 1]]


def _fit(estimator: object, x1: Float64s, x2: Float64s) -> tuple[Float64s | None, Bools]:
    """A matrix and the matches that agree with it, by USAC with a fixed seed."""
    settings = cv2.UsacParams()
    settings.threshold = _INLIER_PX
    settings.confidence = 0.999
    settings.maxIterations = 5000
    settings.randomGeneratorState = 0
    assert callable(estimator)
    matrix, mask = estimator(x1, x2, settings)
    if matrix is None or mask is None or matrix.shape != (3, 3):
        return None, np.zeros(len(x1), dtype=bool)
    return np.asarray(matrix, dtype=np.float64), np.asarray(mask).ravel() > 0


def _spread(points: Float64s, shape: tuple[int, ...]) -> bool:
    """Do the points lie in several parts of the picture?"""
    return covered_cells(points, (shape[1], shape[0]), 0.25) >= _FEWEST_CELLS
