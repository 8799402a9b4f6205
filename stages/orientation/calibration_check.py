"""Is the stated calibration right as a whole?  The cameras that the site states, held against the matches of the night.

A stale calibration file, a lens whose distortion was left out, a zoom that nobody wrote down: all cameras are wrong together, so
no camera stands out against the others, and every pair is made dense along rows that are wrong.  Matches tell it all the same:
under right cameras they lie as near to the epipolar lines as to those of a fundamental matrix of their own.  Where they do not,
a few causes with one to three unknowns each are fitted to them, and the one that brings them back is named.

Matches of two cameras alone may show look-alikes, which lie on lines of their own as well.  So what counts are the matches that
the way over a third camera confirms; where there are none, only a cause that all cameras share is believed, and only where it
explains nearly everything.  What is slightly wrong shows later, in what dense matching measures beside the rows.

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
from .pose_check import BELIEVED, MIN_SHARED

FEWEST_CONFIRMED = 15
"""A pair with fewer confirmed matches says nothing."""
SAMPLE = 150
"""So many matches of a pair are looked at: more of them err together."""
LEAST_NOISE_PX = 0.2
"""No picture tells places better."""
OUTLIER = 3.0
"""Scale of the loss, in standard deviations."""
AGREEING = 0.8
"""A pair of whose matches half lie nearer to the stated lines than this, in standard deviations, agrees with these: what lies
elsewhere are look-alikes, even those that a third camera confirms (right cameras: 0.15 to 0.76, in a car park 0.69 with a quarter
of the matches elsewhere; focal lengths 3 % too long: 0.8 to 7.6)."""
MEDIAN_ERROR = 0.79
"""Standard error of the median distance of normal deviates from 0, times the root of their number."""
CONTRADICTED = 1.6
"""Confirmed matches whose loss under the stated cameras is so many times that under their own geometry contradict these."""
EXPLAINED, EXPLAINED_ALONE = 1.12, 1.5
"""A cause is named where the loss under the stated cameras is so many times the loss with it: of confirmed matches,
of others..."""
SHARE, SHARE_ALONE = 0.6, 0.8
"""...and where it takes away this share of what the stated cameras lose over the matches' own geometry..."""
LEAST_LOSS = 30.0
"""...and in all so many squared standard deviations (the matches of a pair count as `COUNTED` at most)."""
COUNTED = 50
STRAYED, LED_BACK = 1.6, 2
"""Of pairs whose matches nobody confirms some are look-alikes, which no cause leads back to the lines.  Pairs whose median
distance is more than so many standard deviations have strayed: a cause is named that leads so many, and half of them, back to
half of that distance or less, and no other pair away."""
HARMFUL_PX = 0.4
"""Cameras that move points by less than this (median, in pixels along and across the epipolar line) spoil no cloud."""
FARTHEST_PX = 1e4
LARGEST_SITE = 12
"""Exchanged poses are looked for among so many cameras at most."""
LARGEST_ZOOM = 3.0
"""Logarithm of the largest factor of focal lengths that is tried."""
STEPS = 20
STRETCHED, LEAST_STRETCH = ("stretched-x", "stretched-y", "stretched-z"), 0.02
"""No survey is off by less along one axis alone; what matches ask for on a harbour, all of whose poses are right, is 0.009."""
CORNER = "principal-points-corner"
CORNER_PX = np.array([-0.5, -0.5])
"""What principal points lack that are counted from the corner of the first pixel, not from its centre."""
FITS = 3.0
"""Standard errors of the median that are granted to pairs which agree with the stated lines."""
FEWEST_PAIRS = 4
"""Rows of fewer tell too little of what they have in common."""
FEWEST_TILES, LEAST_GAIN = 4, 15.0
"""What dense matching measures across the rows of a pair says something with so many matches, and blames a cause that takes away
so many squared standard deviations: 140 unharmed nights of nine scenes have 10 at most, focal lengths 1.5 % too long 14 to
137..."""
OF_ONE, ALONG, ASIDE = 1.25e-3, 6e-4, 2e-3
"""...if it moves points by these shares of the width: of one camera (four photographs with true cameras: 6e-4), or of all,
along the lines; or turns rays by the last."""


@dataclass(frozen=True)
class _Matches:
    """Matches of a pair, and the standard deviation of their distance to the lines of their own fundamental matrix."""

    pair: Pair
    x1: Float64s
    x2: Float64s
    noise_px: float | Float64s
    own_loss: float
    """Mean loss under that matrix."""


