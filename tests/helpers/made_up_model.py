"""A made-up matcher as an ONNX model: it matches the brightest pixels of two images by their brightness."""

from __future__ import annotations

import onnx
from onnx import TensorProto, helper

POINTS = 12


def two_pictures(width: int = 0, height: int = 0, channels: int = 1, **other: str) -> bytes:
    """A model image0, image1 -> kpts0, kpts1, matches0, mscores0.  Size 0 means any; other: new names for these, equally long."""
    nodes = [*_brightest("image0", "0"), *_brightest("image1", "1")]
    nodes += [
        helper.make_node("Transpose", ["value1"], ["across"], perm=[1, 0]),
        helper.make_node("Sub", ["value0", "across"], ["difference"]),
        helper.make_node("Abs", ["difference"], ["distance"]),
        helper.make_node("Neg", ["distance"], ["likeness"]),
        helper.make_node("ArgMax", ["likeness"], ["matches0"], axis=1, keepdims=0),
        helper.make_node("ReduceMax", ["likeness"], ["best"], axes=[1], keepdims=0),
        helper.make_node("Exp", ["best"], ["mscores0"]),
    ]
    sizes = [1, channels, height or "h", width or "w"]
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, sizes) for name in ("image0", "image1")]
    outputs = [helper.make_tensor_value_info(f"kpts{k}", TensorProto.FLOAT, [1, POINTS, 2]) for k in "01"]
    outputs.append(helper.make_tensor_value_info("matches0", TensorProto.INT64, [POINTS]))
    outputs.append(helper.make_tensor_value_info("mscores0", TensorProto.FLOAT, [POINTS]))
    weights = [
        helper.make_tensor("flat", TensorProto.INT64, [2], [1, -1]),
        helper.make_tensor("column", TensorProto.INT64, [2], [POINTS, 1]),
        helper.make_tensor("points", TensorProto.INT64, [1], [POINTS]),
        helper.make_tensor("w", TensorProto.FLOAT, [1], [float(width)]),
        helper.make_tensor("half", TensorProto.FLOAT, [1], [0.5]),
        helper.make_tensor("shape", TensorProto.INT64, [3], [1, POINTS, 2]),
    ]
    graph = helper.make_graph(nodes, "made up", inputs, outputs, weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    text: bytes = model.SerializeToString()
    for name, now in other.items():
        assert len(name) == len(now)
        text = text.replace(name.encode(), now.encode())
    return text


def _brightest(image: str, k: str) -> list[onnx.NodeProto]:
    """Nodes for the brightest pixels of a grey image: their values (n, 1), and their positions kpts (1, n, 2)."""
    node = helper.make_node
    return [
        node("Reshape", [image, "flat"], [f"pixels{k}"]),
        node("TopK", [f"pixels{k}", "points"], [f"top{k}", f"index{k}"], axis=1),
        node("Reshape", [f"top{k}", "column"], [f"value{k}"]),
        node("Cast", [f"index{k}"], [f"place{k}"], to=TensorProto.FLOAT),
        node("Reshape", [f"place{k}", "column"], [f"at{k}"]),
        node("Add", [f"at{k}", "half"], [f"middle{k}"]),
        node("Div", [f"middle{k}", "w"], [f"rows{k}"]),
        node("Floor", [f"rows{k}"], [f"y{k}"]),
        node("Mul", [f"y{k}", "w"], [f"before{k}"]),
        node("Sub", [f"at{k}", f"before{k}"], [f"x{k}"]),
        node("Concat", [f"x{k}", f"y{k}"], [f"xy{k}"], axis=1),
        node("Reshape", [f"xy{k}", "shape"], [f"kpts{k}"]),
    ]
