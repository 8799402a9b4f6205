"""Keypoints and descriptors of a network, for users who have the weights: an ONNX model of one image, run by ONNX Runtime.

The interface is that of the files which COLMAP publishes (`aliked-n16rot.onnx`, `aliked-n32.onnx`: X. Zhao et al., ALIKED: A
Lighter Keypoint and Descriptor Extraction Network via Deformable Transformation, IEEE Trans. Instrum. Meas. 2023):

    image (1, 3, h, w) float32 RGB 0 to 1, sides multiples of 32;  max_keypoints int64;  min_score float32
        ->  keypoints (1, n, 2) from -1 to 1 (centres of the first and the last pixel), descriptors (1, n, d), scores (1, n)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..contracts.defaults import CROWDING, GRID_COLUMNS, MAX_KEYPOINTS, MIN_SCORE, TILTED_KEYPOINTS
from ..types import LEARNED, TILTED, Bools, Capture, Features, Float32s, Float64s, Frame, Uint8s
from .neighbours import nearest_lookalike
from .onnx_model import input_shapes, interface_of, onnx_session, run
from .sift import detect_sift
from .spread import Spread
from .turns import QUARTER_TURNS, turned_axes, turned_back

_INPUTS = ("image", "max_keypoints", "min_score")
_OUTPUTS = ("keypoints", "descriptors", "scores")
_STRIDE = 32
"""Sides of the image that the network gets are multiples of this, pixels."""
_OVERLAP_PX = 96
"""Pixels around a tile that the network sees, too: keypoints in them are those of the neighbouring tile."""
_NOMINAL_SIZE_PX = 8.0
"""Size of a keypoint in pixels of the image that the network gets, where others have that of their patch; only ratios matter."""
_DISTINCT_PX = 2.0
"""Keypoints nearer to a stronger one than this are left out, pixels of the frame: placed to a fraction of a pixel, neighbouring
maxima of the score often become one and the same point twice, and each would be the other's rival for every match."""
_SURPLUS = 2
"""The network is asked for this many times the keypoints that are kept, from which those spread over the image are chosen."""


def detect_onnx(
    frame: Frame,
    model: Capture,
    *,
    max_keypoints: int = MAX_KEYPOINTS,
    min_score: float = MIN_SCORE,
    grid_columns: int = GRID_COLUMNS,
    crowding: float = CROWDING,
    long_side_px: int = 1600,
    tile_px: int = 1024,
    turned: bool = False,
) -> Features:
    """Detect and describe keypoints by an ONNX model of one image.

    Raises ValueError, with the file's name, if the file is not an ONNX model, has another interface, or cannot be run, and
    ModuleNotFoundError without the package onnxruntime.

    Parameters
    ----------
    frame : the clean frame; keypoints on masked pixels are left out.
    model : the ONNX file: a path, or a name that `wbflow models` lists.
    max_keypoints : most keypoints kept.
    min_score : keypoints to which the model gives a lower score are dropped, 0 to 1.
    grid_columns : number of square cells across the image, over which the keypoints are spread.
    crowding : a cell yields at most this many times its even share while other cells still have keypoints; no unit.
    long_side_px : long side to which larger frames are scaled, pixels.
    tile_px : frames larger than this are searched in tiles of at most this side, since the network takes about 2 kB for each
        pixel that it sees at a time (ONNX Runtime: 1.4 kB in the first frame, more from the second one on).
    turned : search the frame on its sides and upside down, too, for sites with cameras that are mounted so.  Features take four
        times as long; each pair is matched in the turns in which most of its strongest keypoints agree.
    """
    session = onnx_session(model)
    shapes = _checked_interface(model.name, session)
    spread = Spread(max_keypoints, grid_columns, crowding)
    h, w = frame.image.shape[:2]
    scale = min(long_side_px / max(h, w), 1.0)
    parts = []
    for turn in range(QUARTER_TURNS if turned else 1):
        # 1. the frame as it is searched: its turn and size
        image = np.ascontiguousarray(np.rot90(frame.image, turn))
        size = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
        stretch = np.array([image.shape[1] / size[0], image.shape[0] / size[1]])
        if scale < 1:
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)

        # 2. the keypoints of all tiles
        found = _search_tiles(model.name, session, shapes, image, tile_px, _SURPLUS * crowding * max_keypoints, min_score)

        # 3. the best of them in pixels of the frame, spread over it; pixel centres are at integers
        xy = turned_back((found.xy + 0.5) * stretch - 0.5, turn, (w, h))
        usable = _usable(xy, frame.mask) & _is_strongest_near(xy, found.scores)
        kept = spread.rows(xy, found.scores, usable, (h, w))
        xy = xy[kept]
        descriptors = np.ascontiguousarray(found.descriptors[kept])
        count = len(kept)
        part = Features(
            xy=xy,
            frames=np.tile(turned_axes(turn) * _NOMINAL_SIZE_PX / scale, (count, 1, 1)),
            descriptors=descriptors,
            responses=found.scores[kept],
            tilts=np.full(count, LEARNED + turn, np.uint8),
            view=frame.view,
            lookalikes=nearest_lookalike(descriptors, xy, count),
            plain_keypoints=count,
        )
        parts.append(part)
    return _joined(parts)


