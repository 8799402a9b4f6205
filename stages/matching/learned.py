"""Learned matchers, for users who have the weights: an ONNX model that takes two images, run by ONNX Runtime.

Two interfaces are supported, in which LightGlue and its features are published as one model (Lindenberger, Sarlin, Pollefeys,
LightGlue: Local Feature Matching at Light Speed, ICCV 2023):

    image0, image1 (1, c, h, w) each    ->  kpts0, kpts1 (1, n, 2), matches0, mscores0
    images (2, c, h, w)                 ->  keypoints (2, n, 2), matches, mscores

Images are RGB or grey from 0 to 1; keypoints are in their pixels.  Matches are rows of two keypoint indices, or of the index of
the pair and two keypoint indices, or one index for each left keypoint, negative for none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from ..core.luminance import grey_levels
from ..types import Capture, Float32s, Float64s, Frame, Matches, Uint8s

_TWO_INPUTS, _TWO_OUTPUTS = ("image0", "image1"), ("kpts0", "kpts1", "matches0", "mscores0")
_ONE_INPUT, _ONE_OUTPUTS = ("images",), ("keypoints", "matches", "mscores")
_STRIDE = 32
"""Image sizes that the model leaves free are multiples of this, the largest factor by which common features downsample."""
_NEEDED = (
    f"a model of {', '.join(_TWO_INPUTS)} -> {', '.join(_TWO_OUTPUTS)}, or of {', '.join(_ONE_INPUT)} -> "
    f"{', '.join(_ONE_OUTPUTS)}, is wanted: features and matcher exported as one"
)


def match_onnx(
    left_frame: Frame, right_frame: Frame, model: Capture, *, min_score: float = 0.0, long_side_px: int = 1024
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
    session = _session(model.name, model.data.tobytes())
    inputs = {value.name: tuple(n if isinstance(n, int) else 0 for n in value.shape) for value in session.get_inputs()}
    _check(model.name, inputs, [value.name for value in session.get_outputs()])
    shapes = [inputs.get(name, inputs.get(_ONE_INPUT[0], ())) for name in _TWO_INPUTS]
    sizes = [_size(shape, frame, long_side_px) for shape, frame in zip(shapes, (left_frame, right_frame), strict=True)]
    if len(inputs) == 1:  # both in one array
        sizes[1] = sizes[0]
    frames = zip((left_frame, right_frame), sizes, shapes, strict=True)
    x1, x2, scores = _run(model.name, session, [_model_input(frame.image, size, shape[1]) for frame, size, shape in frames])
    x1, x2 = _in_frame(x1, sizes[0], left_frame), _in_frame(x2, sizes[1], right_frame)
    keep = (scores >= min_score) & _usable(x1, left_frame) & _usable(x2, right_frame)
    p = np.clip(scores[keep], 0, 1).astype(np.float32)
    return Matches(x1[keep], x2[keep], None, None, p, None, left_frame.view, right_frame.view)


@lru_cache(maxsize=1)
def _session(name: str, model: bytes) -> Any:
    """The model of a file of this name, ready to run.  It uses one thread, so that every machine finds the same."""
    try:
        import onnxruntime  # imported here: other matchers work without it
    except ModuleNotFoundError:
        raise ModuleNotFoundError("the matcher onnx needs ONNX Runtime: pip install 'wbflow[onnx]'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no base class of their own
        needed = "give the file that the model was exported to, whole"
        raise ValueError(f"{name}: ONNX Runtime cannot read it: {_shortened(error)}: {needed}") from None


def _shortened(error: Exception) -> str:
    return " ".join(str(error).split())[-300:]


def _check(name: str, inputs: Mapping[str, tuple[int, ...]], outputs: Sequence[str]) -> None:
    """Raise ValueError for a model that has neither of the two interfaces."""
    forms = ((_TWO_INPUTS, _TWO_OUTPUTS), (_ONE_INPUT, _ONE_OUTPUTS))
    fits = any(set(inputs) == set(i) and set(outputs) >= set(o) for i, o in forms)
    if not fits or any(len(sizes) != 4 or sizes[1] not in {0, 1, 3} for sizes in inputs.values()):
        takes = ", ".join(f"{name} {sizes}" for name, sizes in inputs.items())
        raise ValueError(f"{name} takes {takes} and gives {', '.join(outputs)}: {_NEEDED}")


def _size(shape: tuple[int, ...], frame: Frame, long_side_px: int) -> tuple[int, int]:
    """Width and height of the image that a model gets for a frame.  shape: (n, c, h, w) of the model's input, 0 where free."""
    _, _, height, width = shape
    scale = min(long_side_px / max(frame.view.width, frame.view.height), 1.0)
    default = [max(round(n * scale / _STRIDE), 1) * _STRIDE for n in (frame.view.width, frame.view.height)]
    return width or default[0], height or default[1]


def _model_input(image: Uint8s, size: tuple[int, int], channels: int) -> Float32s:
    """Input of a model for an image: (1, c, h, w), 0 to 1."""
    smaller = size[0] < image.shape[1] and size[1] < image.shape[0]
    image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR), dtype=np.uint8)
    planes = grey_levels(image)[None] if channels == 1 else image.transpose(2, 0, 1)
    return np.ascontiguousarray(planes[None], dtype=np.float32) / np.float32(255)


def _run(name: str, session: Any, images: list[Float32s]) -> tuple[Float64s, Float64s, Float32s]:
    """Run a model on two images: matches (n, 2), (n, 2) in pixels of each, and scores (n,)."""
    single_input = len(session.get_inputs()) == 1
    inputs = {_ONE_INPUT[0]: np.concatenate(images)} if single_input else dict(zip(_TWO_INPUTS, images, strict=True))
    try:
        outputs = session.run([*(_ONE_OUTPUTS if single_input else _TWO_OUTPUTS)], inputs)
    except Exception as error:  # as above
        raise ValueError(f"{name}: ONNX Runtime cannot run it: {_shortened(error)}") from None
    return _parse_outputs(name, outputs)


def _parse_outputs(name: str, outputs: list[Any]) -> tuple[Float64s, Float64s, Float32s]:
    """Matches and scores, as `_run` returns them, from a model's outputs."""
    *points, matches, scores = outputs
    points1, points2 = (np.asarray(p, dtype=np.float64).reshape(-1, 2) for p in (points if len(points) == 2 else points[0]))
    rows = np.asarray(matches).astype(np.int64)
    if rows.ndim == 2 and rows.shape[1] in {2, 3} and rows.shape[0] == scores.size:
        i1, i2 = rows[:, -2], rows[:, -1]
    elif rows.size == len(points1):
        i1, i2 = np.arange(rows.size), rows.ravel()
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


def _usable(x: Float64s, frame: Frame) -> Any:
    """(n,) whether points are inside the frame and its mask."""
    column, row = np.rint(x).astype(int).T
    inside = (column >= 0) & (row >= 0) & (column < frame.view.width) & (row < frame.view.height)
    inside[inside] = frame.mask[row[inside], column[inside]]
    return inside
