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
AGREEING = 0.8
"""A pair agrees with the stated cameras if the median distance of its matches from the stated epipolar lines is below this (in
standard deviations); its distant matches are then look-alikes, even confirmed ones (right cameras: 0.15 to 0.76, in a car park
0.69 with a quarter of the matches elsewhere; focal lengths 3 % too long: 0.8 to 7.6)."""
MEDIAN_ERROR = 0.79
"""Standard error of the median absolute value of normal deviates, times the square root of their number."""
CONTRADICTED = 1.6
"""Confirmed matches contradict the stated cameras if their loss under these exceeds this multiple of that under their own F."""
LEAST_LOSS_RATIO, LEAST_LOSS_RATIO_UNCONFIRMED = 1.12, 1.5
"""Smallest ratio of the loss under the stated cameras to the loss under a cause for it to be named: with confirmed matches, and
with unconfirmed ones.  Up to the first times the loss under their own F, matches agree with the stated cameras."""
LEAST_SHARE, LEAST_SHARE_UNCONFIRMED = 0.6, 0.8
"""A cause must remove this share of the loss beyond that under the matches' own F: if these are confirmed, and if not."""
LEAST_LOSS = 30.0
"""A cause must remove this total loss, in squared standard deviations (a pair counts as at most `COUNTED` matches)."""
COUNTED = 50
STRAYED_SIGMAS, FEWEST_RECOVERED = 1.6, 2
"""Some unconfirmed pairs match look-alikes, which no cause brings back to the lines.  A pair has strayed if its median distance
exceeds the first, in standard deviations.  A cause is named if it brings at least `FEWEST_RECOVERED` pairs, and half of those
that strayed, back to at most half of their distance, and makes no other pair stray."""
HARMFUL_PX = 0.4
"""Cameras that move points by less than this (median, in pixels along and across the epipolar line) do not harm a cloud."""
FARTHEST_PX = 1e4
LARGEST_SITE = 12
"""Largest number of cameras among which exchanged poses are tried."""
LARGEST_ZOOM = 3.0
"""Logarithm of the largest factor of focal lengths, and of positions, that is tried."""
STEPS = 20
STRETCHED, LEAST_STRETCH = ("stretched-x", "stretched-y", "stretched-z"), 0.02
"""Smallest stretch along one axis alone (logarithm of the factor) that is blamed: surveys have no smaller ones.  The matches of a
harbour, all of whose poses are right, yield 0.009."""
CORNER = "principal-points-corner"
CORNER_PX = np.array([-0.5, -0.5])
"""Correction of principal points that are counted from the corner of the first pixel instead of its centre."""
FITS = 3.0
"""Standard errors of the median added to `AGREEING` if no cause, or only a turned or moved camera, explains the matches."""
FEWEST_PAIRS = 4
"""Fewest pairs whose rows are compared: fewer show too little of a common cause."""
FEWEST_TILES, LEAST_GAIN = 4, 15.0
"""Fewest matches of a pair for its row offsets to count, and smallest gain of a cause (in squared standard deviations) for row
offsets to blame it.  140 correct nights of nine scenes gain at most 10, focal lengths 1.5 % too long 14 to 137."""
LEAST_MOTION_OF_ONE, LEAST_MOTION_ALONG, LEAST_TURN = 1.25e-3, 6e-4, 2e-3
"""Smallest effects, as shares of the width, for row offsets to blame a cause.  Motion of points: by a cause of single cameras
(four photographs with true cameras: 6e-4), and along the lines by a cause of all.  Turn of rays: by a cause of all."""


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
class _Seen:
    """A camera, and what is wrong with the distortion that was removed from its frames."""

    camera: Camera
    k1: float = 0.0
    """Radial distortion that remains in the frames."""
    stated: Camera | None = None
    """Camera whose K and distortion were used for the removal instead of the camera's own; None if the right ones were."""

    def straight(self, x: Float64s) -> Float64s:
        """Pixels with the distortion removed correctly."""
        if self.k1 == 0 and self.stated is None:
            return x
        K = self.camera.K
        focal = np.array([K[0, 0], K[1, 1]])
        ray = (x - K[:2, 2]) / focal if self.stated is None else _undistorted_otherwise(x, self.stated, self.camera)
        return np.asarray(K[:2, 2] + ray * (1 - self.k1 * (ray**2).sum(axis=1, keepdims=True)) * focal, dtype=np.float64)


