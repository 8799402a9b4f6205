"""Adjustment of cameras, clocks and the places of things to all observations, and how exact the result is.

An observation's residual is the difference between the predicted and the observed ray, in pixels of the captured picture:

    r = s G e(d, q) + (s - 1) a,    e = 2 d / (1 + d . q),    d = R (X - C) / |X - C|

with the observed unit ray q at the camera's own time, G the derivatives of the lens' pixels by the ray, s the factor of the focal
length and a the pixel from the principal point.  e is exact to first order about q, for any lens, and grows without bound towards
the opposite direction, so that a thing behind a camera never fits.  An offset of the clock moves q along the track.

The places are eliminated from the normal equations (Schur's complement).  Weights are those of Geman and McClure, by the
noise of each camera, which is estimated from its residuals and their redundancy.

References
----------
Triggs, McLauchlan, Hartley & Fitzgibbon, Bundle adjustment, a modern synthesis, 2000.
Albl et al., On the two-view geometry of unsynchronized cameras, CVPR 2017.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..core.rotations import rotation_matrix, rotation_vector
from ..types import Bools, Float64s
from .tracks import Clock, Moments, Track, seen_by

SIZE = 9
"""Unknowns of a camera: turn (3), centre (3), offset and drift of its clock, logarithm of its focal length's factor."""
OFFSET = 6
DRIFT = 7
FOCAL = 8
ROBUST = 7.0
"""Residuals of this many standard deviations have a quarter of the weight.  The cost is convex up to 0.58 times this: with less,
many a right pair of rays would be torn apart, one of them placing the thing alone."""
USED = 5.0
"""Observations agree with the poses if their residual is below this many standard deviations."""
_PICTURE_PX = 1000.0
"""Size of the part of a picture where wrong observations lie, pixels."""
LEAST_NOISE_PX = 0.05
"""Smallest standard deviation of an observation's coordinate, pixels."""
MOST_NOISE_PX = 12.0
"""Largest one: with more, observations say nothing."""
MOST_UNEQUAL = 3.0
"""A camera's noise is at most this many times that of all cameras, and at least its reciprocal."""
_LOW = 0.25
"""Share of the smallest residuals that a first estimate of the noise relies on."""
_OF_PAIRS = (0.203, 0.84)
"""Of twice the square of a standard normal variable: this quantile, and the median of the values up to 9."""
_OF_MORE = (0.575, 1.37)
"""The same of the sum of two squared standard normal variables."""
_LEAST_REDUNDANCY = 0.02
"""Smallest redundancy: what is left of the error of an observation that alone places its thing is rounding."""
_TELLING_REDUNDANCY = 0.1
"""Observations with less say nothing about the noise: their thing's place follows them, or they it."""
_STEPS = 10
"""Most steps of Levenberg and Marquardt between two estimates of the noise."""
_MOST_DAMPING = 1e2
"""No step lowers the cost if none with this damping does, as a share of the normal matrix' diagonal."""


@dataclass(frozen=True)
class Prior:
    """What is known of a camera's unknowns besides the observations: values and standard deviations; inf: nothing; 0: held."""

    sigma: Float64s
    """(9,) of turn (radians), centre, offset, drift and focal length's logarithm."""
    R: Float64s = field(default_factory=lambda: np.eye(3))
    C: Float64s = field(default_factory=lambda: np.zeros(3))
    offset: float = 0.0


@dataclass(frozen=True)
class State:
    """The unknowns: cameras and the places of the things."""

    R: Float64s
    """(c, 3, 3) world to camera axes."""
    C: Float64s
    """(c, 3)."""
    clocks: tuple[Clock, ...]
    log_focal: Float64s
    """(c,) logarithm of the factor of the focal length."""
    X: Float64s
    """(m, 3) places at the moments."""
    noise: Float64s
    """(c,) standard deviation of an observation's coordinate, as a multiple of the stated one, or pixels where none is."""


