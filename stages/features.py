"""Keypoints of a frame: SIFT, spread over the image, with RootSIFT descriptors.

SIFT is Lowe's detector (IJCV 2004), in kernels of our own (`matching.scale_space`, `matching.description`): only what is kept
gets a direction and a descriptor, from the pyramid that it was found in.  RootSIFT takes the square root of the L1-normalised
descriptor, so that Euclidean distance compares histograms as Hellinger does (Arandjelovic & Zisserman, CVPR 2012).  A second set
of keypoints comes from the frame compressed by 2 in x, the one simulated view of ASIFT (Morel & Yu, 2009) that pays between
upright cameras far apart: it is detected here once, and used only by pairs whose plain views are not enough.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import cv2
import numpy as np

from .core.luminance import grey_levels
from .core.ordering import rank_within
from .matching.description import LENGTH, describe, main_directions
from .matching.neighbours import nearest_elsewhere
from .matching.scale_space import Blobs, Pyramid, find_blobs, pyramid
from .reasons import Reason, Rejected
from .types import Bools, Features, Float32s, Float64s, Frame, Int64s, Uint8s

Preprocessing = Literal["auto", "none", "clahe"]

DARK_GREY, FLAT_RANGE = 50.0, 25.0
"""Grey levels of 255: a median below the first, or a span from 10 to 90 % below the second, asks for CLAHE."""
ANGLE_SEAM_DEG = 45.0
"""SIFT repeats a keypoint for each strong gradient direction; the first from this angle on stays.  Upright cameras then choose
alike (edges are mostly level or plumb, so the seam lies between), and no place is spent on repeats."""
LARGEST_PX, OVERLAP_PX = 6_500_000, 256
"""An image with more pixels is searched in bands: all scales of one pixel take 230 bytes.  Bands reach farther by the overlap,
and begin at multiples of it, so that coarse scales are sampled at the same places."""


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
    max_keypoints : how many to keep in the plain view.
    tilted_keypoints : how many to keep in the view compressed by 2 in x; 0 leaves that view out.
    contrast_threshold : least contrast of a keypoint, as share of the grey range (OpenCV's meaning).
    grid_columns : square cells across the image among which the keypoints are spread.
    crowding : a cell gives at most this many times its even share, as long as others have keypoints to give; no unit.
    preprocessing : "clahe" smooths the noise and equalises the local contrast first, for night, lamps and fog; "auto" looks at
        the image to decide between that and "none", because by day this finds less.
    min_keypoints : fewer than this in the plain view reject the frame.
    """
    grey = grey_levels(frame.image)
    equalise = preprocessing == "clahe" or (preprocessing == "auto" and _low_contrast(grey, frame.mask))
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
    count, made = len(plain[0]), "clahe" if equalise else "none"
    lookalikes = nearest_elsewhere(plain[2], plain[0], count)
    return Features(xy, frames, descriptors, responses, tilts, frame.view, lookalikes, count, made)


_View = tuple[Float64s, Float64s, Float32s, Float32s]
"""xy, frames, descriptors and responses of one view's keypoints."""


def _low_contrast(grey: Uint8s, mask: Bools) -> bool:
    """True for a dark image (night, lamps), or one that lives in a small part of the grey range (fog)."""
    if not mask.any():
        return False
    low, median, high = np.percentile(grey[mask][::7], [10, 50, 90])
    return bool(median < DARK_GREY or high - low < FLAT_RANGE)


