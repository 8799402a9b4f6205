"""Is the stated calibration right as a whole?  The cameras that the site states, held against the matches of the night.

A stale calibration file, a lens whose distortion was left out, a zoom that nobody wrote down: all cameras are wrong together, so
no camera stands out against the others, and every pair is made dense along rows that are wrong.  Matches tell it all the same:
under right cameras they lie as near to the epipolar lines as to those of a fundamental matrix of their own.  Where they do not,
a few causes with one to three unknowns each are fitted to them, and the one that brings them back is named.

Matches of two cameras alone may show look-alikes, which lie on lines of their own as well.  So what counts are the matches that
the way over a third camera confirms; where there are none, only a cause that all cameras share is believed, and only where it
explains nearly everything.

References
----------
Loss: Cauchy, see Black & Anandan, The Robust Estimation of Multiple Motions, 1996.  Distance: Hartley & Zisserman, eq. 11.9.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..core.rotations import rotation_matrix
from ..twoview.epipolar import fundamental_from_cameras, sampson_distance, triangulate_depth
from ..types import CalibrationCheck, Camera, Float64s, Geometry, Pair
from .pose_check import BELIEVED, MIN_SHARED
from .triplet_consistency import consistent_matches

FEWEST_CONFIRMED = 15
"""A pair with fewer confirmed matches says nothing."""
SAMPLE = 150
"""So many matches of a pair are looked at: more of them err together."""
LEAST_NOISE_PX = 0.2
"""No picture tells places better."""
OUTLIER = 3.0
"""Scale of the loss, in standard deviations."""
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
HARMFUL_PX = 0.4
"""Cameras that move points by less than this (median, in pixels along the epipolar line) spoil no cloud."""
FARTHEST_PX = 1e4
LARGEST_SITE = 12
"""Exchanged poses are looked for among so many cameras at most."""
LARGEST_ZOOM = 3.0
"""Logarithm of the largest factor of focal lengths that is tried."""
STEPS = 20


@dataclass(frozen=True)
class _Matches:
    """Matches of a pair, and the standard deviation of their distance to the lines of their own fundamental matrix."""

    pair: Pair
    x1: Float64s
    x2: Float64s
    noise_px: float
    own_loss: float
    """Mean loss under that matrix."""


@dataclass(frozen=True)
class _World:
    """Cameras, and a radial distortion that is left in their frames."""

    cameras: Mapping[str, Camera]
    k1: float = 0.0

    def residuals(self, matches: _Matches) -> Float64s:
        """Distances (n,) of matches to the epipolar lines, in standard deviations."""
        left, right = (self.cameras[name] for name in matches.pair)
        F = fundamental_from_cameras(left, right)
        return sampson_distance(F, self.straight(left, matches.x1), self.straight(right, matches.x2)) / matches.noise_px

    def straight(self, camera: Camera, x: Float64s) -> Float64s:
        """Pixels without the distortion that was left in."""
        if self.k1 == 0:
            return x
        focal = np.array([camera.K[0, 0], camera.K[1, 1]])
        ray = (x - camera.K[:2, 2]) / focal
        return np.asarray(camera.K[:2, 2] + ray * (1 - self.k1 * (ray**2).sum(axis=1, keepdims=True)) * focal, dtype=np.float64)


@dataclass(frozen=True)
class _Cause:
    """Something that may be wrong with the stated cameras, with `unknowns` numbers; zeros: as stated."""

    name: str
    unknowns: int
    world: Callable[[Float64s], _World]
    cameras: tuple[str, ...] = ()
    """Those that it is about; () for all."""


@dataclass(frozen=True)
class _Explanation:
    cause: _Cause
    amount: Float64s
    loss: float
    """Mean over all matches."""


def check_calibration(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> CalibrationCheck | None:
    """Compare stated cameras with the matches of the night; None where too few matches can tell.

    Parameters
    ----------
    cameras
        As the site states them, at working resolution, by id, in the order of the site.
    geometries
        Matches of the pairs, without the stated distortion.
    """
    believed = {
        pair: geometry
        for pair, geometry in geometries.items()
        if set(pair) <= set(cameras) and geometry.good_probability >= BELIEVED and len(geometry.x1) >= MIN_SHARED
    }
    confirmed = _confirmed(tuple(cameras), believed)
    evidence = confirmed or [_matches(pair, geometry, geometry) for pair, geometry in believed.items()]
    if not evidence:
        return None
    stated = _World(cameras)
    loss, own = _loss(stated, evidence), float(_mean(evidence, [m.own_loss for m in evidence]))
    count = sum(len(m.x1) for m in evidence)
    found = CalibrationCheck(matches=count, pairs=len(evidence), confirmed=bool(confirmed), misfit=loss / max(own, 1e-9))
    best = _explanation(stated, evidence, alone=not confirmed)
    if best is not None and _explains(best, loss, own, evidence, alone=not confirmed):
        off_px = _off_px(stated, best.cause.world(best.amount), evidence)
        if not off_px < HARMFUL_PX:
            amount = tuple(float(a) for a in best.amount)
            return replace(
                found,
                contradicted=True,
                cause=best.cause.name,
                cameras=best.cause.cameras,
                amount=amount,
                better=loss / best.loss,
                off_px=off_px,
            )
    return replace(found, contradicted=bool(confirmed) and loss > CONTRADICTED * own)


def _confirmed(names: tuple[str, ...], believed: Mapping[Pair, Geometry]) -> list[_Matches]:
    """The pairs of which third cameras confirm enough matches, with these alone.  names: in the order of the pairs' sides."""
    number = {name: k for k, name in enumerate(names)}
    edges = {(number[a], number[b]): geometry for (a, b), geometry in believed.items()}
    found = []
    for (i, j), some in consistent_matches(edges).items():
        if len(some.x1) >= FEWEST_CONFIRMED:
            found.append(_matches((names[i], names[j]), some, edges[i, j]))
    return found


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


