"""A made-up matcher of keypoints as an ONNX model with LightGlue's interface: each keypoint gets the most similar one."""

from __future__ import annotations

import onnx
from onnx import TensorProto, helper

FRAMES = ("scales0", "scales1", "oris0", "oris1")


def two_keypoint_sets(score: str = "likeness", *, of_sift: bool = False, length: int = 0, floats: bool = False) -> bytes:
    """A model kpts0 .. image_size1 -> matches0, mscores0.

    score: what mscores0 is: "likeness", the product of the descriptors; "x", the left keypoint as share of the picture's width;
    "scale", the left scale over 100; "angle", the left orientation as share of a turn, -0.5 to 0.5, plus 0.5; "element", the
    second number of the left descriptor.
    of_sift: it takes scales and orientations, too; length: of the descriptors, 0: any; floats: matches0 is float32.
    """
    node = helper.make_node
    nodes = [
        node("Transpose", ["desc1"], ["across"], perm=[0, 2, 1]),
        node("MatMul", ["desc0", "across"], ["products"]),
        node("ArgMax", ["products"], ["best"], axis=2, keepdims=0),
        node("Reshape", ["best", "flat"], ["rows"]),
        node("Cast", ["rows"], ["matches0"], to=TensorProto.FLOAT if floats else TensorProto.INT64),
    ]
    scores = {
        "likeness": [node("ReduceMax", ["products"], ["score"], axes=[2], keepdims=0)],
        "x": [
            node("Gather", ["kpts0", "first"], ["x"], axis=2),
            node("Gather", ["image_size0", "first"], ["width"], axis=1),
            node("Div", ["x", "width"], ["score"]),
        ],
        "element": [node("Gather", ["desc0", "second"], ["score"], axis=2)],
        "scale": [node("Div", ["scales0", "hundred"], ["score"])],
        "angle": [node("Div", ["oris0", "turn"], ["share"]), node("Add", ["share", "half"], ["score"])],
    }
    nodes += [*scores[score], node("Reshape", ["score", "flat"], ["mscores0"])]
    sizes: dict[str, list[int | str]] = {"kpts": [1, "n", 2], "desc": [1, "n", length or "d"], "image_size": [1, 2]}
    if of_sift:
        sizes |= {"scales": [1, "n"], "oris": [1, "n"]}
    inputs = []
    for name, shape in sizes.items():
        for side in "01":
            own = [f"n{side}" if size == "n" else size for size in shape]
            inputs.append(helper.make_tensor_value_info(name + side, TensorProto.FLOAT, own))
    outputs = [
        helper.make_tensor_value_info("matches0", TensorProto.FLOAT if floats else TensorProto.INT64, ["n0"]),
        helper.make_tensor_value_info("mscores0", TensorProto.FLOAT, ["n0"]),
    ]
    constants = [
        helper.make_tensor("flat", TensorProto.INT64, [1], [-1]),
        helper.make_tensor("first", TensorProto.INT64, [1], [0]),
        helper.make_tensor("second", TensorProto.INT64, [1], [1]),
        helper.make_tensor("hundred", TensorProto.FLOAT, [1], [100.0]),
        helper.make_tensor("turn", TensorProto.FLOAT, [1], [6.283185307]),
        helper.make_tensor("half", TensorProto.FLOAT, [1], [0.5]),
    ]
    graph = helper.make_graph(nodes, "made up", inputs, outputs, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    text: bytes = model.SerializeToString()
    return text
