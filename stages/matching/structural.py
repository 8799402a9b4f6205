"""Match two keypoint sets by their descriptors *and* by the pattern they form (the default matcher).

The intent is that of Hao (2011), chapter 3: the structure of the whole set decides, rows and columns compete, an affine map
compensates the change of viewpoint, and a match must dominate its rivals.  Here the affine is local, one at every keypoint
(what that work names as its future), because one global map cannot follow a scene with depth:

1. candidates: the nearest few by descriptor, both ways;
2. seeds: mutual nearest neighbours that their own neighbours confirm, each through its keypoints' frames;
3. rounds of expectation and maximisation: confident matches give the local affine field; the field and the descriptors give the
   log odds of each candidate; Sinkhorn's balancing with a dustbin turns these into probabilities;
4. a match is accepted where its probability p dominates what is left to its rivals: p > dominance * (1 - p).

The same rounds with an epipolar term and the inliers as seeds are the guided matching of a pair whose F is known.  Pairs of views
far apart may bring in the keypoints of the frames compressed in x: plain with plain, tilted with plain, plain with tilted, under
one field.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from ..core.jit import kernel
from ..core.nearest_points import nearest_points
from ..features import PLAIN, TILTED
from ..types import Features, Float32s, Float64s, Int32s, Int64s
from .affine_field import AffineField, fit_affine_field
from .assignment import assign, without_repeats
from .neighbours import Neighbours, nearest_neighbours


@dataclass(frozen=True)
class Evidence:
    """Log odds of a candidate against "no partner", in nats.

    Without a field: `alone - alone_slope q`, q = descriptor distance over the local noise level of descriptors.
    With a field: `growing` (`final` in the last round) `- slope q` minus penalties `weight ln(1 + (error/scale)^2)` of the
    distance to the prediction (over its sigma), of the log scale (over 0.25) and of the angle (over 0.25 rad), and minus
    `sigma_weight ln(sigma / 2 px)`: a Student density of the distance, which is the lower the wider it is.
    With an epipolar line: `epipolar - epipolar_weight ln(1 + e^2)`, e in pixels.
    Fitted by maximum likelihood on the candidates of half of 68 pairs (photographed and rendered, truth by depth), so that p is a
    probability; `final` is less than what fits best, for precision.
    """

    alone: float = 15.0
    alone_slope: float = 14.2
    growing: float = 17.0
    final: float = 9.2
    slope: float = 5.5
    distance_weight: float = 1.4
    sigma_weight: float = 1.7
    scale_weight: float = 0.75
    angle_weight: float = 0.45
    epipolar: float = 1.5
    epipolar_weight: float = 1.2


EVIDENCE = Evidence()

NOISE_RANK = 2
"""The local noise level of a keypoint is its distance to the neighbour this many places after the last candidate."""
SEED_RATIO = 0.85
VOTERS = 24
VOTE_PX, VOTE_PER_PX, VOTE_RAD, VOTE_LOG_SCALE = 8.0, 0.3, 0.6, 0.8
"""A seed's neighbour confirms it within 8 px + 0.3 of their distance, 0.6 rad and a log scale of 0.8."""
MIN_SIGMA_PX, MAX_SIGMA_PX, MAX_RADIUS_PX = 2.0, 15.0, 40.0
SEARCH_CELL_PX = 12.0
TRUST_HALF = 1.5
"""Support at which the field is trusted as much as the descriptors alone."""
MAX_DISTANCE = 1.08
"""Candidates near a prediction may be this much farther in descriptor space than the noise level."""
MIN_SEEDS = 6


@dataclass(frozen=True)
class Correspondences:
    """i1, i2: (n,) int32 rows of the two `Features`; probability: (n,) float64, p of the accepted match."""

    i1: Int32s
    i2: Int32s
    probability: Float64s


def structural_matches(
    left: Features, right: Features, *, tilted: bool = False, dominance: float = 0.8, neighbours: int = 7, rounds: int = 4
) -> Correspondences:
    """Match two frames' keypoints without geometry.

    tilted: bring in the views compressed in x; dominance: the least odds of an accepted match; neighbours: candidates that each
    keypoint proposes; rounds: of expectation and maximisation.
    """
    problems = view_pairs(left, right, tilted, neighbours)
    return _solve(left, right, problems, _seeds(problems), dominance, rounds, None)


