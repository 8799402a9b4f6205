"""A rectification fitted to matches: by homographies unless they tear the image, else polar; its figures and disparity range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..contracts.reasons import Reason, Rejected
from ..core.epipolar import triangulate_depth
from ..core.nearest_points import nearest_points
from ..core.ordering import percentiles
from ..twoview.intrinsics_prior import freedoms
from ..types import Float64s, Geometry, Rectification
from .method import Homographies, MatchedPair, PolarImages
from .placement import frame_grid, place
from .planar import hartley
from .polar import polar
from .quality import line_uncertainty, order_agreement
from .warping import Side, from_rectified, rectified_size, resampling, to_rectified

_SMALLEST_SIDE_PX = 16
"""Polar images with a shorter side, pixels, show nothing that could be matched."""
_LEAST_IN_FRONT = 0.98
"""Smallest share of the matches in front of the line sent to infinity, or on one side of the epipole, for a correct F."""
_MOST_STRETCH = 4.0
"""Homographies that enlarge some parts of the image this many times more than others tear it: an epipole is near."""
_MOST_ANISOTROPY = 3.0
"""Homographies that make pixels this many times longer than wide tear the image."""
_LEAST_ORDER_AGREEMENT = 0.7
"""Smallest rank correlation of matches along the rows for a correct F."""
_FEW_MATCHES = 50
"""A rectification from fewer matches carries a warning."""
_RANGE_TAIL = 0.5
"""Per cent of the matches beyond either end of the disparity range before it is widened: wrong matches."""
_RANGE_MARGIN_OF_WIDTH = 0.01
"""Widening of the disparity range at either end besides `range_margin`, as a share of the frame's width."""
_NOMINAL_SIDE = 768
"""Long side of the frame, pixels, for which `max_row_error_px` is stated; the limit grows with larger frames."""
_DEVIATIONS = 3.5
"""Standard deviations by which epipolar lines may be off: residuals miss errors that matches share, and wrong matches that agree
(measured on fountain with known lenses: the smallest with which no pair with wrong rows passes)."""


class Footprint(NamedTuple):
    """Where a rectified image shows its frame: points (n, 2) of a regular grid over the frame, their share of the grid, and areas
    and sides (n,) of the pixels resampled there."""

    points: Float64s
    share: float
    area: Float64s
    longer: Float64s
    shorter: Float64s


Layout = tuple[Rectification, list[Footprint]]


def fit_layout(
    pair: MatchedPair, method: str, rectifier: Callable[[], Homographies | PolarImages], fallback: bool
) -> Layout | Rejected:
    """The rectification by the method; if that fails, by Hartley's homographies, which bend x least; else polar.

    Parameters
    ----------
    pair : frames' sizes, F, and matches.
    method, rectifier : name of the method, for the result, and the method with all its arguments.
    fallback : replace homographies that stretch the image too much; False keeps them.
    """
    reason = "as asked"
    attempts = {method: rectifier}
    if method not in ("hartley", "polar"):
        attempts["hartley"] = partial(hartley, pair)
    for name, attempt in attempts.items():
        try:
            images = attempt()
        except ValueError as error:
            reason = str(error)
            continue
        if isinstance(images, PolarImages):
            return _by_polar_rows(pair, images, name, reason)
        layout = _by_homographies(pair, images, name, reason, allow_torn=not fallback)
        if not isinstance(layout, str):
            return layout
        reason = layout
    return _by_polar_rows(pair, polar(pair), "polar", reason)


