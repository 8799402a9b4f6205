"""Check the stated calibration as a whole: compare the cameras that the site states with the matches of the night.

A stale calibration file, a lens whose distortion was left out, or a zoom that was not recorded makes all cameras wrong together.
No camera then stands out against the others, and every pair is matched densely along wrong rows.  Matches reveal it: under right
cameras they lie as near to the epipolar lines as to those of a fundamental matrix of their own.  If they do not, a few causes
with up to three unknowns each are fitted to them, and the cause that restores the fit is named.

Matches of only two cameras may be look-alikes, which lie on epipolar lines of their own as well.  So the evidence is the matches
that are confirmed through a third camera.  Without any, only a cause that all cameras share is accepted, and only if it explains
nearly everything.  Small errors are caught later, from the row offsets that dense matching measures.

References
----------
Loss: Cauchy, see Black & Anandan, The Robust Estimation of Multiple Motions, 1996.  Distance: Hartley & Zisserman, eq. 11.9.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from math import sqrt

import cv2
import numpy as np

from ..core.cameras import ray_angles, rays
from ..core.epipolar import fundamental_from_cameras, sampson_distance, triangulate_depth
from ..core.rotations import rotation_matrix
from ..sfm.consistent_matches import consistent_matches
from ..types import CalibrationCheck, Camera, Float64s, Geometry, Pair, RowMatches
from .pose_check import LEAST_PROBABILITY, MIN_SHARED

FEWEST_CONFIRMED = 15
"""Pairs with fewer confirmed matches count as unconfirmed."""
SAMPLE = 150
"""Largest number of matches sampled from a pair: the errors of more are correlated."""
LEAST_NOISE_PX = 0.2
"""Smallest noise of matches: no image locates points better."""
OUTLIER = 3.0
"""Scale of the loss, in standard deviations."""
AGREEING_SIGMAS = 0.8
"""A pair agrees with the stated cameras if the median distance of its matches from the stated epipolar lines is below this (in
standard deviations); its distant matches are then look-alikes, even confirmed ones (right cameras: 0.15 to 0.76, in a car park
0.69 with a quarter of the matches elsewhere; focal lengths 3 % too long: 0.8 to 7.6)."""
MEDIAN_ERROR = 0.79
"""Standard error of the median absolute value of normal deviates, times the square root of their number."""
CONTRADICTED_RATIO = 1.6
"""Confirmed matches contradict the stated cameras if their loss under these exceeds this multiple of that under their own F."""
LEAST_LOSS_RATIO, LEAST_LOSS_RATIO_UNCONFIRMED = 1.12, 1.5
"""Smallest ratio of the loss under the stated cameras to the loss under a cause for it to be named: with confirmed matches, and
with unconfirmed ones.  Matches agree with the stated cameras up to the first ratio times the loss under their own F."""
LEAST_SHARE, LEAST_SHARE_UNCONFIRMED = 0.6, 0.8
"""A cause must remove this share of the loss beyond that under the matches' own F: for confirmed and for unconfirmed matches."""
LEAST_LOSS = 30.0
"""A cause must remove this total loss, in squared standard deviations (a pair counts as at most `MOST_COUNTED` matches)."""
MOST_COUNTED = 50
STRAYED_SIGMAS, FEWEST_RECOVERED = 1.6, 2
"""Some unconfirmed pairs match look-alikes, which no cause brings back to the lines.  A pair has strayed if its median distance
exceeds the first, in standard deviations.  A cause is named if it brings at least `FEWEST_RECOVERED` pairs, and half of those
that strayed, back to at most half of their distance, and makes no other pair stray."""
HARMFUL_PX = 0.4
"""Cameras that move points by less than this (median, in pixels along and across the epipolar line) do not harm a cloud."""
FARTHEST_PX = 1e4  # largest motion of a point that counts
LARGEST_SITE = 12
"""Largest number of cameras among which exchanged poses are tried."""
LARGEST_ZOOM = 3.0
"""Logarithm of the largest factor of focal lengths, and of positions, that is tried."""
STEPS = 20
STRETCHED, LEAST_STRETCH = ("stretched-x", "stretched-y", "stretched-z"), 0.02
"""Causes that stretch the site along one axis, and the smallest stretch (logarithm of the factor) that is blamed: surveys have no
smaller ones.  The matches of a harbour, all of whose poses are right, yield 0.009."""
CORNER = "principal-points-corner"
CORNER_PX = np.array([-0.5, -0.5])
"""Correction of principal points that are counted from the corner of the first pixel instead of its centre."""
SLACK_ERRORS = 3.0
"""Standard errors of the median added to `AGREEING_SIGMAS` if no cause, or only one turned or moved camera, explains matches."""
FEWEST_PAIRS = 4
"""Fewest pairs whose rows are compared: fewer show too little of a common cause."""
FEWEST_TILES, LEAST_GAIN = 4, 15.0
"""Fewest matches of a pair for its row offsets to count, and smallest gain of a cause (in squared standard deviations) for row
offsets to blame it.  140 correct nights of nine scenes gain at most 10, focal lengths 1.5 % too long 14 to 137."""
LEAST_MOTION_OF_ONE, LEAST_MOTION_ALONG, LEAST_TURN = 1.25e-3, 6e-4, 2e-3
"""Smallest effects, as shares of the width, for row offsets to blame a cause.  Of single cameras: motion of points (the first;
four photographs with true cameras: 6e-4).  Of all cameras: motion of points (the second) or turn of rays (the third)."""


