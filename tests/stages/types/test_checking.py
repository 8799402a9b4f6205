"""What is wrong with a result, in words."""

from __future__ import annotations

import dataclasses
from typing import Any, get_type_hints

import numpy as np
import pytest

from wbflow_stages import types
from wbflow_stages.rectification.method import Homographies
from wbflow_stages.types import Camera, Cloud, DepthMap, Frame, Poses, View
from wbflow_stages.types.checking import SHAPES, check_result, fault_in

VIEW = View(6, 4, np.eye(3))
FRAME = Frame(np.zeros((4, 6, 3), np.uint8), np.ones((4, 6), np.bool_), VIEW)
MAP = np.ones((4, 6), np.float32)
DEPTH = DepthMap(MAP, MAP, MAP, MAP, MAP.astype(np.uint32), ("roof",), MAP > 0)
NONE = np.zeros(0, np.float32)
EMPTY = Cloud(np.zeros((0, 3)), NONE.reshape(0, 3), np.zeros((0, 3), np.uint8), NONE, NONE.astype(np.uint16), NONE)

POSES = Poses(cameras={}, unsolved={}, metric=True, source="calibration")


@pytest.mark.parametrize("name", [name for name in SHAPES if hasattr(types, name)])
def test_the_shape_of_every_array_is_declared(name: str) -> None:
    arrays = {field for field, hint in get_type_hints(getattr(types, name)).items() if "ndarray" in str(hint)}
    assert set(SHAPES[name]) == arrays


@pytest.mark.parametrize("result", [FRAME, DEPTH, EMPTY, VIEW, Homographies(np.eye(3), np.eye(3)), POSES])
def test_what_is_right_has_no_fault(result: object) -> None:
    assert fault_in(result) == ""


def test_unknown_depth_is_nan() -> None:
    assert fault_in(dataclasses.replace(DEPTH, depth=MAP * np.nan)) == ""


@pytest.mark.parametrize(
    ("result", "changed", "fault"),
    [
        (FRAME, {"image": np.zeros((4, 6, 3))}, "image is float64 (4, 6, 3); uint8 (h, w, 3) is needed"),
        (FRAME, {"image": np.zeros((4, 6), np.uint8)}, "image is uint8 (4, 6); uint8 (h, w, 3) is needed"),
        (FRAME, {"mask": np.ones((6, 4), np.bool_)}, "mask is bool (6, 4); bool (h, w) is needed, with h = 4"),
        (FRAME, {"view": View(6, 8)}, "image is uint8 (4, 6, 3); uint8 (h, w, 3) is needed, with h = 8"),
        (FRAME, {"view": View(6, 4, np.ones((2, 2)))}, "view.K is float64 (2, 2); float64 (3, 3) is needed"),
        (FRAME, {"view": None}, "view is None; View is needed"),
        (FRAME, {"noise": np.float32(1)}, "noise is float32; float or None is needed"),
        (DEPTH, {"sure": MAP}, "sure is float32 (4, 6); bool (h, w) is needed"),
        (DEPTH, {"partners": ["roof"]}, "partners is list; tuple is needed"),
        (EMPTY, {"points": np.zeros((1, 3))}, "normals is float32 (0, 3); float32 (n, 3) is needed, with n = 1"),
        (POSES, {"cameras": {"gate": Camera(np.eye(3), np.eye(3), np.zeros(2), 6, 4)}}, "cameras[gate].C is float64 (2,)"),
    ],
)  # fmt: skip
def test_a_fault_is_told_with_its_field(result: Any, changed: dict[str, object], fault: str) -> None:
    assert fault_in(dataclasses.replace(result, **changed)).startswith(fault)


def test_confidence_is_a_share() -> None:
    one = np.ones(1, np.float32)
    cloud = Cloud(np.zeros((1, 3)), np.ones((1, 3), np.float32), np.ones((1, 3), np.uint8), 70 * one, np.ones(1, np.uint16), one)
    with pytest.raises(TypeError, match="mine:fuse returned a wrong Cloud: confidence is 70 to 70; values from 0 to 1"):
        check_result(cloud, "mine:fuse", Cloud)
