"""The solution from all observations: growth, adjustment of everything, lenses that disagree, and the two halves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..contracts.reasons import Reason, Rejected
from ..core.rotations import angle_between_deg, nearest_rotation
from ..types import Bools, Float64s, Int64s, Lens
from .adjustment import Adjusted, State, adjust
from .growth import GrownModel, Limits, common_counts, grow
from .hypotheses import LEAST_COMMON
from .lines import sees_a_line
from .tracks import Moments, Track, choose_moments, seen_by
from .uncertainty import Covariances, covariances

MOST_MOMENTS = 6000
"""Most moments of the final adjustment."""
OFFSET_SIGMA_S = 10.0
"""Standard deviation of clocks, seconds: it decides only where the observations say nothing of them."""
DRIFT_SIGMA = 1e-4
"""Standard deviation of a clock's drift, seconds a second."""
LEAST_DRIFT_S = 120.0
"""Drifts are solved if the recording lasts this long, seconds."""
STATED_SIGMA = 0.02
"""Standard deviation of the logarithm of a stated focal length while the model grows."""
HFOV_SIGMA = 0.1
"""The same of a focal length of which only the field of view is stated."""
LENS_SIGMA = 0.05
"""Standard deviation of the logarithm of a stated focal length while lenses are checked."""
LEAST_FOCAL_CHANGE = 0.015
"""Smallest relative change of a stated focal length that is said and used."""
FOCAL_DEVIATIONS = 5.0
"""... if it is at least this many standard deviations."""
LEAST_CHECKED = 3
"""Fewest cameras that can check a lens: of two that see a thing in a plane, focal lengths are hardly determined, and biased."""
BLOCKS = 20
"""Number of stretches into which the recording is cut for the two halves."""


@dataclass(frozen=True)
class Solved:
    """All cameras that could be placed, in one frame of the model."""

    names: tuple[str, ...]
    """Ids of the cameras in the order of the state."""
    tracks: Mapping[str, Track]
    """Of all cameras that have a lens."""
    adjusted: Adjusted
    limits: Limits
    """In the order of `names`."""
    common: Float64s
    """(t, t) moments that two cameras may have seen at once, in the order of `tracks`."""
    nearest: tuple[Int64s, ...]
    """(m,) for each camera the observation nearest to each moment."""
    focal_solved: tuple[str, ...] = ()
    """Cameras whose focal length was solved."""
    of_hfov: tuple[str, ...] = ()
    """Cameras of which only a field of view is stated: their focal length is solved in any case."""