def _undistorted_otherwise(x: Float64s, stated: Camera, right: Camera) -> Float64s:
    """Normalised coordinates (n, 2), by the right camera, of pixels that were undistorted with the stated one."""
    ray = np.column_stack([(x - stated.K[:2, 2]) / stated.K[[0, 1], [0, 1]], np.ones(len(x))])
    captured = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), stated.K, stated.distortion)[0]
    return np.asarray(cv2.undistortPoints(captured, right.K, right.distortion)[:, 0], dtype=np.float64)


_World = Mapping[str, _Seen]
_Change = Callable[[_Seen, Float64s], _Seen]


@dataclass(frozen=True)
class _Cause:
    """A possible error of the stated cameras; with unknowns of zero they are as stated."""

    name: str
    change: Callable[[_World, Float64s], _World]
    about: tuple[str, ...] = ()
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
    stated = {name: _Seen(camera) for name, camera in cameras.items()}
    confirmed, others = _evidence(stated, geometries)
    if not confirmed and not others:
        return None
    found = _checked(stated, confirmed, others)
    if not found.contradicted and others:
        found = _with_cause_of_most(found, stated, [*confirmed, *others])
    return found


def misfit_without_cause(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> float:
    """The misfit of confirmed matches that remains once the likeliest cause that all cameras share is corrected.

    cameras, geometries: as for `check_calibration`.
    """
    stated = {name: _Seen(camera) for name, camera in cameras.items()}
    confirmed, _ = _evidence(stated, geometries)
    shared = [cause for cause in _causes(stated, confirmed, alone=False) if cause.about and not cause.cameras]
    return min(_fit(cause, stated, confirmed).loss for cause in shared) / _mean(confirmed, [m.own_loss for m in confirmed])


def check_rows(cameras: Mapping[str, Camera], rows: Mapping[Pair, RowMatches]) -> CalibrationCheck | None:
    """Compare stated cameras with the row offsets that dense matching measures; None if there are too few pairs.

    These matches are ten times as accurate as keypoints, and contain no look-alikes, so they reveal small errors.

    cameras : by id.  rows : of pairs of them.
    """
    evidence = [
        _Matches(pair, found.x1, found.x2, found.sigma_px, 0.0) for pair, found in rows.items() if len(found.x1) >= FEWEST_TILES
    ]
    if len(evidence) < FEWEST_PAIRS:
        return None
    stated = {name: _Seen(camera) for name, camera in cameras.items()}
    loss, count = _loss(stated, evidence), sum(min(len(m.x1), COUNTED) for m in evidence)
    best = _simplest([_fit(cause, stated, evidence) for cause in _causes(stated, evidence, alone=False)], loss, slack=0.0)
    half = _fit(_Cause(CORNER, lambda world, a: _of_all(_shifted_px, world, a * CORNER_PX), ("",)), stated, evidence)
    explains = best.cause.name == "principal-points" and loss - half.loss >= LEAST_SHARE_UNCONFIRMED * (loss - best.loss)
    if explains and 0.25 <= half.amount[0] <= 1.25:  # matches found by dense matching are biased toward the rows
        best = half
    gained, tiles = max(count * (loss - best.loss), 0.0), sum(len(m.x1) for m in evidence)
    found = CalibrationCheck(tiles, len(evidence), True, misfit=loss / max(best.loss, 1e-9), sigmas=sqrt(gained))
    return _named(found, best, stated, evidence) if gained >= LEAST_GAIN and _matters(best, stated, evidence) else found


def _matters(best: _Explanation, stated: _World, evidence: list[_Matches]) -> bool:
    """Does a cause exceed the errors that surveys and lenses always have?"""
    name = best.cause.name
    if name == CORNER:
        return True  # however small its effect: it is half a pixel or nothing
    if best.cause.cameras:
        return _off_px(stated, best.world, evidence) >= LEAST_MOTION_OF_ONE * next(iter(stated.values())).camera.width
    return (name not in STRETCHED or abs(best.amount[0]) >= LEAST_STRETCH) and _is_felt(stated, best.world, evidence)


def _evidence(stated: _World, geometries: Mapping[Pair, Geometry]) -> tuple[list[_Matches], list[_Matches]]:
    """Confirmed matches of pairs of stated cameras, and all matches of the pairs with too few confirmed ones."""
    enough = {pair: geometry for pair, geometry in geometries.items() if len(geometry.x1) >= MIN_SHARED}
    believed = {pair: geometry for pair, geometry in enough.items() if geometry.good_probability >= LEAST_PROBABILITY}
    mine = {pair: some for pair, some in consistent_matches(believed).items() if set(pair) <= set(stated)}
    known = {pair: some for pair, some in mine.items() if len(some.x1) >= FEWEST_CONFIRMED}
    confirmed = [_matches(pair, some, geometries[pair]) for pair, some in known.items()]
    return confirmed, [_matches(pair, geometries[pair], geometries[pair]) for pair in mine if pair not in known]


def _checked(stated: _World, confirmed: list[_Matches], others: list[_Matches]) -> CalibrationCheck:
    """Check by confirmed matches; by the others if there are none."""
    evidence = confirmed or others
    loss, own = _loss(stated, evidence), _mean(evidence, [m.own_loss for m in evidence])
    count = sum(len(m.x1) for m in evidence)
    found = CalibrationCheck(matches=count, pairs=len(evidence), confirmed=bool(confirmed), misfit=loss / max(own, 1e-9))
    excess = _excess(stated, evidence)
    if excess <= LEAST_LOSS_RATIO * own:
        return found
    beyond_noise = found.confirmed and excess > CONTRADICTED * own
    best = _explanation(stated, evidence, own, alone=not confirmed)
    if (best is None or best.cause.name in ("turned", "moved")) and _excess(
        stated, evidence, errors=FITS
    ) <= LEAST_LOSS_RATIO * own:
        best, beyond_noise = None, False  # few matches, most of which agree: a changed pose merely fits look-alikes
    named = replace(found, contradicted=beyond_noise) if best is None else _named(found, best, stated, evidence)
    return named if beyond_noise or named.off_px >= HARMFUL_PX else found


def _named(found: CalibrationCheck, best: _Explanation, stated: _World, evidence: list[_Matches]) -> CalibrationCheck:
    """The result with the cause of the contradiction."""
    cause, amount, better = best.cause, tuple(float(a) for a in best.amount), _loss(stated, evidence) / best.loss
    off_px = _off_px(stated, best.world, evidence)
    return replace(found, contradicted=True, cause=cause.name, cameras=cause.cameras, amount=amount, better=better, off_px=off_px)


def _with_cause_of_most(found: CalibrationCheck, stated: _World, evidence: list[_Matches]) -> CalibrationCheck:
    """Name the cause that brings most pairs back to the lines of the stated cameras, if that is more than chance."""
    before = np.array([_median(stated, m) for m in evidence])
    strayed = before > STRAYED_SIGMAS
    if strayed.sum() < FEWEST_RECOVERED:
        return found
    causes = [_fit(cause, stated, evidence) for cause in _causes(stated, evidence, alone=False)]
    after = np.array([[_median(explanation.world, m) for m in evidence] for explanation in causes])
    good = after <= STRAYED_SIGMAS
    back = (strayed & good & (2 * after <= before)).sum(axis=1)
    able = (back >= FEWEST_RECOVERED) & (2 * back >= strayed.sum()) & (good | strayed).all(axis=1)
    if not able.any():
        return found
    most = good[able].sum(axis=1).max()
    equal = [k for k in np.flatnonzero(able) if good[k].sum() == most]
    pairs = good[min(equal, key=lambda k: causes[k].loss)]
    mine = [m for m, one in zip(evidence, pairs, strict=True) if one]
    loss, own = _loss(stated, mine), _mean(mine, [m.own_loss for m in mine])
    best = _simplest([replace(causes[k], loss=_loss(causes[k].world, mine)) for k in equal], loss)
    if not _explains(best, loss, own, mine, alone=False):
        return found
    asked = replace(found, matches=sum(len(m.x1) for m in mine), pairs=len(mine), misfit=loss / max(own, 1e-9))
    named = _named(asked, best, stated, mine)
    return found if named.off_px < HARMFUL_PX else named


def _matches(pair: Pair, some: Geometry, whole: Geometry) -> _Matches:
    """A sample of some matches of a pair; the noise is estimated from all of them (`whole`)."""
    off = np.abs(sampson_distance(whole.F, whole.x1, whole.x2))
    noise_px = max(1.4826 * float(np.median(off)), LEAST_NOISE_PX)
    rows = np.linspace(0, len(some.x1) - 1, min(SAMPLE, len(some.x1))).astype(np.int64)
    x1, x2 = some.x1[rows], some.x2[rows]
    own = float(_cauchy(sampson_distance(whole.F, x1, x2) / noise_px).mean())
    return _Matches(pair, x1, x2, noise_px, own)


def _cauchy(residuals: Float64s) -> Float64s:
    """Cauchy loss: squares of residuals, whose weight decreases beyond `OUTLIER`."""
    return np.asarray(OUTLIER**2 * np.log1p((residuals / OUTLIER) ** 2), dtype=np.float64)


def _residuals(world: _World, matches: _Matches) -> Float64s:
    """Distances (n,) of matches to the epipolar lines, in standard deviations."""
    left, right = (world[name] for name in matches.pair)
    F = fundamental_from_cameras(left.camera, right.camera)
    return sampson_distance(F, left.straight(matches.x1), right.straight(matches.x2)) / matches.noise_px


def _median(world: _World, matches: _Matches) -> float:
    """Median distance of the matches to the epipolar lines, in standard deviations."""
    return float(np.median(np.abs(_residuals(world, matches))))


def _mean(evidence: list[_Matches], values: list[float]) -> float:
    """Mean over pairs, weighted by their number of matches, up to `COUNTED`."""
    return float(np.average(values, weights=[min(len(m.x1), COUNTED) for m in evidence]))


def _loss(world: _World, evidence: list[_Matches]) -> float:
    return _mean(evidence, [float(_cauchy(_residuals(world, m)).mean()) for m in evidence])


def _excess(world: _World, evidence: list[_Matches], errors: float = 0.0) -> float:
    """The loss, except that pairs which agree with the world count with the loss under their own geometry.

    errors: tolerance of agreement, in standard errors of the median.
    """
    most = [AGREEING + errors * MEDIAN_ERROR / sqrt(len(m.x1)) for m in evidence]
    agrees = [_median(world, m) <= limit for m, limit in zip(evidence, most, strict=True)]
    return _mean(evidence, [m.own_loss if same else _loss(world, [m]) for m, same in zip(evidence, agrees, strict=True)])


def _explains(best: _Explanation, loss: float, own: float, evidence: list[_Matches], alone: bool) -> bool:
    """Does a cause restore the fit that the matches have under their own geometry?"""
    times, share = (LEAST_LOSS_RATIO_UNCONFIRMED, LEAST_SHARE_UNCONFIRMED) if alone else (LEAST_LOSS_RATIO, LEAST_SHARE)
    gained, count = loss - best.loss, sum(min(len(m.x1), COUNTED) for m in evidence)
    return loss > times * best.loss and gained >= share * (loss - min(own, best.loss)) and gained * count >= LEAST_LOSS


def _off_px(stated: _World, right: _World, evidence: list[_Matches]) -> float:
    """Motion of points along the epipolar lines between two worlds, and towards these lines, in pixels: median over the matches
    of the pairs that change; `FARTHEST_PX` for points behind a camera."""
    found = []
    for matches in evidence:
        if all(stated[name] is right[name] for name in matches.pair):
            continue
        (z, gain), (other, _) = (_depths(world, matches) for world in (stated, right))
        before, after = (np.abs(_residuals(world, matches)) * matches.noise_px for world in (stated, right))
        with np.errstate(invalid="ignore", divide="ignore"):
            along = np.minimum(np.nan_to_num(np.abs(z - other) / gain, nan=FARTHEST_PX), FARTHEST_PX)
        found.append(np.hypot(along, before - after))
    return float(np.median(np.concatenate(found))) if found else 0.0


def _is_felt(stated: _World, right: _World, evidence: list[_Matches]) -> bool:
    """Do points move noticeably in another world, along their rays or because these turn?"""
    seen = [(stated[name], right[name], x) for m in evidence for name, x in zip(m.pair, (m.x1, m.x2), strict=True)]
    turns = [ray_angles(*(rays(each.camera, each.straight(x)).T for each in two)) * two[0].camera.K[0, 0] for *two, x in seen]
    width = np.mean([one.camera.width for one, *_ in seen])
    return bool(
        _off_px(stated, right, evidence) >= LEAST_MOTION_ALONG * width or np.median(np.concatenate(turns)) >= LEAST_TURN * width
    )


def _depths(world: _World, matches: _Matches) -> tuple[Float64s, Float64s]:
    left, right = (world[name] for name in matches.pair)
    return triangulate_depth(left.camera, right.camera, left.straight(matches.x1), right.straight(matches.x2))


def _explanation(stated: _World, evidence: list[_Matches], own: float, alone: bool) -> _Explanation | None:
    """The cause that explains the matches best, or the simplest of those about as good; None if it explains too little."""
    found = [_fit(cause, stated, evidence) for cause in _causes(stated, evidence, alone)]
    loss = _loss(stated, evidence)
    best = _simplest(found, loss)
    return best if _explains(best, loss, own, evidence, alone) else None


def _simplest(found: list[_Explanation], loss: float, slack: float = 0.1) -> _Explanation:
    """The simplest of the causes that explain about as much of a loss as any; slack: tolerated share of the remaining loss."""
    least = min(explanation.loss for explanation in found)
    enough = least + max(slack * least, 0.05 * (loss - least))
    return min(found, key=lambda e: (e.loss > enough, len(e.cause.about), e.loss))


def _fit(cause: _Cause, stated: _World, evidence: list[_Matches]) -> _Explanation:
    """The amount of a cause that fits the matches best, by Gauss-Newton steps on a loss whose scale tightens."""
    mine = [m for m in evidence if not cause.cameras or set(cause.cameras) & set(m.pair)]
    amount, damping, scale = np.zeros(len(cause.about)), 1e-3, np.inf

    def residuals(at: Float64s, about: str = "") -> list[Float64s]:
        world = cause.change(stated, at)
        return [_residuals(world, m) if not about or about in m.pair else off[k] for k, m in enumerate(mine)]

    off: list[Float64s] = []
    off = residuals(amount)
    for _ in range(STEPS if len(amount) else 0):
        all_off = np.concatenate(off)
        scale = min(scale, max(OUTLIER, 1.5 * float(np.median(np.abs(all_off)))))
        cost = float(np.log1p((all_off / scale) ** 2).sum())
        rows = zip(cause.about, 1e-6 * np.eye(len(amount)), strict=True)
        slope = np.stack([(np.concatenate(residuals(amount + row, about)) - all_off) / 1e-6 for about, row in rows], axis=1)
        weight = 1 / (1 + (all_off / scale) ** 2)
        normal, right = slope.T @ (slope * weight[:, None]), slope.T @ (weight * all_off)
        step = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-9), -right)
        ahead = residuals(amount + step)
        if float(np.log1p((np.concatenate(ahead) / scale) ** 2).sum()) < cost:
            amount, off, damping = amount + step, ahead, max(damping / 10, 1e-9)
        elif (damping := damping * 10) > 1e3:
            break
        if np.linalg.norm(step) < 1e-7 and scale <= OUTLIER:
            break
    world = cause.change(stated, amount)
    return _Explanation(cause, amount, world, _loss(world, evidence))


