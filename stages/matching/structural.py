"""Match two keypoint sets by their descriptors *and* by the pattern they form (the default matcher).

The idea is that of Hao (2011), chapter 3: the structure of the whole set decides, rows and columns compete, an affine map
compensates the change of viewpoint, and a match must dominate its rivals.  Here the affine map is local, one at every keypoint
(named there as future work), because one global map cannot follow a scene with depth:

1. candidates: the nearest few by descriptor, both ways;
2. first matches: mutual nearest neighbours that neighbouring matches confirm, each through its local affine frame;
3. rounds of expectation and maximisation: confident matches give the local affine field; the field and the descriptors give the
   log odds of each candidate; Sinkhorn balancing with a dustbin turns these into probabilities;
4. a match is accepted if its probability p dominates the remainder, which is left to its rivals: p > dominance * (1 - p).

The same rounds with an epipolar term, started from the inliers, are the guided matching of a pair whose F is known.  Pairs of
views far apart may also use the keypoints of the frames compressed in x: plain with plain, tilted with plain, plain with tilted,
under one field.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, NamedTuple

import numpy as np

from ..core.jit import kernel
from ..core.nearest_points import nearest_points
from ..types import TILTED, Bools, Features, Float64s, Int32s, Int64s, Matches
from .affine_field import AffineField, fit_affine_field
from .assignment import assign, without_repeats
from .candidates import NEIGHBOURS, ViewPair, inverses, near_predictions, searched_view_pairs, view_pairs
from .local_affines import match_affines
from .local_consensus import local_consensus
from .matcher import keypoint_matches

Tilt = Literal["auto", "never", "always"]


class Evidence(NamedTuple):
    """Log odds of a candidate against "no partner", in nats.

    Without a field: `descriptor_base - descriptor_slope q`, q = descriptor distance over the local noise level of descriptors.
    With a field: `field_base` (`final_base` in the last round) `- slope q` minus penalties `weight ln(1 + (error/scale)^2)` of
    the distance to the prediction (over its sigma), of the log scale (over 0.25) and of the angle (over 0.25 rad), and minus
    `sigma_weight ln(sigma / 2 px)`: a Student density of the distance, which is lower where it is wider.
    With an epipolar line: `epipolar - epipolar_weight ln(1 + e^2)`, e in pixels.
    Fitted by maximum likelihood on the candidates of half of 68 pairs (photographed and rendered, truth by depth), so that p is a
    probability; `final_base` is below the best fit, for precision.
    """

    descriptor_base: float = 15.0
    descriptor_slope: float = 14.2
    field_base: float = 17.0
    final_base: float = 9.2
    slope: float = 5.5
    distance_weight: float = 1.4
    sigma_weight: float = 1.7
    scale_weight: float = 0.75
    angle_weight: float = 0.45
    epipolar: float = 1.5
    epipolar_weight: float = 1.2


EVIDENCE = Evidence()
"""The evidence of SIFT keypoints, in every round but the last, which begins from `final_base`."""
LEARNED_EVIDENCE = Evidence(scale_weight=0.0, angle_weight=0.0)
"""The evidence of learned keypoints, whose frames say nothing.  The other coefficients are those of SIFT: fitted to ALIKED
on half of the fountain's pairs, they lost two thirds of the right matches above 70 degrees (all pairs of fountain and entry) and
were no more precise there."""
EPIPOLAR = EVIDENCE.epipolar
"""Largest gain in nats that the epipolar term can bring, as a constant that kernels can read."""
LEAST_LOG_ODDS = -8.0
"""Candidates with log odds (nats) below this are left out: they would not noticeably lower their rivals' probabilities."""
MIN_SIGMA_PX = 2.0
"""Smallest standard deviation of a prediction, pixels.  Larger forgives more where the field is smooth; smaller would trust it
beyond what a linear map can follow."""
FRAME_SCALE = 0.25
"""Error of a match's log scale, and of its angle in radians, at which the penalty of either is `weight` ln 2."""
TRUST_HALF = 1.5
"""Support (summed weight of agreeing matches) at which the field has the same weight as the descriptors alone."""
DOMINANCE = 0.8
"""Smallest odds of an accepted match against all its rivals together; no unit."""
GROWING_DOMINANCE = 1.0
"""The same in every round but the last: matches that are more likely right than wrong make the next field."""
ROUNDS = 3
"""Rounds of expectation and maximisation.  More find few new matches."""
MIN_MATCHES = 6
"""Fewest confident matches for a field; with fewer, the pair has no matches."""


