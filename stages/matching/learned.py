"""Learned matchers, for users who have the weights: an ONNX model that takes two images, run by ONNX Runtime.

Two interfaces are supported, in which LightGlue and its features are published as one model (Lindenberger, Sarlin, Pollefeys,
LightGlue: Local Feature Matching at Light Speed, ICCV 2023):

    image0, image1 (1, c, h, w) each    ->  kpts0, kpts1 (1, n, 2), matches0, mscores0
    images (2, c, h, w)                 ->  keypoints (2, n, 2), matches, mscores

Images are RGB or grey from 0 to 1; keypoints are in their pixels.  Matches are rows of two keypoint indices, or of the index of
the pair and two keypoint indices, or one index for each left keypoint, negative for none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..contracts.defaults import MIN_SCORE
from ..types import Bools, Capture, Float32s, Float64s, Frame, Matches
from .onnx_model import input_shapes, interface_of, model_input, onnx_session, run


@dataclass(frozen=True)
class _Interface:
    """Names of a model's inputs, and of the outputs that are read."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def words(self) -> str:
        """The interface as in messages."""
        return f"{', '.join(self.inputs)} -> {', '.join(self.outputs)}"


_TWO_IMAGES = _Interface(("image0", "image1"), ("kpts0", "kpts1", "matches0", "mscores0"))
"""Each image is an input of its own, of its own size."""
_ONE_BATCH = _Interface(("images",), ("keypoints", "matches", "mscores"))
"""Both images are one input, and therefore have the same size."""
_STRIDE = 32
"""Image sizes that the model leaves free are multiples of this, the largest factor by which common features downsample."""
_NEEDED = f"a model of {_TWO_IMAGES.words()}, or of {_ONE_BATCH.words()}, is wanted: features and matcher exported as one"


def match_onnx(
    left_frame: Frame, right_frame: Frame, model: Capture, *, min_score: float = MIN_SCORE, long_side_px: int = 1024
) -> Matches:
    """Match by an ONNX model that takes both images (features and LightGlue exported as one).

    The points are not keypoints of the site: geometry uses them as they are, without guided matching.  Raises ValueError, with
    the file's name, if the file is not an ONNX model, has other inputs or outputs, or cannot be run, and ModuleNotFoundError
    without the package onnxruntime.

    Parameters
    ----------
    left_frame, right_frame : the pair.
    model : the ONNX file: `model: PATH` in the site file.  Its content, not its path, decides whether pairs are matched again.
    min_score : matches to which the model gives a lower score are dropped, 0 to 1.
    long_side_px : long side to which larger images are scaled if the model takes any size, pixels.
    """
    session = onnx_session(model)
    shapes = input_shapes(session)
    interface = _interface(model.name, session)

    # the images in the sizes that the model takes
    left_shape = shapes[interface.inputs[0]]
    right_shape = shapes[interface.inputs[-1]]
    left_size = _size(left_shape, left_frame, long_side_px)
    right_size = left_size if interface is _ONE_BATCH else _size(right_shape, right_frame, long_side_px)
    left_image = model_input(left_frame.image, left_size, left_shape[1])
    right_image = model_input(right_frame.image, right_size, right_shape[1])

    x1, x2, scores = _run(model.name, session, interface, left_image, right_image)
    x1 = _in_frame(x1, left_size, left_frame)
    x2 = _in_frame(x2, right_size, right_frame)
    keep = (scores >= min_score) & _usable(x1, left_frame) & _usable(x2, right_frame)
    p = np.clip(scores[keep], 0, 1).astype(np.float32)
    return Matches(x1[keep], x2[keep], None, None, p, None, left_frame.view, right_frame.view)


def _interface(name: str, session: Any) -> _Interface:
    """The interface that a model has.  Raises ValueError if it has neither of the two, or takes no grey or RGB images."""
    shapes = input_shapes(session)
    outputs = [value.name for value in session.get_outputs()]
    takes_images = all(len(sizes) == 4 and sizes[1] in {0, 1, 3} for sizes in shapes.values())
    for interface in (_TWO_IMAGES, _ONE_BATCH):
        if takes_images and set(shapes) == set(interface.inputs) and set(outputs) >= set(interface.outputs):
            return interface
    raise ValueError(f"{name} {interface_of(session)}: {_NEEDED}")


