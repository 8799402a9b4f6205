"""A small ALIKED with random weights, as an ONNX file of the published interface."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from wbflow_stages.types import Capture

aliked_onnx = pytest.importorskip("aliked_onnx", reason="the script needs the package onnx")


def untrained_weights() -> dict[str, Any]:
    """A small ALIKED with random weights: its keypoints are repeatable, if not good."""
    random = np.random.default_rng(1)
    sizes = (4, 4, 8, 8)
    weights: dict[str, Any] = {}

    def convolution(name: str, out: int, into: int, side: int, bias: bool = False) -> None:
        weights[f"{name}.weight"] = random.normal(0, 1 / np.sqrt(into * side * side), (out, into, side, side)).astype(np.float32)
        if bias:
            weights[f"{name}.bias"] = np.zeros(out, np.float32)

    def normalization(name: str, n: int) -> None:
        for part, value in (("weight", 1.0), ("bias", 0.0), ("running_mean", 0.0), ("running_var", 1.0)):
            weights[f"{name}.{part}"] = np.full(n, value, np.float32)

    for number, (into, out) in enumerate(zip((3, *sizes), sizes, strict=False), 1):
        for layer, channels in (("conv1", into), ("conv2", out)):
            name = f"block{number}.{layer}"
            if number > 2:
                convolution(f"{name}.offset_conv", 18, channels, 3, bias=True)
                convolution(f"{name}.regular_conv", out, channels, 3)
            else:
                convolution(name, out, channels, 3)
            normalization(f"block{number}.bn{layer[-1]}", out)
        if number > 1:
            convolution(f"block{number}.downsample", out, into, 1, bias=True)
        convolution(f"conv{number}", 8, out, 1)
    for number, (out, into, side) in {0: (8, 32, 1), 2: (4, 8, 3), 4: (4, 4, 3), 6: (1, 4, 3)}.items():
        convolution(f"score_head.{number}", out, into, side)
    weights["desc_head.agg_weights"] = random.normal(0, 0.1, (4, 32, 32)).astype(np.float32)
    convolution("desc_head.offset_conv.0", 8, 32, 3, bias=True)
    convolution("desc_head.offset_conv.2", 8, 8, 1, bias=True)
    convolution("desc_head.sf_conv", 32, 32, 1)
    return weights


def as_capture(weights: Mapping[str, Any], name: str = "small.onnx") -> Capture:
    return Capture(name, np.frombuffer(aliked_onnx.aliked(weights).SerializeToString(), dtype=np.uint8))
