"""Dense matching of a rectified pair: disparity of both views, kept where they agree (Hao 2011, chapter 5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .contracts.reasons import Reason, Rejected
from .core.methods import bind
from .rectification.warping import Side, from_rectified
from .stereo.consistency import agreeing, disagreement, lands_on, without_speckles
from .stereo.matcher import DenseMatches, RectifiedPair
from .stereo.rectified import rectified_pair, with_coarse_range
from .stereo.y_parallax import measure_y_parallax
from .types import INVALID, Disparity, Float32s, Frame, Int16s, Rectification, RowMatches, Uint8s
from .types.checking import require

MATCHERS = {
    "patchmatch": "wbflow_stages.stereo.patchmatch:match_patchmatch",
    "sgbm": "wbflow_stages.stereo.sgbm:match_sgbm",
    "census-sgm": "wbflow_stages.stereo.census:match_census_sgm",
}
"""Dense matchers by name.  Inputs are passed by argument name: `pair` (`RectifiedPair`: grey, denoised, exposures equal),
`left`, `right` (`Frame`), `rectification`; parameters are keyword-only, with defaults.  Matchers return `DenseMatches`."""

_WIDEST_RANGE_PX = 4000
"""Widest disparity range in pixels that int16 sixteenths can hold: 4096 less a margin."""
_DISAGREEMENT_WEIGHT = 0.5
"""Share of its confidence that a pixel loses where the views differ by the whole tolerance."""


def match_dense(
    left: Frame,
    right: Frame,
    rectification: Rectification,
    reference_rectification: Rectification | None = None,
    reference_disparity: Disparity | None = None,
    *,
    matcher: str = "patchmatch",
    tolerance_px: float = 2.0,
    speckle_share: float = 1.5e-4,
    min_density: float = 0.01,
    **options: object,
) -> Disparity | Rejected:
    """Match every pixel of the two rectified images.

    Raises ValueError for an argument of a wrong type or an unknown matcher, TypeError for a parameter that the matcher does
    not have.

    Parameters
    ----------
    left, right : the frames of the pair; masked and saturated pixels are never matched.
    rectification : how the frames are resampled.
    reference_rectification, reference_disparity : the reference's, if there is one: an optional start for matchers, used
        if its rectification has the same homographies as tonight's.
    matcher : "patchmatch": a slanted plane for each pixel, started from census semi-global matching; the most accurate.
        "sgbm": OpenCV's semi-global matching, in half the time.  "census-sgm": the start of "patchmatch" alone.  Or a function
        of your own, `package.module:function`.
    tolerance_px : largest left-right difference of disparity in rectified pixels; less where disparity is steep or jumps.
    speckle_share : connected regions of disparity smaller than this share of the rectified image are dropped.
    min_density : reject if less than this share of the common area gets a disparity.
    options : parameters of the matcher, see its function.

    References: Hirschmueller, PAMI 2008; Bleyer et al., BMVC 2011.
    """
    require(Frame, left=left, right=right)
    require(Rectification, rectification=rectification)
    if rectification.disparity_max_px - rectification.disparity_min_px > _WIDEST_RANGE_PX:
        return Rejected(Reason.RANGE_TOO_WIDE, {"disparity_max_px": rectification.disparity_max_px})
    pair = with_coarse_range(rectified_pair(left, right, rectification))
    if reference_disparity is not None and reference_rectification is not None and _equal(rectification, reference_rectification):
        pair = _with_reference(pair, reference_disparity)

    # 1. match
    inputs = {"pair": pair, "left": left, "right": right, "rectification": rectification}
    height, width = pair.left.shape
    lengths = {"h": height, "w": width}
    matches: DenseMatches | Rejected = bind(MATCHERS, matcher, inputs, options, DenseMatches | Rejected, lengths)()
    if isinstance(matches, Rejected):
        return matches

    # 2. keep what passes all checks
    offset = round((pair.disparity_min + pair.disparity_max) / 2)
    speckle_px = round(speckle_share * pair.left.size)
    left_map, left_confidence = _checked(pair, matches, 1, tolerance_px, speckle_px, offset)
    right_map, right_confidence = _checked(pair, matches, 2, tolerance_px, speckle_px, offset)
    common_px = int(pair.matchable_pixels().sum())
    density = float(np.sum(left_map != INVALID) / max(common_px, 1))
    if density < min_density:
        return Rejected(Reason.NO_DENSE_MATCHES, {"density": density, "common_px": float(common_px)})

    # 3. do corresponding points lie on the same row?
    rows = _row_matches(pair, rectification, _in_pixels(left_map, offset, pair.left.shape[1]))

    # the columns that pad the images are cut off; copies free them
    width1 = rectification.size1[0]
    width2 = rectification.size2[0]
    return Disparity(
        left=left_map[:, :width1].copy(),
        right=right_map[:, :width2].copy(),
        confidence_left=left_confidence[:, :width1].copy(),
        confidence_right=right_confidence[:, :width2].copy(),
        offset_px=offset,
        density=density,
        rows=rows,
    )


def _equal(first: Rectification, second: Rectification) -> bool:
    """Do two rectifications resample the images in the same way, by homographies?"""
    if first.H1 is None or first.H2 is None or second.H1 is None or second.H2 is None:
        return False
    if first.size1 != second.size1 or first.size2 != second.size2:
        return False
    return np.array_equal(first.H1, second.H1) and np.array_equal(first.H2, second.H2)


def _with_reference(pair: RectifiedPair, reference: Disparity) -> RectifiedPair:
    """The pair with the disparity of the reference, which resampled its images in the same way."""
    width = pair.left.shape[1]
    return replace(
        pair,
        reference_left=_in_pixels(reference.left, reference.offset_px, width),
        reference_right=_in_pixels(reference.right, reference.offset_px, width),
    )


def _in_pixels(stored: Int16s, offset: int, width: int) -> Float32s:
    """(h, width) disparity in pixels; nan where unknown, and in the columns that pad the image to `width`."""
    known = stored != INVALID
    disparity = np.where(known, stored / np.float32(16) + offset, np.float32(np.nan)).astype(np.float32)
    return np.pad(disparity, ((0, 0), (0, width - stored.shape[1])), constant_values=np.nan)


def _checked(
    pair: RectifiedPair, matches: DenseMatches, side: Side, tolerance_px: float, speckle_px: int, offset: int
) -> tuple[Int16s, Uint8s]:
    """The disparities of one view that pass all checks: as stored (sixteenths of a pixel from `offset`), and their confidence.

    Parameters
    ----------
    pair, matches : what was matched, and what was found.
    side : the view: 1 the left one, 2 the right one.
    tolerance_px : largest difference between the disparities of both views.
    speckle_px : connected pieces of fewer pixels are dropped.
    offset : whole disparity from which stored ones count.
    """
    # the partner lies at x + sign * disparity
    if side == 1:
        sign = -1
        disparity = matches.left
        confidence = matches.confidence_left
        valid = pair.valid_left
        other = matches.right
        valid_other = pair.valid_right
    else:
        sign = 1
        disparity = matches.right
        confidence = matches.confidence_right
        valid = pair.valid_right
        other = matches.left
        valid_other = pair.valid_left
    disparity = (np.rint((disparity - offset) * 16) / 16 + offset).astype(np.float32)  # the checks see the values as stored

    accepted = valid & (confidence > 0)
    accepted &= agreeing(disparity, other, sign, tolerance_px)
    accepted &= lands_on(valid_other, disparity, sign)
    filtered = without_speckles(np.where(accepted, disparity, np.float32(np.nan)), speckle_px)
    known = ~np.isnan(filtered)
    stored = np.full(disparity.shape, INVALID, dtype=np.int16)
    stored[known] = np.rint((filtered[known] - offset) * 16).astype(np.int16)

    # confidence from 1 to 255, and 0 where there is no disparity
    difference = disagreement(disparity, other, sign)
    reduced = confidence * (1 - _DISAGREEMENT_WEIGHT * np.minimum(difference, tolerance_px) / tolerance_px)
    levels = np.clip(np.rint(255 * reduced), 1, 255)
    return stored, np.where(stored == INVALID, 0, levels).astype(np.uint8)


def _row_matches(pair: RectifiedPair, rectification: Rectification, disparity: Float32s) -> RowMatches:
    """Points of both frames that show how far corresponding rows lie apart, from the left view's `disparity` (h, w)."""
    x1, x2, sigma_px = measure_y_parallax(pair, disparity, rectification.angle_deg)
    return RowMatches(
        x1=from_rectified(rectification, 1, x1),
        x2=from_rectified(rectification, 2, x2),
        sigma_px=sigma_px / rectification.scale,
    )