def solve(
    tracks: Mapping[str, Track], still: Bools, lenses: Mapping[str, Lens], unit: float, max_offset_s: float, seed: int
) -> Solved | Rejected:
    """Place all cameras that can be placed.

    Parameters
    ----------
    tracks : by camera.
    still : (things,) bool, things that don't move.
    lenses : by camera.
    unit : units of time in a second.
    max_offset_s : largest offset of a clock, seconds.
    seed : of the random samples.
    """
    names = tuple(tracks)
    if len(names) < 2:
        return Rejected(Reason.ONE_OBSERVING_CAMERA, {"cameras": len(names)})
    every = list(tracks.values())
    common = common_counts(every, still, max_offset_s * unit)
    if common.max() < LEAST_COMMON:
        return Rejected(Reason.NEVER_SEEN_TOGETHER, {"moments": float(common.max()), "needed": LEAST_COMMON})

    lines = sum(sees_a_line(track) for track in every)
    if len(every) - lines < 2:
        return Rejected(Reason.OBSERVED_ON_A_LINE, {"lines": float(lines), "cameras": len(every)})

    # 1. A model of the cameras.
    limits = Limits(
        most_offset=max_offset_s * unit,
        offset_sigma=OFFSET_SIGMA_S * unit,
        drift_sigma=DRIFT_SIGMA if _seconds(every, unit) > LEAST_DRIFT_S else 0.0,
        focal_sigmas=np.array([STATED_SIGMA if lenses[name].hfov_deg is None else HFOV_SIGMA for name in names]),
    )
    model = grow(every, still, limits, common, seed)
    if model is None:
        return Rejected(Reason.OBSERVATIONS_DISAGREE, {"pairs": float((np.triu(common) >= LEAST_COMMON).sum())})
    if model.has_twin and len(model.cameras) == 2:
        return Rejected(Reason.OBSERVED_IN_A_PLANE)
    model = _in_order(model)

    # 2. All observations, with lenses free: which stated focal lengths are clearly off?
    chosen = [every[k] for k in model.cameras]
    placed = tuple(names[k] for k in model.cameras)
    adjusted = model.adjusted
    off = []
    if len(placed) >= LEAST_CHECKED:
        free = replace(limits, focal_sigmas=np.full(len(placed), LENS_SIGMA))
        adjusted = _finally(chosen, still, model, free)
        off = [k for k in _wrong_lenses(chosen, adjusted, free) if lenses[placed[k]].hfov_deg is None]

    # 3. And with the others as stated.
    guessed = [k for k, name in enumerate(placed) if lenses[name].hfov_deg is not None]
    sigmas = np.zeros(len(placed))
    sigmas[off] = np.inf
    sigmas[guessed] = HFOV_SIGMA
    log_focal = np.where(sigmas > 0, adjusted.state.log_focal, 0.0)
    start = replace(adjusted, state=replace(adjusted.state, log_focal=log_focal))
    final_limits = replace(limits, focal_sigmas=sigmas)
    adjusted = _finally(chosen, still, replace(model, adjusted=start), final_limits)
    solved_lenses = tuple(placed[k] for k in sorted({*off, *guessed}))
    nearest = tuple(seen_by(t, c, adjusted.moments).nearest for t, c in zip(chosen, adjusted.state.clocks, strict=True))
    return Solved(placed, tracks, adjusted, final_limits, common, nearest, solved_lenses, tuple(placed[k] for k in guessed))


def _in_order(model: GrownModel) -> GrownModel:
    """The model with its cameras in the order of the observations; the clock of the first is then the common one."""
    state = model.adjusted.state
    order = np.argsort(model.cameras)
    first = state.clocks[order[0]]
    clocks = []
    for k in order:
        clock = state.clocks[k]
        clocks.append(replace(clock, offset=clock.offset - first.offset, drift=clock.drift - first.drift))
    ordered = replace(
        state,
        R=state.R[order],
        C=state.C[order],
        clocks=tuple(clocks),
        log_focal=state.log_focal[order],
        noise=state.noise[order],
    )
    cameras = tuple(model.cameras[k] for k in order)
    return replace(model, cameras=cameras, adjusted=replace(model.adjusted, state=ordered))


def _wrong_lenses(tracks: Sequence[Track], adjusted: Adjusted, limits: Limits) -> list[int]:
    """The cameras whose focal length is clearly off.

    Two halves of the observations show by how much focal lengths vary for reasons that no covariance knows of: a board that
    bends, rows that are exposed one after another, a thing that is tracked at one side.
    """
    spread = covariances(adjusted)
    sigma = np.array([spread.focal_sigma(k) for k in range(len(tracks))])
    half_states = _half_states(tracks, adjusted, limits)
    if half_states is None:
        return []
    difference = half_states[0].log_focal - half_states[1].log_focal
    # a half has twice the variance of the whole, and the difference of two halves four times that
    sigma = sigma * _excess(difference**2 / (4 * sigma**2)) ** 0.5
    limit = np.maximum(LEAST_FOCAL_CHANGE, FOCAL_DEVIATIONS * sigma)
    return [int(k) for k in np.flatnonzero(np.abs(adjusted.state.log_focal) > limit)]


def _excess(squares: Float64s) -> float:
    """Factor of variances, from squares that are 1 on average where these are right; never less than 1."""
    return max(1.0, float(np.mean(squares)))


