"""A model of all cameras, grown from two: relative pose of the two, then camera by camera against the places that they see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..core.rotations import angle_between_deg
from ..types import Bools, Float64s
from .adjustment import DRIFT, FOCAL, OFFSET, SIZE, Adjusted, Prior, State, adjust, triangulate
from .hypotheses import LEAST_COMMON, Hypothesis, absolute_poses, chance_share, relative_poses
from .tracks import Clock, Track, choose_moments, seen_by

MOST_SEEDS = 4
"""Most pairs of cameras that are tried as the first two."""
MOST_STARTS = 5
"""Most hypotheses of a pair that are adjusted."""
GROWTH_MOMENTS = 400
"""Moments that are adjusted while the model grows."""
LEAST_ANGLE_DEG = 1.0
"""Smallest median angle between the rays of two cameras that begin a model."""
LEAST_SHARE = 0.3
"""Smallest share of the moments at which a camera must agree with the others."""
BEYOND_CHANCE = 0.1
"""Two cameras begin a model if they agree on this share of the moments more than two that see different things."""
RIVAL_SHARE = 0.99
"""A model whose score is this share of the best one's fits as well."""
MOST_NOISE_PX = 6.0
"""Cameras whose observations agree only within larger errors are not placed: wrong poses do that, too."""
_ANNEALED = (5.0, 2.0, np.nan, np.nan)
"""Noise in the rounds of an adjustment that starts from a hypothesis; nan: estimated."""


@dataclass(frozen=True)
class Limits:
    """What is known of clocks and lenses beforehand."""

    most_offset: float
    """Largest offset of a clock that is looked for."""
    offset_sigma: float
    drift_sigma: float
    focal_sigmas: Float64s
    """(cameras,) standard deviations of the logarithm of the focal lengths; 0: held."""

    def prior(self, camera: int, is_first: bool) -> Prior:
        """The prior of a camera without a known pose."""
        sigma = np.full(SIZE, np.inf)
        sigma[OFFSET] = 0.0 if is_first else self.offset_sigma
        sigma[DRIFT] = 0.0 if is_first else self.drift_sigma
        sigma[FOCAL] = self.focal_sigmas[camera]
        return Prior(sigma)


@dataclass(frozen=True)
class GrownModel:
    """Cameras in one frame."""

    cameras: tuple[int, ...]
    """Numbers of the tracks, in the order of the states; the clock of the first is the common one."""
    adjusted: Adjusted
    has_twin: bool = False
    """Other poses of the same cameras fit as well: two cameras that see a thing in a plane have two relative poses."""


def common_counts(tracks: Sequence[Track], still: Bools, most_offset: float) -> Float64s:
    """(c, c) moments at which two cameras can have seen a thing at once, if their clocks agree best."""
    counts = np.zeros((len(tracks), len(tracks)))
    for i, j in combinations(range(len(tracks)), 2):
        moments = choose_moments([tracks[i]], [Clock()], still, 300, least_cameras=1)
        share = 0.0
        for offset in np.linspace(0, most_offset, 5):
            for sign in (-1, 1):
                valid = seen_by(tracks[j], Clock(sign * float(offset)), moments).valid
                share = max(share, float(valid.mean()))
        counts[i, j] = counts[j, i] = share * len(np.unique(np.column_stack([tracks[i].thing, tracks[i].row]), axis=0))
    return counts


def grow(tracks: Sequence[Track], still: Bools, limits: Limits, common: Float64s, seed: int) -> GrownModel | None:
    """The best model that any of a few pairs of cameras begins; None if no two cameras have a relative pose.

    Parameters
    ----------
    tracks : of the cameras.
    still : (things,) bool, things that don't move.
    limits : what is known of clocks and lenses.
    common : (c, c) moments that two cameras have in common.
    seed : of the random numbers.
    """
    # 1. Pairs that see much at once come first.
    pairs = [(i, j) for i, j in combinations(range(len(tracks)), 2) if common[i, j] >= LEAST_COMMON]
    pairs.sort(key=lambda pair: -common[pair])
    models: list[GrownModel] = []
    for number, (i, j) in enumerate(pairs[: 3 * MOST_SEEDS]):
        rng = np.random.default_rng((seed, number))
        for start in _seeds(tracks, still, limits, (i, j), rng):
            models.append(_grown(tracks, still, limits, common, start, rng))
        # a model of all cameras that agree is not improved by another beginning
        if models and len(max(models, key=_quality).cameras) == len(tracks):
            break
        if number + 1 >= MOST_SEEDS and models:
            break
    if not models:
        return None
    best = max(models, key=_quality)
    rivals = [other for other in models if _is_rival(other, best)]
    return replace(best, has_twin=bool(rivals))


