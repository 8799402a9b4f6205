"""Final refinement of F, or of E for known lenses, with matches weighted by the localisation accuracy of their keypoints.

A keypoint's error grows with its size: in photographs and renderings alike, the largest eighth has three times the error of the
smallest.  Least squares with equal weights would be dominated by the least accurate.  Reference: Zeisl et al., Estimation of
location uncertainty for scale invariant feature points, BMVC 2009.
"""

from __future__ import annotations

import numpy as np

from ..core.epipolar import epipoles, sampson_distance, unit_norm
from ..core.jit import kernel
from ..core.least_squares import Equations, levenberg_marquardt
from ..core.rotations import skew
from ..types import Float64s

Intrinsics = tuple[Float64s, Float64s]
"""K1 and K2, (3, 3) each."""

CAUCHY = 1.5
"""Residual, in standard deviations, at which the weight of a match is halved."""
LEAST_NOISE_PX = 0.02
"""Smallest noise of a match with a keypoint of median size, pixels: exact matches would have infinite weight."""
ITERATIONS = 12
"""Most steps of a descent."""
_GENERATORS = np.stack([skew(axis) for axis in np.eye(3)])
"""(3, 3, 3) generators of small rotations about each axis."""


def noise_px(F: Float64s, x1: Float64s, x2: Float64s, size: Float64s) -> Float64s:
    """(n,) standard deviation in pixels of each match's distance to F: proportional to `size` (n,), scaled to the residuals.

    Parameters
    ----------
    F : (3, 3).
    x1, x2 : (n, 2) pixels of the matches.
    size : (n,) size of the coarser keypoint of each match, in any unit.
    """
    # 1.4826: from the median absolute value to the standard deviation of a normal distribution
    ratio = 1.4826 * float(np.median(np.abs(sampson_distance(F, x1, x2)) / size))
    return np.asarray(size * max(ratio, LEAST_NOISE_PX / float(np.median(size))), dtype=np.float64)


def refine_two_view(
    F: Float64s, x1: Float64s, x2: Float64s, size: Float64s, intrinsics: Intrinsics | None = None
) -> tuple[Float64s, Float64s]:
    """F of unit norm near `F` that fits the matches best, and the standard deviation (n,) in pixels of their distances.

    Minimises Cauchy-weighted Sampson distances over seven degrees of freedom (five for known lenses) by Levenberg-Marquardt; the
    noise is estimated twice.

    Parameters
    ----------
    F : (3, 3), initial value.
    x1, x2 : (n, 2) pixels of the matches.
    size : (n,) size of the coarser keypoint of each match, in any unit.
    intrinsics : K1, K2; if given, F = K2^-T E K1^-1 throughout.
    """
    # normalised coordinates within -1 to 1, in which the entries of F are of similar size (Hartley 1997)
    half = max(float(np.abs(np.concatenate([x1, x2])).max()) / 2, 1.0)
    N = np.array([[1 / half, 0.0, -1.0], [0.0, 1 / half, -1.0], [0.0, 0.0, 1.0]])
    N_inverse = np.linalg.inv(N)
    lenses = None if intrinsics is None else (N @ intrinsics[0], N @ intrinsics[1])
    for _ in range(2):
        scale = half / noise_px(F, x1, x2, size)
        initial = unit_norm(N_inverse.T @ F @ N_inverse)
        normalised_F = _descend(initial, x1 / half - 1, x2 / half - 1, scale / CAUCHY, lenses)
        F = unit_norm(N.T @ normalised_F @ N)
    return F, noise_px(F, x1, x2, size)


def _descend(F: Float64s, x1: Float64s, x2: Float64s, scale: Float64s, lenses: Intrinsics | None) -> Float64s:
    """F that minimises the distances in normalised coordinates; scale: (n,) factor from distances to units of the loss."""

    def equations(state: tuple[Float64s, Float64s]) -> Equations:
        return normal_equations(state[0], x1, x2, scale, state[1])

    def stepped(state: tuple[Float64s, Float64s], step: Float64s) -> tuple[Float64s, Float64s]:
        F = _nearest(state[0] + (state[1] @ step).reshape(3, 3), lenses)
        return F, tangent(F, lenses)

    F = _nearest(F, lenses)
    _, (F, _) = levenberg_marquardt(
        *((F, tangent(F, lenses)), equations, stepped),
        steps=ITERATIONS,
        damping=1e-4,
        most_damping=1e3,
        floor=1e-12,
        relative_tolerance=1e-7,
    )
    return F


