"""F of two views whose lenses are unknown, but not arbitrary: refinement with a prior on the intrinsics.

A bare F has seven degrees of freedom, and wrong matches that agree with each other bend it where right matches constrain it
little.  Cameras have square pixels, a principal point near the centre, a plausible focal length, and mostly the same one in both
views.  So F is estimated as that of two cameras with such intrinsics, as far as the matches permit.  If the matches require
implausible intrinsics, F is more likely wrong than the lenses are unusual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from ..core.least_squares import levenberg_marquardt
from ..core.rotations import rotation_matrix, skew
from ..types import Float64s, View
from .refinement import CAUCHY, normal_equations
from .robust import pose_of_fundamental

FOCAL_SIGMA = 0.7
"""Standard deviation of the logarithm of an unknown focal length; its mean is that of one long side."""
GUESS_SIGMA = 0.2
"""Standard deviation of the logarithm of a guessed focal length (from a field of view or EXIF)."""
KNOWN_SIGMA = 0.01
"""Standard deviation of the logarithm of a known focal length."""
RATIO_SIGMA = 0.1
"""Scale of the Cauchy prior on the log ratio of both focal lengths: most pairs share one lens, some do not."""
CENTRE_SIGMA = 0.01
"""Standard deviation of the principal point, as a share of the long side."""
CORRELATION_FACTOR = 2.5
"""Factor by which the noise of the matches is taken to exceed their residuals, because errors of matches are correlated (on
photographs, true errors exceed those expected of independent matches by this factor)."""
MOST_IMPLAUSIBLE = 4.0
"""Largest plausible `implausibility`, two standard deviations: above it, F is more likely bent by wrong matches."""
STARTS = (0.5, 0.7, 1.0, 1.4, 2.0)
"""Initial focal lengths of the search, as multiples of the long side, or of the guess if there is one."""
FIRST_STEPS = 5
"""Steps from each start: enough to tell which of them is best."""
LAST_STEPS = 30
"""Most steps from the best start."""


@dataclass(frozen=True)
class TwoCameras:
    """An F and the intrinsics that were estimated with it."""

    F: Float64s
    """(3, 3) of unit norm."""
    K1: Float64s
    K2: Float64s
    """(3, 3) intrinsics of the two views."""
    implausibility: float
    """Deviation of these intrinsics from the prior, in squared standard deviations."""


@dataclass(frozen=True)
class _State:
    """The refined parameters."""

    R: Float64s
    t: Float64s
    """`cam2_R_cam1`, unit `cam2_t_cam1`."""
    lens: Float64s
    """(6,) log f1, log f2, c1 (2), c2 (2), relative to each image's centre, in units of the first image's long side."""


@dataclass(frozen=True)
class _Matches:
    """Matches and the lens prior."""

    x1: Float64s
    x2: Float64s
    """(n, 2) matches relative to each image's centre, in units of the first image's long side."""
    scale: Float64s
    """(n,) factor from distances to units of the loss."""
    mean: Float64s
    sigma: Float64s
    """(6,) mean and standard deviation of the lens prior."""


def refine_with_plausible_intrinsics(
    candidates: Sequence[Float64s], x1: Float64s, x2: Float64s, noise: Float64s, view1: View, view2: View
) -> TwoCameras | None:
    """The two cameras near a candidate F that explain the matches best; None if no candidate yields a pose.

    Maximum a posteriori pose and lenses, by Levenberg-Marquardt over 11 parameters from several focal lengths.

    Parameters
    ----------
    candidates : (3, 3) fundamental matrices to start from.
    x1, x2 : (n, 2) pixels of the matches.
    noise : (n,) standard deviation of each match, pixels.
    view1, view2 : sizes of the frames, and known or guessed intrinsics.
    """
    unit = float(max(view1.width, view1.height))
    T1 = _to_pixels(view1, unit)
    T2 = _to_pixels(view2, unit)
    mean, sigma = _prior_of_both(view1, view2, unit)
    centred_x1 = (x1 - T1[:2, 2]) / unit
    centred_x2 = (x2 - T2[:2, 2]) / unit
    matches = _Matches(centred_x1, centred_x2, unit / (noise * CAUCHY), mean, sigma)

    # 1. A few steps from each candidate and each focal length.
    best: tuple[float, _State] | None = None
    for F, factor in product(candidates, STARTS):
        lens = mean + np.array([np.log(factor), np.log(factor), 0, 0, 0, 0])
        K1, K2 = _intrinsics(lens)
        lens_view1 = View(view1.width, view1.height, T1 @ K1)
        lens_view2 = View(view2.width, view2.height, T2 @ K2)
        pose = pose_of_fundamental(F, x1, x2, lens_view1, lens_view2)
        if pose is None:
            continue
        R, t = pose
        refined = _descend(_State(R, t / np.linalg.norm(t), lens), matches, FIRST_STEPS)
        if best is None or refined[0] < best[0]:
            best = refined
    if best is None:
        return None

    # 2. The best of them to the end, and back to pixels.
    _, state = _descend(best[1], matches, LAST_STEPS)
    K1, K2 = _intrinsics(state.lens)
    F = np.linalg.inv(T2).T @ _fundamental(state) @ np.linalg.inv(T1)
    implausibility = _information(state.lens, mean, sigma)[2]
    return TwoCameras(F / np.linalg.norm(F), T1 @ K1, T2 @ K2, implausibility)


def freedoms(F: Float64s, K1: Float64s, K2: Float64s, view1: View, view2: View) -> tuple[Float64s, Float64s]:
    """Directions (9, 12) in which F = K2^-T E K1^-1 may change, by rotations of either camera (6) and by the lenses (6), and the
    prior information on these parameters (12, 12), in units of the matches' information.

    Parameters
    ----------
    F : (3, 3).
    K1, K2 : (3, 3) intrinsics in pixels.
    view1, view2 : sizes of the frames, and known or guessed intrinsics.
    """
    unit = float(max(view1.width, view1.height))
    T1 = _to_pixels(view1, unit)
    T2 = _to_pixels(view2, unit)
    mean, sigma = _prior_of_both(view1, view2, unit)
    # intrinsics and E in centred coordinates
    L1 = np.linalg.inv(T1) @ K1
    L2 = np.linalg.inv(T2) @ K2
    lens = np.array([np.log(L1[0, 0]), np.log(L2[0, 0]), L1[0, 2], L1[1, 2], L2[0, 2], L2[1, 2]])
    L1_inv = np.linalg.inv(L1)
    L2_inv_T = np.linalg.inv(L2).T
    E = L2.T @ (T2.T @ F @ T1) @ L1

    changes = []
    for axis in np.eye(3):
        changes.append(L2_inv_T @ (skew(axis) @ E) @ L1_inv)  # the second camera turns
        changes.append(L2_inv_T @ (E @ skew(axis)) @ L1_inv)  # the first camera turns
    changes += _changes_by_lenses(E, L1, L2)
    directions = np.linalg.inv(T2).T @ np.stack(changes) @ np.linalg.inv(T1)
    information = np.zeros((12, 12))
    information[6:, 6:] = CORRELATION_FACTOR**2 * _information(lens, mean, sigma)[0]
    return directions.reshape(12, 9).T, information


def _to_pixels(view: View, unit: float) -> Float64s:
    """(3, 3) transform to pixels, from coordinates in units of `unit` relative to the image's centre."""
    return np.array([[unit, 0.0, (view.width - 1) / 2], [0.0, unit, (view.height - 1) / 2], [0.0, 0.0, 1.0]])


