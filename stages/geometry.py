"""Two-view geometry of a pair: F (or E, where the lenses are known), the evidence for it, and tests for degenerate cases."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from .contracts.defaults import SEED
from .contracts.reasons import Reason, Rejected
from .core.epipolar import symmetric_epipolar_distance
from .matching.candidates import searched_view_pairs
from .matching.structural import match_guided
from .twoview.image_grid import GRID_COLUMNS, GRID_ROWS
from .twoview.intrinsics_prior import MOST_IMPLAUSIBLE, TwoCameras, refine_with_plausible_intrinsics
from .twoview.pair_evidence import pair_evidence, point_evidence, ray_angle_deg
from .twoview.pair_score import PairEvidence, informs_about_site, pair_score, probability
from .twoview.pooled_pair import matches_of_night, pooled_evidence, with_night
from .twoview.refinement import noise_px, refine_two_view
from .twoview.robust import (
    INLIER_FACTOR,
    TwoView,
    estimate_essential,
    estimate_fundamental,
    estimate_with_one_lens,
    homography_support,
    pose_of_fundamental,
    rotation_support,
    supporters,
)
from .types import Features, Float64s, Geometry, Matches, View, at_rows
from .types.checking import require

ESSENTIAL_SUPPORT = 0.7
"""E is kept if it has at least this share of the inliers of F.  F has two more degrees of freedom: enough to also fit matches
that repeat along a facade (a sixth of the inliers of some right pairs), and to be bent by them."""
PLANAR_SHARE = 0.95
"""F counts as undetermined if a model without depth (homography, rotation) explains this share of its inliers, or all but
fewer than `min_inliers`: the rest may be chance."""


@dataclass(frozen=True)
class _Options:
    """Parameters shared by all estimates of one pair, see `estimate_geometry`."""

    threshold_px: float
    use_intrinsics: bool
    seed: int


def estimate_geometry(
    matches: Matches,
    left: Features,
    right: Features,
    *,
    threshold_px: float = 1.0,
    guided: bool = True,
    use_intrinsics: bool = True,
    min_inliers: int = 20,
    few_inliers: int = 50,
    min_area: float = 0.005,
    small_area: float = 0.03,
    min_score: float = -4.0,
    seed: int = SEED,
) -> Geometry | Rejected:
    """Estimate the epipolar geometry of a pair and decide whether it can be used.

    Returns `Rejected`, with figures, for too few or too clustered inliers, a planar scene, a pure rotation, or wrong matches.
    Raises ValueError for an argument of a wrong type.

    Parameters
    ----------
    matches : correspondences before geometry.  Points without keypoints stay as they are, and their matcher's probability
        replaces the distinctiveness of descriptors; for matches pooled over nights, one night's keypoints supply it.
    left, right : the keypoints of the two frames.
    threshold_px : noise of a correct match, pixels.
    guided : match again along the epipolar lines, and keep the result unless the number of inliers drops.
    use_intrinsics : also try the 5-point E where both K are known, and keep the better supported model.
    min_inliers : reject a pair with fewer inliers (with 15 the error of F reaches tens of pixels).
    few_inliers : warn about a pair with fewer inliers.
    min_area : smallest share of either image that the convex hull of the inliers covers; reject if it is less.
    small_area : warn if the convex hull of the inliers covers less than this share of either image.
    min_score : reject the pair if the log odds that it is right are lower; between this and 0 the whole site decides, as it
        does for pairs whose matches agree but whose rays hardly converge.
    seed : seed of the random samples.

    References: Hartley & Zisserman, Multiple View Geometry, 2nd ed., chapters 9 to 11.
    """
    require(Matches, matches=matches)
    require(Features, left=left, right=right)
    options = _Options(threshold_px, use_intrinsics, seed)
    if matches.i1 is not None:
        matches = replace(matches, searched=searched_view_pairs(matches, left, right))
    raw_matches = matches
    raw_count = len(raw_matches.x1)

    # 1. Estimate robustly, match again around the estimate, and refine.
    model = _solve(matches, _keypoint_sizes(matches, left, right), options)
    if model is None:
        return Rejected(Reason.TOO_FEW_INLIERS, {"matches": raw_count, "inliers": 0, "needed": min_inliers})
    night = _one_night_matches(matches, model, left, right)
    if guided and (night is not None or matches.i1 is not None):
        matches, model = _guided_round(matches, model, night, left, right, options)
    model, noise, lenses = _refined(matches, model, _keypoint_sizes(matches, left, right), options)
    count = int(model.inliers.sum())
    if count < min_inliers:
        return Rejected(Reason.TOO_FEW_INLIERS, {"matches": raw_count, "inliers": count, "needed": min_inliers})

    # 2. Do the inliers determine it?
    inliers = at_rows(matches, model.inliers)
    support = _support(inliers, model, options)
    figures = {"matches": float(raw_count), **support.figures()}
    degenerate = _degenerate(support, min_area, min_inliers)
    if degenerate is not None:
        return Rejected(degenerate, figures | {"needed_share": min_area})

    # 3. Is it right?  That F was preferred to E although both lenses are known is evidence against it.
    has_known_lenses = _has_known_lens(matches.view1) and _has_known_lens(matches.view2)
    is_contradicted = use_intrinsics and has_known_lenses and model.R is None
    evidence = _evidence(raw_matches, inliers, night, model, left, right, options)
    score = pair_score(evidence, is_contradicted)
    figures |= {"score": score, "distinct_cells": float(evidence.distinct_cells), "agreement": evidence.agreement}
    if score < min_score and not informs_about_site(evidence):
        return Rejected(Reason.WRONG_MATCHES, figures | {"cells": GRID_COLUMNS * GRID_ROWS})

    accepted = _accepted(inliers, model, support, evidence, score)
    if lenses is not None:
        accepted = replace(accepted, lens1=lenses.K1, lens2=lenses.K2, implausibility=lenses.implausibility)
    return replace(
        accepted,
        matches=raw_count,
        noise_px=noise[model.inliers].astype(np.float32),
        warnings=_warnings(support, is_contradicted, few_inliers, small_area, min_inliers),
    )


def _keypoint_sizes(matches: Matches, left: Features, right: Features) -> Float64s:
    """(n,) size of the coarser keypoint of each match, pixels; 1 without keypoints: only ratios of sizes matter."""
    if matches.i1 is None or matches.i2 is None:
        return np.ones(len(matches.x1))
    size1 = _frame_sizes(left.frames[matches.i1])
    size2 = _frame_sizes(right.frames[matches.i2])
    return np.asarray(np.maximum(size1, size2), dtype=np.float64)


def _frame_sizes(frames: Float64s) -> Float64s:
    """(n,) size of keypoints in pixels of the frame, from their local frames (n, 2, 2)."""
    return np.asarray(np.sqrt(np.abs(np.linalg.det(frames))), dtype=np.float64)


def _solve(matches: Matches, size: Float64s, options: _Options) -> TwoView | None:
    """F or, where both K are known and `ESSENTIAL_SUPPORT` prefers it, E.  size: (n,) sizes of the matched keypoints."""
    x1 = matches.x1
    x2 = matches.x2
    if not (options.use_intrinsics and _has_known_lens(matches.view1) and _has_known_lens(matches.view2)):
        bare = estimate_fundamental(x1, x2, options.threshold_px, options.seed)
        if bare is None:
            return None
        return _with_plausible_lenses(matches, bare, size, options)
    calibrated = estimate_essential(x1, x2, matches.view1, matches.view2, options.threshold_px, options.seed)
    if calibrated is not None and calibrated.inliers.sum() >= ESSENTIAL_SUPPORT * len(x1):
        return calibrated  # even an F with all matches as inliers would not be preferred
    uncalibrated = estimate_fundamental(x1, x2, options.threshold_px, options.seed)
    if uncalibrated is None:
        return calibrated
    if calibrated is None or calibrated.inliers.sum() < ESSENTIAL_SUPPORT * uncalibrated.inliers.sum():
        return uncalibrated
    return calibrated


def _has_known_lens(view: View) -> bool:
    """Whether the intrinsics are known, not only guessed from a field of view or EXIF."""
    return view.K is not None and view.focal_known


def _with_plausible_lenses(matches: Matches, bare: TwoView, size: Float64s, options: _Options) -> TwoView:
    """F with plausible lenses for both cameras; the bare F if there are none, or if too many inliers would be lost."""
    x1 = matches.x1
    x2 = matches.x2
    view1, view2 = _lenses_to_use(matches, options.use_intrinsics)
    # The matches of the refinement are the inliers of the bare F or of an F with one centred lens, which bends less.
    candidates = [bare]
    one_lens = estimate_with_one_lens(x1, x2, view1, view2, options.threshold_px, options.seed)
    if one_lens is not None:
        candidates.append(one_lens)
    any_inlier = np.any([candidate.inliers for candidate in candidates], axis=0)
    # Noise is proportional to keypoint size: its factor, from the inliers of the bare F, holds for the other matches too.
    bare_noise = noise_px(bare.F, x1[bare.inliers], x2[bare.inliers], size[bare.inliers])
    noise = size[any_inlier] * (bare_noise[0] / size[bare.inliers][0])
    initial = [candidate.F for candidate in candidates]
    plausible = refine_with_plausible_intrinsics(initial, x1[any_inlier], x2[any_inlier], noise, view1, view2)
    if plausible is None or plausible.implausibility > MOST_IMPLAUSIBLE:
        return bare
    inliers = supporters(plausible.F, x1, x2, options.threshold_px)
    if inliers.sum() < max(ESSENTIAL_SUPPORT * bare.inliers.sum(), 8):
        return bare
    return TwoView(plausible.F, inliers)


def _lenses_to_use(matches: Matches, use_intrinsics: bool) -> tuple[View, View]:
    """The two views, without their intrinsics if these are not to be used."""
    if use_intrinsics:
        return matches.view1, matches.view2
    return View(matches.view1.width, matches.view1.height), View(matches.view2.width, matches.view2.height)


def _one_night_matches(matches: Matches, model: TwoView, left: Features, right: Features) -> Matches | None:
    """One night's keypoint matches around a geometry pooled over many nights; None if it is not pooled."""
    if matches.nights == 1 or matches.i1 is not None or not min(len(left.xy), len(right.xy)):
        return None
    return matches_of_night(at_rows(matches, model.inliers), model.F, left, right)


