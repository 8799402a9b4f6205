"""The world of the solved cameras: by poses that are stated, by where the thing was, by lengths, or upright and without scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..core.rotations import Similarity, nearest_rotation, with_rotation
from ..orientation.world import UP_WEIGHT, Landmark, align, upward
from ..types import Bools, Camera, Float64s, Placement, ThingSurvey
from .adjustment import Adjusted
from .tracks import MOST_GAP

LEAST_PLACES = 6
"""Fewest known places of the thing that determine a frame."""
STEP_SHARE = 0.02
"""Steps in which the clock of the survey is first looked for, as a share of the largest offset."""
_GOLDEN = 12
"""Times that the interval of the survey's clock is narrowed."""
_ROUNDS = 8
"""Rounds of robust weights."""


@dataclass(frozen=True)
class WorldFrame:
    """How a model lies in the world."""

    similarity: Similarity
    """Model to world."""
    metric: bool
    scale: str
    """Source of the scale, in words."""
    covariance: Float64s = field(default_factory=lambda: np.zeros((7, 7)))
    """(7, 7) of the frame itself: shift, turn (radians) and relative scale about `centre`."""
    centre: Float64s = field(default_factory=lambda: np.zeros(3))
    """(3,) world."""
    survey_m: float | None = None
    trusted: tuple[str, ...] = ()
    """Cameras whose stated poses agree."""
    notes: tuple[str, ...] = ()


def find_frame(
    names: Sequence[str],
    adjusted: Adjusted,
    placements: Mapping[str, Placement],
    survey: ThingSurvey | None,
    most_offset: float,
) -> WorldFrame:
    """The world frame of a model by the best of what is known.

    Parameters
    ----------
    names : ids of the cameras.
    adjusted : the model.
    placements, survey : what is known of cameras and of the thing.
    most_offset : largest offset of the survey's clock.
    """
    notes: list[str] = []
    up = _up(adjusted)
    frame = _by_cameras(names, adjusted, placements, up)
    if frame is not None:
        return frame
    if survey is not None and len(survey.time):
        frame = _by_places(adjusted, survey, most_offset, up)
        if frame is not None:
            return frame
        notes.append("the survey of the thing does not fit its track: neither frame nor scale are taken from it")
    scale = None if survey is None else scale_of_lengths(adjusted, survey)
    return replace(_own_frame(names, adjusted, placements, up, scale), notes=tuple(notes))


def _up(adjusted: Adjusted) -> Float64s:
    cameras = [Camera(np.eye(3), R, C, 1, 1) for R, C in zip(adjusted.state.R, adjusted.state.C, strict=True)]
    return upward(cameras)


def _by_cameras(names: Sequence[str], adjusted: Adjusted, placements: Mapping[str, Placement], up: Float64s) -> WorldFrame | None:
    """By cameras whose positions are stated: two or more."""
    landmarks = []
    for k, name in enumerate(names):
        placement = placements.get(name)
        if placement is not None and placement.C is not None and placement.metric:
            sigma = placement.sigma_m
            landmarks.append(Landmark(name, adjusted.state.C[k], placement.C, adjusted.state.R[k], placement.R, sigma))
    if len(landmarks) < 2:
        return None
    distances = np.linalg.norm(adjusted.state.X[None] - adjusted.state.C[:, None], axis=2)
    alignment = align(landmarks, up, float(np.median(distances[adjusted.used])))
    if alignment is None or len(alignment.trusted) < 2:
        return None
    notes = []
    for name, (length, degrees) in alignment.deviations.items():
        turn = "" if np.isnan(degrees) else f" and {degrees:.1f} degrees"
        notes.append(f"{name}: its stated pose is {length:.2g} m{turn} off from what the observations say; it is left out")
    scale = f"{len(alignment.trusted)} known positions of cameras"
    return WorldFrame(alignment.similarity, True, scale, trusted=alignment.trusted, notes=tuple(notes))


def _by_places(adjusted: Adjusted, survey: ThingSurvey, most_offset: float, up: Float64s) -> WorldFrame | None:
    """By where the thing was at known times; the survey's clock is found, too."""
    reliable = adjusted.used.sum(axis=0) >= 2
    moves = bool(np.isfinite(survey.time).any())

    def fit(offset: float) -> _Fit | None:
        return _fitted(adjusted, reliable, survey, offset, up)

    offsets = np.zeros(1)
    if moves and most_offset > 0:
        offsets = most_offset * np.arange(-1, 1 + STEP_SHARE, STEP_SHARE)
        offsets = offsets[np.argsort(np.abs(offsets), kind="stable")]
    fits = [(fit(float(offset)), float(offset)) for offset in offsets]
    found = [(f.spread, k) for k, (f, _) in enumerate(fits) if f is not None]
    if not found:
        return None
    best, offset = fits[min(found)[1]]
    # the clock, ever finer
    step = STEP_SHARE * most_offset
    for _ in range(_GOLDEN if len(offsets) > 1 else 0):
        step /= 2
        for candidate in (offset - step, offset + step):
            other = fit(candidate)
            if other is not None and best is not None and other.spread < best.spread:
                best = other
                offset = candidate
    assert best is not None
    scale = f"{best.count} known places of the thing"
    return WorldFrame(best.similarity, True, scale, best.covariance, best.centre, best.median)