@dataclass(frozen=True)
class Residuals:
    """Residuals of all cameras at all moments, and what they depend on."""

    valid: Bools
    """(c, m) the camera saw the thing."""
    r: Float64s
    """(c, m, 2) in standard deviations as stated; 0 where it did not."""
    by_place: Float64s
    """(c, m, 2, 3) derivatives by the place."""
    by_camera: Float64s
    """(c, m, 2, 9) derivatives by the camera's unknowns."""
    sigma: Float64s
    """(c, m) pixels that r counts: the stated standard deviation, or 1, of an interpolated observation."""

    @property
    def pixels(self) -> Float64s:
        """(c, m) distances in pixels."""
        return np.asarray(self.sigma * np.linalg.norm(self.r, axis=2))


def residuals(tracks: Sequence[Track], moments: Moments, state: State) -> Residuals:
    """Residuals and their derivatives; see the head of this file."""
    rows = [_camera_residuals(track, moments, state, c) for c, track in enumerate(tracks)]
    return Residuals(*(np.array(column) for column in zip(*rows, strict=True)))


def _camera_residuals(
    track: Track, moments: Moments, state: State, c: int
) -> tuple[Bools, Float64s, Float64s, Float64s, Float64s]:
    """The same, of one camera."""
    seen = seen_by(track, state.clocks[c], moments)
    R = state.R[c]
    u = (state.X - state.C[c]) @ R.T
    distance = np.maximum(np.linalg.norm(u, axis=1), 1e-12)
    d = u / distance[:, None]
    q = seen.ray
    scale = np.exp(state.log_focal[c])

    # 1. The residual.  Opposite directions would divide by zero.
    nearness = np.maximum(1 + np.sum(d * q, axis=1), 1e-6)
    G = scale * track.pixels_of[seen.nearest]
    arm = track.arm[seen.nearest]
    Gd = (G @ (d - q)[:, :, None])[:, :, 0]
    r = 2 * Gd / nearness[:, None] + (scale - 1) * arm

    # 2. Derivatives by the direction, by the place, and by what moves the camera.
    by_d = 2 * (G - Gd[:, :, None] * q[:, None, :] / nearness[:, None, None]) / nearness[:, None, None]
    by_u = (by_d - (by_d @ d[:, :, None]) * d[:, None, :]) / distance[:, None, None]
    by_place = by_u @ R
    by_camera = np.zeros((len(moments), 2, SIZE))
    by_camera[:, :, :3] = by_u @ _skews(u).transpose(0, 2, 1)  # R -> exp(w) R moves u by w x u
    by_camera[:, :, 3:6] = -by_place
    # a later offset moves the observed ray back along the track, and the residual forward
    velocity = (G @ seen.velocity[:, :, None])[:, :, 0]
    velocity[moments.is_still] = 0.0
    by_camera[:, :, OFFSET] = velocity
    by_camera[:, :, DRIFT] = velocity * (moments.time - state.clocks[c].middle)[:, None]
    by_camera[:, :, FOCAL] = r + arm

    # 3. In standard deviations.
    sigma = seen.sigma
    r /= sigma[:, None]
    by_place /= sigma[:, None, None]
    by_camera /= sigma[:, None, None]
    unseen = ~seen.valid
    r[unseen] = 0.0
    by_place[unseen] = 0.0
    by_camera[unseen] = 0.0
    return seen.valid, r, by_place, by_camera, sigma


def _skews(u: Float64s) -> Float64s:
    """(m, 3, 3) matrices [u]x."""
    skews = np.zeros((len(u), 3, 3))
    for row, column, k in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        skews[:, row, column] = u[:, k]
        skews[:, column, row] = -u[:, k]
    return skews


def triangulate(tracks: Sequence[Track], moments: Moments, state: State) -> Float64s:
    """(m, 3) places nearest to the rays of the cameras that saw the things: the linear start of the adjustment."""
    normal = np.zeros((len(moments), 3, 3))
    right = np.zeros((len(moments), 3))
    for c, track in enumerate(tracks):
        seen = seen_by(track, state.clocks[c], moments)
        ray = seen.ray @ state.R[c]
        across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
        across[~seen.valid] = 0.0
        normal += across
        right += across @ state.C[c]
    # parallel rays have no nearest place; the small term puts it near the cameras' centre instead
    normal += 1e-9 * np.eye(3)
    right += 1e-9 * state.C.mean(axis=0)
    return np.asarray(np.linalg.solve(normal, right[:, :, None])[:, :, 0])


