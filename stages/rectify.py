"""Rectification of a pair: after it a point lies on the same row in both images (Hao 2011, chapter 4).

The homographies of `congruent`, `hao2011`, `hartley` and `calibrated` cannot work when an epipole lies in or near the image;
then `polar` takes over.  Rectifications that would be wrong are rejected, with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .contracts.defaults import RAY_ANGLE_DEG
from .contracts.reasons import Reason, Rejected
from .core.cameras import convergence_deg
from .core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance, triangulate_depth
from .core.methods import bind
from .core.ordering import percentiles
from .core.residual_distortion import residual_distortion, undistorted_points
from .mvs.ground import ground_homography, inverse_depth_line
from .rectification.fitting import Layout, finish_layout, fit_layout
from .rectification.method import Homographies, MatchedPair, PolarImages
from .rectification.predicted import ground_in_both, predict
from .rectification.quality import parallax_px
from .rectification.warping import to_rectified
from .stereo.row_verification import verify_rows
from .twoview.intrinsics_prior import MOST_IMPLAUSIBLE
from .twoview.pair_score import hardly_converging
from .types import Bools, Camera, Float32s, Float64s, Frame, Geometry, GroundOfPair, PairCheck, Rectification, Scene
from .types.checking import require

METHODS = {
    "congruent": "wbflow_stages.rectification.planar:congruent",
    "hao2011": "wbflow_stages.rectification.planar:hao2011",
    "hartley": "wbflow_stages.rectification.planar:hartley",
    "calibrated": "wbflow_stages.rectification.planar:calibrated",
    "polar": "wbflow_stages.rectification.polar:polar",
}
"""Rectification methods by name.  A method takes its inputs by argument name: `pair` (`MatchedPair`), `geometry`, `left`,
`right` (`Camera`); its own parameters are keyword-only, with defaults.  It returns `Homographies` or `PolarImages`, and raises
ValueError, with the reason, if it cannot rectify a pair."""

_LEAST_PARALLAX = 0.01
"""Least parallax of the matches against their best homography, as a share of the width, where the ray angle is unknown."""
_AGREEMENT_PX = 1.5
"""Matches agree with known cameras if they lie within this many pixels of their epipolar lines."""
_AGREEMENT_SHARE = 0.002
"""The same as a share of the frame's longer side; the larger of both holds."""
_LEAST_AGREEING = 0.5
"""Cameras contradict the matches if a smaller share of these agrees with them."""
_PREDICTED_RANGE = (2.0, 98.0)
"""Percentiles, per cent, of the predicted disparities between which dense matching first searches."""
_LEAST_GROUND_IN_REACH = 0.5
"""Smallest share of the ground seen by two known cameras that the disparity range covers; if it covers less, the matches have
not shown where the scene lies."""
_BELOW_GROUND = 0.05
"""Depth under the ground, as a share of the lower camera's height above it, below which nothing is searched: matches there
come from repeating stones."""
_FEWEST_POINTS = 50
"""Fewest points, of a dense match or on the ground, that show where the scene lies."""
_MARGIN_OF_POINTS = 0.1
"""Margin of the disparity range beyond the points of a dense match, as a share of their range."""


