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
_NOMINAL_SIDE = 768
"""Long side of the frame, pixels, for which `max_row_error_px` is stated; the limit grows with larger frames."""
_DEVIATIONS = 3.5
"""Standard deviations by which epipolar lines may be off: residuals miss errors that matches share, and wrong matches that agree.
Chosen on fountain with known lenses as the smallest with which no pair with wrong rows passes; checked on entry and the demo."""


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
    H1, H2 = homographies
    shown1, shown2 = pair.shown()
    in_front1, in_front2 = _third_coordinate(H1, shown1) > 0, _third_coordinate(H2, shown2) > 0
    if min(in_front1.mean(), in_front2.mean()) < 0.98 or not np.isfinite([H1, H2]).all():
        return "an epipole lies among the matches"
    x1, x2 = (np.compress(in_front1 & in_front2, x, axis=0) for x in (shown1, shown2))  # 5 times as fast as x[...]
    H1, H2, size1, size2 = place(H1, H2, x1, x2, pair.size1, pair.size2)
    result = Rectification(method, reason, H1, H2, size1, size2, 0.0, 0.0, 0.0, 0.0, float("nan"))
    footprints = [_footprint(result, pair, side) for side in _SIDES]
    for footprint, H in zip(footprints, (H1, H2), strict=True):
        if len(footprint.points) == 0 or _third_coordinate(H, footprint.points).min() <= 0:
            return "the line sent to infinity crosses the image"
        if allow_torn:
            continue
        low, high = np.sqrt(percentiles(np.abs(footprint.area), 5, 95))
        if high > 4 * low:
            return f"{method} stretches the image {high / low:.1f} times: an epipole is near, or the matches scatter"
        (anisotropy,) = percentiles(footprint.longer / footprint.shorter, 95)
        if anisotropy > 3:
            return f"{method} makes pixels {anisotropy:.1f} times longer than wide: an epipole is near, or the matches scatter"
    return result, footprints


def _third_coordinate(H: Float64s, x: Float64s) -> Float64s:
    """(n,): third homogeneous coordinate of the images of points x (n, 2); 0 on the line sent to infinity."""
    return np.asarray(x @ H[2, :2] + H[2, 2], dtype=np.float64)


def _by_polar_rows(pair: MatchedPair, images: PolarImages, method: str, reason: str) -> Layout | Rejected:
    rows1, rows2, size1, size2, agreement = images
    if agreement < 0.98:
        return Rejected(Reason.EPIPOLE_AMONG_MATCHES, {"same_side": agreement})
    too_few = Rejected(Reason.TOO_FEW_EPIPOLAR_LINES, {"rows": size1[1], "columns": size1[0]})
    if min(*size1, *size2) < _SMALLEST_SIDE_PX:
        return too_few
    result = Rectification(method, reason, None, None, size1, size2, 0.0, 0.0, 0.0, 0.0, float("nan"), rows1, rows2)
    footprints = [_footprint(result, pair, side) for side in _SIDES]
    return too_few if min(footprint.share for footprint in footprints) == 0 else (result, footprints)


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
    y1, y2 = to_rectified(found, 1, pair.x1), to_rectified(found, 2, pair.x2)
    vertical = np.abs(y1[:, 1] - y2[:, 1])
    agreement = order_agreement(y1, y2)
    if agreement < 0.7 and geometry is not None:
        return Rejected(Reason.ROW_ORDER, {"rank_correlation": agreement})
    areas = [np.median(footprint.area) for footprint in footprints]
    if min(areas) <= 0:
        return Rejected(Reason.MIRRORED, {"area1": areas[0], "area2": areas[1]})
    disparity = y1[:, 0] - y2[:, 0]
    low, high = percentiles(disparity, 0.5, 99.5)
    margin = range_margin * (high - low) + 0.01 * pair.size1[0]
    scale = float(np.sqrt(np.median(np.concatenate([footprint.area for footprint in footprints]))))
    uncertainty = _row_uncertainty_px(found, footprints[0].points, pair, geometry, y1, y2)
    allowed = max_row_error_px * max(1.0, max(pair.size1) / _NOMINAL_SIDE)
    if uncertainty > allowed:
        return Rejected(Reason.UNCERTAIN_ROWS, {"row_error_px": uncertainty, "allowed_px": allowed})
    return replace(
        found,
        disparity_min_px=float(np.floor(low - margin)),
        disparity_max_px=float(np.ceil(high + margin)),
        vertical_px=float(vertical.mean()),
        vertical_p95_px=percentiles(vertical, 95)[0],
        angle_deg=pair.angle_deg,
        scale=scale,
        anisotropy=percentiles(np.concatenate([f.longer / f.shorter for f in footprints]), 95)[0],
        kept1=footprints[0].share,
        kept2=footprints[1].share,
        depth_resolution=_depth_resolution(pair, scale),
        warnings=("few matches",) if len(pair.x1) < 50 else (),
    )


_SIDES: tuple[Side, ...] = (1, 2)


def _footprint(rectification: Rectification, pair: MatchedPair, side: Side) -> Footprint:
    grid = frame_grid(pair.size1 if side == 1 else pair.size2)
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
    rectified = to_rectified(rectification, 1, shown)
    rectified[:, 0] -= (y1[:, 0] - y2[:, 0])[nearest_points(y1, rectified, 1)[1][:, 0]]
    partner = from_rectified(rectification, 2, rectified)
    inside = ((partner >= -0.5) & (partner <= np.array(pair.size2) - 0.5)).all(axis=1)
    if not inside.any():
        return 0.0
    K1, K2 = geometry.view1.K, geometry.view2.K
    essential = (K1, K2) if geometry.model == "E" and K1 is not None and K2 is not None else None  # five degrees of freedom only
    lenses = None
    if geometry.lens1 is not None and geometry.lens2 is not None:
        lenses = freedoms(pair.F, geometry.lens1, geometry.lens2, geometry.view1, geometry.view2)
    noise = None if geometry.noise_px is None else geometry.noise_px.astype(np.float64)
    shown, partner = np.compress(inside, shown, axis=0), np.compress(inside, partner, axis=0)
    sigma = line_uncertainty(pair.F, pair.x1, pair.x2, shown, partner, essential, noise, lenses)
    return _DEVIATIONS * percentiles(sigma, 95)[0]


def _depth_resolution(pair: MatchedPair, scale: float) -> float:
    """Median relative error of the depth due to one rectified pixel of disparity; nan without cameras."""
    if pair.camera1 is None or pair.camera2 is None:
        return float("nan")
    depth, error_per_px = triangulate_depth(pair.camera1, pair.camera2, pair.x1, pair.x2)
    known = np.isfinite(depth)
    return np.median(error_per_px[known] / depth[known]) / scale if known.any() else float("nan")