def _guided_round(
    matches: Matches, model: TwoView, night: Matches | None, left: Features, right: Features, options: _Options
) -> tuple[Matches, TwoView]:
    """Matches and their geometry after the guided round, or those passed in if they have more inliers.

    night: one night's keypoint matches around the geometry, if the matches are pooled over nights.
    """
    if night is not None:
        guided = with_night(matches, night)
    else:
        guided = match_guided(at_rows(matches, model.inliers), left, right, model.F)
    guided = replace(guided, view1=matches.view1, view2=matches.view2, matcher=matches.matcher)
    inliers = supporters(model.F, guided.x1, guided.x2, options.threshold_px)
    if inliers.sum() < model.inliers.sum():
        return matches, model
    return guided, replace(model, inliers=inliers)


def _refined(matches: Matches, model: TwoView, size: Float64s, options: _Options) -> tuple[TwoView, Float64s, TwoCameras | None]:
    """The geometry refined with weights by keypoint size; the noise (n,) of each match in pixels; and the lenses that go with
    F where they are not known.  The geometry stays as it is if the refined one has no pose, or fewer than 8 inliers."""
    view1 = matches.view1
    view2 = matches.view2
    x1 = matches.x1[model.inliers]
    x2 = matches.x2[model.inliers]
    inlier_size = size[model.inliers]
    intrinsics: tuple[Float64s, Float64s] | None = None  # for an E; a bare F is refined without them
    if model.R is not None and view1.K is not None and view2.K is not None:
        intrinsics = (view1.K, view2.K)
    lenses: TwoCameras | None = None
    pose: tuple[Float64s, Float64s] | None = None

    F, noise = refine_two_view(model.F, x1, x2, inlier_size, intrinsics)
    if intrinsics is not None:
        pose = pose_of_fundamental(F, x1, x2, view1, view2)
    elif not (_has_known_lens(view1) and _has_known_lens(view2)):
        views = _lenses_to_use(matches, options.use_intrinsics)
        lenses = refine_with_plausible_intrinsics([F], x1, x2, noise, *views)
        if lenses is not None and lenses.implausibility <= MOST_IMPLAUSIBLE:
            F = lenses.F

    all_noise = size * (noise[0] / inlier_size[0])  # proportional to size
    inliers = supporters(F, matches.x1, matches.x2, options.threshold_px)
    if inliers.sum() < 8:
        return model, all_noise, lenses
    if intrinsics is None:
        return TwoView(F, inliers), all_noise, lenses
    if pose is None:
        return model, all_noise, lenses
    return TwoView(F, inliers, *pose), all_noise, lenses