def _joined(parts: list[Features]) -> Features:
    """Keypoints of one frame that were found in several searches, one after the other."""
    return replace(
        parts[0],
        xy=np.concatenate([part.xy for part in parts]),
        frames=np.concatenate([part.frames for part in parts]),
        descriptors=np.concatenate([part.descriptors for part in parts]),
        responses=np.concatenate([part.responses for part in parts]),
        tilts=np.concatenate([part.tilts for part in parts]),
        lookalikes=np.concatenate([part.lookalikes for part in parts]),
        plain_keypoints=sum(part.plain_keypoints for part in parts),
    )


def detect_both(
    frame: Frame,
    model: Capture,
    *,
    max_keypoints: int = MAX_KEYPOINTS,
    tilted_keypoints: int = TILTED_KEYPOINTS,
    turned: bool = False,
) -> Features:
    """SIFT keypoints and those of a model together; each kind is matched with its own.

    Parameters
    ----------
    frame : the clean frame.
    model : the ONNX file, as of `detect_onnx`.
    max_keypoints : most keypoints of each kind.
    tilted_keypoints : most SIFT keypoints kept in the view compressed by 2 in x.
    turned : let the model search the frame on its sides and upside down, too, as of `detect_onnx`.
    """
    sift = detect_sift(frame, max_keypoints=max_keypoints, tilted_keypoints=tilted_keypoints)
    learned = detect_onnx(frame, model, max_keypoints=max_keypoints, turned=turned)
    # descriptors of the longer kind decide the length; zeros change no distance
    length = max(sift.descriptors.shape[1], learned.descriptors.shape[1])
    descriptors = np.concatenate([_lengthened(sift.descriptors, length), _lengthened(learned.descriptors, length)])
    tilts = np.concatenate([sift.tilts, learned.tilts])

    # the compressed view last: look-alikes are stored for the rows before it
    order = np.argsort(tilts == TILTED, kind="stable")
    return Features(
        xy=np.concatenate([sift.xy, learned.xy])[order],
        frames=np.concatenate([sift.frames, learned.frames])[order],
        descriptors=descriptors[order],
        responses=np.concatenate([sift.responses, learned.responses])[order],
        tilts=tilts[order],
        view=frame.view,
        lookalikes=np.concatenate([sift.lookalikes, learned.lookalikes]),
        plain_keypoints=sift.plain_keypoints,
        preprocessing=sift.preprocessing,
    )


def _lengthened(descriptors: Float32s, length: int) -> Float32s:
    """Descriptors (n, d) with zeros at the end, so that they have this length."""
    return np.pad(descriptors, ((0, 0), (0, length - descriptors.shape[1])))


def _checked_interface(name: str, session: Any) -> dict[str, tuple[int, ...]]:
    """Shapes of the model's inputs by name.  Raises ValueError if it has another interface."""
    shapes = input_shapes(session)
    outputs = [value.name for value in session.get_outputs()]
    takes_image = len(shapes.get("image", ())) == 4 and shapes["image"][1] in {0, 3}
    if takes_image and set(shapes) == set(_INPUTS) and set(outputs) >= set(_OUTPUTS):
        return shapes
    raise ValueError(
        f"{name} {interface_of(session)}: a detector of {', '.join(_INPUTS)} -> {', '.join(_OUTPUTS)} is"
        " wanted, such as aliked-n32.onnx as COLMAP publishes it"
    )


@dataclass(frozen=True)
class _Tile:
    """A part of the image whose keypoints count, and the larger part that the network sees: pixels, ends exclusive."""

    left: int
    top: int
    right: int
    bottom: int
    seen_left: int
    seen_top: int
    seen_right: int
    seen_bottom: int

    @property
    def core_area(self) -> int:
        """Pixels whose keypoints count."""
        return (self.right - self.left) * (self.bottom - self.top)