def guided_matches(
    left: Features,
    right: Features,
    problems: list[ViewPair],
    known: Correspondences,
    F: Float64s,
    *,
    dominance: float = 0.8,
    rounds: int = 3,
) -> Correspondences:
    """Match again around the inliers `known` of F, with the distance to the epipolar lines as evidence.

    problems: from `view_pairs`.
    """
    return _solve(left, right, problems, known, dominance, rounds, F)


@dataclass(frozen=True)
class Candidates:
    """Pairs i--j, (c,) int32 in order of i and j, that may correspond by their descriptors (n1, d) and (n2, d).

    near: the nearest both ways, `NOISE_RANK` more than the `neighbours` that are candidates; noise: (n1,) and (n2,), the local
    noise levels; q: (c,) descriptor distances over the noise.
    """

    descriptors1: Float32s
    descriptors2: Float32s
    neighbours: int
    near: Neighbours
    noise1: Float32s
    noise2: Float32s
    i: Int32s
    j: Int32s
    q: Float64s


@dataclass(frozen=True)
class ViewPair:
    """One view of the left frame against one of the right: rows of the `Features`, places, frames of 1, inverse frames of 2."""

    rows1: Int32s
    rows2: Int32s
    x1: Float64s
    x2: Float64s
    frames1: Float64s
    unframes2: Float64s
    candidates: Candidates


def view_pairs(left: Features, right: Features, tilted: bool, neighbours: int = 7) -> list[ViewPair]:
    """What is matched with what: the plain views, and each compressed view with the other's plain one."""
    views = [(PLAIN, PLAIN), (TILTED, PLAIN), (PLAIN, TILTED)] if tilted else [(PLAIN, PLAIN)]
    found = (_view_pair(left, right, a, b, neighbours) for a, b in views)
    return [problem for problem in found if problem is not None]


def _view_pair(left: Features, right: Features, view1: int, view2: int, neighbours: int) -> ViewPair | None:
    rows1 = np.flatnonzero(left.tilts == view1).astype(np.int32)
    rows2 = np.flatnonzero(right.tilts == view2).astype(np.int32)
    if min(len(rows1), len(rows2)) <= neighbours + NOISE_RANK:
        return None
    found = _candidates(left.descriptors[rows1], right.descriptors[rows2], neighbours)
    return ViewPair(rows1, rows2, left.xy[rows1], right.xy[rows2], left.frames[rows1], _inverses(right.frames[rows2]), found)