@dataclass(frozen=True)
class _Matches:
    """Matches of a pair, and the standard deviation of their distance to the epipolar lines of their own fundamental matrix."""

    pair: Pair
    x1: Float64s
    x2: Float64s
    noise_px: float | Float64s
    own_loss: float
    """Mean loss under that matrix."""


@dataclass(frozen=True)
class _CheckedView:
    """A camera, and what is wrong with the distortion that was removed from its frames."""

    camera: Camera
    k1: float = 0.0
    """Radial distortion that remains in the frames."""
    stated: Camera | None = None
    """Camera whose K and distortion were used for the removal instead of the camera's own; None if the right ones were."""

    def undistort(self, x: Float64s) -> Float64s:
        """Pixels with the distortion removed correctly."""
        if self.k1 == 0 and self.stated is None:
            return x
        K = self.camera.K
        focal = np.array([K[0, 0], K[1, 1]])
        ray = (x - K[:2, 2]) / focal if self.stated is None else _undistorted_otherwise(x, self.stated, self.camera)
        return np.asarray(K[:2, 2] + ray * (1 - self.k1 * (ray**2).sum(axis=1, keepdims=True)) * focal, dtype=np.float64)


def _undistorted_otherwise(x: Float64s, stated: Camera, actual: Camera) -> Float64s:
    """Normalised coordinates (n, 2), by the right camera, of pixels that were undistorted with the stated one."""
    ray = np.column_stack([(x - stated.K[:2, 2]) / stated.K[[0, 1], [0, 1]], np.ones(len(x))])
    captured = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), stated.K, stated.distortion)[0]
    return np.asarray(cv2.undistortPoints(captured, actual.K, actual.distortion)[:, 0], dtype=np.float64)


_World = Mapping[str, _CheckedView]
_Change = Callable[[_CheckedView, Float64s], _CheckedView]


@dataclass(frozen=True)
class _Cause:
    """A possible error of the stated cameras; with unknowns of zero they are as stated."""

    name: str
    change: Callable[[_World, Float64s], _World]
    camera_of_unknown: tuple[str, ...] = ()
    """For each unknown, the camera that it concerns; "" for all."""
    cameras: tuple[str, ...] = ()
    """The cameras that the cause concerns; () for all."""


@dataclass(frozen=True)
class _Explanation:
    cause: _Cause
    amount: Float64s
    world: _World
    loss: float
    """Mean over all matches."""