def _prior_of_both(view1: View, view2: View, unit: float) -> tuple[Float64s, Float64s]:
    """Mean and standard deviation (6,) of the prior on `_State.lens`."""
    mean1, sigma1 = _prior(view1, unit)
    mean2, sigma2 = _prior(view2, unit)
    # both focal lengths first, then both principal points
    mean = np.concatenate([mean1[:1], mean2[:1], mean1[1:], mean2[1:]])
    sigma = np.concatenate([sigma1[:1], sigma2[:1], sigma1[1:], sigma2[1:]])
    return mean, sigma


def _prior(view: View, unit: float) -> tuple[Float64s, Float64s]:
    """Mean and standard deviation (3,) of the prior on log f, cx, cy."""
    side = max(view.width, view.height)
    if view.K is None:
        centre_sigma = CENTRE_SIGMA * side / unit
        return np.array([np.log(side / unit), 0.0, 0.0]), np.array([FOCAL_SIGMA, centre_sigma, centre_sigma])
    K = np.linalg.inv(_to_pixels(view, unit)) @ view.K
    mean = np.array([np.log(K[0, 0]), K[0, 2], K[1, 2]])
    if view.focal_known:
        centre_sigma = 0.1 * CENTRE_SIGMA * side / unit  # calibrated together with the focal length
        return mean, np.array([KNOWN_SIGMA, centre_sigma, centre_sigma])
    centre_sigma = CENTRE_SIGMA * side / unit
    return mean, np.array([GUESS_SIGMA, centre_sigma, centre_sigma])


def _intrinsics(lens: Float64s) -> tuple[Float64s, Float64s]:
    """(3, 3) intrinsics of both views from `_State.lens`."""
    f1, f2 = np.exp(lens[:2])
    return (
        np.array([[f1, 0.0, lens[2]], [0.0, f1, lens[3]], [0.0, 0.0, 1.0]]),
        np.array([[f2, 0.0, lens[4]], [0.0, f2, lens[5]], [0.0, 0.0, 1.0]]),
    )