def _candidates(descriptors1: Float32s, descriptors2: Float32s, neighbours: int) -> Candidates:
    """Candidates of two sets of descriptors: each proposes its `neighbours` nearest.

    The last few searches are remembered: a pair's geometry asks for what its matching has just found.
    """
    for known in list(_REMEMBERED):
        same = np.array_equal(known.descriptors1, descriptors1) and np.array_equal(known.descriptors2, descriptors2)
        if same and known.neighbours == neighbours:
            return known
    near = nearest_neighbours(descriptors1, descriptors2, neighbours + NOISE_RANK)
    noise1, noise2 = near.row_distance[:, -1].copy(), near.column_distance[:, -1].copy()
    n1, n2 = len(descriptors1), len(descriptors2)
    from_rows = np.arange(n1)[:, None] * n2 + near.rows[:, :neighbours]
    from_columns = near.columns[:, :neighbours].astype(np.int64) * n2 + np.arange(n2)[:, None]
    edges = np.sort(np.concatenate([from_rows.ravel(), from_columns.ravel()]))
    edges = edges[np.concatenate([[True], edges[1:] != edges[:-1]])]
    i, j = (edges // n2).astype(np.int32), (edges % n2).astype(np.int32)
    q = np.empty(len(i))
    _relative_distances(descriptors1, descriptors2, noise1, noise2, i, j, q)
    found = Candidates(descriptors1, descriptors2, neighbours, near, noise1, noise2, i, j, q)
    _REMEMBERED.append(found)
    return found


_REMEMBERED: deque[Candidates] = deque(maxlen=3)
"""One for each combination of views that a pair can bring in."""


def rival_distances(
    left: Features, right: Features, problems: list[ViewPair], i1: Int32s, i2: Int32s, apart_px: float = 6.0
) -> Float64s:
    """(n,) descriptor distance of each match's nearest rival: of those that its two keypoints have in the other image, at least
    `apart_px` from the match.  Among the nearest few only: where all lie at the match itself, the last of them."""
    rivals = np.full(len(i1), 2.0)
    for problem in problems:
        mine = np.flatnonzero(np.isin(i1, problem.rows1) & np.isin(i2, problem.rows2))
        at1, at2 = np.searchsorted(problem.rows1, i1[mine]), np.searchsorted(problem.rows2, i2[mine])
        near = problem.candidates.near
        forward = _first_apart(problem.x2[near.rows[at1]], right.xy[i2[mine]], near.row_distance[at1], apart_px)
        backward = _first_apart(problem.x1[near.columns[at2]], left.xy[i1[mine]], near.column_distance[at2], apart_px)
        rivals[mine] = np.minimum(forward, backward)
    return rivals


def _first_apart(places: Float64s, match: Float64s, distance: Float32s, apart_px: float) -> Float64s:
    """Distance of the nearest neighbour (of (n, k), nearest first) that lies apart from the match."""
    apart = np.linalg.norm(places - match[:, None], axis=2) >= apart_px
    apart[:, -1] = True
    return np.asarray(distance[np.arange(len(distance)), apart.argmax(axis=1)], dtype=np.float64)


def _seeds(problems: list[ViewPair]) -> Correspondences:
    """Mutual nearest neighbours that are clearly nearest, or that their neighbours confirm; weight 1 each."""
    if not problems:
        return Correspondences(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0))
    i1, i2, x1, x2, affine, ratio = (np.concatenate(parts) for parts in zip(*map(_clear, problems), strict=True))
    if len(problems) > 1:
        keep = without_repeats(x1, x2, 1 - ratio)
        i1, i2, x1, x2, affine, ratio = (part[keep] for part in (i1, i2, x1, x2, affine, ratio))
    votes = _votes(x1, x2, affine)
    good = (votes >= 2) | ((votes >= 1) & (ratio < 0.75)) | (ratio < 0.55)
    if good.sum() < 8:
        good = np.zeros(len(ratio), dtype=bool)
        good[np.argsort(ratio - 0.2 * votes, kind="stable")[:8]] = True
    return Correspondences(i1[good], i2[good], np.ones(int(good.sum())))


def mutual_neighbours(problem: ViewPair) -> tuple[Int64s, Int32s, Float64s]:
    """i, j of mutual nearest neighbours of a view pair, and first over second distance, the worse of both ways."""
    near = problem.candidates.near
    i = np.flatnonzero(near.columns[near.rows[:, 0], 0] == np.arange(len(near.rows)))
    j = near.rows[i, 0]
    forward = near.row_distance[i, 0] / np.maximum(near.row_distance[i, 1], 1e-9)
    backward = near.column_distance[j, 0] / np.maximum(near.column_distance[j, 1], 1e-9)
    return i, j, np.maximum(forward, backward).astype(np.float64)


def _clear(problem: ViewPair) -> tuple[Int32s, Int32s, Float64s, Float64s, Float64s, Float64s]:
    """Rows of the `Features`, places, frame affines and ratios of the mutual nearest neighbours that may be seeds."""
    i, j, ratio = mutual_neighbours(problem)
    keep = ratio < SEED_RATIO
    i, j = i[keep], j[keep]
    affine = np.linalg.inv(problem.unframes2[j]) @ _inverses(problem.frames1[i])
    return problem.rows1[i], problem.rows2[j], problem.x1[i], problem.x2[j], affine, ratio[keep]


def _votes(x1: Float64s, x2: Float64s, affine: Float64s) -> Int32s:
    """(n,) how many of a seed's nearest seeds predict it, place and frame."""
    votes = np.zeros(len(x1), np.int32)
    if len(x1) >= 4:
        _, index = nearest_points(x1, x1, min(VOTERS, len(x1) - 1) + 1)
        _count_votes(index, x1, x2, affine, votes)
    return votes