def check_calibration(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> CalibrationCheck | None:
    """Compare stated cameras with the matches of the night; None if there are too few matches.

    cameras: as the site states them, at working resolution, by id.  geometries: matches of the pairs, with the stated
    distortion removed; pairs with other cameras serve to confirm matches.
    """
    if len(cameras) < 2:
        return None
    stated = {name: _CheckedView(camera) for name, camera in cameras.items()}
    confirmed, other_matches = _evidence(stated, geometries)
    if not confirmed and not other_matches:
        return None
    check = _check(stated, confirmed, other_matches)
    if not check.contradicted and other_matches:
        check = _with_majority_cause(check, stated, [*confirmed, *other_matches])
    return check


def misfit_without_cause(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> float:
    """The misfit of confirmed matches that remains once the likeliest cause that all cameras share is corrected.

    cameras, geometries: as for `check_calibration`.
    """
    stated = {name: _CheckedView(camera) for name, camera in cameras.items()}
    confirmed, _ = _evidence(stated, geometries)
    shared_causes = [c for c in _causes(stated, confirmed, unconfirmed=False) if c.camera_of_unknown and not c.cameras]
    return min(_fit(cause, stated, confirmed).loss for cause in shared_causes) / _mean(confirmed, [m.own_loss for m in confirmed])


def check_rows(cameras: Mapping[str, Camera], rows: Mapping[Pair, RowMatches]) -> CalibrationCheck | None:
    """Compare stated cameras with the row offsets that dense matching measures; None if there are too few pairs.

    These matches are ten times as accurate as keypoints, and contain no look-alikes, so they reveal small errors.

    cameras : by id.  rows : of pairs of them.
    """
    evidence = [
        _Matches(pair, tiles.x1, tiles.x2, tiles.sigma_px, 0.0) for pair, tiles in rows.items() if len(tiles.x1) >= FEWEST_TILES
    ]
    if len(evidence) < FEWEST_PAIRS:
        return None
    stated = {name: _CheckedView(camera) for name, camera in cameras.items()}
    loss, count = _loss(stated, evidence), sum(min(len(m.x1), MOST_COUNTED) for m in evidence)
    best = _simplest([_fit(cause, stated, evidence) for cause in _causes(stated, evidence, unconfirmed=False)], loss, slack=0.0)
    corner = _fit(_Cause(CORNER, lambda world, a: _for_all(_shifted_px, world, a * CORNER_PX), ("",)), stated, evidence)
    is_corner = best.cause.name == "principal-points" and loss - corner.loss >= LEAST_SHARE_UNCONFIRMED * (loss - best.loss)
    if is_corner and 0.25 <= corner.amount[0] <= 1.25:  # matches found by dense matching are biased toward the rows
        best = corner
    gain, tile_count = max(count * (loss - best.loss), 0.0), sum(len(m.x1) for m in evidence)
    check = CalibrationCheck(tile_count, len(evidence), True, misfit=loss / max(best.loss, 1e-9), sigmas=sqrt(gain))
    return _with_cause(check, best, stated, evidence) if gain >= LEAST_GAIN and _exceeds_usual(best, stated, evidence) else check


def _exceeds_usual(best: _Explanation, stated: _World, evidence: list[_Matches]) -> bool:
    """Does a cause exceed the errors that surveys and lenses always have?"""
    name = best.cause.name
    if name == CORNER:
        return True  # however small its effect: it is half a pixel or nothing
    if best.cause.cameras:
        return _moved_px(stated, best.world, evidence) >= LEAST_MOTION_OF_ONE * next(iter(stated.values())).camera.width
    return (name not in STRETCHED or abs(best.amount[0]) >= LEAST_STRETCH) and _is_noticeable(stated, best.world, evidence)


def _evidence(stated: _World, geometries: Mapping[Pair, Geometry]) -> tuple[list[_Matches], list[_Matches]]:
    """Confirmed matches of pairs of stated cameras, and all matches of the pairs with too few confirmed ones."""
    large_pairs = {pair: geometry for pair, geometry in geometries.items() if len(geometry.x1) >= MIN_SHARED}
    probable = {pair: geometry for pair, geometry in large_pairs.items() if geometry.good_probability >= LEAST_PROBABILITY}
    consistent = {pair: geometry for pair, geometry in consistent_matches(probable).items() if set(pair) <= set(stated)}
    sufficient = {pair: geometry for pair, geometry in consistent.items() if len(geometry.x1) >= FEWEST_CONFIRMED}
    confirmed = [_sampled(pair, geometry, geometries[pair]) for pair, geometry in sufficient.items()]
    return confirmed, [_sampled(pair, geometries[pair], geometries[pair]) for pair in consistent if pair not in sufficient]


def _check(stated: _World, confirmed: list[_Matches], other_matches: list[_Matches]) -> CalibrationCheck:
    """Check by confirmed matches; by the others if there are none."""
    evidence = confirmed or other_matches
    loss, own_loss = _loss(stated, evidence), _mean(evidence, [m.own_loss for m in evidence])
    count = sum(len(m.x1) for m in evidence)
    check = CalibrationCheck(matches=count, pairs=len(evidence), confirmed=bool(confirmed), misfit=loss / max(own_loss, 1e-9))
    excess = _excess(stated, evidence)
    if excess <= LEAST_LOSS_RATIO * own_loss:
        return check
    exceeds_noise = check.confirmed and excess > CONTRADICTED_RATIO * own_loss
    best = _best_explanation(stated, evidence, own_loss, unconfirmed=not confirmed)
    only_a_pose = best is None or best.cause.name in ("turned", "moved")
    if only_a_pose and _excess(stated, evidence, tolerance=SLACK_ERRORS) <= LEAST_LOSS_RATIO * own_loss:
        best, exceeds_noise = None, False  # few matches, most of which agree: a changed pose merely fits look-alikes
    named = replace(check, contradicted=exceeds_noise) if best is None else _with_cause(check, best, stated, evidence)
    return named if exceeds_noise or named.off_px >= HARMFUL_PX else check


def _with_cause(check: CalibrationCheck, best: _Explanation, stated: _World, evidence: list[_Matches]) -> CalibrationCheck:
    """The result with the cause of the contradiction."""
    cause, amount, ratio = best.cause, tuple(float(a) for a in best.amount), _loss(stated, evidence) / best.loss
    off_px = _moved_px(stated, best.world, evidence)
    return replace(check, contradicted=True, cause=cause.name, cameras=cause.cameras, amount=amount, better=ratio, off_px=off_px)


def _with_majority_cause(check: CalibrationCheck, stated: _World, evidence: list[_Matches]) -> CalibrationCheck:
    """Name the cause under which most pairs lie near their epipolar lines again, if that is more than chance."""
    stated_medians = np.array([_median_distance(stated, m) for m in evidence])
    has_strayed = stated_medians > STRAYED_SIGMAS
    if has_strayed.sum() < FEWEST_RECOVERED:
        return check
    explanations = [_fit(cause, stated, evidence) for cause in _causes(stated, evidence, unconfirmed=False)]
    medians = np.array([[_median_distance(explanation.world, m) for m in evidence] for explanation in explanations])
    is_near = medians <= STRAYED_SIGMAS
    recovered = (has_strayed & is_near & (2 * medians <= stated_medians)).sum(axis=1)
    is_eligible = (recovered >= FEWEST_RECOVERED) & (2 * recovered >= has_strayed.sum()) & (is_near | has_strayed).all(axis=1)
    if not is_eligible.any():
        return check
    most_near = is_near[is_eligible].sum(axis=1).max()
    ties = [k for k in np.flatnonzero(is_eligible) if is_near[k].sum() == most_near]
    is_near_best = is_near[min(ties, key=lambda k: explanations[k].loss)]
    near = [m for m, fits in zip(evidence, is_near_best, strict=True) if fits]
    loss, own_loss = _loss(stated, near), _mean(near, [m.own_loss for m in near])
    best = _simplest([replace(explanations[k], loss=_loss(explanations[k].world, near)) for k in ties], loss)
    if not _explains(best, loss, own_loss, near, unconfirmed=False):
        return check
    checked = replace(check, matches=sum(len(m.x1) for m in near), pairs=len(near), misfit=loss / max(own_loss, 1e-9))
    named = _with_cause(checked, best, stated, near)
    return check if named.off_px < HARMFUL_PX else named


def _sampled(pair: Pair, chosen: Geometry, full: Geometry) -> _Matches:
    """A sample of some matches of a pair; the noise is estimated from all of them (`full`)."""
    distance = np.abs(sampson_distance(full.F, full.x1, full.x2))
    noise_px = max(1.4826 * float(np.median(distance)), LEAST_NOISE_PX)
    rows = np.linspace(0, len(chosen.x1) - 1, min(SAMPLE, len(chosen.x1))).astype(np.int64)
    x1, x2 = chosen.x1[rows], chosen.x2[rows]
    own_loss = float(_cauchy(sampson_distance(full.F, x1, x2) / noise_px).mean())
    return _Matches(pair, x1, x2, noise_px, own_loss)


def _cauchy(residuals: Float64s) -> Float64s:
    """Cauchy loss: squares of residuals, whose weight decreases beyond `OUTLIER`."""
    return np.asarray(OUTLIER**2 * np.log1p((residuals / OUTLIER) ** 2), dtype=np.float64)


def _residuals(world: _World, matches: _Matches) -> Float64s:
    """Distances (n,) of matches to the epipolar lines, in standard deviations."""
    left, right = (world[name] for name in matches.pair)
    F = fundamental_from_cameras(left.camera, right.camera)
    return sampson_distance(F, left.undistort(matches.x1), right.undistort(matches.x2)) / matches.noise_px


def _median_distance(world: _World, matches: _Matches) -> float:
    """Median distance of the matches to the epipolar lines, in standard deviations."""
    return float(np.median(np.abs(_residuals(world, matches))))


def _mean(evidence: list[_Matches], values: list[float]) -> float:
    """Mean over pairs, weighted by their number of matches, up to `MOST_COUNTED`."""
    return float(np.average(values, weights=[min(len(m.x1), MOST_COUNTED) for m in evidence]))


def _loss(world: _World, evidence: list[_Matches]) -> float:
    return _mean(evidence, [float(_cauchy(_residuals(world, m)).mean()) for m in evidence])


def _excess(world: _World, evidence: list[_Matches], tolerance: float = 0.0) -> float:
    """The loss, except that pairs which agree with the world count with the loss under their own geometry.

    tolerance: of the agreement, in standard errors of the median.
    """
    limits = [AGREEING_SIGMAS + tolerance * MEDIAN_ERROR / sqrt(len(m.x1)) for m in evidence]
    agrees = [_median_distance(world, m) <= limit for m, limit in zip(evidence, limits, strict=True)]
    return _mean(evidence, [m.own_loss if agreeing else _loss(world, [m]) for m, agreeing in zip(evidence, agrees, strict=True)])


def _explains(best: _Explanation, loss: float, own_loss: float, evidence: list[_Matches], unconfirmed: bool) -> bool:
    """Does a cause restore the fit that the matches have under their own geometry?"""
    ratio, share = (LEAST_LOSS_RATIO_UNCONFIRMED, LEAST_SHARE_UNCONFIRMED) if unconfirmed else (LEAST_LOSS_RATIO, LEAST_SHARE)
    gain, count = loss - best.loss, sum(min(len(m.x1), MOST_COUNTED) for m in evidence)
    return loss > ratio * best.loss and gain >= share * (loss - min(own_loss, best.loss)) and gain * count >= LEAST_LOSS


def _moved_px(stated: _World, corrected: _World, evidence: list[_Matches]) -> float:
    """Motion of points along the epipolar lines between two worlds, and towards these lines, in pixels: median over the matches
    of the pairs that change; `FARTHEST_PX` for points behind a camera."""
    motions = []
    for matches in evidence:
        if all(stated[name] is corrected[name] for name in matches.pair):
            continue
        (z, gain), (corrected_z, _) = (_depths(world, matches) for world in (stated, corrected))
        stated_px, corrected_px = (np.abs(_residuals(world, matches)) * matches.noise_px for world in (stated, corrected))
        with np.errstate(invalid="ignore", divide="ignore"):
            along = np.minimum(np.nan_to_num(np.abs(z - corrected_z) / gain, nan=FARTHEST_PX), FARTHEST_PX)
        motions.append(np.hypot(along, stated_px - corrected_px))
    return float(np.median(np.concatenate(motions))) if motions else 0.0


def _is_noticeable(stated: _World, other: _World, evidence: list[_Matches]) -> bool:
    """Do points move, or their rays turn, noticeably between two worlds?"""
    views = [(stated[name], other[name], x) for m in evidence for name, x in zip(m.pair, (m.x1, m.x2), strict=True)]
    turns = [ray_angles(*(rays(v.camera, v.undistort(x)).T for v in both)) * both[0].camera.K[0, 0] for *both, x in views]
    width = np.mean([view.camera.width for view, *_ in views])
    return bool(
        _moved_px(stated, other, evidence) >= LEAST_MOTION_ALONG * width or np.median(np.concatenate(turns)) >= LEAST_TURN * width
    )


def _depths(world: _World, matches: _Matches) -> tuple[Float64s, Float64s]:
    left, right = (world[name] for name in matches.pair)
    return triangulate_depth(left.camera, right.camera, left.undistort(matches.x1), right.undistort(matches.x2))


def _best_explanation(stated: _World, evidence: list[_Matches], own_loss: float, unconfirmed: bool) -> _Explanation | None:
    """The cause that explains the matches best, or the simplest of those about as good; None if it explains too little."""
    explanations = [_fit(cause, stated, evidence) for cause in _causes(stated, evidence, unconfirmed)]
    loss = _loss(stated, evidence)
    best = _simplest(explanations, loss)
    return best if _explains(best, loss, own_loss, evidence, unconfirmed) else None


def _simplest(explanations: list[_Explanation], loss: float, slack: float = 0.1) -> _Explanation:
    """The simplest of the causes that explain about as much of a loss as any; slack: tolerated share of the remaining loss."""
    least_loss = min(explanation.loss for explanation in explanations)
    limit = least_loss + max(slack * least_loss, 0.05 * (loss - least_loss))
    return min(explanations, key=lambda e: (e.loss > limit, len(e.cause.camera_of_unknown), e.loss))


def _fit(cause: _Cause, stated: _World, evidence: list[_Matches]) -> _Explanation:
    """The amount of a cause that fits the matches best, by Gauss-Newton steps on a loss whose scale tightens."""
    affected = [m for m in evidence if not cause.cameras or set(cause.cameras) & set(m.pair)]
    amount, damping, scale = np.zeros(len(cause.camera_of_unknown)), 1e-3, np.inf

    def residuals(amounts: Float64s, camera: str = "") -> list[Float64s]:
        world = cause.change(stated, amounts)
        return [_residuals(world, m) if not camera or camera in m.pair else current[k] for k, m in enumerate(affected)]

    current: list[Float64s] = []
    current = residuals(amount)
    for _ in range(STEPS if len(amount) else 0):
        stacked = np.concatenate(current)
        scale = min(scale, max(OUTLIER, 1.5 * float(np.median(np.abs(stacked)))))
        cost = float(np.log1p((stacked / scale) ** 2).sum())
        deltas = zip(cause.camera_of_unknown, 1e-6 * np.eye(len(amount)), strict=True)
        J = np.stack([(np.concatenate(residuals(amount + delta, camera)) - stacked) / 1e-6 for camera, delta in deltas], axis=1)
        weight = 1 / (1 + (stacked / scale) ** 2)
        normal, gradient = J.T @ (J * weight[:, None]), J.T @ (weight * stacked)
        step = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-9), -gradient)
        trial = residuals(amount + step)
        if float(np.log1p((np.concatenate(trial) / scale) ** 2).sum()) < cost:
            amount, current, damping = amount + step, trial, max(damping / 10, 1e-9)
        elif (damping := damping * 10) > 1e3:
            break
        if np.linalg.norm(step) < 1e-7 and scale <= OUTLIER:
            break
    world = cause.change(stated, amount)
    return _Explanation(cause, amount, world, _loss(world, evidence))


