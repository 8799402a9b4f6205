"""Planes that are off by about half a pixel are moved to where the photographs fit best."""

from __future__ import annotations

import numpy as np

from wbflow_stages.mvs.propagation import Propagation
from wbflow_stages.types import Float32s, Float64s, Int32s

ROWS, COLUMNS, MARGIN = 48, 150, 14
TRUE = 0.073
"""True inverse depth of the whole scene."""
BASES = np.array([[100.0, 0.0, 0.0], [0.0, -120.0, 0.0]])
"""Pixels in x and y by which a unit of inverse depth moves the image in each source (b of `Propagation`)."""
TAPS: Int32s = 2 * np.array([(0, 0), *((x, y) for y in (-2, 0, 2) for x in (-2, 0, 2) if (x, y) != (0, 0))], np.int32)
INSIDE = slice(MARGIN, ROWS - MARGIN), slice(MARGIN, COLUMNS - MARGIN)


def seen_from(base: Float64s, contrast: float = 20.0) -> Float32s:
    """An image of waves, shifted as the source of this base sees it."""
    y, x = np.mgrid[0:ROWS, 0:COLUMNS].astype(np.float64)
    x, y = x - TRUE * base[0], y - TRUE * base[1]
    waves = np.random.default_rng(3).uniform((-0.9, -0.9, 0.0), (0.9, 0.9, 6.3), (12, 3))
    return np.asarray(128 + contrast * sum(np.sin(a * x + b * y + c) for a, b, c in waves), np.float32)


def refined_once(planes: Float32s, contrast: float = 20.0) -> Float32s:
    """The planes after one step of refinement with an image and two sources."""
    sources = np.stack([seen_from(base, contrast) for base in BASES])
    usable = np.ones((ROWS, COLUMNS), np.bool_)
    view = Propagation(seen_from(np.zeros(3), contrast), usable, sources, np.stack([np.eye(3)] * 2), BASES, TAPS)
    after = planes.copy()
    view.refine_photometrically(after, 3)
    return after


def planes_off_by(pixels: Float64s | float) -> Float32s:
    flat = np.zeros((ROWS, COLUMNS))
    return np.stack([flat + TRUE + np.asarray(pixels) / 110, flat, flat]).astype(np.float32)


def errors_px(planes: Float32s) -> Float64s:
    return np.asarray(110 * np.abs(planes[0] - TRUE)[INSIDE], np.float64)


def test_depth_errors_of_half_a_pixel_are_reduced_to_a_fraction() -> None:
    start = planes_off_by(np.random.default_rng(1).uniform(-0.6, 0.6, (ROWS, COLUMNS)))
    before, after = errors_px(start), errors_px(refined_once(start))
    assert np.median(after) < 0.15 * np.median(before)
    assert np.percentile(after, 95) < 0.3 * np.percentile(before, 95)


def test_a_plane_that_is_far_off_is_moved_only_a_little() -> None:
    start = planes_off_by(6.0)
    assert np.abs(errors_px(refined_once(start)) - 6.0).max() < 2.1


def test_planes_of_untextured_pixels_stay_unchanged() -> None:
    start = planes_off_by(0.4)
    start[0, 20, 70] = np.nan
    after = refined_once(start, contrast=0.0)
    assert np.isnan(after[0, 20, 70])
    assert np.array_equal(after, start, equal_nan=True)