def _mean(evidence: list[_Matches], values: list[float]) -> float:
    """Mean over pairs, each by its number of matches."""
    return float(np.average(values, weights=[min(len(m.x1), COUNTED) for m in evidence]))


def _loss(world: _World, evidence: list[_Matches]) -> float:
    return _mean(evidence, [float(_cauchy(world.residuals(m)).mean()) for m in evidence])


def _explains(best: _Explanation, loss: float, own: float, evidence: list[_Matches], alone: bool) -> bool:
    """Does a cause bring the matches back to where their own geometry has them?"""
    times, share = (EXPLAINED_ALONE, SHARE_ALONE) if alone else (EXPLAINED, SHARE)
    gained = loss - best.loss
    total = gained * sum(min(len(m.x1), COUNTED) for m in evidence)
    return loss > times * best.loss and gained >= share * (loss - min(own, best.loss)) and total >= LEAST_LOSS


def _off_px(stated: _World, right: _World, evidence: list[_Matches]) -> float:
    """How far points move along the epipolar lines between two worlds, in pixels: median over the matches of the pairs that
    change; `FARTHEST_PX` where they lie behind a camera."""
    found = []
    for matches in evidence:
        if all(stated.cameras[n] is right.cameras[n] for n in matches.pair) and right.k1 == stated.k1:
            continue
        (z, gain), (other, _) = (_depths(world, matches) for world in (stated, right))
        with np.errstate(invalid="ignore", divide="ignore"):
            found.append(np.minimum(np.nan_to_num(np.abs(z - other) / gain, nan=FARTHEST_PX), FARTHEST_PX))
    return float(np.median(np.concatenate(found))) if found else 0.0


def _depths(world: _World, matches: _Matches) -> tuple[Float64s, Float64s]:
    left, right = (world.cameras[name] for name in matches.pair)
    return triangulate_depth(left, right, world.straight(left, matches.x1), world.straight(right, matches.x2))


def _explanation(stated: _World, evidence: list[_Matches], alone: bool) -> _Explanation | None:
    """The cause that explains the matches best; of those that do so about as well the simplest."""
    found = [_fit(cause, evidence) for cause in _causes(stated, evidence, alone)]
    if not found:
        return None
    least = min(explanation.loss for explanation in found)
    return min(found, key=lambda e: (e.loss > 1.1 * least, e.cause.unknowns, e.loss))