def _causes(stated: _World, evidence: list[_Matches], unconfirmed: bool) -> Iterator[_Cause]:
    """Possible causes, the likeliest first."""
    names = sorted({name for m in evidence for name in m.pair})
    baseline, zero = _median_baseline(stated, evidence), np.zeros(3)

    def of_all(name: str, unknowns: int, change: _Change) -> _Cause:
        return _Cause(name, lambda w, a: _for_all(change, w, a), ("",) * unknowns)

    def of_one(name: str, unknowns: int, change: _Change, camera: str) -> _Cause:
        return _Cause(name, lambda w, a: {**w, camera: change(w[camera], a)}, (camera,) * unknowns, (camera,))

    def of_two(name: str, keys: tuple[str, ...], one: str, other: str) -> _Cause:
        return _Cause(
            name, lambda w, a: {**w, one: _mixed(w[one], w[other], keys), other: _mixed(w[other], w[one], keys)}, (), (one, other)
        )

    yield of_all("focal-lengths", 1, _zoomed)
    yield of_all("distortion", 1, _distorted)
    if any(_has_distortion(view.camera) for view in stated.values()):
        yield of_all("distortion-factor", 1, _distortion_scaled)
    if unconfirmed:
        return
    yield of_all("pixel-shape", 1, lambda view, a: _zoomed(view, np.append(a, 0.0)))
    yield of_all("pixel-height", 1, lambda view, a: _zoomed(view, np.append(0.0, a)))
    yield of_all(CORNER, 0, lambda view, _: _shifted_px(view, CORNER_PX))
    yield of_all("principal-points", 2, _shifted)
    yield of_all("focal-lengths-and-distortion", 2, lambda view, a: _distorted(_zoomed(view, a[:1]), a[1:]))
    for axis, name in enumerate(STRETCHED):
        yield of_all(name, 1, lambda view, a, axis=axis: _stretched(view, axis, a))  # type: ignore[misc]
    for name, change in CONVENTIONS.items():
        yield of_all(name, 0, lambda view, a, c=change: replace(view, camera=c(view.camera)))  # type: ignore[misc]
    for name in names:
        if len({m.pair for m in evidence if name in m.pair}) < 2:  # matches of one pair may be look-alikes
            continue
        yield of_one("focal-length", 1, _zoomed, name)
        yield of_one("distortion-of-one", 1, _distorted, name)
        yield of_one("turned", 3, lambda view, a: _posed(view, np.append(a, zero), baseline), name)
        yield of_one("moved", 3, lambda view, a: _posed(view, np.append(zero, a), baseline), name)
        for convention in ("mirrored-frames", "upside-down"):
            yield of_one(convention, 0, lambda view, a, c=convention: replace(view, camera=CONVENTIONS[c](view.camera)), name)  # type: ignore[misc]
    if len(names) <= LARGEST_SITE:
        for step in (1, -1) if len(stated) > 2 else ():
            yield _Cause("captures-exchanged", lambda w, _, step=step: _assigned_to_next(w, step))  # type: ignore[misc]
        for one, other in combinations(names, 2):
            for name, keys in EXCHANGED.items():
                yield of_two(name, keys, one, other)


