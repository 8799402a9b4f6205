"""Dataclasses of arrays have a short `repr`."""

from __future__ import annotations

import numpy as np

from wbflow_stages.types import Camera, Disparity, Features, Matches, Poses, View


def test_repr_shows_arrays_by_type_and_shape() -> None:
    empty = np.zeros((20, 30), np.int16)
    shown = repr(Disparity(empty, empty, empty.astype(np.uint8), empty.astype(np.uint8), -12, 1 / 3))
    assert shown == (
        "Disparity(left=int16 (20, 30), right=int16 (20, 30), confidence_left=uint8 (20, 30), confidence_right=uint8 (20, 30), "
        "offset_px=-12, density=0.333333)"
    )


def test_repr_omits_defaults_and_internal_fields() -> None:
    x, view = np.zeros((5, 2)), View(640, 480)
    shown = repr(Matches(x, x, None, None, np.ones(5, np.float32), None, view, view, "mutual", searched=(x, x)))
    assert "matcher='mutual'" in shown and "tilted" not in shown and "searched" not in shown and "i1=None" in shown


def test_repr_of_long_mappings_and_large_arrays_is_short() -> None:
    cameras = {f"c{k}": Camera(np.eye(3), np.eye(3), np.zeros(3), 640, 480) for k in range(300)}
    shown = repr(Poses(cameras, metric=True, source="solved"))
    assert "... 294 more" in shown and len(shown) < 1500
    n = 10_000
    none, descriptors = np.zeros(n, np.float32), np.zeros((n, 128), np.float32)
    features = Features(np.zeros((n, 2)), np.zeros((n, 2, 2)), descriptors, none, none.astype(np.uint8), View(640, 480))
    assert len(repr(features)) < 400
