"""Poses of one camera by robust estimation on rays while its clock is unknown: relative to another camera, or to known places.

Offsets of the clock are tried on a coarse grid, and about the best of them on a fine one.  At each, minimal samples give poses,
and the best of all are kept.  Everything works on unit rays, so that lenses may see more than half of all directions.

References
----------
Fischler & Bolles, Random sample consensus, 1981; Torr & Zisserman, MLESAC, 2000 (truncated squared errors)
Nister, An efficient solution to the five-point relative pose problem, 2004; Ding et al., Revisiting the P3P problem, 2023
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import poselib

from ..core.rotations import angle_between_deg
from ..types import Float64s, Int64s
from .tracks import Clock, Moments, Track, seen_by

MOST_PLACES = 160
"""Number of moments, spread over what both see, that a hypothesis is tested on."""
LEAST_COMMON = 12
"""Fewest moments that two cameras must see at once."""
ERROR_PX = 6.0
"""Observations agree with a hypothesis up to this many pixels."""
COARSE_PX = 24.0
"""What the distance to the nearest offset of the coarse grid may add, pixels."""
FINE_PX = 4.0
"""What the distance to the nearest offset of the fine grid may add, pixels."""
MOST_OFFSETS = 81
"""Largest number of offsets on the coarse grid."""
SAMPLES = 120
"""Minimal samples at each offset."""
MOST_FINE = 3
"""Most offsets of the coarse grid about which a fine one is laid."""
LEAST_FINE = 0.6
"""... if their score is this share of the best one's, or more."""
_CHANCES = 12
"""Parts of the recording by which a clock is shifted to see what pairs reach by chance."""
_KEPT = 3
"""Best hypotheses kept at each offset."""
_OPPOSITE = np.pi
"""Error of what lies behind a camera, radians."""
_SAME_DEG = 3.0
"""Hypotheses at one offset whose rotations and directions differ by less are the same."""


@dataclass(frozen=True)
class Hypothesis:
    """A pose of the camera, and what is added to its clock."""

    score: float
    """Sum of 1 - (error / limit)^2 over the agreeing observations."""
    R: Float64s
    """(3, 3), and t (3,): camera axes are R x + t."""
    t: Float64s
    offset: float
    count: int
    """Number of tested observations."""

    @property
    def C(self) -> Float64s:
        """(3,) centre of the camera."""
        return np.asarray(-self.R.T @ self.t)


def coarse_step(track: Track, most_offset: float) -> float:
    """Distance between offsets of the coarse grid; 0 if only 0 is tried, since nothing moves or the clocks are the same."""
    speeds = _speeds(track)
    if not len(speeds) or most_offset <= 0:
        return 0.0
    # two grid points are apart by twice the slack at the usual speed, and at least by half a frame
    step = max(2 * COARSE_PX / max(float(np.quantile(speeds, 0.7)), 1e-9), 0.5 * track.interval)
    return float(max(step, 2 * most_offset / (MOST_OFFSETS - 1)))


def _offsets(step: float, most_offset: float) -> Float64s:
    """Offsets on a grid about zero, nearest to zero first."""
    steps = int(np.floor(most_offset / step)) if step > 0 else 0
    offsets = step * np.arange(-steps, steps + 1)
    return np.asarray(offsets[np.argsort(np.abs(offsets), kind="stable")])


def _speeds(track: Track) -> Float64s:
    """Pixels per time of the steps in which the thing moves on."""
    rows = np.flatnonzero(track.follows)
    pixels = np.einsum("nij,nj->ni", track.pixels_of[rows], track.ray[rows] - track.ray[rows - 1])
    return np.asarray(np.linalg.norm(pixels, axis=1) / np.maximum(track.time[rows] - track.time[rows - 1], 1e-9))


def pixel_angle(track: Track) -> float:
    """Radians that a pixel of the camera covers, typically."""
    # the norm of the 2 x 2 derivative of a lens that is equal in both directions is sqrt(2) pixels per radian
    pixels = float(np.median(np.linalg.norm(track.pixels_of, axis=(1, 2)))) / 2**0.5
    return 1 / max(pixels, 1e-9)