def _tiles(width: int, height: int, side: int) -> Iterator[_Tile]:
    """Tiles that cover an image; one if neither side is longer than a tile."""
    columns = -(-width // side)
    rows = -(-height // side)
    for row in range(rows):
        for column in range(columns):
            left = width * column // columns
            right = width * (column + 1) // columns
            top = height * row // rows
            bottom = height * (row + 1) // rows
            yield _Tile(
                left, top, right, bottom,
                max(left - _OVERLAP_PX, 0),
                max(top - _OVERLAP_PX, 0),
                min(right + _OVERLAP_PX, width),
                min(bottom + _OVERLAP_PX, height),
            )  # fmt: skip


@dataclass(frozen=True)
class _Found:
    """What the network finds in a tile."""

    xy: Float64s
    """(n, 2) pixels of the image."""
    descriptors: Float32s
    scores: Float32s


def _search_tiles(
    name: str, session: Any, shapes: dict[str, tuple[int, ...]], image: Uint8s, tile_px: int, wanted: float, min_score: float
) -> _Found:
    """The keypoints of all tiles of an image (h, w, 3), about `wanted` of them, shared out by the tiles' areas."""
    h, w = image.shape[:2]
    parts = []
    for tile in _tiles(w, h, tile_px):
        share = tile.core_area / (w * h)
        parts.append(_search(name, session, shapes, image, tile, int(np.ceil(wanted * share)), min_score))
    return _Found(
        np.concatenate([part.xy for part in parts]),
        np.concatenate([part.descriptors for part in parts]),
        np.concatenate([part.scores for part in parts]),
    )


def _search(
    name: str, session: Any, shapes: dict[str, tuple[int, ...]], image: Uint8s, tile: _Tile, wanted: int, min_score: float
) -> _Found:
    """The keypoints of one tile of an image (h, w, 3)."""
    # 1. the network's input: sides are rounded up to its stride by repeating the last pixels
    part = image[tile.seen_top : tile.seen_bottom, tile.seen_left : tile.seen_right]
    h, w = part.shape[:2]
    padded = np.pad(part, ((0, -h % _STRIDE), (0, -w % _STRIDE), (0, 0)), mode="edge")
    planes = np.ascontiguousarray(padded.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255)
    # models take a limit as a number, or as a vector of one
    inputs = {
        "image": planes,
        "max_keypoints": np.full([1] * len(shapes["max_keypoints"]), wanted, np.int64),
        "min_score": np.full([1] * len(shapes["min_score"]), min_score, np.float32),
    }
    keypoints, descriptors, scores = run(name, session, _OUTPUTS, inputs)

    # 2. its outputs, checked
    keypoints = np.asarray(keypoints, np.float64).reshape(-1, 2)
    descriptors = np.asarray(descriptors, np.float32).reshape(len(keypoints), -1)
    scores = np.asarray(scores, np.float32).ravel()
    if len(scores) != len(keypoints) or not (np.isfinite(keypoints).all() and np.isfinite(descriptors).all()):
        raise ValueError(f"{name} gives {len(scores)} scores for {len(keypoints)} keypoints, or numbers that are not finite")
    length = np.linalg.norm(descriptors, axis=1, keepdims=True)
    descriptors = descriptors / np.maximum(length, np.float32(1e-12))

    # 3. in pixels of the image; those in the core of the tile
    last = np.array([padded.shape[1] - 1, padded.shape[0] - 1])
    xy = (keypoints + 1) / 2 * last + [tile.seen_left, tile.seen_top]
    core = (xy >= [tile.left - 0.5, tile.top - 0.5]) & (xy < [tile.right - 0.5, tile.bottom - 0.5])
    inside = core.all(axis=1)
    return _Found(xy[inside], descriptors[inside], scores[inside])


def _is_strongest_near(xy: Float64s, scores: Float32s) -> Bools:
    """(n,) keypoints without a stronger one within `_DISTINCT_PX`; of equally strong ones, the first row counts as stronger."""
    pairs = cKDTree(xy).query_pairs(_DISTINCT_PX, output_type="ndarray")
    first = pairs[:, 0]
    second = pairs[:, 1]  # the larger row of the two
    weaker = np.where(scores[second] > scores[first], first, second)
    is_strongest = np.ones(len(xy), dtype=bool)
    is_strongest[weaker] = False
    return is_strongest


def _usable(xy: Float64s, mask: Bools) -> Bools:
    """(n,) keypoints in the frame that are farther from masked pixels than the network's patch of pixels reaches."""
    h, w = mask.shape
    x = np.rint(xy[:, 0]).astype(int)
    y = np.rint(xy[:, 1]).astype(int)
    inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
    if not mask.all():
        clearance = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 3)
        inside[inside] = clearance[y[inside], x[inside]] > _NOMINAL_SIZE_PX / 2
    return np.asarray(inside, dtype=np.bool_)