@dataclass(frozen=True)
class Equations:
    """Normal equations of the cameras, with the places eliminated."""

    normal: Float64s
    """(9 c, 9 c)."""
    gradient: Float64s
    """(9 c,)."""
    place_inverse: Float64s
    """(m, 3, 3) inverse normal matrices of the places."""
    place_gradient: Float64s
    """(m, 3)."""
    coupling: Float64s
    """(9 c, m, 3) mixed terms of cameras and places."""


def equations(residual: Residuals, weight: Float64s) -> Equations:
    """Normal equations for residuals with weights (c, m)."""
    cameras, count = residual.valid.shape
    wJx = weight[:, :, None, None] * residual.by_place
    transposed = wJx.transpose(0, 1, 3, 2)
    V = (transposed @ residual.by_place).sum(axis=0)
    g = (transposed @ residual.r[:, :, :, None]).sum(axis=0)[:, :, 0]
    # directions that a place's rays leave open stay as they are
    trace = np.einsum("mii->m", V)
    inverse = np.linalg.inv(V + (1e-10 * trace + 1e-15)[:, None, None] * np.eye(3))
    mixed = residual.by_camera.transpose(0, 1, 3, 2) @ wJx
    coupling = mixed.transpose(0, 2, 1, 3).reshape(cameras * SIZE, count, 3)
    reduced = (mixed @ inverse).transpose(0, 2, 1, 3).reshape(cameras * SIZE, -1)
    normal = -reduced @ coupling.reshape(cameras * SIZE, -1).T
    gradient = -reduced @ g.ravel()
    for c in range(cameras):
        block = slice(c * SIZE, (c + 1) * SIZE)
        Jc = residual.by_camera[c].reshape(-1, SIZE)
        wJc = np.repeat(weight[c], 2)[:, None] * Jc
        normal[block, block] += wJc.T @ Jc
        gradient[block] += residual.r[c].ravel() @ wJc
    return Equations(0.5 * (normal + normal.T), gradient, inverse, g, coupling)


def redundancy(residual: Residuals, weight: Float64s, place_inverse: Float64s) -> Float64s:
    """(c, m) share of an observation's error that remains in its residual once the place has adapted, 0 to 1."""
    Jx = residual.by_place
    absorbed = weight * np.sum((Jx @ place_inverse) * Jx, axis=(2, 3))
    return np.asarray(np.clip(1 - 0.5 * absorbed, _LEAST_REDUNDANCY, 1.0))


@dataclass(frozen=True)
class Adjusted:
    """The result of an adjustment."""

    state: State
    moments: Moments
    residual: Residuals
    weight: Float64s
    """(c, m) weights of the observations."""
    deviation: Float64s
    """(c, m) residuals in standard deviations, with redundancy; inf where nothing was seen."""
    equations: Equations
    prior_information: Float64s
    """(9 c,) of the priors."""
    is_free: Bools
    """(9 c,) unknowns that are not held."""

    @property
    def has_known_frame(self) -> bool:
        """Do priors of cameras fix the frame?"""
        of_centres = np.reshape(~self.is_free | (self.prior_information > 0), (-1, SIZE))[:, 3]
        return int(of_centres.sum()) >= 2

    @property
    def used(self) -> Bools:
        """(c, m) observations that agree with the poses and with another camera's."""
        agrees = self.residual.valid & (self.deviation < USED)
        return np.asarray(agrees & (agrees.sum(axis=0) >= 2))

    @property
    def score(self) -> float:
        """Logarithm of how much likelier the observations that agree are than places anywhere in a picture."""
        used = self.used
        ratio = np.linalg.norm(self.residual.r, axis=2)[used] / self.state.noise[np.nonzero(used)[0]]
        # what is left of an observation's two coordinates once the place has adapted
        coordinates = 2 * (ratio / np.maximum(self.deviation[used], 1e-12)) ** 2
        sigma = (self.state.noise[:, None] * self.residual.sigma)[used]
        return float(np.sum(coordinates * np.log(_PICTURE_PX / sigma) - 0.5 * ratio**2))