def _seconds(tracks: Sequence[Track], unit: float) -> float:
    times = np.concatenate([track.time for track in tracks])
    return float(np.ptp(times)) / unit


def _finally(tracks: Sequence[Track], still: Bools, model: GrownModel, limits: Limits) -> Adjusted:
    """The cameras adjusted to all moments, chosen anew after their clocks have moved."""
    adjusted = model.adjusted
    priors = [limits.prior(k, k == 0) for k in range(len(tracks))]
    for _ in range(2):
        moments = choose_moments(tracks, adjusted.state.clocks, still, MOST_MOMENTS)
        state = replace(adjusted.state, X=np.zeros((0, 3)))
        adjusted = adjust(tracks, moments, state, priors, noise=(np.nan,) * 3)
    return adjusted


@dataclass(frozen=True)
class Halves:
    """How the solutions from two halves of the observations agree: alternating stretches of time."""

    distance: float
    """Largest distance of a camera between the two, in the frame of the model."""
    degrees: float
    """Largest angle of a camera between the two."""
    excess: float
    """Factor by which variances of poses are larger than the covariance says, at least 1."""


def halves(solved: Solved, spread: Covariances) -> Halves | None:
    """Solve from two halves; both start from the full solution, with its lenses.  None if a half is too small.

    spread: the covariances of the full solution.
    """
    tracks = [solved.tracks[name] for name in solved.names]
    held = replace(solved.limits, focal_sigmas=np.zeros(len(tracks)))
    half_states = _half_states(tracks, solved.adjusted, held)
    if half_states is None:
        return None
    distances, degrees = _apart(*half_states)
    squares = []
    for k in range(len(tracks)):
        squares.append(distances[k] ** 2 / (4 * float(np.trace(spread.centre(k)))))
        squares.append(np.deg2rad(degrees[k]) ** 2 / (4 * float(np.trace(spread.turn(k)))))
    return Halves(float(distances.max()), float(degrees.max()), _excess(np.array(squares)))


def _half_states(tracks: Sequence[Track], adjusted: Adjusted, limits: Limits) -> tuple[State, State] | None:
    """The solutions from two halves of the moments; None if a camera has too few observations in one of them."""
    moments = adjusted.moments
    priors = [limits.prior(k, k == 0) for k in range(len(tracks))]
    block = _blocks(moments)
    states = []
    for parity in (0, 1):
        rows = np.flatnonzero(block % 2 == parity)
        valid = adjusted.used[:, rows].sum(axis=1)
        if valid.min() < LEAST_COMMON:
            return None
        start = replace(adjusted.state, X=adjusted.state.X[rows])
        states.append(adjust(tracks, moments.take(rows), start, priors, noise=(np.nan,) * 2).state)
    return states[0], states[1]


def _blocks(moments: Moments) -> Int64s:
    """(m,) number of the stretch of time of each moment; things that don't move are dealt out by number."""
    edges = np.quantile(moments.time, np.linspace(0, 1, BLOCKS + 1)[1:-1])
    by_time = np.searchsorted(edges, moments.time)
    return np.where(moments.is_still, moments.thing, by_time)


def _apart(a: State, b: State) -> tuple[Float64s, Float64s]:
    """Distance and angle in degrees of each camera between two solutions, in the frame that brings their cameras closest."""
    R = nearest_rotation(np.einsum("cji,cjk->ik", a.R, b.R))
    a_arm = a.C - a.C.mean(axis=0)
    b_arm = (b.C - b.C.mean(axis=0)) @ R.T
    scale = float(np.sum(a_arm * b_arm) / np.sum(b_arm**2))
    degrees = [angle_between_deg(A, B @ R.T) for A, B in zip(a.R, b.R, strict=True)]
    return np.linalg.norm(a_arm - scale * b_arm, axis=1), np.array(degrees)
