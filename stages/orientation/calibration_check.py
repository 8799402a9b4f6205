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

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from math import sqrt

import cv2
import networkx as nx
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
"""Smallest noise of matches, pixels: no image locates points better."""
OUTLIER = 3.0
"""Scale of the loss, in standard deviations."""
AGREEING_SIGMAS = 0.8
"""A pair agrees with the stated cameras if the median distance of its matches from the stated epipolar lines is below this, in
standard deviations; its distant matches are then look-alikes (measured: right cameras 0.15 to 0.76)."""
MEDIAN_ERROR = 0.79
"""Standard error of the median absolute value of normal deviates, times the square root of their number."""
CONTRADICTED_RATIO = 1.6
"""Confirmed matches contradict the stated cameras if their loss under these exceeds this multiple of that under their own F."""
LEAST_LOSS_RATIO = 1.12
"""Smallest ratio of the loss under the stated cameras to the loss under a cause for it to be named, with confirmed matches.
Matches agree with the stated cameras up to this ratio times the loss under their own F."""
LEAST_LOSS_RATIO_UNCONFIRMED = 1.5
"""The same ratio for a cause to be named from unconfirmed matches."""
LEAST_SHARE = 0.6
"""A cause must remove this share of the loss beyond that under the matches' own F, with confirmed matches."""
LEAST_SHARE_UNCONFIRMED = 0.8
"""The same share for unconfirmed matches."""
LEAST_LOSS = 30.0
"""A cause must remove this total loss, in squared standard deviations (a pair counts as at most `MOST_COUNTED` matches)."""
MOST_COUNTED = 50
"""Largest number of matches that a pair counts for in means over pairs."""
STRAYED_SIGMAS = 1.6
"""A pair has strayed if its median distance exceeds this many standard deviations: some match look-alikes, which no cause brings
back."""
FEWEST_RECOVERED = 2
"""A cause is named if it halves the distance of at least this many pairs, and of half of those that strayed, and makes no other
pair stray."""
HARMFUL_PX = 0.4
"""Cameras that move points by less than this (median, in pixels along and across the epipolar line) do not harm a cloud."""
FARTHEST_PX = 1e4
"""Largest motion of a point that counts, pixels."""
LARGEST_SITE = 12
"""Largest number of cameras among which exchanged poses are tried."""
LARGEST_ZOOM = 3.0
"""Logarithm of the largest factor of focal lengths, and of positions, that is tried."""
STEPS = 20
"""Largest number of steps of the fit of a cause."""
STRETCHED = ("stretched-x", "stretched-y", "stretched-z")
"""Causes that stretch the site along one axis."""
LEAST_STRETCH = 0.02
"""Smallest stretch (logarithm of the factor) that is blamed: surveys have no smaller ones (measured: 0.009 from right poses)."""
CORNER = "principal-points-corner"
"""The cause that principal points are counted from the corner of the first pixel instead of its centre."""
CORNER_PX = np.array([-0.5, -0.5])
"""Correction of such principal points, pixels."""
FEWEST_PAIRS_FOR_CORNER = 4
"""Fewest pairs whose rows can blame `CORNER` if they give only a part of it: those of three give half without any error."""
LEAST_CORNER = 0.25
"""Smallest part of `CORNER` that rows may give: the fit is biased towards the rows."""
MOST_CORNER = 1.25
"""Largest multiple of `CORNER` that rows may give."""
SLACK_ERRORS = 3.0
"""Standard errors of the median added to `AGREEING_SIGMAS` if no cause, or only one turned or moved camera, explains matches."""
FEWEST_TILES = 4
"""Fewest matches of a pair for its row offsets to count."""
LEAST_GAIN = 15.0
"""Least gain of a cause, in squared standard deviations, to blame it for row offsets (measured: correct nights up to 10)."""
LEAST_GAIN_OF_SECOND = 4.0
"""Least gain of the pair with the second largest one for a single camera to be blamed (measured: rows of look-alikes 0.1, wrong
cameras 5.5 or more)."""
LEAST_MOTION_OF_ONE = 1.25e-3
"""Smallest motion of points, as a share of the width, for row offsets to blame a single camera (measured: true cameras 6e-4)."""
LEAST_MOTION_ALONG = 6e-4
"""Smallest motion of points, as a share of the width, for row offsets to blame a cause that all cameras share."""
LEAST_TURN = 2e-3
"""Smallest turn of rays, in pixels as a share of the width, that is as good as this motion."""
_POSE_UNKNOWNS = 6
"""Unknowns of a pose: rotation and shift."""


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
        if self.stated is None:
            ray = (x - K[:2, 2]) / focal
        else:
            # back to the capture by the lens that was used, and from there by the right one
            stated_K = self.stated.K
            stated_ray = np.column_stack([(x - stated_K[:2, 2]) / stated_K[[0, 1], [0, 1]], np.ones(len(x))])
            captured = cv2.projectPoints(stated_ray, np.zeros(3), np.zeros(3), stated_K, self.stated.distortion)[0]
            ray = np.asarray(cv2.undistortPoints(captured, K, self.camera.distortion)[:, 0], dtype=np.float64)
        return np.asarray(K[:2, 2] + ray * (1 - self.k1 * (ray**2).sum(axis=1, keepdims=True)) * focal, dtype=np.float64)