def _size(shape: tuple[int, ...], frame: Frame, long_side_px: int) -> tuple[int, int]:
    """Width and height of the image that a model gets for a frame.  shape: (n, c, h, w) of the model's input, 0 where free."""
    _, _, height, width = shape
    scale = min(long_side_px / max(frame.view.width, frame.view.height), 1.0)
    free_width = max(round(frame.view.width * scale / _STRIDE), 1) * _STRIDE
    free_height = max(round(frame.view.height * scale / _STRIDE), 1) * _STRIDE
    return width or free_width, height or free_height


def _run(
    name: str, session: Any, interface: _Interface, left_image: Float32s, right_image: Float32s
) -> tuple[Float64s, Float64s, Float32s]:
    """Run a model on two images.

    Parameters
    ----------
    name : the file's name, for messages.
    session : the model, ready to run.
    interface : its inputs and outputs.
    left_image, right_image : (1, c, h, w) float32.

    Returns
    -------
    Matches (n, 2), (n, 2) in pixels of each image, and scores (n,).
    """
    if interface is _ONE_BATCH:
        inputs = {interface.inputs[0]: np.concatenate([left_image, right_image])}
    else:
        inputs = dict(zip(interface.inputs, (left_image, right_image), strict=True))
    outputs = run(name, session, interface.outputs, inputs)
    return _parse_outputs(name, outputs)


def _parse_outputs(name: str, outputs: list[Any]) -> tuple[Float64s, Float64s, Float32s]:
    """Matches and scores, as `_run` returns them, from a model's outputs."""
    # keypoints: two outputs (1, n, 2), or one (2, n, 2)
    *keypoints, matches, scores = outputs
    left_keypoints, right_keypoints = keypoints if len(keypoints) == 2 else keypoints[0]
    points1 = np.asarray(left_keypoints, dtype=np.float64).reshape(-1, 2)
    points2 = np.asarray(right_keypoints, dtype=np.float64).reshape(-1, 2)

    rows = np.asarray(matches).astype(np.int64)
    if rows.ndim == 2 and rows.shape[1] in {2, 3} and rows.shape[0] == scores.size:
        # (m, 2) rows of both keypoints, or (m, 3) with the index of the pair first
        i1 = rows[:, -2]
        i2 = rows[:, -1]
    elif rows.size == len(points1):
        # one right keypoint for each left one, negative for none
        i1 = np.arange(rows.size)
        i2 = rows.ravel()
    else:
        raise ValueError(f"{name} gives matches of shape {rows.shape} for {len(points1)} and {len(points2)} keypoints: {_NEEDED}")
    if scores.size != len(i1):
        raise ValueError(f"{name} gives {scores.size} scores for {len(i1)} matches: {_NEEDED}")
    matched = (i1 >= 0) & (i1 < len(points1)) & (i2 >= 0) & (i2 < len(points2))
    return points1[i1[matched]], points2[i2[matched]], np.asarray(scores, dtype=np.float32).ravel()[matched]


def _in_frame(points: Float64s, size: tuple[int, int], frame: Frame) -> Float64s:
    """Points of an image of this size as pixels of the frame that it was scaled from; pixel centres are at integers."""
    scale = np.array([frame.view.width / size[0], frame.view.height / size[1]])
    return np.asarray((points + 0.5) * scale - 0.5, dtype=np.float64)


def _usable(x: Float64s, frame: Frame) -> Bools:
    """(n,) whether points are inside the frame and its mask."""
    column, row = np.rint(x).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < frame.view.width) & (row < frame.view.height)
    # the mask is read only where there are pixels
    inside[inside] = frame.mask[row[inside], column[inside]]
    return np.asarray(inside, dtype=np.bool_)