def _is_rival(model: GrownModel, best: GrownModel) -> bool:
    """Does another model of the same cameras, with other poses, fit as well?"""
    if set(model.cameras[:2]) != set(best.cameras[:2]) or len(model.cameras) != len(best.cameras):
        return False
    return model.adjusted.score > RIVAL_SHARE * best.adjusted.score and not _same(model, best)


def _quality(model: GrownModel) -> tuple[int, float]:
    return len(model.cameras), model.adjusted.score


def _seeds(
    tracks: Sequence[Track], still: Bools, limits: Limits, pair: tuple[int, int], rng: np.random.Generator
) -> list[GrownModel]:
    """Models of two cameras: the best one, and others that fit about as well."""
    first, second = (tracks[k] for k in pair)
    moments = choose_moments([first], [Clock()], still, 600, least_cameras=1)
    clock = Clock(middle=_middle(tracks))
    hypotheses = relative_poses(first, second, clock, moments, limits.most_offset, rng)
    if not hypotheses:
        return []
    best = hypotheses[0]
    by_chance = chance_share(first, second, clock, moments, best.offset, rng)
    if best.score / best.count < by_chance + BEYOND_CHANCE:
        return []

    # The best hypotheses are adjusted; those that end at the same pose count once.
    found: list[GrownModel] = []
    for hypothesis in _distinct(hypotheses, MOST_STARTS):
        clocks = (Clock(middle=clock.middle), replace(clock, offset=hypothesis.offset))
        state = State(
            R=np.array([np.eye(3), hypothesis.R]),
            C=np.array([np.zeros(3), hypothesis.C]),
            clocks=clocks,
            log_focal=np.zeros(2),
            X=np.zeros((0, 3)),
            noise=np.ones(2),
        )
        model = _adjusted(tracks, still, limits, pair, state)
        if model is None or not _is_tied(model):
            continue
        if not any(_same(model, other) for other in found):
            found.append(model)
    found.sort(key=lambda model: -model.adjusted.score)
    return [model for model in found if model.adjusted.score > 0.8 * found[0].adjusted.score][:3]


def _distinct(hypotheses: list[Hypothesis], most: int) -> list[Hypothesis]:
    """The best hypotheses, of which no two are nearly the same."""
    kept: list[Hypothesis] = []
    for hypothesis in hypotheses:
        is_new = all(angle_between_deg(hypothesis.R, other.R) > 6 or
                     np.dot(hypothesis.C, other.C) < 0.98 * np.linalg.norm(hypothesis.C) * np.linalg.norm(other.C)
                     for other in kept)  # fmt: skip
        if is_new:
            kept.append(hypothesis)
        if len(kept) == most:
            break
    return kept


def _same(model: GrownModel, other: GrownModel) -> bool:
    """Do two models of two cameras agree?"""
    turns = []
    directions = []
    for state in (model.adjusted.state, other.adjusted.state):
        turns.append(state.R[1] @ state.R[0].T)
        baseline = state.R[0] @ (state.C[1] - state.C[0])
        directions.append(baseline / np.linalg.norm(baseline))
    return angle_between_deg(turns[0], turns[1]) < 2 and directions[0] @ directions[1] > 0.999


def _middle(tracks: Sequence[Track]) -> float:
    return float(np.mean(np.concatenate([track.time for track in tracks])))


def _adjusted(
    tracks: Sequence[Track], still: Bools, limits: Limits, cameras: Sequence[int], state: State, most: int = GROWTH_MOMENTS
) -> GrownModel | None:
    """The cameras adjusted to moments that are chosen anew; None if too few are left."""
    chosen = [tracks[k] for k in cameras]
    moments = choose_moments(chosen, state.clocks, still, most)
    if len(moments) < LEAST_COMMON:
        return None
    priors = [limits.prior(k, place == 0) for place, k in enumerate(cameras)]
    state = replace(state, X=triangulate(chosen, moments, state))
    adjusted = adjust(chosen, moments, state, priors, noise=_ANNEALED)
    # the two first cameras fix the unit of length
    baseline = np.linalg.norm(adjusted.state.C[1] - adjusted.state.C[0])
    if not np.isfinite(baseline) or baseline <= 0:
        return None
    return GrownModel(tuple(cameras), adjusted)


