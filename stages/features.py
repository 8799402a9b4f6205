"""Keypoints of a frame: SIFT, spread over the image, with RootSIFT descriptors.

SIFT is Lowe's detector (IJCV 2004), in kernels of our own (`matching.scale_space`, `matching.description`): only keypoints
that are kept get an orientation and a descriptor, from the pyramid in which they were found.  RootSIFT takes the square root
of the L1-normalised descriptor, so that Euclidean distance compares histograms as Hellinger does (Arandjelovic & Zisserman,
CVPR 2012).  A second set of keypoints comes from the frame compressed by 2 in x, the one simulated view of ASIFT (Morel & Yu,
2009) that pays off between upright cameras far apart; only pairs whose plain views are not enough use it.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import cv2
import numpy as np

from .contracts.reasons import Reason, Rejected
from .core.luminance import grey_levels
from .core.ordering import rank_within
from .matching.description import LENGTH, describe, main_directions
from .matching.neighbours import nearest_lookalike
from .matching.scale_space import Blobs, Pyramid, find_blobs, pyramid
from .types import Bools, Features, Float32s, Float64s, Frame, Int64s, Uint8s

Preprocessing = Literal["auto", "none", "clahe"]

DARK_GREY, FLAT_RANGE = 50.0, 25.0
"""Grey levels (0 to 255): CLAHE is applied if the median is below the first, or the 10 to 90 % range below the second."""
ANGLE_SEAM_DEG = 45.0
"""SIFT repeats a keypoint for each strong gradient direction; only the first one from this angle on is kept.  Upright cameras
then choose the same one (edges are mostly level or plumb, and the seam lies between), and repeats do not use up the quota."""
LARGEST_PX, OVERLAP_PX = 6_500_000, 256
"""Larger images are searched in bands, since all scales of one pixel take 230 bytes.  Bands overlap by `OVERLAP_PX` pixels and
begin at multiples of it, so that coarse scales are sampled at the same places."""


def detect(
    frame: Frame,
    *,
    max_keypoints: int = 6000,
    tilted_keypoints: int = 3000,
    contrast_threshold: float = 0.01,
    grid_columns: int = 6,
    crowding: float = 2.0,
    preprocessing: Preprocessing = "auto",
    min_keypoints: int = 50,
) -> Features | Rejected:
    """Detect and describe the keypoints of a frame.

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
    min_keypoints : reject the frame if the plain view has fewer.
    """
    grey = grey_levels(frame.image)
    equalise = preprocessing == "clahe" or (preprocessing == "auto" and _has_low_contrast(grey, frame.mask))
    if equalise:
        grey = _equalised(grey)
    plain = _detect_view(grey, contrast_threshold, frame.mask, max_keypoints, grid_columns, crowding)
    if len(plain[0]) < min_keypoints:
        figures = {"keypoints": len(plain[0]), "needed": min_keypoints, "usable_share": float(frame.mask.mean())}
        return Rejected(Reason.TOO_FEW_KEYPOINTS, figures)
    views = [plain]
    if tilted_keypoints > 0:
        views.append(_detect_tilted(grey, contrast_threshold, frame.mask, tilted_keypoints, grid_columns, crowding))
    xy, frames, descriptors, responses = (np.concatenate(parts) for parts in zip(*views, strict=True))
    tilts = np.repeat(np.arange(len(views), dtype=np.uint8), [len(v[0]) for v in views])
    count, prepared = len(plain[0]), "clahe" if equalise else "none"
    lookalikes = nearest_lookalike(plain[2], plain[0], count)
    return Features(xy, frames, descriptors, responses, tilts, frame.view, lookalikes, count, prepared)


_Keypoints = tuple[Float64s, Float64s, Float32s, Float32s]
"""xy, frames, descriptors and responses of one view's keypoints."""


def _has_low_contrast(grey: Uint8s, mask: Bools) -> bool:
    """True for a dark image (night, lamps), or one with a narrow range of grey levels (fog)."""
    if not mask.any():
        return False
    low, median, high = np.percentile(grey[mask][::7], [10, 50, 90])
    return bool(median < DARK_GREY or high - low < FLAT_RANGE)