@dataclass(frozen=True)
class Correspondences:
    """Matches before and after each round."""

    i1: Int32s
    i2: Int32s
    """(n,) int32 rows of the two `Features`."""
    probability: Float64s
    """(n,) float64 probability of each match."""


def match_structural(
    left: Features,
    right: Features,
    *,
    dominance: float = DOMINANCE,
    neighbours: int = NEIGHBOURS,
    rounds: int = ROUNDS,
    tilt: Tilt = "auto",
    weak_matches: int = 300,
) -> Matches:
    """Match two frames' keypoints without geometry, by descriptors and local affine structure together.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    dominance : smallest odds of an accepted match against all its rivals together; no unit.  More is stricter: 0.8 keeps what is
        more likely right than wrong, 9 keeps what is right nine times in ten.
    neighbours : candidates that each keypoint proposes.
    rounds : rounds of expectation and maximisation.
    tilt : also match the views compressed in x: "auto" does so if the plain views give fewer than `weak_matches` matches.
    weak_matches : with fewer matches of the plain views, "auto" also matches the compressed views.
    """
    has_tilted_view = bool((left.tilts == TILTED).any() or (right.tilts == TILTED).any())
    can_tilt = tilt != "never" and has_tilted_view

    # 1. the plain views alone: enough for most pairs, at a fraction of the cost
    pairs: tuple[ViewPair, ...] = ()
    if not (can_tilt and tilt == "always"):
        pairs = view_pairs(left, right, False, neighbours)
        matches = solve_rounds(left, right, pairs, initial_matches(pairs), dominance, rounds, None)
        if not can_tilt or len(matches.i1) >= weak_matches:
            return keypoint_matches(left, right, matches.i1, matches.i2, matches.probability, searched=pairs)

    # 2. the compressed views too, from new first matches; candidates of the plain views are not searched again
    pairs = view_pairs(left, right, True, neighbours, known=pairs)
    matches = solve_rounds(left, right, pairs, initial_matches(pairs), dominance, rounds, None)
    return keypoint_matches(left, right, matches.i1, matches.i2, matches.probability, tilted=True, searched=pairs)


def match_guided(matches: Matches, left: Features, right: Features, F: Float64s) -> Matches:
    """Match again, starting from the inliers of F, with the distance to the epipolar lines as additional evidence.  The result
    has inliers that were found again and new matches.  Raises ValueError for matches without keypoints.

    Parameters
    ----------
    matches : the inliers.
    left, right : the keypoints that were matched.
    F : (3, 3), x2^T F x1 = 0.
    """
    if matches.i1 is None or matches.i2 is None:
        raise ValueError("matches without keypoints cannot be guided")
    pairs = searched_view_pairs(matches, left, right)
    known = Correspondences(matches.i1, matches.i2, matches.probability.astype(np.float64))
    guided = solve_rounds(left, right, pairs, known, DOMINANCE, ROUNDS, F)
    return keypoint_matches(left, right, guided.i1, guided.i2, guided.probability, tilted=matches.tilted, searched=pairs)