def _is_tied(model: GrownModel) -> bool:
    """Do the last camera's observations agree with the others, and its rays meet theirs at an angle?"""
    adjusted = model.adjusted
    valid = adjusted.residual.valid[-1] & (adjusted.residual.valid[:-1].any(axis=0))
    used = adjusted.used[-1] & (adjusted.used[:-1].any(axis=0))
    if used.sum() < LEAST_COMMON or used.sum() < LEAST_SHARE * valid.sum():
        return False
    if np.median(adjusted.state.noise[-1] * adjusted.residual.sigma[-1][used]) > MOST_NOISE_PX:
        return False
    return float(np.median(ray_angles_deg(adjusted, len(adjusted.state.C) - 1)[used])) > LEAST_ANGLE_DEG


def ray_angles_deg(adjusted: Adjusted, camera: int) -> Float64s:
    """(m,) largest angle between a camera's ray to a place and the rays of the others that see it, degrees."""
    directions = adjusted.state.X[None] - adjusted.state.C[:, None]
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    cosine = np.einsum("cmi,mi->cm", directions, directions[camera])
    angle = np.rad2deg(np.arccos(np.clip(cosine, -1, 1)))
    angle = np.minimum(angle, 180 - angle)
    angle[~adjusted.used] = 0.0
    return np.asarray(angle.max(axis=0))


def _grown(
    tracks: Sequence[Track], still: Bools, limits: Limits, common: Float64s, model: GrownModel, rng: np.random.Generator
) -> GrownModel:
    """The model with all cameras that can be added to it."""
    # cameras that see most together with those of the model come first; one that fails is tried again after others are added
    missing = [k for k in range(len(tracks)) if k not in model.cameras]
    while missing:
        missing.sort(key=lambda k: (-common[k, list(model.cameras)].max(), k))
        for k in missing:
            hypotheses = _hypotheses(tracks, limits, model, k, rng)
            extended = _extended(tracks, still, limits, model, k, hypotheses)
            if extended is not None:
                model = extended
                missing.remove(k)
                break
        else:
            break
    return model


def _hypotheses(
    tracks: Sequence[Track], limits: Limits, model: GrownModel, camera: int, rng: np.random.Generator
) -> list[Hypothesis]:
    """Poses of another camera against the places of a model."""
    adjusted = model.adjusted
    reliable = (adjusted.used.sum(axis=0) >= 2) & (_angles_of_places(adjusted) > LEAST_ANGLE_DEG)
    if reliable.sum() < LEAST_COMMON:
        return []
    clock = Clock(middle=adjusted.state.clocks[0].middle)
    moments = adjusted.moments.take(reliable)
    return absolute_poses(tracks[camera], clock, moments, adjusted.state.X[reliable], limits.most_offset, rng)


def _angles_of_places(adjusted: Adjusted) -> Float64s:
    """(m,) largest angle between any two rays to a place, degrees."""
    angles = [ray_angles_deg(adjusted, c) * adjusted.used[c] for c in range(len(adjusted.state.C))]
    return np.asarray(np.max(angles, axis=0))


def _extended(
    tracks: Sequence[Track],
    still: Bools,
    limits: Limits,
    model: GrownModel,
    camera: int,
    hypotheses: list[Hypothesis],
) -> GrownModel | None:
    """The model with one more camera, at the best of its hypotheses; None if it does not agree with the others."""
    best: GrownModel | None = None
    state = model.adjusted.state
    for hypothesis in _distinct(hypotheses, 2):
        clock = Clock(hypothesis.offset, 0.0, state.clocks[0].middle)
        start = State(
            R=np.concatenate([state.R, hypothesis.R[None]]),
            C=np.concatenate([state.C, hypothesis.C[None]]),
            clocks=(*state.clocks, clock),
            log_focal=np.append(state.log_focal, 0.0),
            X=np.zeros((0, 3)),
            noise=np.append(state.noise, 1.0),
        )
        extended = _adjusted(tracks, still, limits, (*model.cameras, camera), start)
        if extended is None or not _is_tied(extended):
            continue
        if best is None or extended.adjusted.score > best.adjusted.score:
            best = extended
    return best
