"""Write ALIKED as an ONNX file of the interface that COLMAP publishes.    aliked_onnx.py WEIGHTS.pth OUT.onnx

WEIGHTS.pth is the state dict of ALIKED-n32 (or another one with kernels of 3 x 3) as its authors publish it.  Only for benches:
users download the file that COLMAP publishes.  The network is that of X. Zhao et al., ALIKED: A Lighter Keypoint and Descriptor
Extraction Network via Deformable Transformation, IEEE Transactions on Instrumentation and Measurement 2023 (arXiv 2304.03608):

    image (1, 3, h, w) float32 RGB 0 to 1, sides multiples of 32;  max_keypoints, min_score
        ->  keypoints (1, n, 2) from -1 to 1 (centres of the first and the last pixel), descriptors (1, n, d), scores (1, n)
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper
from onnx_graph import Graph, Weights, state_dict

_BN_EPSILON = 1e-5
"""Added to the variance by batch normalisation; PyTorch's default."""
_NMS_RADIUS = 2
"""Keypoints are maxima of the score within this many pixels in x and y (section III.C)."""
_TEMPERATURE = 0.1
"""Of the softmax that places a keypoint within its 5 x 5 patch of scores (DKD, equation 6)."""


def main() -> None:
    """Read the weights named on the command line, and write the model."""
    source = Path(sys.argv[1])
    target = Path(sys.argv[2])
    onnx.save(aliked(state_dict(source)), str(target))


def aliked(weights: Weights) -> Any:
    """The model of a state dict."""
    graph = Graph()
    features, score_map = _maps(graph, weights)
    places, keypoints, scores = _keypoints(graph, score_map)
    descriptors = _descriptors(graph, weights, features, places)
    return _model(graph, {"keypoints": keypoints, "descriptors": descriptors, "scores": scores})


