"""Learned matchers, for users who have the weights: an ONNX model that takes two images, run by OpenCV's dnn module.

Two interfaces are supported, in which LightGlue and its features are published as one model (Lindenberger, Sarlin, Pollefeys,
LightGlue: Local Feature Matching at Light Speed, ICCV 2023):

    image0, image1 (1, c, h, w) each    ->  kpts0, kpts1 (1, n, 2), matches0, mscores0
    images (2, c, h, w)                 ->  keypoints (2, n, 2), matches, mscores

Images are RGB or grey from 0 to 1; keypoints are in their pixels.  Matches are rows of two keypoint indices, or of the index of
the pair and two keypoint indices, or one index for each left keypoint, negative for none.
"""

from __future__ import annotations

import functools
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
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
    the file's name, if the file is not an ONNX model, has other inputs or outputs, or cannot be run by OpenCV.

    Parameters
    ----------
    left_frame, right_frame : the pair.
    model : the ONNX file: `model: PATH` in the site file.  Its content, not its path, decides whether pairs are matched again.
    min_score : matches to which the model gives a lower score are dropped, 0 to 1.
    long_side_px : long side to which larger images are scaled if the model takes any size, pixels.
    """
    data = model.data.tobytes()
    try:
        interface = read_interface(data)
    except ValueError as error:
        raise ValueError(f"{model.name} {error}: give the file that the model was exported to, whole") from None
    _check(model.name, interface)
    if problem := why_unreadable(data):
        raise ValueError(f"{model.name}: {problem}: export it with GELU written as (x * erf(x / sqrt(2)) + x) / 2")
    shapes = [interface.inputs.get(name, interface.inputs.get(_ONE_INPUT[0], ())) for name in _TWO_INPUTS]
    sizes = [_size(shape, frame, long_side_px) for shape, frame in zip(shapes, (left_frame, right_frame), strict=True)]
    if len(interface.inputs) == 1:  # both in one array
        sizes[1] = sizes[0]
    frames = zip((left_frame, right_frame), sizes, shapes, strict=True)
    x1, x2, scores = _run(model, interface, [_model_input(frame.image, size, shape[1]) for frame, size, shape in frames])
    x1, x2 = _in_frame(x1, sizes[0], left_frame), _in_frame(x2, sizes[1], right_frame)
    keep = (scores >= min_score) & _usable(x1, left_frame) & _usable(x2, right_frame)
    p = np.clip(scores[keep], 0, 1).astype(np.float32)
    return Matches(x1[keep], x2[keep], None, None, p, None, left_frame.view, right_frame.view)


def _check(name: str, interface: ModelInterface) -> None:
    """Raise ValueError for a model that has neither of the two interfaces."""
    forms = ((_TWO_INPUTS, _TWO_OUTPUTS), (_ONE_INPUT, _ONE_OUTPUTS))
    fits = any(set(interface.inputs) == set(i) and set(interface.outputs) >= set(o) for i, o in forms)
    if not fits or any(len(sizes) != 4 or sizes[1] not in {0, 1, 3} for sizes in interface.inputs.values()):
        takes = ", ".join(f"{name} {sizes}" for name, sizes in interface.inputs.items()) or "nothing"
        raise ValueError(f"{name} takes {takes} and gives {', '.join(interface.outputs) or 'nothing'}: {_NEEDED}")


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


def _run(model: Capture, interface: ModelInterface, images: list[Float32s]) -> tuple[Float64s, Float64s, Float32s]:
    """Run a model on two images: matches (n, 2), (n, 2) in pixels of each, and scores (n,).  It uses one thread, so that every
    machine finds the same."""
    single_input = len(interface.inputs) == 1
    names = _ONE_OUTPUTS if single_input else _TWO_OUTPUTS
    inputs = {"images": np.concatenate(images)} if single_input else dict(zip(_TWO_INPUTS, images, strict=True))
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        net = cv2.dnn.readNetFromONNX(np.ascontiguousarray(model.data))
        for name, value in inputs.items():
            net.setInput(value, name)
        outputs = [np.asarray(output) for output in net.forward(list(names))]
    except cv2.error as error:
        message = " ".join(str(error).split())[-300:]
        raise ValueError(f"{model.name}: OpenCV {cv2.__version__} cannot run it: {message}") from None
    finally:
        cv2.setNumThreads(threads)
    return _parse_outputs(model.name, outputs)


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


_VARINT, _EIGHT_BYTES, _BYTES, _FOUR_BYTES = 0, 1, 2, 5
"""Wire types of Protocol Buffers."""


@dataclass(frozen=True)
class ModelInterface:
    """Inputs and outputs of a model."""

    inputs: dict[str, tuple[int, ...]]
    """Shapes by name, 0 where the model takes any size."""
    outputs: tuple[str, ...]


def read_interface(model: bytes) -> ModelInterface:
    """The interface of an ONNX model.  Raises ValueError for bytes that are not an ONNX model."""
    try:
        (graph,) = _parts(memoryview(model), 7)
        weights = {_text(tensor, 8) for tensor in _parts(graph, 5)}  # old models list them as inputs, too
        inputs = {_text(value, 1): _sizes(value) for value in _parts(graph, 11)}
        outputs = tuple(_text(value, 1) for value in _parts(graph, 12))
    except (IndexError, ValueError):  # UnicodeDecodeError is a ValueError
        raise ValueError("is no ONNX model") from None
    return ModelInterface({name: sizes for name, sizes in inputs.items() if name not in weights}, outputs)


def _sizes(value: memoryview) -> tuple[int, ...]:
    """The shape of an input; () if the model does not state it."""
    for kind in _parts(value, 2):
        for tensor in _parts(kind, 1):
            for shape in _parts(tensor, 2):
                return tuple(next((n for f, n in _fields(dim) if f == 1 and isinstance(n, int)), 0) for dim in _parts(shape, 1))
    return ()


def _text(message: memoryview, field: int) -> str:
    return next((bytes(part).decode() for part in _parts(message, field)), "")


def _parts(message: memoryview, field: int) -> list[memoryview]:
    """The values of a field of strings, bytes or messages."""
    return [value for number, value in _fields(message) if number == field and isinstance(value, memoryview)]


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of each field.  Raises IndexError or ValueError if the message is truncated or invalid."""
    position = 0
    while position < len(message):
        tag, position = _varint(message, position)
        if tag & 7 == _VARINT:
            value, position = _varint(message, position)
            yield tag >> 3, value
            continue
        length = {_EIGHT_BYTES: 8, _FOUR_BYTES: 4}.get(tag & 7, 0)
        if tag & 7 == _BYTES:
            length, position = _varint(message, position)
        elif not length:
            raise ValueError("no such wire type")
        if position + length > len(message):
            raise IndexError
        yield tag >> 3, message[position : position + length]
        position += length


def _varint(message: memoryview, position: int) -> tuple[int, int]:
    """A varint, which has seven bits in each byte, and the position after it."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
    raise ValueError("no number")


_READ = """
import sys, cv2, numpy
try:
    cv2.dnn.readNetFromONNX(numpy.frombuffer(sys.stdin.buffer.read(), numpy.uint8))
except cv2.error:
    pass
"""
_LONGEST_S = 120.0


@functools.lru_cache(maxsize=2)
def why_unreadable(model: bytes) -> str:
    """Why this process must not read a model, "" if it may: reading is tried in another process, which OpenCV may crash."""
    try:
        process = subprocess.run([sys.executable, "-c", _READ], input=model, capture_output=True, timeout=_LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return f"OpenCV has not read it within {_LONGEST_S:.0f} s"
    if process.returncode >= 0:
        return ""
    return f"OpenCV ends with {signal.Signals(-process.returncode).name} while it reads it"