def _equalised(grey: Uint8s) -> Uint8s:
    """Smoothed against the sensor's noise, then contrast-limited adaptive histogram equalisation on 8 x 8 tiles.

    Equalising without smoothing first amplifies the noise of a night image, and finds less than the image left alone.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.2)
    return np.asarray(cv2.createCLAHE(clipLimit=2.0, tileGridSize=(8, 8)).apply(smooth), dtype=np.uint8)


def _detect_view(grey: Uint8s, contrast: float, mask: Bools, wanted: int, grid_columns: int, crowding: float) -> _View:
    bands = _bands(*grey.shape)
    octaves: Pyramid = ()
    found, band_of = [], []
    for number, (start, top, bottom, stop) in enumerate(bands):
        octaves = pyramid(grey[start:stop])
        blobs = find_blobs(octaves, contrast).lower_by(start)
        found.append(blobs.at((blobs.y >= top) & (blobs.y < bottom)) if len(bands) > 1 else blobs)
        band_of.append(np.full(len(found[-1].x), number))
    blobs, band = Blobs.joined(found), np.concatenate(band_of)
    chosen = _spread(blobs, _usable(blobs, mask), grey.shape, wanted, grid_columns, crowding)
    blobs, band = blobs.at(chosen), band[chosen]
    angles, descriptors = np.empty(len(chosen)), np.empty((len(chosen), LENGTH), np.float32)
    for number, (start, _, _, stop) in enumerate(bands):
        octaves = pyramid(grey[start:stop]) if len(bands) > 1 else octaves
        mine = blobs.at(band == number).lower_by(-start)
        angles[band == number] = angle = main_directions(octaves, mine, np.radians(ANGLE_SEAM_DEG))
        descriptors[band == number] = describe(octaves, mine, angle)
    c, s = 2 * blobs.sigma * np.cos(angles), 2 * blobs.sigma * np.sin(angles)
    frames = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    # RootSIFT: unit length follows from the L1 normalisation
    root = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-12)).astype(np.float32)
    return np.column_stack([blobs.x, blobs.y]), frames, root, blobs.response.astype(np.float32)


def _bands(height: int, width: int) -> list[tuple[int, int, int, int]]:
    """Bands of a large image: where each starts, is looked at from and to, and stops."""
    count = -(-height * width // LARGEST_PX)
    edges = [height * band // count for band in range(count + 1)]
    return [
        (max(top // OVERLAP_PX - 1, 0) * OVERLAP_PX, top, bottom, min(bottom + OVERLAP_PX, height))
        for top, bottom in pairwise(edges)
    ]


def _detect_tilted(grey: Uint8s, contrast: float, mask: Bools, wanted: int, grid_columns: int, crowding: float) -> _View:
    """Keypoints of the frame compressed by 2 in x (smoothed first, so that nothing aliases), mapped back into the frame."""
    h, w = grey.shape
    size = (max(w // 2, 1), h)
    smooth = cv2.GaussianBlur(grey, (0, 0), sigmaX=1.2, sigmaY=1e-3)
    narrow = np.asarray(cv2.resize(smooth, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    narrow_mask = cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    xy, frames, descriptors, responses = _detect_view(narrow, contrast, narrow_mask, wanted, max(grid_columns // 2, 1), crowding)
    stretch = np.array([w / size[0], 1.0])
    return (xy + 0.5) * stretch - 0.5, stretch[:, None] * frames, descriptors, responses


def _usable(blobs: Blobs, mask: Bools) -> Bools:
    """Keypoints whose disc (of radius sigma) touches no masked pixel: the rim of a mask is no structure of the scene."""
    h, w = mask.shape
    if mask.all():
        return np.ones(len(blobs.x), dtype=bool)
    clearance = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
    x = np.clip(np.rint(blobs.x).astype(int), 0, w - 1)
    y = np.clip(np.rint(blobs.y).astype(int), 0, h - 1)
    return np.asarray(clearance[y, x] > blobs.sigma)


def _spread(blobs: Blobs, usable: Bools, shape: tuple[int, ...], wanted: int, grid_columns: int, crowding: float) -> Int64s:
    """Rows of the keypoints to keep, strongest first; no cell gives more than its crowded share before all have given theirs.

    Spreading more evenly finds more at 50 to 60 degrees but loses a tenth everywhere else: weak keypoints aren't found again.
    """
    order = np.lexsort((blobs.sigma, blobs.y, blobs.x, -blobs.response))
    order = order[usable[order]]
    if len(order) <= wanted:
        return np.asarray(order)
    cell = shape[1] / grid_columns
    cells = (blobs.y[order] // cell).astype(np.int64) * (grid_columns + 1) + (blobs.x[order] // cell).astype(np.int64)
    share = wanted * cell * cell / (shape[0] * shape[1])
    crowded = rank_within(cells, np.arange(len(cells))) >= crowding * share
    return np.asarray(order[np.sort(np.lexsort((np.arange(len(order)), crowded))[:wanted])])