def _maps(graph: Graph, weights: Weights) -> tuple[str, str]:
    """The feature map (1, d, h, w), of unit length in each pixel, and the score map (1, 1, h, w), 0 to 1."""

    def normalized(x: str, name: str) -> str:
        values = [graph.constant(weights[f"{name}.{part}"]) for part in ("weight", "bias", "running_mean", "running_var")]
        return graph.add("BatchNormalization", x, *values, epsilon=_BN_EPSILON)

    def convolution(x: str, name: str) -> str:
        kernel = weights[f"{name}.weight"]
        inputs = [x, graph.constant(kernel)]
        if f"{name}.bias" in weights:
            inputs.append(graph.constant(weights[f"{name}.bias"]))
        return graph.add("Conv", *inputs, pads=[kernel.shape[-1] // 2] * 4)

    def deformable(x: str, name: str) -> str:
        # Offsets are limited to a quarter of the longer side, as in training.
        shape = graph.add("Shape", x, start=2)
        longer = graph.add("Cast", graph.add("ReduceMax", shape, keepdims=0), to=TensorProto.FLOAT)
        limit = graph.add("Mul", longer, graph.constant(0.25))
        offsets = graph.add("Clip", convolution(x, f"{name}.offset_conv"), graph.add("Neg", limit), limit)
        kernel = graph.constant(weights[f"{name}.regular_conv.weight"])
        return graph.add("DeformConv", x, kernel, offsets, kernel_shape=[3, 3], pads=[1, 1, 1, 1])

    def block(x: str, name: str) -> str:
        layer = deformable if f"{name}.conv1.offset_conv.weight" in weights else convolution
        inner = graph.add("Selu", normalized(layer(x, f"{name}.conv1"), f"{name}.bn1"))
        inner = normalized(layer(inner, f"{name}.conv2"), f"{name}.bn2")
        if f"{name}.downsample.weight" in weights:
            inner = graph.add("Add", inner, convolution(x, f"{name}.downsample"))
        return graph.add("Selu", inner)

    # 1. The encoder (section III.A): four blocks at 1, 1/2, 1/8 and 1/32 of the size.
    levels = [block("image", "block1")]
    for number, factor in ((2, 2), (3, 4), (4, 4)):
        pooled = graph.add("AveragePool", levels[-1], kernel_shape=[factor, factor], strides=[factor, factor])
        levels.append(block(pooled, f"block{number}"))

    # 2. Feature aggregation: each level at full size, all as channels of one map.
    full_size = graph.add("Shape", "image", start=2)
    aggregated = []
    for number, level in enumerate(levels, 1):
        reduced = graph.add("Selu", convolution(level, f"conv{number}"))
        if number > 1:
            target = graph.add("Concat", graph.add("Shape", reduced, start=0, end=2), full_size, axis=0)
            reduced = graph.add("Resize", reduced, "", "", target, mode="linear", coordinate_transformation_mode="align_corners")
        aggregated.append(reduced)
    features = graph.add("Concat", *aggregated, axis=1)

    # 3. The score head.
    score = features
    for number in (0, 2, 4):
        score = graph.add("Selu", convolution(score, f"score_head.{number}"))
    score_map = graph.add("Sigmoid", convolution(score, "score_head.6"))
    return graph.add("LpNormalization", features, axis=1, p=2), score_map


def _keypoints(graph: Graph, score_map: str) -> tuple[str, str, str]:
    """Differentiable keypoint detection (section III.C).

    Returns
    -------
    Keypoints (n, 2) in pixels of the image, the same (1, n, 2) from -1 to 1, and their scores (1, n).
    """
    side = 2 * _NMS_RADIUS + 1

    def highest_near(x: str) -> str:
        return graph.add("MaxPool", x, kernel_shape=[side, side], pads=[_NMS_RADIUS] * 4, strides=[1, 1])

    # 1. Local maxima; twice more, those that only a suppressed neighbour had beaten.
    zero = graph.constant(0)
    is_maximum = graph.add("Equal", score_map, highest_near(score_map))
    for _ in range(2):
        near_maximum = highest_near(graph.add("Cast", is_maximum, to=TensorProto.FLOAT))
        is_suppressed = graph.add("Greater", near_maximum, zero)
        others = graph.add("Where", is_suppressed, zero, score_map)
        is_new = graph.add("And", graph.add("Equal", others, highest_near(others)), graph.add("Not", is_suppressed))
        is_maximum = graph.add("Or", is_maximum, is_new)
    maxima = graph.add("Where", is_maximum, score_map, zero)

    # 2. None so near the border that its patch is cut off.
    border = _NMS_RADIUS
    inner = graph.add("Slice", maxima, graph.integers(border, border), graph.integers(-border, -border), graph.integers(2, 3))
    margins = graph.integers(0, 0, border, border, 0, 0, border, border)
    maxima = graph.add("Pad", inner, margins, zero)

    # 3. The best of those above the least score.
    flat = graph.add("Reshape", maxima, graph.integers(-1))
    above = graph.add("Cast", graph.add("Greater", flat, "min_score"), to=TensorProto.INT64)
    count = graph.add("Min", graph.add("ReduceSum", above, keepdims=0), "max_keypoints")
    top = graph.add("TopK", flat, graph.add("Reshape", count, graph.integers(1)), axis=0)
    rows = f"{top}_rows"
    graph.nodes[-1].output.append(rows)
    shape = graph.add("Shape", maxima, start=2)
    width = graph.add("Gather", shape, graph.constant(1, np.int64), axis=0)
    x = graph.add("Mod", rows, width)
    y = graph.add("Div", rows, width)
    axis1 = graph.integers(1)
    whole = graph.add("Concat", graph.add("Unsqueeze", x, axis1), graph.add("Unsqueeze", y, axis1), axis=1)

    # 4. Subpixel: the mean of the patch's places, weighted by a softmax of its scores.  One number per pixel and tap would take
    #    25 maps, so the patches are gathered.
    steps = np.arange(-_NMS_RADIUS, _NMS_RADIUS + 1)
    taps = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    at = graph.add("Add", graph.add("Unsqueeze", whole, axis1), graph.constant(taps, np.int64))
    at_x = graph.add("Gather", at, graph.constant(0, np.int64), axis=2)
    at_y = graph.add("Gather", at, graph.constant(1, np.int64), axis=2)
    flat_scores = graph.add("Reshape", score_map, graph.integers(-1))
    patch = graph.add("Gather", flat_scores, graph.add("Add", graph.add("Mul", at_y, width), at_x), axis=0)
    weight = graph.add("Softmax", graph.add("Mul", patch, graph.constant(1 / _TEMPERATURE)), axis=1)
    offset = graph.add("MatMul", weight, graph.constant(taps))
    places = graph.add("Add", graph.add("Cast", whole, to=TensorProto.FLOAT), offset)

    # 5. Scores there.
    keypoints = _from_minus_one(graph, places, shape)
    sampled = graph.add(
        "GridSample", score_map, graph.add("Unsqueeze", keypoints, graph.integers(0, 1)), mode="linear", align_corners=1
    )
    scores = graph.add("Reshape", sampled, graph.integers(1, -1))
    return places, graph.add("Unsqueeze", keypoints, graph.integers(0)), scores


def _from_minus_one(graph: Graph, places: str, shape: str) -> str:
    """Places (..., 2) in pixels as numbers from -1 to 1, the centres of the first and the last pixel; shape: (h, w)."""
    size = graph.add("Cast", graph.add("Gather", shape, graph.integers(1, 0), axis=0), to=TensorProto.FLOAT)
    last = graph.add("Sub", size, graph.constant(1))
    doubled = graph.add("Mul", places, graph.constant(2))
    return graph.add("Sub", graph.add("Div", doubled, last), graph.constant(1))


def _descriptors(graph: Graph, weights: Weights, features: str, places: str) -> str:
    """The sparse deformable descriptor head (section III.B): descriptors (1, n, d) at places (n, 2) in pixels."""
    axis0 = graph.integers(0)
    axis1 = graph.integers(1)
    shape = graph.add("Shape", features, start=2)
    channels, samples = weights["desc_head.sf_conv.weight"].shape[0], weights["desc_head.agg_weights"].shape[0]

    # 1. The 3 x 3 pixels around each keypoint give the places of its samples.
    whole = graph.add("Floor", places)
    steps = np.arange(-1, 2)
    taps = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    at = graph.add("Add", graph.add("Unsqueeze", whole, axis1), graph.constant(taps))
    grid = graph.add("Unsqueeze", _from_minus_one(graph, at, shape), axis0)
    around = graph.add("GridSample", features, grid, mode="nearest", align_corners=1)  # (1, d, n, 9)
    patches = graph.add("Reshape", graph.add("Transpose", around, perm=[2, 1, 3, 0]), graph.integers(-1, channels, 3, 3))
    first, second = (
        [graph.constant(weights[f"desc_head.offset_conv.{number}.{part}"]) for part in ("weight", "bias")] for number in (0, 2)
    )
    inner = graph.add("Selu", graph.add("Conv", patches, *first))
    planes = graph.add("Reshape", graph.add("Conv", inner, *second), graph.integers(-1, 2, samples))  # all x, then all y
    offsets = graph.add("Transpose", planes, perm=[0, 2, 1])
    longer = graph.add("Cast", graph.add("ReduceMax", shape, keepdims=0), to=TensorProto.FLOAT)
    limit = graph.add("Mul", longer, graph.constant(0.25))
    offsets = graph.add("Clip", offsets, graph.add("Neg", limit), limit)

    # 2. Samples of the feature map there, aggregated.
    sample_places = graph.add("Add", graph.add("Unsqueeze", places, axis1), offsets)
    grid = graph.add("Unsqueeze", _from_minus_one(graph, sample_places, shape), axis0)
    sampled = graph.add("GridSample", features, grid, mode="linear", align_corners=1)  # (1, d, n, samples)
    mixed = graph.add("Selu", graph.add("Conv", sampled, graph.constant(weights["desc_head.sf_conv.weight"])))
    rows = graph.add("Reshape", graph.add("Transpose", mixed, perm=[0, 2, 3, 1]), graph.integers(-1, samples * channels))
    aggregation = weights["desc_head.agg_weights"].reshape(samples * channels, channels)
    descriptors = graph.add("MatMul", rows, graph.constant(aggregation))
    return graph.add("Unsqueeze", graph.add("LpNormalization", descriptors, axis=1, p=2), axis0)


def _model(graph: Graph, outputs: Mapping[str, str]) -> Any:
    """The graph as a model of the published interface; outputs: the name of each in the graph."""
    graph.name_outputs(outputs)
    made = helper.make_graph(
        graph.nodes,
        "aliked",
        [
            helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, "height", "width"]),
            helper.make_tensor_value_info("max_keypoints", TensorProto.INT64, [1]),
            helper.make_tensor_value_info("min_score", TensorProto.FLOAT, [1]),
        ],
        [
            helper.make_tensor_value_info("keypoints", TensorProto.FLOAT, [1, "n", 2]),
            helper.make_tensor_value_info("descriptors", TensorProto.FLOAT, [1, "n", "d"]),
            helper.make_tensor_value_info("scores", TensorProto.FLOAT, [1, "n"]),
        ],
        graph.constants,
    )
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 20)], ir_version=9)
    onnx.checker.check_model(model)
    return model


if __name__ == "__main__":
    main()