@dataclass(frozen=True)
class _Support:
    """How well the inliers determine a geometry."""

    inliers: int
    area: float
    """Share of the image that their convex hull covers, in the image with less."""
    plane_share: float
    """Share of them that one homography explains."""
    turned_share: float | None
    """Share of them that a pure rotation explains; None without E."""

    def figures(self) -> dict[str, float]:
        """For the report."""
        figures = {"inliers": float(self.inliers), "area_share": self.area, "homography_share": self.plane_share}
        if self.turned_share is not None:
            figures["rotation_share"] = self.turned_share
        return figures

    def explained(self, share: float, min_inliers: int) -> bool:
        """Can the inliers that a model without depth does not explain be chance?  share: of those that it does explain."""
        unexplained = self.inliers * (1 - share)
        return unexplained < max(min_inliers, (1 - PLANAR_SHARE) * self.inliers)


def _support(inliers: Matches, model: TwoView, options: _Options) -> _Support:
    """How well the inliers determine this geometry."""
    x1 = inliers.x1
    x2 = inliers.x2
    turned_share: float | None = None
    if model.R is not None:
        limit_px = INLIER_FACTOR * options.threshold_px
        turned_share = rotation_support(x1, x2, inliers.view1, inliers.view2, model.R, limit_px)
    plane_share = float(homography_support(x1, x2, options.threshold_px, options.seed).mean())
    area = min(_hull_share(x1, inliers.view1), _hull_share(x2, inliers.view2))
    return _Support(len(x1), area, plane_share, turned_share)