def adjust(
    tracks: Sequence[Track],
    moments: Moments,
    state: State,
    priors: Sequence[Prior],
    *,
    noise: Sequence[float],
) -> Adjusted:
    """Adjust cameras, clocks and places to the observations.

    Parameters
    ----------
    tracks, priors : of the cameras in the order of the state.
    moments : at which they are compared.
    state : where to start; its places are triangulated anew if they are of other moments.
    noise : the noise that each round of steps assumes, in stated standard deviations: large values let observations that are
        still far off take part; nan: it is estimated.
    """
    if len(state.X) != len(moments):
        state = replace(state, X=triangulate(tracks, moments, state))
    sigma = np.array([prior.sigma for prior in priors]).ravel()
    is_free = sigma > 0
    with np.errstate(divide="ignore"):
        information = np.where(is_free, 1 / np.where(is_free, sigma, 1.0) ** 2, 0.0)
    residual = residuals(tracks, moments, state)
    weight = residual.valid.astype(np.float64)
    for value in noise:
        state, scale = _scaled(residual, state, weight, value)
        state, residual = _minimised(tracks, moments, (state, residual), scale, priors, information, is_free)
        weight = _weights(residual, state.noise, scale)
    state, scale = _scaled(residual, state, weight, np.nan)
    weight = _weights(residual, state.noise, scale)
    scale = state.noise[:, None] * np.sqrt(_redundancy_of(residual, weight))
    deviation = np.where(residual.valid, np.linalg.norm(residual.r, axis=2) / scale, np.inf)
    return Adjusted(state, moments, residual, weight, deviation, equations(residual, weight), information, is_free)


def _scaled(residual: Residuals, state: State, weight: Float64s, value: float) -> tuple[State, Float64s]:
    """The state with the noise of each camera, and the standard deviations (c, m) of residuals, which allow for redundancy.

    Parameters
    ----------
    residual : of the state, whose places were adjusted with the former weights.
    state, weight : weights: (c, m) the former ones.
    value : the noise; it is estimated if this is nan.
    """
    redundant = _redundancy_of(residual, weight * residual.valid)
    noise = np.full(len(state.noise), value)
    if np.isnan(value):
        noise = _noise(residual, redundant)
    return replace(state, noise=noise), np.asarray(noise[:, None] * np.sqrt(redundant))


def _weights(residual: Residuals, noise: Float64s, scale: Float64s) -> Float64s:
    """(c, m) weights by Geman and McClure."""
    squared = (residual.r**2).sum(axis=2) / scale**2
    return np.asarray(residual.valid / noise[:, None] ** 2 / (1 + squared / ROBUST**2) ** 2)


def _redundancy_of(residual: Residuals, weight: Float64s) -> Float64s:
    return redundancy(residual, weight, equations(residual, weight).place_inverse)


def _noise(residual: Residuals, redundant: Float64s) -> Float64s:
    """(c,) noise of each camera, if half of its observations or more are right."""
    squared = (residual.r**2).sum(axis=2) / redundant
    says_something = residual.valid & (redundant > _TELLING_REDUNDANCY)
    # of two rays to a place, only the distance between them is left as a residual; of more, both coordinates
    is_pair = np.broadcast_to(residual.valid.sum(axis=0) == 2, says_something.shape)
    pooled = _noise_of(squared, says_something, is_pair)
    if len(squared) == 2:
        # the residuals of two cameras don't say whose errors they are
        return np.full(2, pooled)
    noise = [_noise_of(*of_camera) for of_camera in zip(squared, says_something, is_pair, strict=True)]
    return np.clip(noise, pooled / MOST_UNEQUAL, pooled * MOST_UNEQUAL)