def _causes(stated: _World, evidence: list[_Matches], alone: bool) -> Iterator[_Cause]:
    """Possible causes, the likeliest first."""
    seen = sorted({name for m in evidence for name in m.pair})
    size, still = _size(stated, evidence), np.zeros(3)

    def of_all(name: str, unknowns: int, change: _Change) -> _Cause:
        return _Cause(name, lambda w, a: _of_all(change, w, a), ("",) * unknowns)

    def of_one(name: str, unknowns: int, change: _Change, camera: str) -> _Cause:
        return _Cause(name, lambda w, a: {**w, camera: change(w[camera], a)}, (camera,) * unknowns, (camera,))

    def of_two(name: str, keys: tuple[str, ...], one: str, other: str) -> _Cause:
        return _Cause(
            name, lambda w, a: {**w, one: _like(w[one], w[other], keys), other: _like(w[other], w[one], keys)}, (), (one, other)
        )

    yield of_all("focal-lengths", 1, _zoomed)
    yield of_all("distortion", 1, _distorted)
    if any(_has_distortion(one.camera) for one in stated.values()):
        yield of_all("distortion-factor", 1, _distortion_scaled)
    if alone:
        return
    yield of_all("pixel-shape", 1, lambda one, a: _zoomed(one, np.append(a, 0.0)))
    yield of_all("pixel-height", 1, lambda one, a: _zoomed(one, np.append(0.0, a)))
    yield of_all(CORNER, 0, lambda one, _: _shifted_px(one, CORNER_PX))
    yield of_all("principal-points", 2, _shifted)
    yield of_all("focal-lengths-and-distortion", 2, lambda one, a: _distorted(_zoomed(one, a[:1]), a[1:]))
    for axis, name in enumerate(STRETCHED):
        yield of_all(name, 1, lambda one, a, axis=axis: _stretched(one, axis, a))  # type: ignore[misc]
    for name, change in CONVENTIONS.items():
        yield of_all(name, 0, lambda one, a, c=change: replace(one, camera=c(one.camera)))  # type: ignore[misc]
    for name in seen:
        if len({m.pair for m in evidence if name in m.pair}) < 2:  # matches of one pair may be look-alikes
            continue
        yield of_one("focal-length", 1, _zoomed, name)
        yield of_one("distortion-of-one", 1, _distorted, name)
        yield of_one("turned", 3, lambda one, a: _posed(one, np.append(a, still), size), name)
        yield of_one("moved", 3, lambda one, a: _posed(one, np.append(still, a), size), name)
        for convention in ("mirrored-frames", "upside-down"):
            yield of_one(convention, 0, lambda one, a, c=convention: replace(one, camera=CONVENTIONS[c](one.camera)), name)  # type: ignore[misc]
    if len(seen) <= LARGEST_SITE:
        for step in (1, -1) if len(stated) > 2 else ():
            yield _Cause("captures-exchanged", lambda w, _, step=step: _moved_on(w, step))  # type: ignore[misc]
        for one, other in combinations(seen, 2):
            for name, keys in EXCHANGED.items():
                yield of_two(name, keys, one, other)