def _assigned_to_next(world: _World, step: int) -> _World:
    """Each camera takes the place of the next one, as when a recorder numbers its inputs from another start."""
    names = list(world)
    next_names = [names[(k + step) % len(names)] for k in range(len(names))]
    keys = EXCHANGED["captures-exchanged"]
    return {name: _mixed(world[name], world[next_name], keys) for name, next_name in zip(names, next_names, strict=True)}


def _median_baseline(stated: _World, evidence: list[_Matches]) -> float:
    """Median distance between the two cameras of a pair."""
    return float(np.median([np.linalg.norm(stated[a].camera.C - stated[b].camera.C) for a, b in (m.pair for m in evidence)]))


def _posed(view: _CheckedView, amount: Float64s, baseline: float) -> _CheckedView:
    """The camera rotated and shifted; amount: rotation vector (3), and shift (3) in units of `baseline`."""
    camera = view.camera
    return replace(view, camera=replace(camera, R=rotation_matrix(amount[:3]) @ camera.R, C=camera.C + baseline * amount[3:]))


def _zoomed(view: _CheckedView, logs: Float64s) -> _CheckedView:
    """The camera with scaled focal lengths; logs: log factor of both, or of the horizontal and the vertical one."""
    K = view.camera.K.copy()
    K[[0, 1], [0, 1]] *= np.exp(np.clip(logs, -LARGEST_ZOOM, LARGEST_ZOOM))
    return replace(view, camera=replace(view.camera, K=K))