@dataclass(frozen=True)
class _Fit:
    """A similarity from the model's places to the survey's."""

    similarity: Similarity
    spread: float
    """Robust measure of the distances, metres."""
    median: float
    """Median distance, metres."""
    count: int
    covariance: Float64s
    centre: Float64s


def _fitted(adjusted: Adjusted, reliable: Bools, survey: ThingSurvey, offset: float, up: Float64s) -> _Fit | None:
    """The similarity that brings the track to the surveyed places, if the survey's clock is off by this."""
    rows, source = _places_at(adjusted, reliable, survey, offset)
    if len(rows) < LEAST_PLACES:
        return None
    target = survey.position[rows]
    sigma = np.nan_to_num(survey.sigma_m[rows], nan=1.0)
    sigma = np.where(sigma > 0, sigma, 1.0)
    origin = np.median(target, axis=0)
    target = target - origin

    # robust weights, from distances of which the median sets the scale
    weight = 1 / sigma**2
    similarity = None
    distance = np.ones(len(rows))
    for _ in range(_ROUNDS):
        similarity = _similarity(source, target, weight / weight.sum(), up)
        if similarity is None:
            return None
        distance = np.linalg.norm(similarity.points(source) - target, axis=1)
        usual = max(float(np.median(distance / sigma)), 1e-9)
        weight = 1 / sigma**2 / (1 + (distance / sigma / (2.5 * usual)) ** 2) ** 2
    assert similarity is not None
    covariance = _frame_covariance(similarity.points(source), target, weight, rows)
    centre = weight @ target / weight.sum()
    usual = float(np.median(distance / sigma))
    kept = np.minimum(distance / sigma, 4 * usual)
    # what few places could be compared at this offset must not win by their number
    spread = float(np.sqrt(np.mean(kept**2))) * np.sqrt(len(survey.time) / len(rows))
    placed = Similarity(similarity.scale, similarity.R, similarity.t + origin)
    return _Fit(placed, spread, float(np.median(distance)), len(rows), covariance, centre + origin)


def _similarity(source: Float64s, target: Float64s, weight: Float64s, up: Float64s) -> Similarity | None:
    """Least squares with weights that sum to one; a turn that the places leave open follows the direction up."""
    a = source - weight @ source
    b = target - weight @ target
    size = np.sqrt((weight @ (a**2).sum(axis=1)) * (weight @ (b**2).sum(axis=1)))
    if size <= 0:
        return None
    M = (b * weight[:, None]).T @ a / size + UP_WEIGHT * np.outer([0.0, 0.0, 1.0], up)
    return with_rotation(nearest_rotation(M), source, target, weight)


def _places_at(adjusted: Adjusted, reliable: Bools, survey: ThingSurvey, offset: float) -> tuple[Float64s, Float64s]:
    """Rows of the survey at which the cameras place the thing, and these places (n, 3) in the model, along its track."""
    moments = adjusted.moments
    found_rows = []
    found = []
    for thing in range(len(survey.things)):
        rows = np.flatnonzero(survey.thing == thing)
        of_thing = np.flatnonzero(reliable & (moments.thing == thing))
        if not len(rows) or not len(of_thing):
            continue
        times = moments.time[of_thing]
        wanted = np.where(np.isfinite(survey.time[rows]), survey.time[rows] + offset, 0.0)
        X = adjusted.state.X[of_thing]
        places = np.column_stack([np.interp(wanted, times, column) for column in X.T])
        # only where the track is not interrupted
        after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
        after = np.minimum(after, len(times) - 1)
        gap = times[after] - times[np.maximum(after - 1, 0)]
        usual = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        inside = (wanted >= times[0]) & (wanted <= times[-1]) & (gap <= MOST_GAP * usual + 1e-9)
        found_rows.append(rows[inside])
        found.append(places[inside])
    if not found:
        return np.zeros(0, np.int64), np.zeros((0, 3))
    return np.concatenate(found_rows), np.concatenate(found)