def _noise_of(squared: Float64s, says_something: Bools, is_pair: Bools) -> float:
    """Standard deviation of a coordinate from squared lengths of residuals, of which some are wrong."""
    total = 0.0
    count = 0
    for rows, (low, within) in ((says_something & is_pair, _OF_PAIRS), (says_something & ~is_pair, _OF_MORE)):
        values = squared[rows]
        if not len(values):
            continue
        # a low quantile, which wrong observations hardly touch, then the median of those that agree with it
        variance = np.quantile(values, _LOW) / low
        for _ in range(3):
            variance = np.median(values[values <= 9 * variance]) / within
        total += float(variance) * len(values)
        count += len(values)
    if not count:
        return MOST_NOISE_PX
    return float(np.clip(np.sqrt(total / count), LEAST_NOISE_PX, MOST_NOISE_PX))


def _minimised(
    tracks: Sequence[Track],
    moments: Moments,
    start: tuple[State, Residuals],
    scale: Float64s,
    priors: Sequence[Prior],
    information: Float64s,
    is_free: Bools,
) -> tuple[State, Residuals]:
    """The state after a few steps that lower the cost."""
    damping = 1e-4
    state, residual = start
    cost = _cost(residual, scale, state, priors, information)
    free = np.flatnonzero(is_free)
    for _ in range(_STEPS):
        system = equations(residual, _weights(residual, state.noise, scale))
        normal = system.normal + np.diag(information)
        gradient = system.gradient + information * _prior_deviation(state, priors)
        # steps that do not lower the cost are tried again with more damping
        while damping <= _MOST_DAMPING:
            diagonal = np.diag(normal)[free]
            damped = normal[np.ix_(free, free)] + damping * np.diag(diagonal + 1e-9 * diagonal.max())
            step = np.zeros(len(is_free))
            step[free] = np.linalg.solve(damped, -gradient[free])
            # the places follow the cameras
            right = system.place_gradient + np.tensordot(step, system.coupling, axes=1)
            moved = _moved(state, step, -(system.place_inverse @ right[:, :, None])[:, :, 0])
            new_residual = residuals(tracks, moments, moved)
            new_cost = _cost(new_residual, scale, moved, priors, information)
            if new_cost < cost:
                break
            damping *= 10
        else:
            break
        decrease = cost - new_cost
        state = moved
        residual = new_residual
        cost = new_cost
        damping = max(damping / 10, 1e-10)
        if decrease < 1e-6 * cost:
            break
    return state, residual


def _cost(residual: Residuals, scale: Float64s, state: State, priors: Sequence[Prior], information: Float64s) -> float:
    """Geman and McClure's cost of the residuals, and the squared deviations from the priors, for each valid observation."""
    squared = (residual.r**2).sum(axis=2) / scale**2
    total = float(np.sum(scale**2 / state.noise[:, None] ** 2 * squared / (1 + squared / ROBUST**2)))
    total += float(information @ _prior_deviation(state, priors) ** 2)
    # a clock that moves to where less is seen must not look better for it
    return total / max(int(residual.valid.sum()), 1)


def _prior_deviation(state: State, priors: Sequence[Prior]) -> Float64s:
    """(9 c,) differences of the unknowns from their priors."""
    rows = []
    for c, prior in enumerate(priors):
        turn = np.zeros(3)
        if np.isfinite(prior.sigma[0]):
            turn = rotation_vector(state.R[c] @ prior.R.T)
        clock = state.clocks[c]
        rows.append(np.concatenate([turn, state.C[c] - prior.C, [clock.offset - prior.offset, clock.drift, state.log_focal[c]]]))
    return np.concatenate(rows)


def _moved(state: State, step: Float64s, places: Float64s) -> State:
    """The state after a step of the cameras (9 c,) and places (m, 3)."""
    R = []
    clocks = []
    steps = step.reshape(-1, SIZE)
    for c, of_camera in enumerate(steps):
        R.append(rotation_matrix(of_camera[:3]) @ state.R[c])
        clock = state.clocks[c]
        clocks.append(replace(clock, offset=clock.offset + of_camera[OFFSET], drift=clock.drift + of_camera[DRIFT]))
    C = state.C + steps[:, 3:6]
    return replace(
        state, R=np.array(R), C=C, clocks=tuple(clocks), log_focal=state.log_focal + steps[:, FOCAL], X=state.X + places
    )