@dataclass(frozen=True)
class _Seen:
    """A camera, and what is wrong with the distortion that was taken off its frames."""

    camera: Camera
    k1: float = 0.0
    """Radial distortion that is left in."""
    stated: Camera | None = None
    """Whose distortion was taken off, by its K, in place of the camera's own; None: the right one was."""

    def straight(self, x: Float64s) -> Float64s:
        """Pixels as they would be without distortion."""
        if self.k1 == 0 and self.stated is None:
            return x
        K = self.camera.K
        focal = np.array([K[0, 0], K[1, 1]])
        ray = (x - K[:2, 2]) / focal if self.stated is None else _bent_otherwise(x, self.stated, self.camera)
        return np.asarray(K[:2, 2] + ray * (1 - self.k1 * (ray**2).sum(axis=1, keepdims=True)) * focal, dtype=np.float64)


def _bent_otherwise(x: Float64s, stated: Camera, right: Camera) -> Float64s:
    """Normalised coordinates (n, 2), by the right camera, of pixels whose distortion was taken off as the stated one has it."""
    ray = np.column_stack([(x - stated.K[:2, 2]) / stated.K[[0, 1], [0, 1]], np.ones(len(x))])
    captured = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), stated.K, stated.distortion)[0]
    return np.asarray(cv2.undistortPoints(captured, right.K, right.distortion)[:, 0], dtype=np.float64)


_World = Mapping[str, _Seen]
_Change = Callable[[_Seen, Float64s], _Seen]


@dataclass(frozen=True)
class _Cause:
    """Something that may be wrong with the stated cameras.  Zeros: as stated."""

    name: str
    change: Callable[[_World, Float64s], _World]
    about: tuple[str, ...] = ()
    """The camera that each unknown is about; "" for all."""
    cameras: tuple[str, ...] = ()
    """Those that it is about; () for all."""


@dataclass(frozen=True)
class _Explanation:
    cause: _Cause
    amount: Float64s
    world: _World
    loss: float
    """Mean over all matches."""