def _moved_on(world: _World, step: int) -> _World:
    """Each camera takes the place of the next one, as when a recorder numbers its inputs from another start."""
    names = list(world)
    others = [names[(k + step) % len(names)] for k in range(len(names))]
    keys = EXCHANGED["captures-exchanged"]
    return {name: _like(world[name], world[other], keys) for name, other in zip(names, others, strict=True)}


def _size(stated: _World, evidence: list[_Matches]) -> float:
    """Median distance between the two cameras of a pair."""
    return float(np.median([np.linalg.norm(stated[a].camera.C - stated[b].camera.C) for a, b in (m.pair for m in evidence)]))


def _posed(one: _Seen, amount: Float64s, size: float) -> _Seen:
    """The camera rotated and shifted; amount: rotation vector (3), and shift (3) in units of `size`."""
    camera = one.camera
    return replace(one, camera=replace(camera, R=rotation_matrix(amount[:3]) @ camera.R, C=camera.C + size * amount[3:]))


def _zoomed(one: _Seen, logs: Float64s) -> _Seen:
    """The camera with scaled focal lengths; logs: log factor of both, or of the horizontal and the vertical one."""
    K = one.camera.K.copy()
    K[[0, 1], [0, 1]] *= np.exp(np.clip(logs, -LARGEST_ZOOM, LARGEST_ZOOM))
    return replace(one, camera=replace(one.camera, K=K))


