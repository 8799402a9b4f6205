"""From the arbitrary frame and scale of a solved model to the world: known positions, poses, control points, distances.

All that is known is compared with the solved model at once, and what contradicts the rest is named instead of bending it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np

from ..core.rotations import angle_between_deg, nearest_rotation
from ..core.similarity import Similarity, with_rotation
from ..types import Camera, Float64s

TOLERANCE = 0.01
"""A known position may be off by this share of the scene's distance, and three standard deviations, before it is doubted."""
TOLERANCE_DEG = 1.5
"""A known rotation may be off by so much."""
UP_WEIGHT = 1e-7
"""Weight of "cameras stand upright" against what is known exactly: it decides only what nothing else does."""
MOST_TRIALS = 3000


@dataclass(frozen=True)
class Landmark:
    """A place that is known both in the model and in the world: a camera, or a control point."""

    name: str
    model_X: Float64s
    world_X: Float64s
    """(3,)."""
    model_R: Float64s | None = None
    world_R: Float64s | None = None
    """(3, 3) world to camera axes, for a camera whose rotation is known too."""
    sigma: float = 0.0
    """Standard deviation of world_X, 0 where it is exact."""


@dataclass(frozen=True)
class Alignment:
    """How a model is brought into the world."""

    similarity: Similarity
    """Model to world."""
    trusted: tuple[str, ...]
    """Names of the landmarks it rests on."""
    doubted: Mapping[str, tuple[float, float]]
    """How far off the others seem, by name: (length in the world, degrees or nan)."""


def align(landmarks: Sequence[Landmark], up: Float64s, depth: float, scale: float | None = None) -> Alignment | None:
    """The similarity that most landmarks agree on.

    Parameters
    ----------
    landmarks : at least two; one is enough where `scale` is given.
    up : (3,) the direction in the model that is +z in the world as far as nothing else says so.
    depth : median distance of the scene from its cameras, in the model.
    scale : where it is known otherwise.

    Returns
    -------
    Alignment, or None where the landmarks leave the scale open (one only, or all at one place).
    """
    best: tuple[tuple[int, float], Similarity] | None = None
    for subset in _subsets(landmarks, scale):
        similarity = fit_similarity(subset, up, scale)
        if similarity is None:
            continue
        errors = [_error(similarity, landmark, depth) for landmark in landmarks]
        rank = (sum(e <= 1 for e in errors), -float(np.sum(np.minimum(errors, 1))))
        if best is None or rank > best[0]:
            best = rank, similarity
    if best is None:
        return None
    similarity = best[1]
    for _ in range(3):
        trusted = [landmark for landmark in landmarks if _error(similarity, landmark, depth) <= 1]
        better = fit_similarity(trusted, up, scale) if trusted else None
        if better is None:
            break
        similarity = better
    trusted_names = tuple(landmark.name for landmark in landmarks if _error(similarity, landmark, depth) <= 1)
    doubted = {mark.name: _off(similarity, mark) for mark in landmarks if mark.name not in trusted_names}
    return Alignment(similarity, trusted_names, doubted)


def fit_similarity(landmarks: Sequence[Landmark], up: Float64s, scale: float | None = None) -> Similarity | None:
    """Least squares over landmarks (Wahba's problem over baselines and known rotations, solved by SVD); None without a scale."""
    weight = _weights(landmarks)
    source = np.array([landmark.model_X for landmark in landmarks])
    target = np.array([landmark.world_X for landmark in landmarks])
    a_mean, b_mean = weight @ source, weight @ target
    a, b = source - a_mean, target - b_mean
    spread_a, spread_b = np.sqrt(weight @ (a**2).sum(1)), np.sqrt(weight @ (b**2).sum(1))
    size = np.abs(b_mean).max() + np.abs(a_mean).max() + 1e-300
    wide = spread_a > 1e-12 * size and spread_b > 1e-12 * size
    if not wide and scale is None:
        return None
    noise = np.mean([landmark.sigma**2 for landmark in landmarks]) / spread_b**2 if wide else 0.0
    M = (UP_WEIGHT + noise) * np.outer([0.0, 0.0, 1.0], up)
    if wide:
        M += np.einsum("n,ni,nj->ij", weight, b, a) / (spread_a * spread_b)
    turned = [mark.world_R.T @ mark.model_R for mark in landmarks if mark.world_R is not None and mark.model_R is not None]
    if turned:
        M += np.mean(turned, axis=0)
    return with_rotation(nearest_rotation(M), source, target, weight, scale)


def upward(cameras: Sequence[Camera]) -> Float64s:
    """(3,) the direction that is most likely up: cameras are hung level, so their x axes are horizontal and their y axes point
    down."""
    x = np.array([camera.R[0] for camera in cameras])
    down = np.mean([camera.R[1] for camera in cameras], axis=0)
    down /= np.linalg.norm(down) + 1e-300
    _, vectors = np.linalg.eigh(x.T @ x / len(x) - 0.1 * np.outer(down, down))
    up = vectors[:, 0]
    return np.asarray(-up if up @ down > 0 else up, dtype=np.float64)


def _weights(landmarks: Sequence[Landmark]) -> Float64s:
    """(n,) inverse variances that sum to one; exact landmarks count as a tenth of the smallest standard deviation."""
    sigmas = np.array([landmark.sigma for landmark in landmarks])
    stated = sigmas[sigmas > 0]
    sigmas = np.where(sigmas > 0, sigmas, 0.1 * stated.min() if len(stated) else 1.0)
    weight = 1 / sigmas**2
    return np.asarray(weight / weight.sum(), dtype=np.float64)


def _subsets(landmarks: Sequence[Landmark], scale: float | None) -> list[Sequence[Landmark]]:
    """The smallest sets that fix a similarity, and all landmarks together: first, so that it wins where nothing contradicts."""
    turned = [landmark for landmark in landmarks if landmark.world_R is not None]
    subsets: list[Sequence[Landmark]] = [landmarks]
    if scale is not None:
        subsets += [[landmark] for landmark in turned]
    subsets += islice((pair for pair in combinations(landmarks, 2) if any(m.world_R is not None for m in pair)), MOST_TRIALS)
    subsets += islice(combinations(landmarks, 3), MOST_TRIALS)
    return [subset for subset in subsets if subset]


def _error(similarity: Similarity, landmark: Landmark, depth: float) -> float:
    """How far off a landmark is, as a share of what is tolerated."""
    length, degrees = _off(similarity, landmark)
    tolerated = 3 * landmark.sigma + TOLERANCE * depth * similarity.scale
    return max(length / tolerated, 0.0 if np.isnan(degrees) else degrees / TOLERANCE_DEG)


def _off(similarity: Similarity, landmark: Landmark) -> tuple[float, float]:
    """How far a landmark is from where the model has it: length, degrees (nan where its rotation is unknown)."""
    length = float(np.linalg.norm(similarity.points(landmark.model_X[None])[0] - landmark.world_X))
    if landmark.model_R is None or landmark.world_R is None:
        return length, float("nan")
    return length, angle_between_deg(landmark.model_R @ similarity.R.T, landmark.world_R)