def _fundamental(state: _State) -> Float64s:
    """(3, 3) F = K2^-T [t]x R K1^-1."""
    K1, K2 = _intrinsics(state.lens)
    return np.asarray(np.linalg.inv(K2).T @ skew(state.t) @ state.R @ np.linalg.inv(K1), dtype=np.float64)


def _tangents(t: Float64s) -> Float64s:
    """(3, 2) tangent directions of the unit vector t."""
    return np.asarray(np.linalg.svd(t[None])[2][1:].T, dtype=np.float64)


def _directions(state: _State) -> Float64s:
    """(9, 11) derivative of F by a rotation of the second camera (3), by t (2), and by the lenses (6)."""
    K1, K2 = _intrinsics(state.lens)
    K1_inv = np.linalg.inv(K1)
    K2_inv_T = np.linalg.inv(K2).T
    changes = []
    for axis in np.eye(3):
        changes.append(K2_inv_T @ skew(state.t) @ skew(axis) @ state.R @ K1_inv)
    for tangent in _tangents(state.t).T:
        changes.append(K2_inv_T @ skew(tangent) @ state.R @ K1_inv)
    changes += _changes_by_lenses(skew(state.t) @ state.R, K1, K2)
    return np.stack([change.ravel() for change in changes], axis=1)


def _changes_by_lenses(E: Float64s, K1: Float64s, K2: Float64s) -> list[Float64s]:
    """Derivatives (3, 3) of F = K2^-T E K1^-1 by the six parameters of `_State.lens`, in their order."""
    K1_inv = np.linalg.inv(K1)
    K2_inv_T = np.linalg.inv(K2).T
    by_f1, by_x1, by_y1 = (K2_inv_T @ E @ change for change in _lens_changes(K1))
    by_f2, by_x2, by_y2 = (change.T @ E @ K1_inv for change in _lens_changes(K2))
    return [by_f1, by_f2, by_x1, by_y1, by_x2, by_y2]


def _lens_changes(K: Float64s) -> list[Float64s]:
    """Derivatives of K^-1 by log f, cx and cy."""
    f = K[0, 0]
    by_f = np.array([[-1.0, 0.0, K[0, 2]], [0.0, -1.0, K[1, 2]], [0.0, 0.0, 0.0]]) / f
    by_x = np.zeros((3, 3))
    by_x[0, 2] = -1 / f
    by_y = np.zeros((3, 3))
    by_y[1, 2] = -1 / f
    return [by_f, by_x, by_y]


def _information(lens: Float64s, mean: Float64s, sigma: Float64s) -> tuple[Float64s, Float64s, float]:
    """The lens prior as normal equations (6, 6), (6,), and the implausibility of `lens` in squared standard deviations."""
    deviation = (lens - mean) / sigma
    # the Cauchy prior on the ratio of both focal lengths, as one reweighted equation
    ratio = (lens[0] - mean[0] - lens[1] + mean[1]) / RATIO_SIGMA
    direction = np.array([1.0, -1.0, 0, 0, 0, 0]) / RATIO_SIGMA
    weight = 1 / (1 + ratio**2)
    normal = np.diag(sigma**-2.0) + weight * np.outer(direction, direction)
    gradient = deviation / sigma + weight * ratio * direction
    return normal, gradient, float(deviation @ deviation + np.log1p(ratio**2))


def _equations(state: _State, matches: _Matches) -> tuple[float, Float64s, Float64s]:
    """Cost, normal matrix (11, 11) and right side (11,) of the matches and the lens prior together."""
    cost, normal, gradient = normal_equations(_fundamental(state), matches.x1, matches.x2, matches.scale, _directions(state))
    # `normal_equations` counts distances in units of CAUCHY standard deviations of the noise
    match_weight = (CAUCHY / CORRELATION_FACTOR) ** 2
    normal = match_weight * normal
    gradient = match_weight * gradient
    prior_normal, prior_gradient, implausibility = _information(state.lens, matches.mean, matches.sigma)
    normal[5:, 5:] += prior_normal
    gradient[5:] += prior_gradient
    return match_weight * cost + implausibility, normal, gradient


def _descend(state: _State, matches: _Matches, steps: int) -> tuple[float, _State]:
    """Cost and state after at most this many steps of Levenberg-Marquardt."""
    equations = partial(_equations, matches=matches)
    return levenberg_marquardt(state, equations, _stepped, steps=steps, damping=1e-3, least_damping=1e-9, tolerance=1e-5)


def _stepped(state: _State, step: Float64s) -> _State:
    """The state after a step (11,): of the rotation (3), of t along its tangents (2), and of the lenses (6)."""
    t = state.t + _tangents(state.t) @ step[3:5]
    return _State(rotation_matrix(step[:3]) @ state.R, t / np.linalg.norm(t), state.lens + step[5:])