def solve_rounds(
    left: Features,
    right: Features,
    pairs: tuple[ViewPair, ...],
    first: Correspondences,
    dominance: float,
    rounds: int,
    F: Float64s | None,
) -> Correspondences:
    """Run the rounds: field from the matches, matches from the field.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    pairs : pairs of their views, with the candidates.
    first : matches to begin with.
    dominance, rounds : as in `match_structural`.
    F : (3, 3) fundamental matrix, None if it is not known.
    """
    matches = first
    for step in range(rounds):
        if len(matches.i1) < MIN_MATCHES:
            return Correspondences(matches.i1[:0], matches.i2[:0], matches.probability[:0])
        is_first = step == 0
        is_last = step == rounds - 1

        # maximisation: one field for all pairs of views, from the matches of all of them
        x1 = left.xy[matches.i1]
        x2 = right.xy[matches.i2]
        affine = match_affines(left, right, matches.i1, matches.i2)

        # expectation: each pair of views by itself, since a keypoint has a partner in each of the other frame's views
        results = []
        for pair in pairs:
            field = fit_affine_field(x1, x2, affine, matches.probability, pair.x1)
            evidence = EVIDENCE if pair.has_frames else LEARNED_EVIDENCE
            if is_last:
                final = evidence._replace(field_base=evidence.final_base)
                results.append(_expect(pair, field, final, dominance, not is_first, F))
            else:
                results.append(_expect(pair, field, evidence, GROWING_DOMINANCE, not is_first, F))
        matches = _joined(results)

        # repeats within one pair of views do no harm while the matches grow; those from several pairs would count twice
        if is_last or len(pairs) > 1:
            keep = without_repeats(left.xy[matches.i1], right.xy[matches.i2], matches.probability)
            matches = _rows_of(matches, keep)
    return _rows_of(matches, np.lexsort((matches.i2, matches.i1)))


def _joined(parts: list[Correspondences]) -> Correspondences:
    """The matches of several pairs of views, one after the other."""
    i1 = np.concatenate([part.i1 for part in parts])
    i2 = np.concatenate([part.i2 for part in parts])
    probability = np.concatenate([part.probability for part in parts])
    return Correspondences(i1, i2, probability)


def _rows_of(matches: Correspondences, rows: Bools | Int64s) -> Correspondences:
    """Some of the matches, by a mask or by their rows."""
    return Correspondences(matches.i1[rows], matches.i2[rows], matches.probability[rows])


def _expect(
    pair: ViewPair, field: AffineField, evidence: Evidence, odds: float, search: bool, F: Float64s | None
) -> Correspondences:
    """Candidates whose probability exceeds `odds` times that of all rivals together, as rows of the `Features`.

    Parameters
    ----------
    pair : the pair of views, with its candidates by descriptor.
    field : the affine field at the keypoints of its first view.
    evidence : log odds of the candidates.
    odds : dominance that an accepted candidate needs.
    search : also consider keypoints near a reliable prediction.
    F : (3, 3) fundamental matrix, None if it is not known.
    """
    sigma = np.maximum(field.sigma_px, MIN_SIGMA_PX)
    trust = field.support / (field.support + TRUST_HALF)

    # 1. candidates: by descriptor, and near the field's predictions
    i = pair.candidates.i
    j = pair.candidates.j
    q = pair.candidates.q
    if search:
        near_i, near_j, near_q = near_predictions(pair, field, sigma, trust)
        i = np.concatenate([i, near_i])
        j = np.concatenate([j, near_j])
        q = np.concatenate([q, near_q])

    # 2. their log odds
    log_odds = np.empty(len(i))
    forward = field.affine @ pair.frames1
    _score(
        i, j, q, pair.x2, forward, _log_scale(forward), pair.inverse_frames2, _log_scale(pair.inverse_frames2),
        field.prediction, sigma, np.log(sigma / MIN_SIGMA_PX), trust, evidence, log_odds,
    )  # fmt: skip
    if F is not None:
        _score_epipolar(i, j, pair.x1, pair.x2, np.ascontiguousarray(F), evidence, log_odds)

    # 3. competition among those that are not hopeless
    likely = log_odds > LEAST_LOG_ODDS
    i = i[likely]
    j = j[likely]
    p = assign(i, j, log_odds[likely], len(pair.x1), len(pair.x2))

    # 4. the dominance test
    keep = p > odds * (1 - p)
    return Correspondences(pair.rows1[i[keep]], pair.rows2[j[keep]], p[keep])


