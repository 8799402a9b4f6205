"""SIFT keypoints of a frame, spread over the image, with RootSIFT descriptors.

SIFT is Lowe's detector (IJCV 2004), in kernels of our own (`matching.scale_space`, `matching.description`): only keypoints
that are kept get an orientation and a descriptor, from the pyramid in which they were found.  RootSIFT takes the square root
of the L1-normalised descriptor, so that Euclidean distance compares histograms as Hellinger does (Arandjelovic & Zisserman,
CVPR 2012).  A second set of keypoints comes from the frame compressed by 2 in x, the one simulated view of ASIFT (Morel & Yu,
2009) that pays off between upright cameras far apart; only pairs whose plain views are not enough use it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import cv2
import numpy as np

from ..contracts.defaults import CROWDING, GRID_COLUMNS, MAX_KEYPOINTS, TILTED_KEYPOINTS
from ..core.luminance import grey_levels
from ..types import Bools, Features, Float32s, Float64s, Frame, Uint8s
from .description import LENGTH, describe, main_directions
from .neighbours import nearest_lookalike
from .scale_space import Blobs, Pyramid, find_blobs, pyramid
from .spread import Spread

Preprocessing = Literal["auto", "none", "clahe"]

DARK_GREY = 50.0
"""CLAHE is applied if the median grey level is below this (0 to 255): night, lamps."""
FLAT_RANGE = 25.0
"""CLAHE is applied if the range from the 10th to the 90th percentile of the grey levels is below this: fog."""
ANGLE_SEAM_DEG = 45.0
"""SIFT repeats a keypoint for each strong gradient direction; only the first one from this angle on is kept.  Upright cameras
then choose the same one (edges are mostly level or plumb, and the seam lies between), and repeats do not use up the quota."""
LARGEST_PX = 6_500_000
"""Images with more pixels are searched in bands of at most about as many, since all scales of one pixel take 230 bytes."""
OVERLAP_PX = 256
"""Rows by which bands overlap on each side.  They begin at multiples of it, so that coarse scales are sampled at the same
places as in the whole image."""


def detect_sift(
    frame: Frame,
    *,
    max_keypoints: int = MAX_KEYPOINTS,
    tilted_keypoints: int = TILTED_KEYPOINTS,
    contrast_threshold: float = 0.01,
    grid_columns: int = GRID_COLUMNS,
    crowding: float = CROWDING,
    preprocessing: Preprocessing = "auto",
) -> Features:
    """Detect and describe the SIFT keypoints of a frame.

    Parameters
    ----------
    frame : the clean frame; keypoints on or at the edge of masked pixels are left out.
    max_keypoints : most keypoints kept in the plain view.
    tilted_keypoints : most keypoints kept in the view compressed by 2 in x; 0 leaves that view out.
    contrast_threshold : smallest contrast of a keypoint, as share of the grey range (OpenCV's meaning).
    grid_columns : number of square cells across the image, over which the keypoints are spread.
    crowding : a cell yields at most this many times its even share while other cells still have keypoints; no unit.
    preprocessing : "clahe" first smooths noise and equalises local contrast, for night, lamps and fog; "auto" chooses between
        that and "none" by the image, because "clahe" finds fewer keypoints by day.
    """
    # 1. grey levels, equalised if they are dark or flat
    grey = grey_levels(frame.image)
    equalise = preprocessing == "clahe" or (preprocessing == "auto" and _has_low_contrast(grey, frame.mask))
    if equalise:
        grey = _equalised(grey)

    # 2. the plain view
    plain = _detect_view(grey, contrast_threshold, frame.mask, max_keypoints, grid_columns, crowding)
    count = len(plain.xy)

    # 3. the view compressed in x
    views = [plain]
    if tilted_keypoints > 0:
        views.append(_detect_tilted(grey, contrast_threshold, frame.mask, tilted_keypoints, grid_columns, crowding))

    # 4. how distinctive each plain keypoint is in its own image
    lookalikes = nearest_lookalike(plain.descriptors, plain.xy, count)

    # a view's place in the list is its value of `tilts`: PLAIN, TILTED
    tilts = np.repeat(np.arange(len(views), dtype=np.uint8), [len(view.xy) for view in views])
    return Features(
        xy=np.concatenate([view.xy for view in views]),
        frames=np.concatenate([view.frames for view in views]),
        descriptors=np.concatenate([view.descriptors for view in views]),
        responses=np.concatenate([view.responses for view in views]),
        tilts=tilts,
        view=frame.view,
        lookalikes=lookalikes,
        plain_keypoints=count,
        preprocessing="clahe" if equalise else "none",
    )


@dataclass(frozen=True)
class _Keypoints:
    """The keypoints of one view; fields as in `Features`."""

    xy: Float64s
    frames: Float64s
    descriptors: Float32s
    responses: Float32s


def _has_low_contrast(grey: Uint8s, mask: Bools) -> bool:
    """True for a dark image (night, lamps), or one with a narrow range of grey levels (fog)."""
    if not mask.any():
        return False
    # every seventh usable pixel is enough for percentiles
    low, median, high = np.percentile(grey[mask][::7], [10, 50, 90])
    return bool(median < DARK_GREY or high - low < FLAT_RANGE)


def _equalised(grey: Uint8s) -> Uint8s:
    """The image smoothed against sensor noise, then equalised: contrast-limited adaptive histogram equalisation, 8 x 8 tiles.

    Equalisation without smoothing amplifies the noise of a night image, and yields fewer keypoints than the original image.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.2)
    return np.asarray(cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(smooth), dtype=np.uint8)