def _nearest(F: Float64s, lenses: Intrinsics | None) -> Float64s:
    """The matrix of unit norm nearest to F that has rank 2 or, for known lenses, yields an E with two equal singular values."""
    if lenses is None:
        U, s, Vt = np.linalg.svd(F)
        return unit_norm((U[:, :2] * s[:2]) @ Vt[:2])
    K1, K2 = lenses
    U, _, Vt = np.linalg.svd(K2.T @ F @ K1)
    return unit_norm(np.linalg.inv(K2).T @ U[:, :2] @ Vt[:2] @ np.linalg.inv(K1))


def tangent(F: Float64s, lenses: Intrinsics | None) -> Float64s:
    """Orthonormal directions (9, k) in which F may change while it keeps its norm and its rank, or remains that of an E."""
    if lenses is None:
        e1, e2 = epipoles(F)  # no change along F itself, nor along e2 e1^T
        return np.asarray(np.linalg.svd(np.stack([F.ravel(), np.outer(e2, e1).ravel()]))[2][2:].T, dtype=np.float64)
    K1, K2 = lenses
    E = K2.T @ F @ K1
    rotations = np.concatenate([_GENERATORS @ E, E @ _GENERATORS])  # rotations of either camera about an axis
    changes = (np.linalg.inv(K2).T @ rotations @ np.linalg.inv(K1)).reshape(6, 9)
    changes = changes - np.outer(changes @ F.ravel(), F.ravel())
    return np.asarray(np.linalg.svd(changes, full_matrices=False)[2][:5].T, dtype=np.float64)


@kernel
def normal_equations(
    F: Float64s, x1: Float64s, x2: Float64s, scale: Float64s, directions: Float64s
) -> tuple[float, Float64s, Float64s]:
    """Sum of log(1 + r^2) over the scaled Sampson distances r, and weighted normal equations for steps along `directions`.

    Parameters
    ----------
    F : (3, 3).
    x1, x2 : (n, 2) of the matches.
    scale : (n,) factor from distances to units of the loss.
    directions : (9, k) in which F may change.
    """
    k = directions.shape[1]
    cost = 0.0
    normal = np.zeros((k, k))
    gradient = np.zeros(k)
    by_F = np.empty(9)
    change = np.empty(k)
    for n in range(len(x1)):
        u1 = x1[n, 0]
        v1 = x1[n, 1]
        u2 = x2[n, 0]
        v2 = x2[n, 1]
        # normals of the epipolar lines: a in image 1 (F^T x2), b in image 2 (F x1)
        ax = u2 * F[0, 0] + v2 * F[1, 0] + F[2, 0]
        ay = u2 * F[0, 1] + v2 * F[1, 1] + F[2, 1]
        bx = F[0, 0] * u1 + F[0, 1] * v1 + F[0, 2]
        by = F[1, 0] * u1 + F[1, 1] * v1 + F[1, 2]
        # Sampson distance: x2^T F x1 over the length of its gradient
        inverse = 1 / np.sqrt(ax * ax + ay * ay + bx * bx + by * by + 1e-30)
        algebraic = u1 * ax + v1 * ay + u2 * F[0, 2] + v2 * F[1, 2] + F[2, 2]
        r = algebraic * inverse * scale[n]
        q = algebraic * inverse * inverse  # accounts for the changing length of the gradient
        # derivative of the distance by each entry of F, row by row
        by_F[0] = u2 * u1 - q * (bx * u1 + u2 * ax)
        by_F[1] = u2 * v1 - q * (bx * v1 + u2 * ay)
        by_F[2] = u2 - q * bx
        by_F[3] = v2 * u1 - q * (by * u1 + v2 * ax)
        by_F[4] = v2 * v1 - q * (by * v1 + v2 * ay)
        by_F[5] = v2 - q * by
        by_F[6] = u1 - q * ax
        by_F[7] = v1 - q * ay
        by_F[8] = 1.0
        for i in range(k):
            total = 0.0
            for j in range(9):
                total += by_F[j] * directions[j, i]
            change[i] = total * inverse * scale[n]
        weight = 1 / (1 + r * r)
        cost += np.log(1 + r * r)
        for i in range(k):
            gradient[i] += weight * r * change[i]
            for j in range(k):
                normal[i, j] += weight * change[i] * change[j]
    return cost, normal, gradient