def relative_poses(
    first: Track, second: Track, clock: Clock, moments: Moments, most_offset: float, rng: np.random.Generator
) -> list[Hypothesis]:
    """Poses of the second camera relative to the first one, whose clock is the common one; best first, baseline 1.

    Parameters
    ----------
    first, second : the tracks.
    clock : of the second camera, to which offsets are added.
    moments : that the first camera sees, (m,).
    most_offset : largest offset that is tried.
    rng : chooses the minimal samples.
    """
    rays = seen_by(first, Clock(), moments).ray
    angle = max(pixel_angle(first), pixel_angle(second))
    return _coarse_to_fine(second, clock, moments, rays, most_offset, rng, (5, poselib.relpose_5pt, _epipolar_errors, angle))


def _epipolar_errors(rays1: Float64s, rays2: Float64s, R: Float64s, t: Float64s) -> Float64s:
    """(h, m) radians between rays and the planes through the other ray and the baseline; large behind a camera."""
    # the sines of the angles
    E = np.cross(t[:, None, :], R.transpose(0, 2, 1)).transpose(0, 2, 1)
    lines2 = np.einsum("hij,mj->hmi", E, rays1)
    lines1 = np.einsum("hij,mi->hmj", E, rays2)
    product = np.einsum("hmi,mi->hm", lines2, rays2)
    norm = np.minimum(np.linalg.norm(lines1, axis=2), np.linalg.norm(lines2, axis=2))
    # in front of both: depths along both rays are positive
    turned = np.einsum("hij,mj->hmi", R, rays1)
    cosine = np.einsum("hmi,mi->hm", turned, rays2)
    a = np.einsum("hi,hmi->hm", t, turned)
    b = np.einsum("hi,mi->hm", t, rays2)
    behind = (b * cosine - a < -1e-3) | (b - a * cosine < -1e-3)
    error = np.abs(product) / np.maximum(norm, 1e-12)
    return np.where(behind, _OPPOSITE, error)


def chance_share(first: Track, second: Track, clock: Clock, moments: Moments, offset: float, rng: np.random.Generator) -> float:
    """Score, as a share of the tested observations, that pairs reach if the second camera saw something else at the time.

    The second clock is shifted by parts of the recording, so that both cameras' tracks stay as they are, but not their relation.

    Parameters
    ----------
    first, second, clock, moments, rng : as in `relative_poses`.
    offset : the one that is to be believed.
    """
    if moments.is_still.all():
        return 0.0
    length = float(np.ptp(second.time))
    shifts = length * np.arange(1, _CHANCES) / _CHANCES
    # each shift in the direction in which more is left
    shifts = np.where(shifts > length / 2, shifts - length, shifts)
    rays = seen_by(first, Clock(), moments).ray
    angle = max(pixel_angle(first), pixel_angle(second))
    grid = (offset - clock.offset + shifts, FINE_PX)
    found = _search(second, clock, moments, rays, grid, rng, (5, poselib.relpose_5pt, _epipolar_errors, angle))
    return max((hypothesis.score / hypothesis.count for hypothesis in found), default=0.0)


def absolute_poses(
    track: Track, clock: Clock, moments: Moments, X: Float64s, most_offset: float, rng: np.random.Generator
) -> list[Hypothesis]:
    """Poses of a camera relative to known places of things, best first.

    Parameters
    ----------
    track : of the camera.
    clock : to which offsets are added.
    moments, X : the moments (m,) and places (m, 3).
    most_offset, rng : as in `relative_poses`.
    """

    def test(places: Float64s, rays: Float64s, R: Float64s, t: Float64s) -> Float64s:
        u = np.einsum("hij,mj->hmi", R, places) + t[:, None, :]
        u /= np.linalg.norm(u, axis=2, keepdims=True)
        return np.asarray(np.linalg.norm(u - rays, axis=2))

    def solve(places: Float64s, rays: Float64s) -> list[poselib.CameraPose]:
        return list(poselib.p3p(rays, places))

    return _coarse_to_fine(track, clock, moments, X, most_offset, rng, (3, solve, test, pixel_angle(track)))


Solver = Callable[[Float64s, Float64s], list[poselib.CameraPose]]
Test = Callable[[Float64s, Float64s, Float64s, Float64s], Float64s]
Method = tuple[int, Solver, Test, float]
"""Size of a sample, its solver, the errors (h, m) of poses in radians, and radians of a pixel."""