def rectify(
    geometry: Geometry | None = None,
    left: Camera | None = None,
    right: Camera | None = None,
    check: PairCheck | None = None,
    left_frame: Frame | None = None,
    right_frame: Frame | None = None,
    scene: Scene | None = None,
    *,
    method: str = "congruent",
    fallback: bool = True,
    min_matches: int = 20,
    few_matches: int = 50,
    max_row_error_px: float = 0.5,
    min_angle_deg: float = RAY_ANGLE_DEG,
    range_margin: float = 0.1,
    **options: object,
) -> Rectification | Rejected:
    """Find how the two frames of a pair are resampled so that a point lies on the same row in both.

    Known cameras determine the rows.  Matches that agree with them determine scale, crop and disparity range, together with
    the ground if it is known; if they are too few, points of the likely scene are used, and dense matching must confirm the
    rows.  Raises ValueError for an argument of a wrong type, an unknown method or missing cameras, TypeError for a parameter that
    the method does not have.

    Parameters
    ----------
    geometry : two-view geometry of the pair: its matches determine scale, crop and disparity range, and F if there are no
        cameras.
    left, right, check : solved or known cameras, which then give F; and whether the pair's matches agree with the whole site.
    left_frame, right_frame, scene : the pair's frames, and the likely position of the scene; used if matches are too few.
    method : "congruent": homographies that make the net of matches congruent, robustly; "hartley": homographies that minimise
        the disparity of the matches; "hao2011": congruent by the letter of Hao (2011), for study; "calibrated": both cameras
        turned to a common orientation (needs cameras), then the congruent affine map; "polar": half epipolar lines as rows; or
        a function of your own, `package.module:function`.  Homographies that tear the image are replaced by Hartley's, or by
        "polar" if an epipole is near; `reason` says why.
    fallback : replace homographies that tear the image; False keeps the chosen method however it stretches, for study.
    min_matches : reject a pair without known cameras if it has fewer matches.
    few_matches : if both cameras are known, fewer matches than this do not determine where the scene lies.
    max_row_error_px : without cameras, reject if the epipolar lines may be off by more than this (95 % of them), in pixels of
        a frame with a long side of 768 or less; the limit grows with larger frames, whose pixels show less of the scene.
    min_angle_deg : reject if the rays converge by less (median), in degrees; without cameras, also if one homography explains
        the pair.
    range_margin : the disparity range reaches beyond the matches by this share of their range plus 1 % of the width.
    options : parameters of the method, see its function.

    References: Hartley, IJCV 1999; Fusiello et al., MVA 2000; Pollefeys et al., ICCV 1999.
    """
    require(Geometry | None, geometry=geometry)
    require(Camera | None, left=left, right=right)
    if geometry is not None and left is not None and right is not None:
        geometry = replace(geometry, x1=undistorted_points(left, geometry.x1), x2=undistorted_points(right, geometry.x2))

    def fit(pair: MatchedPair) -> Layout | Rejected:
        inputs = {"pair": pair, "geometry": geometry, "left": left, "right": right}
        bound = bind(METHODS, method, inputs, options, Homographies | PolarImages)
        return fit_layout(pair, method, bound, fallback)

    # 1. by the matches
    limits = _Limits(min_matches, max_row_error_px, min_angle_deg, range_margin)
    by_matches, match_count = _from_matches(geometry, left, right, check, fit, limits)
    if isinstance(by_matches, Rectification):
        conclusive = match_count >= few_matches
    else:
        conclusive = by_matches.code == Reason.NO_BASELINE  # cameras would find none either
    if conclusive or left is None or right is None or left_frame is None or right_frame is None:
        return _with_distortion(_reaching_ground(by_matches, geometry, (left, right), scene, fit), left, right)

    # 2. by the cameras, and by few matches only if that fails
    result = _from_cameras((left, right), (left_frame, right_frame), scene, fit, min_angle_deg)
    if isinstance(result, Rejected) and isinstance(by_matches, Rectification):
        result = by_matches
    return _with_distortion(result, left, right)


class _Limits(NamedTuple):
    """Parameters of `rectify` that decide whether matches are good enough."""

    min_matches: int
    max_row_error_px: float
    min_angle_deg: float
    range_margin: float


def _with_distortion(result: Rectification | Rejected, left: Camera | None, right: Camera | None) -> Rectification | Rejected:
    """The rectification, with the distortion that remains in the frames of two known cameras."""
    if isinstance(result, Rejected) or left is None or right is None:
        return result
    return replace(result, bend1=residual_distortion(left), bend2=residual_distortion(right))


def _from_matches(
    geometry: Geometry | None,
    left: Camera | None,
    right: Camera | None,
    check: PairCheck | None,
    fit: Callable[[MatchedPair], Layout | Rejected],
    limits: _Limits,
) -> tuple[Rectification | Rejected, int]:
    """The rectification from the matches, and how many of them agree with F.

    Parameters
    ----------
    geometry, left, right, check : as for `rectify`.
    fit : the method, and what replaces it where it tears the image.
    limits : what is too few, too uncertain, or too narrow.
    """
    if geometry is None:
        return Rejected(Reason.NOTHING_KNOWN), 0
    pair = _agreeing_matches(geometry, left, right)
    match_count = len(pair.x1)
    if check is not None and not check.kept:
        return Rejected(Reason(check.code), words=check.reason), match_count
    refusal = _unreliable(geometry, pair, limits.min_angle_deg)
    if refusal is not None:
        return refusal, match_count
    refusal = _unusable(len(geometry.x1), pair, limits.min_matches, limits.min_angle_deg)
    if refusal is not None:
        return refusal, match_count
    layout = fit(pair)
    if isinstance(layout, Rejected):
        return layout, match_count
    return finish_layout(*layout, pair, geometry, limits.max_row_error_px, limits.range_margin), match_count