def _fit(cause: _Cause, evidence: list[_Matches]) -> _Explanation:
    """The amount of a cause that fits the matches best: Gauss-Newton steps on a loss that tightens as it goes."""
    mine = [m for m in evidence if not cause.cameras or set(cause.cameras) & set(m.pair)]
    amount, damping = np.zeros(cause.unknowns), 1e-3

    def residuals(at: Float64s) -> Float64s:
        world = cause.world(at)
        return np.concatenate([world.residuals(m) for m in mine])

    off = residuals(amount)
    scale = np.inf
    for _ in range(STEPS if cause.unknowns else 0):
        scale = min(scale, max(OUTLIER, 1.5 * float(np.median(np.abs(off)))))
        cost = float(np.log1p((off / scale) ** 2).sum())
        slope = np.stack([(residuals(amount + 1e-6 * row) - off) / 1e-6 for row in np.eye(cause.unknowns)], axis=1)
        weight = 1 / (1 + (off / scale) ** 2)
        normal, right = slope.T @ (slope * weight[:, None]), slope.T @ (weight * off)
        step = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-12), -right)
        ahead = residuals(amount + step)
        if float(np.log1p((ahead / scale) ** 2).sum()) < cost:
            amount, off, damping = amount + step, ahead, max(damping / 10, 1e-9)
        elif (damping := damping * 10) > 1e3:
            break
        if np.linalg.norm(step) < 1e-7 and scale <= OUTLIER:
            break
    return _Explanation(cause, amount, _loss(cause.world(amount), evidence))


def _causes(stated: _World, evidence: list[_Matches], alone: bool) -> Iterator[_Cause]:
    """What may be wrong, the likeliest first."""
    cameras = stated.cameras
    seen = sorted({name for m in evidence for name in m.pair})
    size = float(np.median([np.linalg.norm(cameras[a].C - cameras[b].C) for a, b in (m.pair for m in evidence)]))

    def everywhere(change: Callable[[Camera], Camera], k1: float = 0.0) -> _World:
        return _World({name: change(camera) for name, camera in cameras.items()}, k1)

    def only(name: str, change: Callable[[Camera], Camera]) -> _World:
        return _World({**cameras, name: change(cameras[name])})

    yield _Cause("focal-lengths", 1, lambda a: everywhere(lambda c: _zoomed(c, a[0])))
    yield _Cause("distortion", 1, lambda a: everywhere(lambda c: c, a[0]))
    if alone:
        return
    yield _Cause("principal-points", 2, lambda a: everywhere(lambda c: _shifted(c, a)))
    yield _Cause("focal-lengths-and-distortion", 2, lambda a: everywhere(lambda c: _zoomed(c, a[0]), a[1]))
    for name in seen:
        if len({m.pair for m in evidence if name in m.pair}) < 2:  # one pair may show look-alikes
            continue
        yield _Cause("focal-length", 1, lambda a, n=name: only(n, lambda c: _zoomed(c, a[0])), (name,))  # type: ignore[misc]
        yield _Cause("turned", 3, lambda a, n=name: only(n, lambda c: replace(c, R=rotation_matrix(a) @ c.R)), (name,))  # type: ignore[misc]
        yield _Cause("moved", 3, lambda a, n=name: only(n, lambda c: replace(c, C=c.C + size * a)), (name,))  # type: ignore[misc]
    for axis in range(3):
        sign = np.where(np.arange(3) == axis, -1.0, 1.0)
        yield _Cause(f"mirrored-{'xyz'[axis]}", 0, lambda a, s=sign: everywhere(lambda c: replace(c, C=c.C * s)))  # type: ignore[misc]
    for one, other in combinations(seen, 2) if len(seen) <= LARGEST_SITE else ():
        yield _Cause("exchanged", 0, lambda a, n=one, m=other: _exchanged(cameras, n, m), (one, other))  # type: ignore[misc]


def _zoomed(camera: Camera, log_scale: float) -> Camera:
    K = camera.K.copy()
    K[:2, :2] *= np.exp(np.clip(log_scale, -LARGEST_ZOOM, LARGEST_ZOOM))
    return replace(camera, K=K)


def _shifted(camera: Camera, share: Float64s) -> Camera:
    """share: of the focal length."""
    K = camera.K.copy()
    K[:2, 2] += share * K[0, 0]
    return replace(camera, K=K)


def _exchanged(cameras: Mapping[str, Camera], one: str, other: str) -> _World:
    a, b = cameras[one], cameras[other]
    return _World({**cameras, one: replace(a, R=b.R, C=b.C), other: replace(b, R=a.R, C=a.C)})
