"""LightGlue on the site's keypoints, for users who have the weights: an ONNX model of two sets of keypoints, run by ONNX Runtime.

The interface is that of the files which COLMAP publishes (`aliked-lightglue.onnx`, `sift-lightglue.onnx`: Lindenberger, Sarlin,
Pollefeys, LightGlue: Local Feature Matching at Light Speed, ICCV 2023):

    kpts0, kpts1 (1, n, 2) pixels;  desc0, desc1 (1, n, d) of unit length;  image_size0, image_size1 (1, 2) width and height
    and, in models of SIFT, scales0, scales1 (1, n) pixels;  oris0, oris1 (1, n) radians from x to y
        ->  matches0 (n,) row of the other keypoint, negative for none;  mscores0 (n,) 0 to 1

All inputs are float32.  As in our frames, the centre of the first pixel is at 0, and angles go from x to y (down); the scale is
the sigma of the blob.  SIFT's descriptors are RootSIFT, but in Lowe's order: their histograms go round the other way than ours.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..contracts.defaults import CROWDING, GRID_COLUMNS, MIN_SCORE
from ..types import LEARNED, PLAIN, Capture, Features, Float32s, Float64s, Int32s, Matches
from .description import DIRECTIONS
from .matcher import keypoint_matches
from .onnx_model import input_shapes, interface_of, onnx_session, run
from .spread import Spread
from .turns import matching_turns, turned

_INPUTS = ("kpts0", "kpts1", "desc0", "desc1", "image_size0", "image_size1")
_FRAME_INPUTS = ("scales0", "scales1", "oris0", "oris1")
"""Further inputs of models of SIFT."""
_OUTPUTS = ("matches0", "mscores0")
_SIGMAS = 2.0
"""Frames of SIFT keypoints are this many sigmas long."""
_SAME_DETECTOR = "use the detector that the model was trained for"


def match_lightglue(
    left: Features, right: Features, model: Capture, *, min_score: float = MIN_SCORE, max_keypoints: int = 2048
) -> Matches:
    """Match keypoints by an ONNX model of LightGlue.

    A model of SIFT takes the SIFT keypoints of the plain view, any other model the learned ones.  Raises ValueError, with the
    file's name, if the file is not an ONNX model, has another interface, is for other keypoints, or cannot be run, and
    ModuleNotFoundError without the package onnxruntime.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    model : the ONNX file: `model: PATH` in the site file.  Its content, not its path, decides whether pairs are matched again.
    min_score : matches to which the model gives a lower score are dropped, 0 to 1.
    max_keypoints : most keypoints of each frame that the model gets, the strongest ones, spread over the picture.  Its time and
        memory grow with their square; the others can still be matched once the geometry is known.
    """
    session = onnx_session(model)
    shapes = _checked_interface(model.name, session)
    takes_sift = _FRAME_INPUTS[0] in shapes

    # 1. the keypoints of its kind; learned ones in the turns of the pictures that fit
    kind1, kind2 = (PLAIN, PLAIN) if takes_sift else matching_turns(left, right)
    rows1 = _strongest(left, kind1, max_keypoints)
    rows2 = _strongest(right, kind2, max_keypoints)
    if not (len(rows1) or len(rows2)) and len(left.xy) and len(right.xy):
        raise ValueError(f"{model.name} {_wanted_keypoints(takes_sift)}")
    if not (len(rows1) and len(rows2)):
        none = np.zeros(0, np.int32)
        return keypoint_matches(left, right, none, none, np.zeros(0))

    # 2. the network
    length = max(_length(left.descriptors[rows1]), _length(right.descriptors[rows2]))
    wanted = shapes["desc0"][2] or length
    if length > wanted or wanted > min(left.descriptors.shape[1], right.descriptors.shape[1]):
        raise ValueError(f"{model.name} takes descriptors of {wanted} numbers, the keypoints' have {length}: {_SAME_DETECTOR}")
    inputs = _inputs_of(left, rows1, wanted, takes_sift, "0") | _inputs_of(right, rows2, wanted, takes_sift, "1")
    try:
        partners, scores = run(model.name, session, _OUTPUTS, inputs)
    except ValueError as error:
        raise ValueError(f"{error}; the keypoints have descriptors of {length} numbers: {_SAME_DETECTOR}") from None

    # 3. its matches as rows of the keypoints
    i, j, probability = _parsed(model.name, partners, scores, len(rows1), len(rows2))
    keep = probability >= min_score
    return keypoint_matches(left, right, rows1[i[keep]], rows2[j[keep]], probability[keep])


def _checked_interface(name: str, session: Any) -> dict[str, tuple[int, ...]]:
    """Shapes of the model's inputs by name.  Raises ValueError if it has another interface, or a fixed number of keypoints."""
    shapes = input_shapes(session)
    outputs = {value.name for value in session.get_outputs()}
    has_names = set(shapes) in (set(_INPUTS), {*_INPUTS, *_FRAME_INPUTS}) and outputs >= set(_OUTPUTS)
    if has_names and all(len(shapes[key]) == 3 and shapes[key][1] == 0 for key in _INPUTS[:4]):
        return shapes
    raise ValueError(
        f"{name} {interface_of(session)}: a matcher of {', '.join(_INPUTS)} (and {', '.join(_FRAME_INPUTS)}) for any number of"
        f" keypoints -> {', '.join(_OUTPUTS)} is wanted, such as aliked-lightglue.onnx as COLMAP publishes it;"
        " a model that takes two images is run by matcher: onnx"
    )