@kernel
def _score(
    i: Int32s,
    j: Int32s,
    q: Float64s,
    x2: Float64s,
    forward: Float64s,
    log_scale1: Float64s,
    inverse_frames2: Float64s,
    log_scale2: Float64s,
    prediction: Float64s,
    sigma: Float64s,
    log_sigma: Float64s,
    trust: Float64s,
    evidence: Evidence,
    log_odds: Float64s,
) -> None:
    """Log odds of the candidates i--j by `Evidence` with the `field_base` of this round, without the epipolar term.

    forward: keypoint frames of image 1 as the field maps them into image 2; log_scale1, log_scale2: log scale of these and of the
    inverse frames of image 2; log_sigma: ln(sigma / MIN_SIGMA_PX).
    """
    for c in range(len(i)):
        a = i[c]
        b = j[c]
        # position: how far the keypoint of image 2 is from the prediction
        r2 = (x2[b, 0] - prediction[a, 0]) ** 2 + (x2[b, 1] - prediction[a, 1]) ** 2
        t = trust[a]
        penalty = evidence.distance_weight * np.log(1 + r2 / sigma[a] ** 2) + evidence.sigma_weight * log_sigma[a]
        by_descriptor = evidence.descriptor_base - evidence.descriptor_slope * q[c]
        by_field = evidence.field_base - evidence.slope * q[c] - penalty
        log_odds[c] = (1 - t) * by_descriptor + t * by_field
        # frames can only lower the odds: most candidates are hopeless already, even if they lie on the epipolar line
        if log_odds[c] < LEAST_LOG_ODDS - EPIPOLAR:
            continue
        # frames: R = N W maps the patch of image 1, by way of the field, to that of image 2; the identity if they agree
        W = forward[a]
        N = inverse_frames2[b]
        r00 = N[0, 0] * W[0, 0] + N[0, 1] * W[1, 0]
        r01 = N[0, 0] * W[0, 1] + N[0, 1] * W[1, 1]
        r10 = N[1, 0] * W[0, 0] + N[1, 1] * W[1, 0]
        r11 = N[1, 0] * W[0, 1] + N[1, 1] * W[1, 1]
        turn = np.arctan2(r10 - r01, r00 + r11)
        zoom = log_scale1[a] + log_scale2[b]
        by_scale = evidence.scale_weight * np.log(1 + (zoom / FRAME_SCALE) ** 2)
        by_angle = evidence.angle_weight * np.log(1 + (turn / FRAME_SCALE) ** 2)
        log_odds[c] -= t * (by_scale + by_angle)


def _log_scale(m: Float64s) -> Float64s:
    """(n,) logarithm of the scale of (n, 2, 2) maps; singular maps get a very small scale."""
    area = np.abs(m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0])
    return np.asarray(0.5 * np.log(np.maximum(area, 1e-12)), dtype=np.float64)


@kernel
def _score_epipolar(
    i: Int32s, j: Int32s, x1: Float64s, x2: Float64s, F: Float64s, evidence: Evidence, log_odds: Float64s
) -> None:
    """Add the evidence of the symmetric distance to the epipolar lines."""
    for c in range(len(i)):
        x = x1[i[c], 0]
        y = x1[i[c], 1]
        u = x2[j[c], 0]
        v = x2[j[c], 1]
        # the line F (x, y, 1) in image 2, and the first two entries of the line F^T (u, v, 1) in image 1
        a2 = F[0, 0] * x + F[0, 1] * y + F[0, 2]
        b2 = F[1, 0] * x + F[1, 1] * y + F[1, 2]
        c2 = F[2, 0] * x + F[2, 1] * y + F[2, 2]
        a1 = F[0, 0] * u + F[1, 0] * v + F[2, 0]
        b1 = F[0, 1] * u + F[1, 1] * v + F[2, 1]
        # both distances share x2^T F x1
        algebraic = abs(u * a2 + v * b2 + c2)
        distance = 0.5 * algebraic * (1 / np.sqrt(a2 * a2 + b2 * b2) + 1 / np.sqrt(a1 * a1 + b1 * b1))
        log_odds[c] += evidence.epipolar - evidence.epipolar_weight * np.log(1 + distance * distance)