def _solve(
    left: Features,
    right: Features,
    problems: list[ViewPair],
    seeds: Correspondences,
    dominance: float,
    rounds: int,
    F: Float64s | None,
) -> Correspondences:
    """The rounds: field from the matches, matches from the field."""
    matches = seeds
    for step in range(rounds):
        if len(matches.i1) < MIN_SEEDS:
            return Correspondences(matches.i1[:0], matches.i2[:0], matches.probability[:0])
        last = step == rounds - 1
        odds = dominance if last else 1.0
        x1, x2 = left.xy[matches.i1], right.xy[matches.i2]
        affine = right.frames[matches.i2] @ _inverses(left.frames[matches.i1])
        found = []
        for problem in problems:
            field = fit_affine_field(x1, x2, affine, matches.probability, problem.x1)
            found.append(_expect(problem, field, odds, last, step > 0, F))
        i1, i2, p = (np.concatenate(parts) for parts in zip(*found, strict=True))
        if last or len(problems) > 1:
            keep = without_repeats(left.xy[i1], right.xy[i2], p)
            i1, i2, p = i1[keep], i2[keep], p[keep]
        matches = Correspondences(i1, i2, p)
    order = np.lexsort((matches.i2, matches.i1))
    return Correspondences(matches.i1[order], matches.i2[order], matches.probability[order])


def _expect(
    problem: ViewPair, field: AffineField, odds: float, last: bool, search: bool, F: Float64s | None
) -> tuple[Int32s, Int32s, Float64s]:
    """Candidates whose probability has at least `odds` against all rivals together, as rows of the `Features`."""
    sigma = np.maximum(field.sigma_px, MIN_SIGMA_PX)
    trust = field.support / (field.support + TRUST_HALF)
    i, j, q = problem.candidates.i, problem.candidates.j, problem.candidates.q
    if search:
        more_i, more_j, more_q = _near_predictions(problem, field, sigma, trust)
        i, j, q = np.concatenate([i, more_i]), np.concatenate([j, more_j]), np.concatenate([q, more_q])
    log_odds = np.empty(len(i))
    e = EVIDENCE
    coefficients = np.array([
        e.alone, e.alone_slope, e.final if last else e.growing, e.slope,
        e.distance_weight, e.sigma_weight, e.scale_weight, e.angle_weight, e.epipolar, e.epipolar_weight,
    ])  # fmt: skip
    forward = field.affine @ problem.frames1
    _score(
        i, j, q, problem.x2, forward, _log_scale(forward), problem.unframes2, _log_scale(problem.unframes2),
        field.prediction, sigma, np.log(sigma / MIN_SIGMA_PX), trust, coefficients, log_odds,
    )  # fmt: skip
    if F is not None:
        _score_epipolar(i, j, problem.x1, problem.x2, np.ascontiguousarray(F), coefficients, log_odds)
    p = assign(i, j, log_odds, len(problem.x1), len(problem.x2))
    keep = p > odds * (1 - p)
    return problem.rows1[i[keep]], problem.rows2[j[keep]], p[keep]


def _near_predictions(problem: ViewPair, field: AffineField, sigma: Float64s, trust: Float64s) -> tuple[Int32s, Int32s, Float64s]:
    """Candidates that no descriptor list has: keypoints of image 2 near the prediction, where the field can be trusted."""
    asking = np.flatnonzero((trust > 0.5) & (sigma < MAX_SIGMA_PX)).astype(np.int32)
    radius = np.minimum(3 * sigma[asking] + 2, MAX_RADIUS_PX)
    cell = SEARCH_CELL_PX
    origin = problem.x2.min(axis=0)
    cells = np.floor((problem.x2 - origin) / cell).astype(np.int64)
    columns, rows = cells.max(axis=0) + 1
    key = cells[:, 1] * columns + cells[:, 0]
    order = np.argsort(key, kind="stable").astype(np.int32)
    starts = np.searchsorted(key[order], np.arange(columns * rows + 1)).astype(np.int32)
    c = problem.candidates
    first = np.searchsorted(c.i, np.arange(len(problem.x1) + 1)).astype(np.int32)
    return _search(
        asking, radius, field.prediction, problem.x2, origin, cell, columns, rows, order, starts, first, c.j,
        c.descriptors1, c.descriptors2, c.noise1, c.noise2,
    )  # fmt: skip