def _distorted(view: _CheckedView, k1: Float64s) -> _CheckedView:
    return replace(view, k1=float(k1[0]))


def _has_distortion(camera: Camera) -> bool:
    return camera.lens is None and bool(camera.distortion.any())


def _distortion_scaled(view: _CheckedView, extra: Float64s) -> _CheckedView:
    """The camera with the stated distortion times 1 + `extra`."""
    camera = view.camera
    scaled = replace(camera, distortion=camera.distortion * (1 + extra[0]))
    return replace(view, camera=scaled, stated=camera) if _has_distortion(camera) else view


def _shifted(view: _CheckedView, share: Float64s) -> _CheckedView:
    """The camera with a shifted principal point; share: of the width."""
    K = view.camera.K.copy()
    K[:2, 2] += share * view.camera.width
    return replace(view, camera=replace(view.camera, K=K))


def _shifted_px(view: _CheckedView, pixels: Float64s) -> _CheckedView:
    return _shifted(view, pixels / view.camera.width)


def _for_all(change: _Change, world: _World, amount: Float64s) -> _World:
    return {name: change(view, amount) for name, view in world.items()}


def _mixed(view: _CheckedView, other: _CheckedView, keys: tuple[str, ...]) -> _CheckedView:
    """The camera with parts of another one."""
    old, new = view.camera, replace(view.camera, **{key: getattr(other.camera, key) for key in keys})
    swapped = "distortion" in keys and old.lens is None and other.camera.lens is None
    return replace(view, camera=new, stated=old if swapped and (_has_distortion(old) or _has_distortion(other.camera)) else None)