def check_calibration(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> CalibrationCheck | None:
    """Compare stated cameras with the matches of the night; None where too few matches can tell.

    cameras: as the site states them, at working resolution, by id.  geometries: matches of the pairs, without the stated
    distortion; those of other cameras confirm matches.
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
    """The misfit of confirmed matches that is left once the likeliest cause that all cameras share is mended.

    cameras, geometries: as of `check_calibration`.
    """
    stated = {name: _Seen(camera) for name, camera in cameras.items()}
    confirmed, _ = _evidence(stated, geometries)
    shared = [cause for cause in _causes(stated, confirmed, alone=False) if cause.about and not cause.cameras]
    return min(_fit(cause, stated, confirmed).loss for cause in shared) / _mean(confirmed, [m.own_loss for m in confirmed])


def check_rows(cameras: Mapping[str, Camera], rows: Mapping[Pair, RowMatches]) -> CalibrationCheck | None:
    """Compare stated cameras with what dense matching measures across their rows; None where too few pairs can tell.

    These matches are ten times as exact as keypoints, and show no look-alikes, so that they tell what is slightly wrong.

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
    explains = best.cause.name == "principal-points" and loss - half.loss >= SHARE_ALONE * (loss - best.loss)
    if explains and 0.25 <= half.amount[0] <= 1.25:  # partners that are found lie nearer to the rows than right ones
        best = half
    gained, tiles = max(count * (loss - best.loss), 0.0), sum(len(m.x1) for m in evidence)
    found = CalibrationCheck(tiles, len(evidence), True, misfit=loss / max(best.loss, 1e-9), sigmas=sqrt(gained))
    return _named(found, best, stated, evidence) if gained >= LEAST_GAIN and _matters(best, stated, evidence) else found


def _matters(best: _Explanation, stated: _World, evidence: list[_Matches]) -> bool:
    """Is what rows blame more than a survey and lenses always leave?"""
    name = best.cause.name
    if name == CORNER:
        return True  # however little it moves: it is half a pixel or nothing
    if best.cause.cameras:
        return _off_px(stated, best.world, evidence) >= OF_ONE * next(iter(stated.values())).camera.width
    return (name not in STRETCHED or abs(best.amount[0]) >= LEAST_STRETCH) and _is_felt(stated, best.world, evidence)


def _evidence(stated: _World, geometries: Mapping[Pair, Geometry]) -> tuple[list[_Matches], list[_Matches]]:
    """The matches of pairs of stated cameras that third cameras confirm, and those of pairs of which these confirm too few."""
    enough = {pair: geometry for pair, geometry in geometries.items() if len(geometry.x1) >= MIN_SHARED}
    believed = {pair: geometry for pair, geometry in enough.items() if geometry.good_probability >= BELIEVED}
    mine = {pair: some for pair, some in consistent_matches(believed).items() if set(pair) <= set(stated)}
    known = {pair: some for pair, some in mine.items() if len(some.x1) >= FEWEST_CONFIRMED}
    confirmed = [_matches(pair, some, geometries[pair]) for pair, some in known.items()]
    return confirmed, [_matches(pair, geometries[pair], geometries[pair]) for pair in mine if pair not in known]


def _checked(stated: _World, confirmed: list[_Matches], others: list[_Matches]) -> CalibrationCheck:
    """What matches say that third cameras confirm; the others, where there are none."""
    evidence = confirmed or others
    loss, own = _loss(stated, evidence), _mean(evidence, [m.own_loss for m in evidence])
    count = sum(len(m.x1) for m in evidence)
    found = CalibrationCheck(matches=count, pairs=len(evidence), confirmed=bool(confirmed), misfit=loss / max(own, 1e-9))
    excess = _excess(stated, evidence)
    if excess <= EXPLAINED * own:
        return found
    beyond_noise = found.confirmed and excess > CONTRADICTED * own
    best = _explanation(stated, evidence, own, alone=not confirmed)
    if (best is None or best.cause.name in ("turned", "moved")) and _excess(stated, evidence, errors=FITS) <= EXPLAINED * own:
        best, beyond_noise = None, False  # few matches, most of which agree: another pose brings look-alikes back
    named = replace(found, contradicted=beyond_noise) if best is None else _named(found, best, stated, evidence)
    return named if beyond_noise or named.off_px >= HARMFUL_PX else found


def _named(found: CalibrationCheck, best: _Explanation, stated: _World, evidence: list[_Matches]) -> CalibrationCheck:
    """With the cause of the contradiction."""
    cause, amount, better = best.cause, tuple(float(a) for a in best.amount), _loss(stated, evidence) / best.loss
    off_px = _off_px(stated, best.world, evidence)
    return replace(found, contradicted=True, cause=cause.name, cameras=cause.cameras, amount=amount, better=better, off_px=off_px)


def _with_cause_of_most(found: CalibrationCheck, stated: _World, evidence: list[_Matches]) -> CalibrationCheck:
    """Name the cause that leads most pairs back to the lines of the stated cameras, if it is more than chance."""
    before = np.array([_median(stated, m) for m in evidence])
    strayed = before > STRAYED
    if strayed.sum() < LED_BACK:
        return found
    causes = [_fit(cause, stated, evidence) for cause in _causes(stated, evidence, alone=False)]
    after = np.array([[_median(explanation.world, m) for m in evidence] for explanation in causes])
    good = after <= STRAYED
    back = (strayed & good & (2 * after <= before)).sum(axis=1)
    able = (back >= LED_BACK) & (2 * back >= strayed.sum()) & (good | strayed).all(axis=1)
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
    """Some matches of a pair; all of them tell the noise."""
    off = np.abs(sampson_distance(whole.F, whole.x1, whole.x2))
    noise_px = max(1.4826 * float(np.median(off)), LEAST_NOISE_PX)
    rows = np.linspace(0, len(some.x1) - 1, min(SAMPLE, len(some.x1))).astype(np.int64)
    x1, x2 = some.x1[rows], some.x2[rows]
    own = float(_cauchy(sampson_distance(whole.F, x1, x2) / noise_px).mean())
    return _Matches(pair, x1, x2, noise_px, own)


def _cauchy(residuals: Float64s) -> Float64s:
    """Squares of residuals, with less and less weight for those beyond `OUTLIER`."""
    return np.asarray(OUTLIER**2 * np.log1p((residuals / OUTLIER) ** 2), dtype=np.float64)


def _residuals(world: _World, matches: _Matches) -> Float64s:
    """Distances (n,) of matches to the epipolar lines, in standard deviations."""
    left, right = (world[name] for name in matches.pair)
    F = fundamental_from_cameras(left.camera, right.camera)
    return sampson_distance(F, left.straight(matches.x1), right.straight(matches.x2)) / matches.noise_px


def _median(world: _World, matches: _Matches) -> float:
    """Distance to the lines, in standard deviations."""
    return float(np.median(np.abs(_residuals(world, matches))))


def _mean(evidence: list[_Matches], values: list[float]) -> float:
    """Mean over pairs, each by its number of matches."""
    return float(np.average(values, weights=[min(len(m.x1), COUNTED) for m in evidence]))


def _loss(world: _World, evidence: list[_Matches]) -> float:
    return _mean(evidence, [float(_cauchy(_residuals(world, m)).mean()) for m in evidence])


def _excess(world: _World, evidence: list[_Matches], errors: float = 0.0) -> float:
    """The loss, but for pairs that agree with the world: these have none beyond that under their own geometry.

    errors: standard errors of the median that are granted.
    """
    most = [AGREEING + errors * MEDIAN_ERROR / sqrt(len(m.x1)) for m in evidence]
    agrees = [_median(world, m) <= limit for m, limit in zip(evidence, most, strict=True)]
    return _mean(evidence, [m.own_loss if same else _loss(world, [m]) for m, same in zip(evidence, agrees, strict=True)])


def _explains(best: _Explanation, loss: float, own: float, evidence: list[_Matches], alone: bool) -> bool:
    """Does a cause bring the matches back to where their own geometry has them?"""
    times, share = (EXPLAINED_ALONE, SHARE_ALONE) if alone else (EXPLAINED, SHARE)
    gained, count = loss - best.loss, sum(min(len(m.x1), COUNTED) for m in evidence)
    return loss > times * best.loss and gained >= share * (loss - min(own, best.loss)) and gained * count >= LEAST_LOSS


def _off_px(stated: _World, right: _World, evidence: list[_Matches]) -> float:
    """How far points move along the epipolar lines between two worlds, and towards these, in pixels: median over the matches of
    the pairs that change; `FARTHEST_PX` where they lie behind a camera."""
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
    """Do points lie elsewhere in another world, farther along their rays, or because these turn?"""
    seen = [(stated[name], right[name], x) for m in evidence for name, x in zip(m.pair, (m.x1, m.x2), strict=True)]
    turns = [ray_angles(*(rays(each.camera, each.straight(x)).T for each in two)) * two[0].camera.K[0, 0] for *two, x in seen]
    width = np.mean([one.camera.width for one, *_ in seen])
    return bool(_off_px(stated, right, evidence) >= ALONG * width or np.median(np.concatenate(turns)) >= ASIDE * width)


def _depths(world: _World, matches: _Matches) -> tuple[Float64s, Float64s]:
    left, right = (world[name] for name in matches.pair)
    return triangulate_depth(left.camera, right.camera, left.straight(matches.x1), right.straight(matches.x2))


def _explanation(stated: _World, evidence: list[_Matches], own: float, alone: bool) -> _Explanation | None:
    """The cause that explains the matches best; of those that do so about as well the simplest."""
    found = [_fit(cause, stated, evidence) for cause in _causes(stated, evidence, alone)]
    loss = _loss(stated, evidence)
    best = _simplest(found, loss)
    return best if _explains(best, loss, own, evidence, alone) else None


def _simplest(found: list[_Explanation], loss: float, slack: float = 0.1) -> _Explanation:
    """The simplest of the causes that explain about as much of a loss as any.  slack: share of what is left that says nothing."""
    least = min(explanation.loss for explanation in found)
    enough = least + max(slack * least, 0.05 * (loss - least))
    return min(found, key=lambda e: (e.loss > enough, len(e.cause.about), e.loss))


def _fit(cause: _Cause, stated: _World, evidence: list[_Matches]) -> _Explanation:
    """The amount of a cause that fits the matches best: Gauss-Newton steps on a loss that tightens as it goes."""
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
    """What may be wrong, the likeliest first."""
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
    yield of_all("distortion", 1, _bent)
    if any(_is_bent(one.camera) for one in stated.values()):
        yield of_all("distortion-factor", 1, _bent_more)
    if alone:
        return
    yield of_all("pixel-shape", 1, lambda one, a: _zoomed(one, np.append(a, 0.0)))
    yield of_all("pixel-height", 1, lambda one, a: _zoomed(one, np.append(0.0, a)))
    yield of_all(CORNER, 0, lambda one, _: _shifted_px(one, CORNER_PX))
    yield of_all("principal-points", 2, _shifted)
    yield of_all("focal-lengths-and-distortion", 2, lambda one, a: _bent(_zoomed(one, a[:1]), a[1:]))
    for axis, name in enumerate(STRETCHED):
        yield of_all(name, 1, lambda one, a, axis=axis: _stretched(one, axis, a))  # type: ignore[misc]
    for name, change in CONVENTIONS.items():
        yield of_all(name, 0, lambda one, a, c=change: replace(one, camera=c(one.camera)))  # type: ignore[misc]
    for name in seen:
        if len({m.pair for m in evidence if name in m.pair}) < 2:  # one pair may show look-alikes
            continue
        yield of_one("focal-length", 1, _zoomed, name)
        yield of_one("distortion-of-one", 1, _bent, name)
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
    """Each camera is the next one: a recorder counts its inputs from another number."""
    names = list(world)
    others = [names[(k + step) % len(names)] for k in range(len(names))]
    keys = EXCHANGED["captures-exchanged"]
    return {name: _like(world[name], world[other], keys) for name, other in zip(names, others, strict=True)}


def _size(stated: _World, evidence: list[_Matches]) -> float:
    """Between two cameras, median."""
    return float(np.median([np.linalg.norm(stated[a].camera.C - stated[b].camera.C) for a, b in (m.pair for m in evidence)]))


def _posed(one: _Seen, amount: Float64s, size: float) -> _Seen:
    """amount: a turn and a move."""
    camera = one.camera
    return replace(one, camera=replace(camera, R=rotation_matrix(amount[:3]) @ camera.R, C=camera.C + size * amount[3:]))


def _zoomed(one: _Seen, logs: Float64s) -> _Seen:
    """logs: of the factors of both focal lengths, or of the horizontal and the vertical one."""
    K = one.camera.K.copy()
    K[[0, 1], [0, 1]] *= np.exp(np.clip(logs, -LARGEST_ZOOM, LARGEST_ZOOM))
    return replace(one, camera=replace(one.camera, K=K))


def _bent(one: _Seen, k1: Float64s) -> _Seen:
    return replace(one, k1=float(k1[0]))


def _is_bent(camera: Camera) -> bool:
    return camera.lens is None and bool(camera.distortion.any())


def _bent_more(one: _Seen, more: Float64s) -> _Seen:
    """The stated distortion, and so many times more of it."""
    camera = one.camera
    bent = replace(camera, distortion=camera.distortion * (1 + more[0]))
    return replace(one, camera=bent, stated=camera) if _is_bent(camera) else one


def _shifted(one: _Seen, share: Float64s) -> _Seen:
    """share: of the width."""
    K = one.camera.K.copy()
    K[:2, 2] += share * one.camera.width
    return replace(one, camera=replace(one.camera, K=K))


def _shifted_px(one: _Seen, pixels: Float64s) -> _Seen:
    return _shifted(one, pixels / one.camera.width)


def _of_all(change: _Change, world: _World, amount: Float64s) -> _World:
    return {name: change(one, amount) for name, one in world.items()}


def _like(one: _Seen, other: _Seen, keys: tuple[str, ...]) -> _Seen:
    """With parts of another camera."""
    was, alike = one.camera, replace(one.camera, **{key: getattr(other.camera, key) for key in keys})
    bent = "distortion" in keys and was.lens is None and other.camera.lens is None
    return replace(one, camera=alike, stated=was if bent and (_is_bent(was) or _is_bent(other.camera)) else None)


def _stretched(one: _Seen, axis: int, log: Float64s) -> _Seen:
    """log: of the factor of positions along an axis."""
    C = one.camera.C.copy()
    C[axis] *= np.exp(np.clip(log[0], -LARGEST_ZOOM, LARGEST_ZOOM))
    return replace(one, camera=replace(one.camera, C=C))


def _flipped(camera: Camera, axes: int) -> Camera:
    """Mirrored frames; with two axes: turned by half a turn."""
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
"""How calibrations are misread: what would be right of what is stated."""
EXCHANGED = {
    "exchanged": ("R", "C"),
    "captures-exchanged": ("K", "distortion", "R", "C"),
    "positions-exchanged": ("C",),
    "lenses-exchanged": ("K", "distortion"),
}
"""What two cameras may have of each other."""