def _by_homographies(pair: MatchedPair, homographies: Homographies, method: str, reason: str, allow_torn: bool) -> Layout | str:
    """The layout by two homographies, or why they tear the image.

    Parameters
    ----------
    pair, homographies : frames' sizes, F, and matches; what the method found.
    method, reason : name of the method, and why it was chosen, for the result.
    allow_torn : accept homographies that stretch the image too much.
    """
    H1, H2 = homographies
    shown1, shown2 = pair.shown()
    in_front1 = _third_coordinate(H1, shown1) > 0
    in_front2 = _third_coordinate(H2, shown2) > 0
    if min(in_front1.mean(), in_front2.mean()) < _LEAST_IN_FRONT or not np.isfinite([H1, H2]).all():
        return "an epipole lies among the matches"
    in_front = in_front1 & in_front2
    x1 = np.compress(in_front, shown1, axis=0)  # 5 times as fast as x[...]
    x2 = np.compress(in_front, shown2, axis=0)
    H1, H2, size1, size2 = place(H1, H2, x1, x2, pair.size1, pair.size2)
    # figures are filled in by `finish_layout`
    result = Rectification(method, reason, H1, H2, size1, size2, 0.0, 0.0, 0.0, 0.0, float("nan"))
    footprints = [_footprint(result, pair, 1), _footprint(result, pair, 2)]
    for footprint, H in zip(footprints, (H1, H2), strict=True):
        if len(footprint.points) == 0 or _third_coordinate(H, footprint.points).min() <= 0:
            return "the line sent to infinity crosses the image"
        if allow_torn:
            continue
        low, high = np.sqrt(percentiles(np.abs(footprint.area), 5, 95))
        if high > _MOST_STRETCH * low:
            return f"{method} stretches the image {high / low:.1f} times: an epipole is near, or the matches scatter"
        (anisotropy,) = percentiles(footprint.longer / footprint.shorter, 95)
        if anisotropy > _MOST_ANISOTROPY:
            return f"{method} makes pixels {anisotropy:.1f} times longer than wide: an epipole is near, or the matches scatter"
    return result, footprints


def _third_coordinate(H: Float64s, x: Float64s) -> Float64s:
    """(n,) third homogeneous coordinate of the images of points x (n, 2); 0 on the line sent to infinity."""
    return np.asarray(x @ H[2, :2] + H[2, 2], dtype=np.float64)


def _by_polar_rows(pair: MatchedPair, images: PolarImages, method: str, reason: str) -> Layout | Rejected:
    """The layout with half epipolar lines as rows, or why it is of no use; `method` and `reason` as in `_by_homographies`."""
    rows1, rows2, size1, size2, agreement = images
    if agreement < _LEAST_IN_FRONT:
        return Rejected(Reason.EPIPOLE_AMONG_MATCHES, {"same_side": agreement})
    too_few = Rejected(Reason.TOO_FEW_EPIPOLAR_LINES, {"rows": size1[1], "columns": size1[0]})
    if min(*size1, *size2) < _SMALLEST_SIDE_PX:
        return too_few
    result = Rectification(method, reason, None, None, size1, size2, 0.0, 0.0, 0.0, 0.0, float("nan"), rows1, rows2)
    footprints = [_footprint(result, pair, 1), _footprint(result, pair, 2)]
    if min(footprint.share for footprint in footprints) == 0:
        return too_few
    return result, footprints


def finish_layout(
    found: Rectification,
    footprints: list[Footprint],
    pair: MatchedPair,
    geometry: Geometry | None,
    max_row_error_px: float,
    range_margin: float,
) -> Rectification | Rejected:
    """The rectification with its figures, or why it must not be used.

    Parameters
    ----------
    found, footprints : the rectification by the method, and where the frames' pixels lie in it.
    pair : frames' sizes, F, and matches.
    geometry : of the pair; None if cameras give the rows, and points at many depths replace matches: their order along the rows
        is then not tested.
    max_row_error_px : a larger error of the rows is rejected.
    range_margin : share of the disparity range that is added at either end.
    """
    y1 = to_rectified(found, 1, pair.x1)
    y2 = to_rectified(found, 2, pair.x2)
    vertical = np.abs(y1[:, 1] - y2[:, 1])
    footprint1, footprint2 = footprints

    # signs that it is wrong
    agreement = order_agreement(y1, y2)
    if agreement < _LEAST_ORDER_AGREEMENT and geometry is not None:
        return Rejected(Reason.ROW_ORDER, {"rank_correlation": agreement})
    area1 = np.median(footprint1.area)
    area2 = np.median(footprint2.area)
    if min(area1, area2) <= 0:
        return Rejected(Reason.MIRRORED, {"area1": area1, "area2": area2})
    uncertainty = _row_uncertainty_px(found, footprint1.points, pair, geometry, y1, y2)
    allowed = max_row_error_px * max(1.0, max(pair.size1) / _NOMINAL_SIDE)
    if uncertainty > allowed:
        return Rejected(Reason.UNCERTAIN_ROWS, {"row_error_px": uncertainty, "allowed_px": allowed})

    # figures
    disparity = y1[:, 0] - y2[:, 0]
    low, high = percentiles(disparity, _RANGE_TAIL, 100 - _RANGE_TAIL)
    margin = range_margin * (high - low) + _RANGE_MARGIN_OF_WIDTH * pair.size1[0]
    areas = np.concatenate([footprint1.area, footprint2.area])
    scale = float(np.sqrt(np.median(areas)))  # a length from an area
    elongations = np.concatenate([footprint1.longer / footprint1.shorter, footprint2.longer / footprint2.shorter])
    warnings = ("few matches",) if len(pair.x1) < _FEW_MATCHES else ()
    return replace(
        found,
        disparity_min_px=float(np.floor(low - margin)),
        disparity_max_px=float(np.ceil(high + margin)),
        vertical_px=float(vertical.mean()),
        vertical_p95_px=percentiles(vertical, 95)[0],
        angle_deg=pair.angle_deg,
        scale=scale,
        anisotropy=percentiles(elongations, 95)[0],
        kept1=footprint1.share,
        kept2=footprint2.share,
        depth_resolution=_depth_resolution(pair, scale),
        warnings=warnings,
    )