def _distorted(one: _Seen, k1: Float64s) -> _Seen:
    return replace(one, k1=float(k1[0]))


def _has_distortion(camera: Camera) -> bool:
    return camera.lens is None and bool(camera.distortion.any())


def _distortion_scaled(one: _Seen, more: Float64s) -> _Seen:
    """The camera with the stated distortion times 1 + `more`."""
    camera = one.camera
    bent = replace(camera, distortion=camera.distortion * (1 + more[0]))
    return replace(one, camera=bent, stated=camera) if _has_distortion(camera) else one


def _shifted(one: _Seen, share: Float64s) -> _Seen:
    """The camera with a shifted principal point; share: of the width."""
    K = one.camera.K.copy()
    K[:2, 2] += share * one.camera.width
    return replace(one, camera=replace(one.camera, K=K))


def _shifted_px(one: _Seen, pixels: Float64s) -> _Seen:
    return _shifted(one, pixels / one.camera.width)


def _of_all(change: _Change, world: _World, amount: Float64s) -> _World:
    return {name: change(one, amount) for name, one in world.items()}


def _like(one: _Seen, other: _Seen, keys: tuple[str, ...]) -> _Seen:
    """The camera with parts of another one."""
    was, alike = one.camera, replace(one.camera, **{key: getattr(other.camera, key) for key in keys})
    bent = "distortion" in keys and was.lens is None and other.camera.lens is None
    return replace(one, camera=alike, stated=was if bent and (_has_distortion(was) or _has_distortion(other.camera)) else None)