def _from_cameras(
    cameras: tuple[Camera, Camera],
    frames: tuple[Frame, Frame],
    scene: Scene | None,
    fit: Callable[[MatchedPair], Layout | Rejected],
    min_angle_deg: float,
) -> Rectification | Rejected:
    """The rectification from two cameras, laid out for the scene that both should see; dense matching must confirm it, and
    shows where the scene really is.

    Parameters
    ----------
    cameras, frames, scene : of the pair: two known cameras, their frames, and the likely position of the scene.
    fit : the method, and what replaces it where it tears the image.
    min_angle_deg : reject if the rays converge by less.
    """
    # 1. a draft, for points where the scene should be
    expected = predict(*cameras, scene)
    if expected is None:
        return Rejected(Reason.NOTHING_IN_COMMON)
    ground = _ground_of_pair(cameras, scene)
    layout = fit(_known_pair(cameras, expected.x1, expected.x2, np.ones(len(expected.x1), np.float32)))
    if isinstance(layout, Rejected):
        return layout
    draft, _ = layout
    disparities = to_rectified(draft, 1, expected.ends1)[:, 0] - to_rectified(draft, 2, expected.ends2)[:, 0]
    low, high = percentiles(disparities[np.isfinite(disparities)], *_PREDICTED_RANGE)
    draft = replace(
        draft,
        disparity_min_px=float(np.floor(low)),
        disparity_max_px=float(np.ceil(high)),
        ground=ground,
        bend1=residual_distortion(cameras[0]),
        bend2=residual_distortion(cameras[1]),
    )

    # 2. dense matches instead of keypoints: do they confirm the rows?
    rows, x1, x2, probability = verify_rows(*frames, draft)
    if not rows.confirmed or len(x1) < _FEWEST_POINTS:
        return Rejected(Reason.ROWS_NOT_CONFIRMED, {"row_share": rows.share, "row_chance": rows.chance})
    pair = replace(_known_pair(cameras, x1, x2, probability), extra_points=(expected.x1, expected.x2))
    if pair.angle_deg < min_angle_deg:
        return Rejected(Reason.NO_BASELINE, {"angle_deg": pair.angle_deg, "needed_deg": min_angle_deg})

    # 3. laid out anew, for the points that matched
    layout = fit(pair)
    if isinstance(layout, Rejected):
        return layout
    result = finish_layout(*layout, pair, None, float("inf"), _MARGIN_OF_POINTS)
    if isinstance(result, Rejected):
        return result
    return replace(
        result, verified="dense", row_share=rows.share, row_chance=rows.chance, row_error_px=rows.row_error_px, ground=ground
    )


def _reaching_ground(
    result: Rectification | Rejected,
    geometry: Geometry | None,
    views: tuple[Camera | None, Camera | None],
    scene: Scene | None,
    fit: Callable[[MatchedPair], Layout | Rejected],
) -> Rectification | Rejected:
    """The rectification from the matches, laid out anew if most of the ground is outside its disparity range: the façades
    around a square match, but the repetitive paving at their feet does not."""
    left, right = views
    if left is None or right is None or isinstance(result, Rejected) or geometry is None or scene is None or scene.ground is None:
        return result
    cameras = (left, right)
    ground1, ground2 = ground_in_both(left, right, scene.ground)
    if len(ground1) < _FEWEST_POINTS or _share_in_reach(result, ground1, ground2) >= _LEAST_GROUND_IN_REACH:
        return result
    # points of the ground join the matches, less those below it, which come from repeating stones
    matched = _agreeing_matches(geometry, left, right)
    above = _above_plane(_lowered(scene.ground, cameras), cameras, matched.x1, matched.x2)
    x1 = np.concatenate([matched.x1[above], ground1])
    x2 = np.concatenate([matched.x2[above], ground2])
    pair = _known_pair(cameras, x1, x2, np.ones(len(x1), np.float32))
    layout = fit(pair)
    if isinstance(layout, Rejected):
        return result
    wider = finish_layout(*layout, pair, None, float("inf"), _MARGIN_OF_POINTS)
    if isinstance(wider, Rejected):
        return result
    return replace(wider, ground=_ground_of_pair(cameras, scene))


def _share_in_reach(result: Rectification, x1: Float64s, x2: Float64s) -> float:
    """Share of points (n, 2), (n, 2) of the frames that both rectified images show within the disparity range."""
    y1 = to_rectified(result, 1, x1)
    y2 = to_rectified(result, 2, x2)
    shown1 = ((y1 > -0.5) & (y1 < np.array(result.size1) - 0.5)).all(axis=1)
    shown2 = ((y2 > -0.5) & (y2 < np.array(result.size2) - 0.5)).all(axis=1)
    disparity = y1[:, 0] - y2[:, 0]
    in_range = (disparity >= result.disparity_min_px) & (disparity <= result.disparity_max_px)
    return float(np.mean(shown1 & shown2 & in_range))


def _known_pair(cameras: tuple[Camera, Camera], x1: Float64s, x2: Float64s, probability: Float32s) -> MatchedPair:
    """Points x1, x2 (n, 2) as if they were matches, of cameras that determine F."""
    left, right = cameras
    return MatchedPair(
        F=fundamental_from_cameras(left, right),
        x1=x1,
        x2=x2,
        probability=probability,
        size1=(left.width, left.height),
        size2=(right.width, right.height),
        camera1=left,
        camera2=right,
        angle_deg=convergence_deg(left, right, x1, x2),
    )