def _footprint(rectification: Rectification, pair: MatchedPair, side: Side) -> Footprint:
    """Where the rectified image of one side shows its frame."""
    grid = frame_grid(pair.size1 if side == 1 else pair.size2)
    # points on the line sent to infinity have no place in the rectified image
    with np.errstate(divide="ignore", invalid="ignore"):
        x = to_rectified(rectification, side, grid)
        width, height = rectified_size(rectification, side)
        inside = (x[:, 0] >= -0.5) & (x[:, 0] <= width - 0.5) & (x[:, 1] >= -0.5) & (x[:, 1] <= height - 0.5)
        shown = np.compress(inside, grid, axis=0)
        shapes = resampling(rectification, side, shown)
    return Footprint(shown, len(shown) / len(grid), *shapes)


def _row_uncertainty_px(
    rectification: Rectification, shown: Float64s, pair: MatchedPair, geometry: Geometry | None, y1: Float64s, y2: Float64s
) -> float:
    """How far the epipolar lines may be off over the shared area (95 %), pixels of the frame; 0 when cameras gave F.

    It is evaluated where the scene probably is: at the disparity of the nearest match y1, y2 (n, 2).
    """
    if pair.camera1 is not None or geometry is None:
        return 0.0
    # 1. points of the shared area in both frames
    rectified = to_rectified(rectification, 1, shown)
    _, nearest = nearest_points(y1, rectified, 1)
    disparity = y1[:, 0] - y2[:, 0]
    rectified[:, 0] -= disparity[nearest[:, 0]]
    partner = from_rectified(rectification, 2, rectified)
    inside = ((partner >= -0.5) & (partner <= np.array(pair.size2) - 0.5)).all(axis=1)
    if not inside.any():
        return 0.0
    shown = np.compress(inside, shown, axis=0)
    partner = np.compress(inside, partner, axis=0)

    # 2. in which ways F may be wrong
    K1 = geometry.view1.K
    K2 = geometry.view2.K
    essential = None
    if geometry.model == "E" and K1 is not None and K2 is not None:
        essential = (K1, K2)  # five degrees of freedom only
    lenses = None
    if geometry.lens1 is not None and geometry.lens2 is not None:
        lenses = freedoms(pair.F, geometry.lens1, geometry.lens2, geometry.view1, geometry.view2)
    noise = None
    if geometry.noise_px is not None:
        noise = geometry.noise_px.astype(np.float64)

    # 3. how far its lines may be off there
    sigma = line_uncertainty(pair.F, pair.x1, pair.x2, shown, partner, essential, noise, lenses)
    return _DEVIATIONS * percentiles(sigma, 95)[0]


def _depth_resolution(pair: MatchedPair, scale: float) -> float:
    """Median relative error of the depth due to one rectified pixel of disparity; nan without cameras."""
    if pair.camera1 is None or pair.camera2 is None:
        return float("nan")
    depth, error_per_px = triangulate_depth(pair.camera1, pair.camera2, pair.x1, pair.x2)
    known = np.isfinite(depth)
    if not known.any():
        return float("nan")
    return np.median(error_per_px[known] / depth[known]) / scale