MAX_RATIO = 0.85
"""Largest ratio of first to second descriptor distance of a first match; no unit."""
GOOD_RATIO = 0.75
"""A first match below this ratio needs one confirming neighbour only, others need `CONFIRMED`."""
CLEAR_RATIO = 0.55
"""A first match below this ratio needs no confirming neighbour."""
CONFIRMED = 2
"""Confirming neighbours that a first match needs, whatever its ratio."""
CONSENSUS = 6
"""Neighbours that must agree with the local map of a first match of learned keypoints; two of them define it."""
FEWEST_FIRST = 8
"""With fewer accepted first matches, this many of the best are taken, so that the rounds have something to begin with."""
CONFIRMING_NEIGHBOURS = 24
"""Nearest matches that are asked whether they confirm a match."""
LEAST_SPACING_PX = 1.5
"""Matches nearer to each other than this (sum of both coordinates, pixels) do not confirm each other: they are repeats."""
CONFIRM_PX = 8.0
"""A neighbouring match confirms a match that it predicts to within this many pixels, plus `CONFIRM_PER_PX` of their distance."""
CONFIRM_PER_PX = 0.3
"""Error of a prediction that is allowed for each pixel of distance in image 2; no unit."""
CONFIRM_RAD = 0.6
"""Largest turn between both frame affines, radians."""
CONFIRM_LOG_SCALE = 0.8
"""Largest difference of their log scales."""


def initial_matches(pairs: tuple[ViewPair, ...]) -> Correspondences:
    """Mutual nearest neighbours that are clearly nearest or confirmed by their neighbours, else the best 8; weight 1 each."""
    if not pairs:
        return Correspondences(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0))
    matches = _joined_first([_clear_matches(pair) for pair in pairs])
    if len(pairs) > 1:
        matches = matches.at(without_repeats(matches.x1, matches.x2, 1 - matches.ratio))
    ratio = matches.ratio
    confirmed = confirmations(matches.x1, matches.x2, matches.affine, matches.has_frames)
    accepted = (confirmed >= CONFIRMED) | ((confirmed >= 1) & (ratio < GOOD_RATIO)) | (ratio < CLEAR_RATIO)
    if accepted.sum() < FEWEST_FIRST:
        # the field needs matches to begin with: a confirmation counts as much as 0.2 of the ratio
        best = np.argsort(ratio - 0.2 * confirmed, kind="stable")[:FEWEST_FIRST]
        accepted = np.zeros(len(ratio), dtype=bool)
        accepted[best] = True
    return Correspondences(matches.i1[accepted], matches.i2[accepted], np.ones(int(accepted.sum())))


@dataclass(frozen=True)
class _FirstMatches:
    """Mutual nearest neighbours, (n,) each."""

    i1: Int32s
    i2: Int32s
    """Rows of the two `Features`."""
    x1: Float64s
    x2: Float64s
    """(n, 2) pixels in either image."""
    affine: Float64s
    """(n, 2, 2) from the keypoint's frame in image 1 to that in image 2."""
    ratio: Float64s
    """Ratio of first to second descriptor distance, the larger one of both directions."""
    has_frames: Bools
    """False for matches of learned keypoints."""

    def at(self, rows: Bools) -> _FirstMatches:
        """Some of the matches."""
        return _FirstMatches(*(getattr(self, field.name)[rows] for field in fields(_FirstMatches)))