def _ground_of_pair(cameras: tuple[Camera, Camera], scene: Scene | None) -> GroundOfPair | None:
    """The ground as both frames show it, and a plane beneath it; None if it is unknown."""
    if scene is None or scene.ground is None:
        return None
    left, right = cameras
    return GroundOfPair(
        homography=ground_homography(left, right, scene.ground),
        beneath=ground_homography(left, right, _lowered(scene.ground, cameras)),
        inverse_depth1=inverse_depth_line(left, scene.ground),
        inverse_depth2=inverse_depth_line(right, scene.ground),
    )


def _lowered(ground: Float64s, cameras: tuple[Camera, Camera]) -> Float64s:
    """(4,) the plane under the ground below which nothing is searched."""
    height = min(float(ground[:3] @ camera.C + ground[3]) for camera in cameras)
    return np.asarray(ground + np.array([0.0, 0.0, 0.0, _BELOW_GROUND * height]), dtype=np.float64)


def _above_plane(plane: Float64s, cameras: tuple[Camera, Camera], x1: Float64s, x2: Float64s) -> Bools:
    """(n,) bool: which matches lie above a plane (4,)."""
    depth, _ = triangulate_depth(*cameras, x1, x2)
    line = inverse_depth_line(cameras[0], plane)
    inverse_depth_of_plane = x1 @ line[:2] + line[2]
    return np.asarray(1 / depth >= inverse_depth_of_plane)  # nearer than the plane on the same ray


def _agreeing_matches(geometry: Geometry, left: Camera | None, right: Camera | None) -> MatchedPair:
    """F from the cameras where both are known, and the matches that agree with it."""
    size1 = (geometry.view1.width, geometry.view1.height)
    size2 = (geometry.view2.width, geometry.view2.height)
    if left is None or right is None:
        return MatchedPair(
            geometry.F, geometry.x1, geometry.x2, geometry.probability, size1, size2, None, None, geometry.angle_deg
        )
    F = fundamental_from_cameras(left, right)
    tolerance_px = max(_AGREEMENT_PX, _AGREEMENT_SHARE * max(size1))
    keep = symmetric_epipolar_distance(F, geometry.x1, geometry.x2) <= tolerance_px
    x1 = np.compress(keep, geometry.x1, axis=0)
    x2 = np.compress(keep, geometry.x2, axis=0)
    angle_deg = convergence_deg(left, right, x1, x2)
    return MatchedPair(F, x1, x2, geometry.probability[keep], size1, size2, left, right, angle_deg)


def _unreliable(geometry: Geometry, pair: MatchedPair, min_angle_deg: float) -> Rejected | None:
    """Reasons why F from the matches alone is not to be believed; none where cameras give it."""
    if pair.camera1 is not None:
        return None
    if geometry.angle_deg < min_angle_deg and hardly_converging(geometry.angle_deg, geometry.agreement):
        return Rejected(Reason.NO_BASELINE, {"angle_deg": geometry.angle_deg, "needed_deg": min_angle_deg})
    if geometry.score <= 0:
        figures = {"score": geometry.score, "matches": len(geometry.x1), "agreement": geometry.agreement}
        return Rejected(Reason.UNLIKELY_GEOMETRY, figures)
    if geometry.implausibility > MOST_IMPLAUSIBLE:
        return Rejected(Reason.IMPLAUSIBLE_INTRINSICS, {"implausibility": geometry.implausibility, "allowed": MOST_IMPLAUSIBLE})
    return None


def _unusable(match_count: int, pair: MatchedPair, min_matches: int, min_angle_deg: float) -> Rejected | None:
    """Reasons that hold for every method: too few of the given matches left, cameras that contradict them, no baseline."""
    n = len(pair.x1)
    if n < min_matches <= match_count or n < _LEAST_AGREEING * match_count:
        return Rejected(Reason.CAMERAS_CONTRADICT_MATCHES, {"matches": match_count, "agreeing": n})
    if n < min_matches:
        return Rejected(Reason.TOO_FEW_MATCHES, {"matches": n, "needed": min_matches})
    if pair.angle_deg < min_angle_deg:
        return Rejected(Reason.NO_BASELINE, {"angle_deg": pair.angle_deg, "needed_deg": min_angle_deg})
    if np.isnan(pair.angle_deg):
        parallax = parallax_px(pair.x1, pair.x2)
        if parallax < _LEAST_PARALLAX * pair.size1[0]:
            return Rejected(Reason.NO_PARALLAX, {"parallax_px": parallax})
    return None