_World = Mapping[str, _CheckedView]
_Change = Callable[[_CheckedView, Float64s], _CheckedView]


@dataclass(frozen=True)
class _Cause:
    """A possible error of the stated cameras; with unknowns of zero they are as stated."""

    name: str
    change: Callable[[_World, Float64s], _World]
    unknowns: int = 0
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
    # Of pairs without confirmed matches, many may still agree on one cause.
    if not check.contradicted and other_matches:
        check = _with_majority_cause(check, stated, [*confirmed, *other_matches])
    return check


def check_solved_lens(name: str, cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> CalibrationCheck | None:
    """A contradiction, if another focal length, with a pose of its own, restores the fit of a solved camera to its matches.

    name: of the solved camera.  cameras: this one, and those whose poses are stated.  If these are only two, nothing else checks
    their lenses: all three may have other focal lengths.  geometries: of all pairs.
    """
    # 1. The matches: of this camera, or of all if there is a third one to compare.
    all_three = len(cameras) == 3
    evidence = []
    for pair, geometry in geometries.items():
        if not set(pair) <= set(cameras) or geometry.good_probability < LEAST_PROBABILITY:
            continue
        if (name in pair or all_three) and len(geometry.x1) >= MIN_SHARED:
            evidence.append(_sampled(pair, geometry, geometry))
    if sum(name in matches.pair for matches in evidence) < 2:
        return None

    # 2. Fit poses of its own to the camera: with its lens, and with other focal lengths.
    stated = {camera: _CheckedView(as_stated) for camera, as_stated in cameras.items()}
    baseline = _baseline(stated, evidence)
    unchanged = _simple("", 0, lambda view, _: view, name)
    lenses = [_simple("focal-length", 1, _zoomed, name)]
    if all_three:
        lenses.append(_simple("focal-lengths", 1, _zoomed))
    posed = _fit(_with_pose(unchanged, name, baseline), stated, evidence)
    zoomed = [_fit(_with_pose(lens, name, baseline), stated, evidence) for lens in lenses]
    best = min(zoomed, key=lambda explanation: explanation.loss)

    # 3. Is the fit clearly better with another one, and does that move points?
    gain = posed.loss - best.loss
    excess = posed.loss - min(_own_loss(evidence), best.loss)
    is_clear = gain * sum(_counts(evidence)) >= LEAST_GAIN and gain >= LEAST_SHARE_UNCONFIRMED * excess
    if not is_clear:
        return None
    best = replace(best, amount=best.amount[_POSE_UNKNOWNS:])
    named = _with_cause(_without_cause(posed.world, evidence, is_confirmed=False), best, posed.world, evidence)
    if named.off_px < HARMFUL_PX:
        return None
    return named


def misfit_without_cause(cameras: Mapping[str, Camera], geometries: Mapping[Pair, Geometry]) -> float:
    """The misfit of confirmed matches that remains once the likeliest cause that all cameras share is corrected.

    cameras, geometries: as for `check_calibration`.
    """
    stated = {name: _CheckedView(camera) for name, camera in cameras.items()}
    confirmed, _ = _evidence(stated, geometries)
    losses = []
    for cause in _causes(stated, confirmed, unconfirmed=False):
        if cause.unknowns and not cause.cameras:
            losses.append(_fit(cause, stated, confirmed).loss)
    return min(losses) / _own_loss(confirmed)


def check_rows(cameras: Mapping[str, Camera], rows: Mapping[Pair, RowMatches]) -> CalibrationCheck | None:
    """Compare stated cameras, by id, with the row offsets that dense matching measures; None if no pair has enough of them.

    These matches are ten times as accurate as keypoints, so they reveal small errors.  Those of a few pairs may be look-alikes.
    """
    # These matches were found along the rows of the stated cameras: they have no geometry of their own, so no own loss.
    evidence = []
    for pair, tiles in rows.items():
        if len(tiles.x1) >= FEWEST_TILES:
            evidence.append(_Matches(pair, tiles.x1, tiles.x2, tiles.sigma_px, own_loss=0.0))
    if not evidence:
        return None
    stated = {name: _CheckedView(camera) for name, camera in cameras.items()}
    loss = _loss(stated, evidence)

    # 1. The simplest cause that explains the offsets.
    explanations = []
    for cause in _causes(stated, evidence, unconfirmed=False):
        explanation = _fit(cause, stated, evidence)
        if _is_seen_by_two_pairs(explanation, stated, evidence):
            explanations.append(explanation)
    best = _simplest(explanations, loss, slack=0.0)

    # 2. Shifted principal points are likelier half a pixel than anything else, if that explains most.
    if best.cause.name == "principal-points" and len(evidence) >= FEWEST_PAIRS_FOR_CORNER:
        part_of_corner = _simple(CORNER, 1, lambda view, a: _shifted(view, a * CORNER_PX / view.camera.width))
        corner = _fit(part_of_corner, stated, evidence)
        explains_most = loss - corner.loss >= LEAST_SHARE_UNCONFIRMED * (loss - best.loss)
        if explains_most and LEAST_CORNER <= corner.amount[0] <= MOST_CORNER:
            best = corner

    # 3. Is it more than noise, and than the errors that cameras always have?
    gain = max(sum(_counts(evidence)) * (loss - best.loss), 0.0)
    graph = nx.Graph([matches.pair for matches in evidence])
    is_confirmed = len(evidence) >= len(cameras) == len(graph) and nx.is_connected(graph)
    check = CalibrationCheck(
        matches=sum(len(matches.x1) for matches in evidence),
        pairs=len(evidence),
        confirmed=is_confirmed,
        misfit=loss / max(best.loss, 1e-9),
        sigmas=sqrt(gain),
    )
    if gain >= LEAST_GAIN and _exceeds_typical_errors(best, stated, evidence):
        return _with_cause(check, best, stated, evidence)
    return check


def _is_seen_by_two_pairs(explanation: _Explanation, stated: _World, evidence: list[_Matches]) -> bool:
    """Does a cause concern all cameras, or improve the fit of two pairs?  The rows of one may be those of look-alikes."""
    blamed = set(explanation.cause.cameras)
    if not blamed:
        return True
    pairs = [matches for matches in evidence if blamed & set(matches.pair)]
    gains = [0.0]
    for matches, count in zip(pairs, _counts(pairs), strict=True):
        gains.append(count * (_loss(stated, [matches]) - _loss(explanation.world, [matches])))
    return sorted(gains)[-2] >= LEAST_GAIN_OF_SECOND


def _exceeds_typical_errors(best: _Explanation, stated: _World, evidence: list[_Matches]) -> bool:
    """Does a cause exceed the errors that surveys and lenses always have?"""
    name = best.cause.name
    if name == CORNER:
        return True  # however small its effect: it is half a pixel or nothing
    if best.cause.cameras:
        width = next(iter(stated.values())).camera.width
        return _moved_px(stated, best.world, evidence) >= LEAST_MOTION_OF_ONE * width
    if name in STRETCHED and abs(best.amount[0]) < LEAST_STRETCH:
        return False
    return _is_noticeable(stated, best.world, evidence)


def _evidence(stated: _World, geometries: Mapping[Pair, Geometry]) -> tuple[list[_Matches], list[_Matches]]:
    """Confirmed matches of pairs of stated cameras, and all matches of the pairs with too few confirmed ones."""
    # Pairs with other cameras serve to confirm matches, too.
    probable = {}
    for pair, geometry in geometries.items():
        if len(geometry.x1) >= MIN_SHARED and geometry.good_probability >= LEAST_PROBABILITY:
            probable[pair] = geometry
    confirmed = []
    unconfirmed = []
    for pair, consistent in consistent_matches(probable).items():
        if not set(pair) <= set(stated):
            continue
        if len(consistent.x1) >= FEWEST_CONFIRMED:
            confirmed.append(_sampled(pair, consistent, geometries[pair]))
        else:
            unconfirmed.append(_sampled(pair, geometries[pair], geometries[pair]))
    return confirmed, unconfirmed


def _check(stated: _World, confirmed: list[_Matches], other_matches: list[_Matches]) -> CalibrationCheck:
    """Check by confirmed matches; by the others if there are none."""
    evidence = confirmed or other_matches
    check = _without_cause(stated, evidence, is_confirmed=bool(confirmed))
    excess = _excess(stated, evidence)
    own_loss = _own_loss(evidence)
    if excess <= LEAST_LOSS_RATIO * own_loss:
        return check
    exceeds_noise = check.confirmed and excess > CONTRADICTED_RATIO * own_loss
    explanations = [_fit(cause, stated, evidence) for cause in _causes(stated, evidence, unconfirmed=not confirmed)]
    best = _simplest(explanations, _loss(stated, evidence))
    is_explained = _explains(best, stated, evidence, unconfirmed=not confirmed)
    is_another_cause = is_explained and best.cause.name not in ("turned", "moved")
    if not is_another_cause and _excess(stated, evidence, tolerance=SLACK_ERRORS) <= LEAST_LOSS_RATIO * own_loss:
        return check  # few matches, most of which agree: a changed pose merely fits look-alikes
    if not is_explained:
        return replace(check, contradicted=exceeds_noise)
    named = _with_cause(check, best, stated, evidence)
    if exceeds_noise or named.off_px >= HARMFUL_PX:
        return named
    return check


def _without_cause(stated: _World, evidence: list[_Matches], is_confirmed: bool) -> CalibrationCheck:
    """How well the stated cameras fit."""
    misfit = _loss(stated, evidence) / max(_own_loss(evidence), 1e-9)
    return CalibrationCheck(sum(len(m.x1) for m in evidence), len(evidence), is_confirmed, misfit)


def _with_cause(check: CalibrationCheck, best: _Explanation, stated: _World, evidence: list[_Matches]) -> CalibrationCheck:
    """The result with the cause of the contradiction."""
    return replace(
        check,
        contradicted=True,
        cause=best.cause.name,
        cameras=best.cause.cameras,
        amount=tuple(float(a) for a in best.amount),
        better=_loss(stated, evidence) / best.loss,
        off_px=_moved_px(stated, best.world, evidence),
    )


def _with_majority_cause(check: CalibrationCheck, stated: _World, evidence: list[_Matches]) -> CalibrationCheck:
    """Name the cause under which most pairs lie near their epipolar lines again, if that is more than chance."""
    stated_medians = np.array([_median_distance(stated, matches) for matches in evidence])
    has_strayed = stated_medians > STRAYED_SIGMAS
    if has_strayed.sum() < FEWEST_RECOVERED:
        return check
    # 1. Causes that bring back enough pairs and make none stray, each with the pairs that are then near their lines.
    candidates: list[tuple[_Explanation, list[_Matches]]] = []
    for cause in _causes(stated, evidence, unconfirmed=False):
        explanation = _fit(cause, stated, evidence)
        medians = np.array([_median_distance(explanation.world, matches) for matches in evidence])
        is_near = medians <= STRAYED_SIGMAS
        recovered = (has_strayed & is_near & (2 * medians <= stated_medians)).sum()
        none_strays = (is_near | has_strayed).all()
        if recovered >= max(FEWEST_RECOVERED, 0.5 * has_strayed.sum()) and none_strays:
            candidates.append((explanation, [evidence[k] for k in np.flatnonzero(is_near)]))
    if not candidates:
        return check
    # 2. Those with the most such pairs; of these the simplest, by the pairs of the one that fits best.
    most_near = max(len(near) for _, near in candidates)
    ties = [candidate for candidate in candidates if len(candidate[1]) == most_near]
    _, near = min(ties, key=lambda tie: tie[0].loss)
    by_near_pairs = [replace(explanation, loss=_loss(explanation.world, near)) for explanation, _ in ties]
    best = _simplest(by_near_pairs, _loss(stated, near))
    if not _explains(best, stated, near, unconfirmed=False):
        return check
    named = _with_cause(_without_cause(stated, near, check.confirmed), best, stated, near)
    if named.off_px < HARMFUL_PX:
        return check
    return named


def _sampled(pair: Pair, chosen: Geometry, full: Geometry) -> _Matches:
    """A sample of some matches of a pair; the noise is estimated from all of them (`full`)."""
    # the median absolute deviation, as a standard deviation
    distance = np.abs(sampson_distance(full.F, full.x1, full.x2))
    noise_px = max(1.4826 * float(np.median(distance)), LEAST_NOISE_PX)
    # evenly spread over the list
    rows = np.linspace(0, len(chosen.x1) - 1, min(SAMPLE, len(chosen.x1))).astype(np.int64)
    x1 = chosen.x1[rows]
    x2 = chosen.x2[rows]
    own_loss = float(_cauchy(sampson_distance(full.F, x1, x2) / noise_px).mean())
    return _Matches(pair, x1, x2, noise_px, own_loss)


def _cauchy(residuals: Float64s) -> Float64s:
    """Cauchy loss: squares of residuals, whose weight decreases beyond `OUTLIER`."""
    return np.asarray(OUTLIER**2 * np.log1p((residuals / OUTLIER) ** 2), dtype=np.float64)


def _residuals(world: _World, matches: _Matches) -> Float64s:
    """Distances (n,) of matches to the epipolar lines, in standard deviations."""
    left = world[matches.pair[0]]
    right = world[matches.pair[1]]
    F = fundamental_from_cameras(left.camera, right.camera)
    return sampson_distance(F, left.undistort(matches.x1), right.undistort(matches.x2)) / matches.noise_px


def _median_distance(world: _World, matches: _Matches) -> float:
    """Median distance of the matches to the epipolar lines, in standard deviations."""
    return float(np.median(np.abs(_residuals(world, matches))))


def _counts(evidence: list[_Matches]) -> list[int]:
    """Number of matches of each pair that count: its weight in means over pairs."""
    return [min(len(matches.x1), MOST_COUNTED) for matches in evidence]


def _own_loss(evidence: list[_Matches]) -> float:
    """The mean loss of the matches under their own geometry."""
    return float(np.average([m.own_loss for m in evidence], weights=_counts(evidence)))


def _loss(world: _World, evidence: list[_Matches]) -> float:
    """The mean loss of the matches in a world."""
    losses = []
    for matches in evidence:
        losses.append(_cauchy(_residuals(world, matches)).mean())
    return float(np.average(losses, weights=_counts(evidence)))


def _excess(world: _World, evidence: list[_Matches], tolerance: float = 0.0) -> float:
    """The loss, except that pairs which agree with the world count with the loss under their own geometry.

    tolerance: of the agreement, in standard errors of the median.
    """
    losses = []
    for matches in evidence:
        limit = AGREEING_SIGMAS + tolerance * MEDIAN_ERROR / sqrt(len(matches.x1))
        if _median_distance(world, matches) <= limit:
            losses.append(matches.own_loss)
        else:
            losses.append(_loss(world, [matches]))
    return float(np.average(losses, weights=_counts(evidence)))


def _explains(best: _Explanation, stated: _World, evidence: list[_Matches], unconfirmed: bool) -> bool:
    """Does a cause restore the fit that the matches have under their own geometry?"""
    ratio = LEAST_LOSS_RATIO_UNCONFIRMED if unconfirmed else LEAST_LOSS_RATIO
    share = LEAST_SHARE_UNCONFIRMED if unconfirmed else LEAST_SHARE
    loss = _loss(stated, evidence)
    gain = loss - best.loss
    needed = share * (loss - min(_own_loss(evidence), best.loss))
    return loss > ratio * best.loss and gain >= needed and gain * sum(_counts(evidence)) >= LEAST_LOSS


def _moved_px(stated: _World, corrected: _World, evidence: list[_Matches]) -> float:
    """Motion of points along the epipolar lines between two worlds, and towards these lines, in pixels: median over the matches
    of the pairs that change; `FARTHEST_PX` for points behind a camera."""
    motions = []
    for matches in evidence:
        if all(stated[name] is corrected[name] for name in matches.pair):
            continue
        # Along the line: the change of depth, by the depth that a pixel of disparity makes (`gain`).
        z, gain = _depths(stated, matches)
        corrected_z, _ = _depths(corrected, matches)
        with np.errstate(invalid="ignore", divide="ignore"):
            along = np.minimum(np.nan_to_num(np.abs(z - corrected_z) / gain, nan=FARTHEST_PX), FARTHEST_PX)
        # Across it: the change of the distance.
        stated_px = np.abs(_residuals(stated, matches)) * matches.noise_px
        corrected_px = np.abs(_residuals(corrected, matches)) * matches.noise_px
        motions.append(np.hypot(along, stated_px - corrected_px))
    if not motions:
        return 0.0
    return float(np.median(np.concatenate(motions)))


def _is_noticeable(stated: _World, other: _World, evidence: list[_Matches]) -> bool:
    """Do points move, or their rays turn, noticeably between two worlds?"""
    turns = []
    widths = []
    for matches in evidence:
        for name, x in zip(matches.pair, (matches.x1, matches.x2), strict=True):
            before = stated[name]
            after = other[name]
            rays_before = rays(before.camera, before.undistort(x)).T
            rays_after = rays(after.camera, after.undistort(x)).T
            turns.append(ray_angles(rays_before, rays_after) * before.camera.K[0, 0])
            widths.append(before.camera.width)
    width = np.mean(widths)
    motion = _moved_px(stated, other, evidence) / width
    turn = np.median(np.concatenate(turns)) / width
    return bool(motion >= LEAST_MOTION_ALONG or turn >= LEAST_TURN)


def _depths(world: _World, matches: _Matches) -> tuple[Float64s, Float64s]:
    """Depths (n,) of the matches in the left camera, and the change of depth by a pixel of disparity (n,)."""
    left = world[matches.pair[0]]
    right = world[matches.pair[1]]
    return triangulate_depth(left.camera, right.camera, left.undistort(matches.x1), right.undistort(matches.x2))


def _simplest(explanations: list[_Explanation], loss: float, slack: float = 0.1) -> _Explanation:
    """The simplest of the causes that explain about as much of a loss as any; slack: tolerated share of the remaining loss.
    Headings count as two unknowns, like the principal points that they imitate: the loss decides between these."""
    least_loss = min(explanation.loss for explanation in explanations)
    # Causes with more unknowns always fit a little better.
    limit = least_loss + max(slack * least_loss, 0.05 * (loss - least_loss))

    def rank(explanation: _Explanation) -> tuple[bool, int, float]:
        unknowns = explanation.cause.unknowns
        if explanation.cause.name == "headings":
            unknowns += 1
        return explanation.loss > limit, unknowns, explanation.loss

    return min(explanations, key=rank)


def _fit(cause: _Cause, stated: _World, evidence: list[_Matches]) -> _Explanation:
    """The amount of a cause that fits the matches best, by Gauss-Newton steps on a loss whose scale tightens."""
    # the loss of other pairs does not depend on the amount
    affected = [matches for matches in evidence if not cause.cameras or set(cause.cameras) & set(matches.pair)]
    amount = np.zeros(cause.unknowns)  # as stated
    damping = 1e-3
    scale = np.inf

    def residuals(amounts: Float64s) -> Float64s:
        world = cause.change(stated, amounts)
        return np.concatenate([_residuals(world, matches) for matches in affected])

    current = residuals(amount)
    steps = STEPS if cause.unknowns else 0
    for _ in range(steps):
        # The scale only tightens, down to that of the loss: a wide one reaches the minimum from afar.
        scale = min(scale, max(OUTLIER, 1.5 * float(np.median(np.abs(current)))))
        cost = float(np.log1p((current / scale) ** 2).sum())

        # Normal equations with numerical derivatives (n, unknowns) and Cauchy weights.
        deltas = 1e-6 * np.eye(cause.unknowns)
        J = np.stack([(residuals(amount + delta) - current) / 1e-6 for delta in deltas], axis=1)
        weight = 1 / (1 + (current / scale) ** 2)
        normal = J.T @ (J * weight[:, None])
        gradient = J.T @ (weight * current)
        step = np.linalg.solve(normal + np.diag(damping * np.diag(normal) + 1e-9), -gradient)

        # Levenberg-Marquardt: a step is taken only if it helps; else a shorter one, nearer to the gradient, is tried.
        trial = residuals(amount + step)
        if float(np.log1p((trial / scale) ** 2).sum()) < cost:
            amount = amount + step
            current = trial
            damping = max(damping / 10, 1e-9)
        else:
            damping *= 10
            if damping > 1e3:
                break
        if np.linalg.norm(step) < 1e-7 and scale <= OUTLIER:
            break
    world = cause.change(stated, amount)
    return _Explanation(cause, amount, world, _loss(world, evidence))


def _causes(stated: _World, evidence: list[_Matches], unconfirmed: bool) -> Iterator[_Cause]:
    """Possible causes, the likeliest first."""
    yield _simple("focal-lengths", 1, _zoomed)
    yield _simple("distortion", 1, _distorted)
    if any(_has_distortion(view.camera) for view in stated.values()):
        yield _simple("distortion-factor", 1, _distortion_scaled)
    if unconfirmed:
        return
    yield _simple("pixel-shape", 1, lambda view, a: _zoomed(view, np.append(a, 0.0)))
    yield _simple("pixel-height", 1, lambda view, a: _zoomed(view, np.append(0.0, a)))
    yield _simple(CORNER, 0, lambda view, _: _shifted(view, CORNER_PX / view.camera.width))
    yield _simple("principal-points", 2, _shifted)
    yield _simple("headings", 1, lambda view, a: _rotated(view, view.camera.R @ rotation_matrix(np.append([0.0, 0.0], a))))
    yield _simple("rolls", 1, lambda view, a: _rotated(view, rotation_matrix(np.append([0.0, 0.0], a)) @ view.camera.R))
    yield _simple("focal-lengths-and-distortion", 2, lambda view, a: _distorted(_zoomed(view, a[:1]), a[1:]))
    for axis, name in enumerate(STRETCHED):
        yield _simple(name, 1, partial(_stretched, axis=axis))
    for name in CONVENTIONS:
        yield _simple(name, 0, partial(_read_otherwise, convention=name))
    baseline = _baseline(stated, evidence)
    zero = np.zeros(3)
    pair_counts = Counter(name for matches in evidence for name in matches.pair)
    names = sorted(pair_counts)
    for name in names:
        if pair_counts[name] < 2:  # matches of one pair may be look-alikes
            continue
        yield _simple("focal-length", 1, _zoomed, name)
        yield _simple("distortion-of-one", 1, _distorted, name)
        yield _simple("turned", 3, lambda view, a: _posed(view, np.append(a, zero), baseline), name)
        yield _simple("moved", 3, lambda view, a: _posed(view, np.append(zero, a), baseline), name)
        for convention in ("mirrored-frames", "upside-down"):
            yield _simple(convention, 0, partial(_read_otherwise, convention=convention), name)
    if len(names) > LARGEST_SITE:
        return
    if len(stated) > 2:
        all_names = list(stated)
        for step in (1, -1):  # each takes the place of the next one, as when a recorder numbers its inputs from another start
            next_names = [*all_names[step:], *all_names[:step]]
            yield _exchange("captures-exchanged", dict(zip(all_names, next_names, strict=True)))
    for one, other in combinations(names, 2):
        for name in EXCHANGED:
            yield _exchange(name, {one: other, other: one}, (one, other))


def _baseline(world: _World, evidence: list[_Matches]) -> float:
    """Median distance between the cameras of the pairs."""
    left = np.array([world[matches.pair[0]].camera.C for matches in evidence])
    right = np.array([world[matches.pair[1]].camera.C for matches in evidence])
    return float(np.median(np.linalg.norm(right - left, axis=1)))


def _simple(name: str, unknowns: int, change: _Change, *cameras: str) -> _Cause:
    """A cause that changes each of some cameras, or of all if none are named, in the same way."""

    def change_all(world: _World, amount: Float64s) -> _World:
        changed = dict(world)
        for camera in cameras or world:
            changed[camera] = change(world[camera], amount)
        return changed

    return _Cause(name, change_all, unknowns, cameras)


def _with_pose(cause: _Cause, name: str, baseline: float) -> _Cause:
    """A cause, together with a pose of its own for a camera; its six unknowns come first."""

    def change(world: _World, amount: Float64s) -> _World:
        changed = cause.change(world, amount[_POSE_UNKNOWNS:])
        return {**changed, name: _posed(changed[name], amount[:_POSE_UNKNOWNS], baseline)}

    return replace(cause, change=change, unknowns=_POSE_UNKNOWNS + cause.unknowns)


def _exchange(name: str, sources: Mapping[str, str], cameras: tuple[str, ...] = ()) -> _Cause:
    """A cause by which each camera in `sources` has parts of another one."""
    keys = EXCHANGED[name]  # names of the fields of `Camera`

    def change(world: _World, _: Float64s) -> _World:
        changed = dict(world)
        for camera, source in sources.items():
            changed[camera] = _mixed(world[camera], world[source], keys)
        return changed

    return _Cause(name, change, cameras=cameras)


def _posed(view: _CheckedView, amount: Float64s, baseline: float) -> _CheckedView:
    """The camera rotated and shifted; amount: rotation vector (3), and shift (3) in units of `baseline`."""
    camera = view.camera
    return replace(view, camera=replace(camera, R=rotation_matrix(amount[:3]) @ camera.R, C=camera.C + baseline * amount[3:]))


def _rotated(view: _CheckedView, R: Float64s) -> _CheckedView:
    return replace(view, camera=replace(view.camera, R=R))


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
    if not _has_distortion(camera):
        return view
    scaled = replace(camera, distortion=camera.distortion * (1 + extra[0]))
    return replace(view, camera=scaled, stated=camera)


def _shifted(view: _CheckedView, share: Float64s) -> _CheckedView:
    """The camera with a shifted principal point; share: of the width."""
    K = view.camera.K.copy()
    K[:2, 2] += share * view.camera.width
    return replace(view, camera=replace(view.camera, K=K))


def _read_otherwise(view: _CheckedView, _: Float64s, convention: str) -> _CheckedView:
    return replace(view, camera=CONVENTIONS[convention](view.camera))


def _mixed(view: _CheckedView, other: _CheckedView, keys: tuple[str, ...]) -> _CheckedView:
    """The camera with parts of another one."""
    old = view.camera
    new = replace(old, **{key: getattr(other.camera, key) for key in keys})
    swapped = "distortion" in keys and old.lens is None and other.camera.lens is None
    # Then the frames were made with the wrong distortion, which has to be undone.
    if swapped and (_has_distortion(old) or _has_distortion(other.camera)):
        return replace(view, camera=new, stated=old)
    return replace(view, camera=new, stated=None)


def _stretched(view: _CheckedView, log: Float64s, axis: int) -> _CheckedView:
    """The camera with its position stretched along an axis; log: logarithm of the factor."""
    C = view.camera.C.copy()
    C[axis] *= np.exp(np.clip(log[0], -LARGEST_ZOOM, LARGEST_ZOOM))
    return replace(view, camera=replace(view.camera, C=C))


def _flipped(camera: Camera, axes: int) -> Camera:
    """The camera for frames that are mirrored (one of the `axes` flipped), or upside down (both flipped)."""
    K = camera.K.copy()
    size = (camera.width, camera.height)
    for k in range(axes):
        K[k, k] = -K[k, k]
        K[k, 2] = size[k] - 1 - K[k, 2]
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