def _stretched(one: _Seen, axis: int, log: Float64s) -> _Seen:
    """The camera with its position stretched along an axis; log: logarithm of the factor."""
    C = one.camera.C.copy()
    C[axis] *= np.exp(np.clip(log[0], -LARGEST_ZOOM, LARGEST_ZOOM))
    return replace(one, camera=replace(one.camera, C=C))


def _flipped(camera: Camera, axes: int) -> Camera:
    """The camera for frames that are mirrored, or with two axes turned by half a turn."""
    K, size = camera.K.copy(), (camera.width, camera.height)
    for k in range(axes):
        K[k, k], K[k, 2] = -K[k, k], size[k] - 1 - K[k, 2]
    return replace(camera, K=K)


_DOWN = np.diag([1.0, -1.0, -1.0])
CONVENTIONS: Mapping[str, Callable[[Camera], Camera]] = {
    "mirrored-x": lambda c: replace(c, C=c.C * (-1, 1, 1)),
    "mirrored-y": lambda c: replace(c, C=c.C * (1, -1, 1)),
    "mirrored-z": lambda c: replace(c, C=c.C * (1, 1, -1)),
    "axes-exchanged": lambda c: replace(c, C=c.C[[1, 0, 2]]),
    "t-for-positions": lambda c: replace(c, C=-c.R.T @ c.C),
    "rotations-transposed": lambda c: replace(c, R=c.R.T),
    "rotations-opengl": lambda c: replace(c, R=_DOWN @ c.R),
    "rotations-transposed-opengl": lambda c: replace(c, R=_DOWN @ c.R.T),
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