def _inverses(m: Float64s) -> Float64s:
    """Inverses of (n, 2, 2) matrices."""
    a, b, c, d = m[:, 0, 0], m[:, 0, 1], m[:, 1, 0], m[:, 1, 1]
    adjugate = np.stack([np.stack([d, -b], axis=1), np.stack([-c, a], axis=1)], axis=1)
    return np.asarray(adjugate / (a * d - b * c)[:, None, None], dtype=np.float64)


@kernel
def _relative_distances(
    d1: Float32s, d2: Float32s, noise1: Float32s, noise2: Float32s, i: Int32s, j: Int32s, q: Float64s
) -> None:
    for c in range(len(i)):
        q[c] = _relative_distance(d1, d2, noise1, noise2, i[c], j[c])


@kernel
def _relative_distance(d1: Float32s, d2: Float32s, noise1: Float32s, noise2: Float32s, i: int, j: int) -> float:
    """Descriptor distance over the mean noise level of the two keypoints."""
    dot = float(np.dot(d1[i], d2[j]))
    return float(np.sqrt(max(2 - 2 * dot, 0.0)) / (0.5 * (noise1[i] + noise2[j]) + 1e-9))


@kernel
def _count_votes(index: Int32s, x1: Float64s, x2: Float64s, affine: Float64s, votes: Int32s) -> None:
    for n in range(len(x1)):
        a = affine[n]
        det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
        for k in range(index.shape[1]):
            o = index[n, k]
            du, dv = x1[n, 0] - x1[o, 0], x1[n, 1] - x1[o, 1]
            if abs(du) + abs(dv) <= 1.5:
                continue
            b = affine[o]
            eu = x2[o, 0] + b[0, 0] * du + b[0, 1] * dv - x2[n, 0]
            ev = x2[o, 1] + b[1, 0] * du + b[1, 1] * dv - x2[n, 1]
            reach = np.hypot(x2[n, 0] - x2[o, 0], x2[n, 1] - x2[o, 1])
            if np.hypot(eu, ev) >= VOTE_PX + VOTE_PER_PX * reach:
                continue
            r00 = (a[1, 1] * b[0, 0] - a[0, 1] * b[1, 0]) / det
            r01 = (a[1, 1] * b[0, 1] - a[0, 1] * b[1, 1]) / det
            r10 = (a[0, 0] * b[1, 0] - a[1, 0] * b[0, 0]) / det
            r11 = (a[0, 0] * b[1, 1] - a[1, 0] * b[0, 1]) / det
            turn = abs(np.arctan2(r10 - r01, r00 + r11))
            zoom = 0.5 * abs(np.log(abs(r00 * r11 - r01 * r10) + 1e-9))
            if turn < VOTE_RAD and zoom < VOTE_LOG_SCALE:
                votes[n] += 1


@kernel
def _score(
    i: Int32s,
    j: Int32s,
    q: Float64s,
    x2: Float64s,
    forward: Float64s,
    log_scale1: Float64s,
    unframes2: Float64s,
    log_scale2: Float64s,
    prediction: Float64s,
    sigma: Float64s,
    log_sigma: Float64s,
    trust: Float64s,
    coefficients: Float64s,
    log_odds: Float64s,
) -> None:
    """Log odds of the candidates i--j by `Evidence`, without the epipolar term; coefficients in the order of its fields.

    forward: keypoint frames of image 1 as the field maps them into image 2; log_scale: of these and of the inverse frames of 2;
    log_sigma: of sigma over the least.
    """
    alone, alone_slope, base, slope, by_distance, by_sigma, by_scale, by_angle = coefficients[:8]
    for c in range(len(i)):
        a, b = i[c], j[c]
        r2 = (x2[b, 0] - prediction[a, 0]) ** 2 + (x2[b, 1] - prediction[a, 1]) ** 2
        penalty = by_distance * np.log(1 + r2 / sigma[a] ** 2) + by_sigma * log_sigma[a]
        W, N = forward[a], unframes2[b]
        q00, q01 = N[0, 0] * W[0, 0] + N[0, 1] * W[1, 0], N[0, 0] * W[0, 1] + N[0, 1] * W[1, 1]
        q10, q11 = N[1, 0] * W[0, 0] + N[1, 1] * W[1, 0], N[1, 0] * W[0, 1] + N[1, 1] * W[1, 1]
        zoom = log_scale1[a] + log_scale2[b]
        turn = np.arctan2(q10 - q01, q00 + q11)
        penalty += by_scale * np.log(1 + (zoom / 0.25) ** 2) + by_angle * np.log(1 + (turn / 0.25) ** 2)
        t = trust[a]
        log_odds[c] = (1 - t) * (alone - alone_slope * q[c]) + t * (base - slope * q[c] - penalty)