def _coarse_to_fine(
    track: Track,
    clock: Clock,
    moments: Moments,
    known: Float64s,
    most_offset: float,
    rng: np.random.Generator,
    method: Method,
) -> list[Hypothesis]:
    """The best poses at offsets on a coarse grid, then on fine ones, best first; known: (m, 3) rays or places of the moments."""
    step = coarse_step(track, most_offset)
    if step == 0:
        return _search(track, clock, moments, known, (np.zeros(1), FINE_PX), rng, method)
    coarse = _search(track, clock, moments, known, (_offsets(step, most_offset), COARSE_PX), rng, method)
    centres: list[float] = []
    for hypothesis in coarse:
        is_good = hypothesis.score >= LEAST_FINE * coarse[0].score
        if is_good and all(abs(hypothesis.offset - other) > 1.5 * step for other in centres):
            centres.append(hypothesis.offset)
    fine = []
    for centre in centres[:MOST_FINE]:
        offsets = centre - clock.offset + _offsets(step * FINE_PX / COARSE_PX, step)
        fine += _search(track, clock, moments, known, (offsets, FINE_PX), rng, method)
    return sorted(fine, key=lambda hypothesis: -hypothesis.score)


def _search(
    track: Track,
    clock: Clock,
    moments: Moments,
    known: Float64s,
    grid: tuple[Float64s, float],
    rng: np.random.Generator,
    method: Method,
) -> list[Hypothesis]:
    """The best poses at each offset of a grid, best first; grid: offsets, and the pixels that a point may be off between them."""
    found = []
    offsets, slack = grid
    for offset in offsets:
        moved = Clock(clock.offset + float(offset), clock.drift, clock.middle)
        seen = seen_by(track, moved, moments)
        rows = np.flatnonzero(seen.valid)
        if len(rows) < LEAST_COMMON:
            continue
        if len(rows) > MOST_PLACES:
            rows = rows[np.linspace(0, len(rows) - 1, MOST_PLACES).round().astype(np.int64)]
        for score, R, t in _best_poses(known[rows], seen.ray[rows], ERROR_PX + slack, rng, method):
            found.append(Hypothesis(score, R, t, moved.offset, len(rows)))
    # of equal ones the first: the one whose offset is nearest to zero
    return sorted(found, key=lambda hypothesis: -hypothesis.score)


def _best_poses(
    known: Float64s, rays: Float64s, limit_px: float, rng: np.random.Generator, method: Method
) -> Iterator[tuple[float, Float64s, Float64s]]:
    """The few best distinct poses at one offset, with their scores."""
    size, solver, test, pixel = method
    # 1. Poses of minimal samples.
    Rs = []
    ts = []
    for rows in _samples(len(rays), size, rng):
        for pose in solver(known[rows], rays[rows]):
            Rs.append(pose.R)
            ts.append(pose.t)
    if not Rs:
        return
    R = np.array(Rs)
    t = np.array(ts)

    # 2. The best ones that differ from each other.
    with np.errstate(invalid="ignore"):
        ratio = np.nan_to_num(test(known, rays, R, t), nan=_OPPOSITE) / (limit_px * pixel)
    scores = np.sum(1 - np.minimum(ratio, 1) ** 2, axis=1)
    kept: list[int] = []
    for k in np.argsort(-scores, kind="stable").tolist():
        if all(_differ(R[k], t[k], R[other], t[other]) for other in kept):
            kept.append(k)
            yield float(scores[k]), R[k], t[k]
        if len(kept) == _KEPT:
            return


def _samples(count: int, size: int, rng: np.random.Generator) -> Iterator[Int64s]:
    """Rows of minimal samples.  Neighbours in time are alike, so that each row is of another stretch of the track."""
    edges = np.linspace(0, count, size + 1)
    shifts = rng.random(SAMPLES)
    shares = rng.random((SAMPLES, size))
    for shift, share in zip(shifts, shares, strict=True):
        places = (edges[:-1] + share * np.diff(edges) + shift * count) % count
        yield places.astype(np.int64)


def _differ(R: Float64s, t: Float64s, other_R: Float64s, other_t: Float64s) -> bool:
    """Are two poses clearly different?"""
    if angle_between_deg(R, other_R) > _SAME_DEG:
        return True
    difference = np.linalg.norm(R.T @ t - other_R.T @ other_t)
    return bool(difference > np.deg2rad(_SAME_DEG) * max(np.linalg.norm(t), 1e-12))