def _stretched(view: _CheckedView, axis: int, log: Float64s) -> _CheckedView:
    """The camera with its position stretched along an axis; log: logarithm of the factor."""
    C = view.camera.C.copy()
    C[axis] *= np.exp(np.clip(log[0], -LARGEST_ZOOM, LARGEST_ZOOM))
    return replace(view, camera=replace(view.camera, C=C))


def _flipped(camera: Camera, axes: int) -> Camera:
    """The camera for frames that are mirrored (one of the `axes` flipped), or upside down (both flipped)."""
    K, size = camera.K.copy(), (camera.width, camera.height)
    for k in range(axes):
        K[k, k], K[k, 2] = -K[k, k], size[k] - 1 - K[k, 2]
    return replace(camera, K=K)


_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
CONVENTIONS: Mapping[str, Callable[[Camera], Camera]] = {
    "mirrored-x": lambda c: replace(c, C=c.C * (-1, 1, 1)),
    "mirrored-y": lambda c: replace(c, C=c.C * (1, -1, 1)),
    "mirrored-z": lambda c: replace(c, C=c.C * (1, 1, -1)),
    "axes-exchanged": lambda c: replace(c, C=c.C[[1, 0, 2]]),
    "t-for-positions": lambda c: replace(c, C=-c.R.T @ c.C),
    "rotations-transposed": lambda c: replace(c, R=c.R.T),
    "rotations-opengl": lambda c: replace(c, R=_FROM_OPENGL @ c.R),
    "rotations-transposed-opengl": lambda c: replace(c, R=_FROM_OPENGL @ c.R.T),
    "mirrored-frames": lambda c: _flipped(c, 1),
    "upside-down": lambda c: _flipped(c, 2),
}
"""Corrections of misread conventions, by name: from the stated camera to the right one."""
EXCHANGED = {
    "exchanged": ("R", "C"),
    "captures-exchanged": ("K", "distortion", "R", "C"),
    "positions-exchanged": ("C",),
    "lenses-exchanged": ("K", "distortion"),
}
"""Parts that two cameras may have exchanged, by name of the cause."""