def _wanted_keypoints(takes_sift: bool) -> str:
    """What a model matches, and how to have such keypoints, when the frames have others."""
    if takes_sift:
        return "matches SIFT keypoints, and the cameras have others: say features: {detector: sift}, or sift+onnx"
    return "matches keypoints of a learned detector, and the cameras have SIFT's: say features: {detector: onnx, model: FILE}"


def _strongest(features: Features, kind: int, quota: int) -> Int32s:
    """Rows of the keypoints that a model gets, by the value of `Features.tilts`, strongest first."""
    size = (features.view.height, features.view.width)
    spread = Spread(quota, GRID_COLUMNS, CROWDING)
    return spread.rows(features.xy, features.responses, features.tilts == kind, size).astype(np.int32)


def _length(descriptors: Float32s) -> int:
    """Length of descriptors (n, d) without the zeros that `sift+onnx` adds to the shorter kind."""
    used = np.flatnonzero(descriptors.any(axis=0))
    return int(used[-1]) + 1 if len(used) else 0


def _inputs_of(features: Features, rows: Int32s, length: int, takes_sift: bool, side: str) -> dict[str, Float32s]:
    """The inputs of one picture, "0" or "1", with descriptors of this length."""
    size = (features.view.width, features.view.height)
    xy = features.xy[rows]
    turn = max(int(features.tilts[rows[0]]) - LEARNED, 0)
    if turn:
        xy = turned(xy, turn, size)
        size = size if turn == 2 else size[::-1]
    descriptors = features.descriptors[rows, :length]
    if takes_sift:
        descriptors = _in_lowes_order(descriptors)
    inputs = {
        f"kpts{side}": _single(xy),
        f"desc{side}": _single(descriptors),
        f"image_size{side}": np.array([size], np.float32),
    }
    if takes_sift:
        # frames are s R(angle): the first column holds both
        columns = features.frames[rows, :, 0]
        inputs[f"scales{side}"] = _single(np.hypot(columns[:, 0], columns[:, 1]) / _SIGMAS)
        inputs[f"oris{side}"] = _single(np.arctan2(columns[:, 1], columns[:, 0]))
    return inputs


def _in_lowes_order(descriptors: Float32s) -> Float32s:
    """SIFT descriptors (n, 128) with the directions of each histogram from x against y (up), as Lowe's SIFT and OpenCV's do."""
    histograms = descriptors.reshape(len(descriptors), -1, DIRECTIONS)
    return histograms[:, :, -np.arange(DIRECTIONS)].reshape(descriptors.shape)


def _single(values: Float64s | Float32s) -> Float32s:
    """Values as a batch of one."""
    return np.ascontiguousarray(values[None], dtype=np.float32)


def _parsed(name: str, partners: Any, scores: Any, count1: int, count2: int) -> tuple[Int32s, Int32s, Float64s]:
    """Rows of the left and the right keypoints of each match, and its score, of `count1` and `count2` keypoints."""
    # some exports number the partners in float32
    partner = np.asarray(partners, np.float64).ravel()
    score = np.asarray(scores, np.float64).ravel()
    if len(partner) != count1 or len(score) != count1 or not np.isfinite(score).all():
        raise ValueError(f"{name} gives {len(partner)} matches0 and {len(score)} mscores0 for {count1} keypoints, or no numbers")
    i = np.flatnonzero(partner >= 0).astype(np.int32)
    j = partner[i].astype(np.int32)
    if (j >= count2).any():
        raise ValueError(f"{name} matches keypoint {j.max()} of {count2}")
    return i, j, np.clip(score[i], 0, 1)