def _equalised(grey: Uint8s) -> Uint8s:
    """The image smoothed against sensor noise, then equalised: contrast-limited adaptive histogram equalisation, 8 x 8 tiles.

    Equalisation without smoothing amplifies the noise of a night image, and yields fewer keypoints than the original image.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.2)
    return np.asarray(cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(smooth), dtype=np.uint8)


def _detect_view(grey: Uint8s, contrast: float, mask: Bools, quota: int, grid_columns: int, crowding: float) -> _Keypoints:
    bands = _bands(*grey.shape)
    octaves: Pyramid = ()
    found_blobs, band_numbers = [], []
    for number, (start, top, bottom, stop) in enumerate(bands):
        octaves = pyramid(grey[start:stop])
        blobs = find_blobs(octaves, contrast).lower_by(start)
        found_blobs.append(blobs.at((blobs.y >= top) & (blobs.y < bottom)) if len(bands) > 1 else blobs)
        band_numbers.append(np.full(len(found_blobs[-1].x), number))
    blobs, band = Blobs.joined(found_blobs), np.concatenate(band_numbers)
    chosen = _spread(blobs, _usable(blobs, mask), grey.shape, quota, grid_columns, crowding)
    blobs, band = blobs.at(chosen), band[chosen]
    angles, descriptors = np.empty(len(chosen)), np.empty((len(chosen), LENGTH), np.float32)
    for number, (start, _, _, stop) in enumerate(bands):
        octaves = pyramid(grey[start:stop]) if len(bands) > 1 else octaves
        band_blobs = blobs.at(band == number).lower_by(-start)
        angles[band == number] = angle = main_directions(octaves, band_blobs, np.radians(ANGLE_SEAM_DEG))
        descriptors[band == number] = describe(octaves, band_blobs, angle)
    c, s = 2 * blobs.sigma * np.cos(angles), 2 * blobs.sigma * np.sin(angles)
    frames = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    # RootSIFT: unit length follows from the L1 normalisation
    root_sift = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)).astype(np.float32)
    return np.column_stack([blobs.x, blobs.y]), frames, root_sift, blobs.response.astype(np.float32)


def _bands(height: int, width: int) -> list[tuple[int, int, int, int]]:
    """Row limits of the bands of a large image: (first row read, first and end row whose keypoints count, end row read)."""
    count = -(-height * width // LARGEST_PX)
    edges = [height * band // count for band in range(count + 1)]
    return [
        (max(top // OVERLAP_PX - 1, 0) * OVERLAP_PX, top, bottom, min(bottom + OVERLAP_PX, height))
        for top, bottom in pairwise(edges)
    ]


def _detect_tilted(grey: Uint8s, contrast: float, mask: Bools, quota: int, grid_columns: int, crowding: float) -> _Keypoints:
    """Keypoints of the frame compressed by 2 in x (smoothed first, so that nothing aliases), mapped back into the frame."""
    h, w = grey.shape
    size = (max(w // 2, 1), h)
    smooth = cv2.GaussianBlur(grey, (0, 0), sigmaX=1.2, sigmaY=1e-3)
    narrow = np.asarray(cv2.resize(smooth, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    narrow_mask = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    xy, frames, descriptors, responses = _detect_view(narrow, contrast, narrow_mask, quota, max(grid_columns // 2, 1), crowding)
    stretch = np.array([w / size[0], 1.0])
    return (xy + 0.5) * stretch - 0.5, stretch[:, None] * frames, descriptors, responses


def _usable(blobs: Blobs, mask: Bools) -> Bools:
    """(n,) keypoints whose disc of radius sigma touches no masked pixel: the edge of a mask is not part of the scene."""
    h, w = mask.shape
    if mask.all():
        return np.ones(len(blobs.x), dtype=bool)
    clearance = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    x = np.clip(np.rint(blobs.x).astype(int), 0, w - 1)
    y = np.clip(np.rint(blobs.y).astype(int), 0, h - 1)
    return np.asarray(clearance[y, x] > blobs.sigma)


def _spread(blobs: Blobs, usable: Bools, shape: tuple[int, ...], quota: int, grid_columns: int, crowding: float) -> Int64s:
    """Rows of the keypoints to keep, strongest first; keypoints beyond `crowding` times a cell's even share come last.

    A more even spread finds more matches at 50 to 60 degrees but loses a tenth elsewhere: weak keypoints are not found again.
    """
    order = np.lexsort((blobs.sigma, blobs.y, blobs.x, -blobs.response))
    order = order[usable[order]]
    if len(order) <= quota:
        return np.asarray(order)
    cell = shape[1] / grid_columns
    cells = (blobs.y[order] // cell).astype(np.int64) * (grid_columns + 1) + (blobs.x[order] // cell).astype(np.int64)
    share = quota * cell * cell / (shape[0] * shape[1])
    crowded = rank_within(cells, np.arange(len(cells))) >= crowding * share
    return np.asarray(order[np.sort(np.lexsort((np.arange(len(order)), crowded))[:quota])])