def _log_scale(m: Float64s) -> Float64s:
    """(n,) logarithm of how much (n, 2, 2) maps enlarge; those that flatten count as enormously small."""
    area = np.abs(m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0])
    return np.asarray(0.5 * np.log(np.maximum(area, 1e-12)), dtype=np.float64)


@kernel
def _score_epipolar(
    i: Int32s, j: Int32s, x1: Float64s, x2: Float64s, F: Float64s, coefficients: Float64s, log_odds: Float64s
) -> None:
    """Add what the symmetric distance to the epipolar lines tells."""
    base, weight = coefficients[8], coefficients[9]
    for c in range(len(i)):
        x, y, u, v = x1[i[c], 0], x1[i[c], 1], x2[j[c], 0], x2[j[c], 1]
        a2, b2, c2 = F[0, 0] * x + F[0, 1] * y + F[0, 2], F[1, 0] * x + F[1, 1] * y + F[1, 2], F[2, 0] * x + F[2, 1] * y + F[2, 2]
        a1, b1 = F[0, 0] * u + F[1, 0] * v + F[2, 0], F[0, 1] * u + F[1, 1] * v + F[2, 1]
        algebraic = abs(u * a2 + v * b2 + c2)
        distance = 0.5 * algebraic * (1 / np.sqrt(a2 * a2 + b2 * b2) + 1 / np.sqrt(a1 * a1 + b1 * b1))
        log_odds[c] += base - weight * np.log(1 + distance * distance)


@kernel
def _search(
    asking: Int32s,
    radius: Float64s,
    prediction: Float64s,
    x2: Float64s,
    origin: Float64s,
    cell: float,
    columns: int,
    rows: int,
    order: Int32s,
    starts: Int32s,
    first: Int32s,
    known: Int32s,
    d1: Float32s,
    d2: Float32s,
    noise1: Float32s,
    noise2: Float32s,
) -> tuple[Int32s, Int32s, Float64s]:
    """Pairs of an asking keypoint and a keypoint of image 2 within its radius that are not candidates yet (first, known: their
    list by row) and whose relative distance, the third result, is small."""
    room = 4 * len(asking) + 16
    out_i, out_j, out_q = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room)
    count = 0
    for n in range(len(asking)):
        a = asking[n]
        px, py = prediction[a, 0], prediction[a, 1]
        limit = radius[n] ** 2
        left, right = (px - radius[n] - origin[0]) / cell, (px + radius[n] - origin[0]) / cell
        top, bottom = (py - radius[n] - origin[1]) / cell, (py + radius[n] - origin[1]) / cell
        if not (right >= 0 and left < columns and bottom >= 0 and top < rows):
            continue
        for row in range(int(max(top, 0.0)), int(min(bottom, rows - 1.0)) + 1):
            for column in range(int(max(left, 0.0)), int(min(right, columns - 1.0)) + 1):
                for at in range(starts[row * columns + column], starts[row * columns + column + 1]):
                    b = order[at]
                    if (x2[b, 0] - px) ** 2 + (x2[b, 1] - py) ** 2 >= limit:
                        continue
                    new = True
                    for k in range(first[a], first[a + 1]):
                        if known[k] == b:
                            new = False
                    if not new:
                        continue
                    q = _relative_distance(d1, d2, noise1, noise2, a, b)
                    if q >= MAX_DISTANCE:
                        continue
                    if count == len(out_i):
                        out_i, out_j = np.concatenate((out_i, out_i)), np.concatenate((out_j, out_j))
                        out_q = np.concatenate((out_q, out_q))
                    out_i[count], out_j[count], out_q[count] = a, b, q
                    count += 1
    return out_i[:count], out_j[:count], out_q[:count]