def _frame_covariance(moved: Float64s, target: Float64s, weight: Float64s, rows: Float64s) -> Float64s:
    """(7, 7) covariance of shift, turn and relative scale about the places' centre; errors that last count fewer times."""
    centre = weight @ target / weight.sum()
    arm = moved - centre
    J = np.zeros((len(moved), 3, 7))
    J[:, :, :3] = np.eye(3)
    J[:, 0, 4] = arm[:, 2]
    J[:, 0, 5] = -arm[:, 1]
    J[:, 1, 3] = -arm[:, 2]
    J[:, 1, 5] = arm[:, 0]
    J[:, 2, 3] = arm[:, 1]
    J[:, 2, 4] = -arm[:, 0]
    J[:, :, 6] = arm
    r = target - moved
    share = weight / weight.max()
    normal = np.einsum("n,nri,nrj->ij", share, J, J)
    variance = float(share @ (r**2).sum(axis=1)) / max(3 * share.sum() - 7, 1.0)
    # the sum of the autocorrelations of neighbouring rows
    lasting = 1.0
    power = float((share * (r**2).sum(axis=1)).sum())
    for lag in range(1, len(rows) // 4):
        correlation = float(np.sum(np.sqrt(share[lag:] * share[:-lag]) * (r[lag:] * r[:-lag]).sum(axis=1))) / max(power, 1e-300)
        if correlation < 0.05:
            break
        lasting += 2 * correlation
    return np.asarray(variance * lasting * np.linalg.pinv(normal, rcond=1e-12))


def scale_of_lengths(adjusted: Adjusted, survey: ThingSurvey) -> float | None:
    """Metres for each unit of the model, from known distances between things at the same time; None without any.

    Errors of the places make distances too long on average, by the trace of their covariances in the squared distance: it is
    subtracted.
    """
    reliable = adjusted.used.sum(axis=0) >= 2
    moments = adjusted.moments
    trace = np.einsum("mii->m", adjusted.equations.place_inverse)
    squared = []
    known = []
    for first, second, metres in survey.lengths:
        a = np.flatnonzero(reliable & (moments.thing == first))
        b = np.flatnonzero(reliable & (moments.thing == second))
        if not len(a) or not len(b):
            continue
        # the same time within a quarter of a frame interval
        interval = float(np.median(np.diff(moments.time[a]))) if len(a) > 1 else 0.0
        nearest = np.clip(np.searchsorted(moments.time[b], moments.time[a] - interval / 4), 0, len(b) - 1)
        same = np.abs(moments.time[b[nearest]] - moments.time[a]) <= interval / 4
        i = a[same]
        j = b[nearest[same]]
        d2 = ((adjusted.state.X[i] - adjusted.state.X[j]) ** 2).sum(axis=1)
        # places that are too inexact for this length say nothing
        exact = trace[i] + trace[j] < 0.1 * d2
        squared.append((d2 - trace[i] - trace[j])[exact])
        known.append(np.full(int(exact.sum()), metres))
    if not squared or not len(np.concatenate(squared)):
        return None
    ratio = np.concatenate(known) / np.sqrt(np.concatenate(squared))
    usual = float(np.median(ratio))
    # long lengths are relatively more exact
    agree = np.abs(ratio / usual - 1) < 0.1
    weight = np.concatenate(known)[agree] ** 2
    return float(1 / np.sqrt(np.sum(weight / ratio[agree] ** 2) / weight.sum()))


def _own_frame(
    names: Sequence[str], adjusted: Adjusted, placements: Mapping[str, Placement], up: Float64s, scale: float | None
) -> WorldFrame:
    """Upright, with x to the right of the first camera, which is at the origin, or at the one pose that is stated."""
    state = adjusted.state
    words = "known lengths"
    metric = scale is not None
    if scale is None:
        words = "none: the median baseline is set to 1"
        baselines = []
        for k in range(1, len(state.C)):
            baselines += np.linalg.norm(state.C[:k] - state.C[k], axis=1).tolist()
        scale = 1 / float(np.median(baselines))
    first = 0
    R = None
    target = np.zeros(3)
    trusted: tuple[str, ...] = ()
    for k, name in enumerate(names):
        placement = placements.get(name)
        if placement is not None and placement.R is not None and placement.C is not None:
            first = k
            R = placement.R.T @ state.R[k]
            target = placement.C
            trusted = (name,)
            break
    if R is None:
        right = state.R[first][0] - (state.R[first][0] @ up) * up
        right /= np.linalg.norm(right)
        R = np.array([right, np.cross(up, right), up])
    return WorldFrame(Similarity(scale, R, target - scale * R @ state.C[first]), metric, words, trusted=trusted)