def _hull_share(x: Float64s, view: View) -> float:
    """Share of an image that the convex hull of the points (n, 2) covers."""
    return float(cv2.contourArea(cv2.convexHull(x.astype(np.float32)))) / (view.width * view.height)


def _degenerate(support: _Support, min_area: float, min_inliers: int) -> Reason | None:
    """Why the inliers do not determine the geometry; None if they do.

    Matches on a plane determine E, but not F; a pure rotation determines neither.  Both look like a homography.
    """
    if support.area < min_area:
        return Reason.CLUSTERED
    if support.turned_share is None:
        return Reason.PLANAR_OR_ROTATION if support.explained(support.plane_share, min_inliers) else None
    return Reason.PURE_ROTATION if support.explained(support.turned_share, min_inliers) else None


def _evidence(
    raw: Matches, inliers: Matches, night: Matches | None, model: TwoView, left: Features, right: Features, options: _Options
) -> PairEvidence:
    """Evidence for the pair: from the descriptors where the matches have keypoints, from those of one night where they are
    pooled over nights, else from the matcher's probabilities."""
    if inliers.i1 is not None and inliers.i2 is not None:
        pairs = searched_view_pairs(inliers, left, right)
        return pair_evidence(left, right, pairs, inliers.i1, inliers.i2, model, options.seed)
    evidence = point_evidence(raw, inliers, model, options.seed)
    if night is None:
        return evidence
    return pooled_evidence(evidence, night, model, left, right, options.threshold_px, options.seed)


def _accepted(inliers: Matches, model: TwoView, support: _Support, evidence: PairEvidence, score: float) -> Geometry:
    """The geometry with its evidence; the relative pose is that of E, or nearest to F if both K are known or guessed."""
    R = model.R
    t = model.t
    if R is None:
        pose = pose_of_fundamental(model.F, inliers.x1, inliers.x2, inliers.view1, inliers.view2)
        if pose is not None:
            R, t = pose
    rival = evidence.rival
    return Geometry(
        F=model.F,
        x1=inliers.x1,
        x2=inliers.x2,
        i1=inliers.i1,
        i2=inliers.i2,
        probability=inliers.probability,
        view1=inliers.view1,
        view2=inliers.view2,
        cam2_R_cam1=R,
        cam2_t_cam1=t,
        matches=len(inliers.x1),
        inliers=len(inliers.x1),
        model="F" if model.R is None else "E",
        epipolar_px=float(np.median(symmetric_epipolar_distance(model.F, inliers.x1, inliers.x2))),
        angle_deg=ray_angle_deg(inliers.x1, inliers.x2, inliers.view1, inliers.view2, R),
        homography_share=support.plane_share,
        score=score,
        good_probability=probability(score),
        distinct_cells=evidence.distinct_cells,
        distinct_share=evidence.distinct_share,
        agreement=evidence.agreement,
        half_rotation_deg=evidence.half_rotation_deg,
        stretch=evidence.stretch,
        rival_inliers=0 if rival is None else rival.inliers,
        rival_elsewhere=0 if rival is None else rival.elsewhere,
        rival_turned_deg=float("nan") if rival is None else rival.turned_deg,
    )


def _warnings(support: _Support, contradicted: bool, few_inliers: int, small_area: float, min_inliers: int) -> tuple[str, ...]:
    """What a user should know about an accepted geometry; contradicted: F was preferred to E although both lenses are known."""
    warnings = []
    if support.inliers < few_inliers:
        warnings.append(f"few inliers: {support.inliers}")
    if support.area < small_area:
        warnings.append(f"clustered: inliers on {100 * support.area:.1f} % of the image")
    if support.explained(support.plane_share, min_inliers):
        warnings.append(f"planar scene: one homography explains {100 * support.plane_share:.0f} % of the inliers")
    if contradicted:
        warnings.append("the intrinsics contradict the matches: F kept instead of E")
    return tuple(warnings)