def _detect_view(grey: Uint8s, contrast: float, mask: Bools, quota: int, grid_columns: int, crowding: float) -> _Keypoints:
    """Keypoints of a grey image (h, w), strongest first.

    Parameters
    ----------
    grey, mask : the image, and its pixels that may be used.
    contrast : smallest contrast, as `contrast_threshold` of `detect`.
    quota : most keypoints kept.
    grid_columns, crowding : as in `detect`.
    """
    # 1. blobs of all bands; a small image is one band, whose pyramid is kept for step 3
    bands = _bands(*grey.shape)
    is_whole = len(bands) == 1
    octaves: Pyramid = ()
    found_blobs = []
    band_numbers = []
    for number, band in enumerate(bands):
        octaves = pyramid(grey[band.start : band.stop])
        found = find_blobs(octaves, contrast).lower_by(band.start)
        if not is_whole:
            found = found.at((found.y >= band.top) & (found.y < band.bottom))
        found_blobs.append(found)
        band_numbers.append(np.full(len(found.x), number))
    blobs = Blobs.joined(found_blobs)
    band_of = np.concatenate(band_numbers)

    # 2. the strongest, spread over the image
    usable = _usable(blobs, mask)
    spread = Spread(quota, grid_columns, crowding)
    chosen = spread.rows(np.column_stack([blobs.x, blobs.y]), blobs.response, usable, grey.shape, then_by=blobs.sigma)
    blobs = blobs.at(chosen)
    band_of = band_of[chosen]

    # 3. directions and descriptors of these, from pyramids that are made again: in memory, one of them is enough
    angles = np.empty(len(chosen))
    descriptors = np.empty((len(chosen), LENGTH), np.float32)
    for number, band in enumerate(bands):
        if not is_whole:
            octaves = pyramid(grey[band.start : band.stop])
        in_band = band_of == number
        band_blobs = blobs.at(in_band).lower_by(-band.start)
        band_angles = main_directions(octaves, band_blobs, np.radians(ANGLE_SEAM_DEG))
        angles[in_band] = band_angles
        descriptors[in_band] = describe(octaves, band_blobs, band_angles)

    # 4. local frames s R(angle), with s of two sigmas
    c = 2 * blobs.sigma * np.cos(angles)
    s = 2 * blobs.sigma * np.sin(angles)
    frames = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)

    # 5. RootSIFT: unit length follows from the L1 normalisation
    l1_length = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)
    root_sift = np.sqrt(descriptors / l1_length).astype(np.float32)
    return _Keypoints(np.column_stack([blobs.x, blobs.y]), frames, root_sift, blobs.response.astype(np.float32))


@dataclass(frozen=True)
class _Band:
    """Rows of a large image that are searched at a time."""

    start: int
    stop: int
    """First row read, and the row after the last one."""
    top: int
    bottom: int
    """First row whose keypoints count, and the row after the last one: each row counts in one band only."""


def _bands(height: int, width: int) -> list[_Band]:
    """The bands of an image, from the top; one for an image of at most `LARGEST_PX`."""
    count = -(-height * width // LARGEST_PX)  # rounded up
    edges = [height * number // count for number in range(count + 1)]
    bands = []
    for top, bottom in pairwise(edges):
        start = max(top // OVERLAP_PX - 1, 0) * OVERLAP_PX
        bands.append(_Band(start, min(bottom + OVERLAP_PX, height), top, bottom))
    return bands


def _detect_tilted(grey: Uint8s, contrast: float, mask: Bools, quota: int, grid_columns: int, crowding: float) -> _Keypoints:
    """Keypoints of the frame compressed by 2 in x (smoothed first, so that nothing aliases), mapped back into the frame."""
    h, w = grey.shape
    size = (max(w // 2, 1), h)
    smooth = cv2.GaussianBlur(grey, (0, 0), sigmaX=1.2, sigmaY=1e-3)
    narrow = np.asarray(cv2.resize(smooth, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    narrow_mask = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    # half as many columns: cells stay square
    found = _detect_view(narrow, contrast, narrow_mask, quota, max(grid_columns // 2, 1), crowding)
    # pixel centres are at integers: the edges of the images correspond, not the centres of their first pixels
    stretch = np.array([w / size[0], 1.0])
    return replace(found, xy=(found.xy + 0.5) * stretch - 0.5, frames=stretch[:, None] * found.frames)


def _usable(blobs: Blobs, mask: Bools) -> Bools:
    """(n,) keypoints whose disc of radius sigma touches no masked pixel: the edge of a mask is not part of the scene."""
    h, w = mask.shape
    if mask.all():
        return np.ones(len(blobs.x), dtype=bool)
    clearance = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    x = np.clip(np.rint(blobs.x).astype(int), 0, w - 1)
    y = np.clip(np.rint(blobs.y).astype(int), 0, h - 1)
    return np.asarray(clearance[y, x] > blobs.sigma)