def _clear_matches(pair: ViewPair) -> _FirstMatches:
    """Mutual nearest neighbours of a pair of views within `MAX_RATIO`."""
    i, j, ratio = pair.candidates.near.mutual()
    # the ratio says little of learned keypoints: their neighbours decide
    keep = ratio < (MAX_RATIO if pair.has_frames else np.inf)
    i = i[keep]
    j = j[keep]
    affine = np.linalg.inv(pair.inverse_frames2[j]) @ inverses(pair.frames1[i])
    has_frames = np.full(len(i), pair.has_frames)
    return _FirstMatches(pair.rows1[i], pair.rows2[j], pair.x1[i], pair.x2[j], affine, ratio[keep], has_frames)


def _joined_first(parts: list[_FirstMatches]) -> _FirstMatches:
    """The first matches of several pairs of views, one after the other."""
    columns = [np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(_FirstMatches)]
    return _FirstMatches(*columns)


def confirmations(x1: Float64s, x2: Float64s, affine: Float64s, has_frames: Bools) -> Int32s:
    """(n,) int32 number of matches around each match that confirm it: of the same kind, with frames or without.

    Parameters
    ----------
    x1, x2 : (n, 2) pixels of the matches in either image.
    affine : (n, 2, 2) from frame 1 to frame 2 of each.
    has_frames : (n,) False for matches of learned keypoints, whose `affine` says nothing.
    """
    count = np.zeros(len(x1), np.int32)
    count[has_frames] = _confirmations_by_frames(x1[has_frames], x2[has_frames], affine[has_frames])
    # neighbours agree with the best of many maps: some always do, and the first few confirm nothing
    _, support = local_consensus(x1[~has_frames], x2[~has_frames])
    count[~has_frames] = np.maximum(support - CONSENSUS + CONFIRMED, 0)
    return count


def _confirmations_by_frames(x1: Float64s, x2: Float64s, affine: Float64s) -> Int32s:
    """(n,) int32 number of the nearest matches around each match that predict its position and frame."""
    count = np.zeros(len(x1), np.int32)
    if len(x1) >= 4:
        # one more than wanted: each match is its own nearest
        _, index = nearest_points(x1, x1, min(CONFIRMING_NEIGHBOURS, len(x1) - 1) + 1)
        _count_confirmations(index, x1, x2, affine, count)
    return count


@kernel
def _count_confirmations(index: Int32s, x1: Float64s, x2: Float64s, affine: Float64s, count: Int32s) -> None:
    """Add the confirmations; index: (n, k) the nearest matches in image 1, the match itself among them."""
    for n in range(len(x1)):
        a = affine[n]
        det = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
        for k in range(index.shape[1]):
            neighbour = index[n, k]
            du = x1[n, 0] - x1[neighbour, 0]
            dv = x1[n, 1] - x1[neighbour, 1]
            if abs(du) + abs(dv) <= LEAST_SPACING_PX:  # the match itself, or a repeat
                continue
            # position: the neighbour's affine map, extended to this match; its error grows with the distance
            b = affine[neighbour]
            eu = x2[neighbour, 0] + b[0, 0] * du + b[0, 1] * dv - x2[n, 0]
            ev = x2[neighbour, 1] + b[1, 0] * du + b[1, 1] * dv - x2[n, 1]
            reach = np.hypot(x2[n, 0] - x2[neighbour, 0], x2[n, 1] - x2[neighbour, 1])
            if np.hypot(eu, ev) >= CONFIRM_PX + CONFIRM_PER_PX * reach:
                continue
            # frame: R = a^-1 b is the identity if both maps agree
            r00 = (a[1, 1] * b[0, 0] - a[0, 1] * b[1, 0]) / det
            r01 = (a[1, 1] * b[0, 1] - a[0, 1] * b[1, 1]) / det
            r10 = (a[0, 0] * b[1, 0] - a[1, 0] * b[0, 0]) / det
            r11 = (a[0, 0] * b[1, 1] - a[1, 0] * b[0, 1]) / det
            turn = abs(np.arctan2(r10 - r01, r00 + r11))
            zoom = 0.5 * abs(np.log(abs(r00 * r11 - r01 * r10) + 1e-9))
            if turn < CONFIRM_RAD and zoom < CONFIRM_LOG_SCALE:
                count[n] += 1
