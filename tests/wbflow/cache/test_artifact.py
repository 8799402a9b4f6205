"""Artifacts are decoded exactly as they were encoded, equal objects give equal bytes, and damage is detected."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from wbflow.cache import artifact
from wbflow_stages.types import Camera, Frame, Poses, View

arrays = hnp.arrays(
    st.sampled_from([np.uint8, np.int16, np.float32, np.float64, np.bool_]), hnp.array_shapes(min_dims=1, max_dims=3, min_side=0)
)


@given(arrays, arrays, st.text(max_size=20))
def test_a_decoded_artifact_equals_what_was_encoded(image: np.ndarray, mask: np.ndarray, note: str) -> None:
    frame = Frame(image, mask, View(3, 2, np.eye(3), focal_known=False), notes=(note,))
    data = artifact.encode(frame)
    back = artifact.decode(data)
    for name in ("image", "mask"):
        ours, theirs = getattr(frame, name), getattr(back, name)
        assert ours.dtype == theirs.dtype
        assert ours.shape == theirs.shape
        assert ours.tobytes() == theirs.tobytes()
    assert (back.view.width, back.view.focal_known, back.notes) == (3, False, (note,))
    assert artifact.encode(back) == data


def poses(x: float) -> Poses:
    cameras = {"a": Camera(np.eye(3), np.eye(3), np.zeros(3), 4, 3), "b": Camera(np.eye(3), np.eye(3), np.array([x, 0, 0]), 4, 3)}
    return Poses(cameras, metric=True, source="calibration")


def test_digests_of_parts_of_a_mapping_change_only_with_their_entries() -> None:
    before, after = artifact.parts(poses(1.0)), artifact.parts(poses(2.0))
    assert before["cameras[a]"] == after["cameras[a]"]
    assert before["cameras[b]"] != after["cameras[b]"]
    assert before["cameras"] != after["cameras"]
    assert artifact.decode(artifact.encode(poses(1.0))).cameras["b"].C[0] == 1.0


def test_memory_order_and_byte_order_of_arrays_do_not_change_the_bytes() -> None:
    a = np.arange(12, dtype=np.float64).reshape(3, 4)
    assert artifact.encode(View(1, 1, a)) == artifact.encode(View(1, 1, np.asfortranarray(a)))
    assert artifact.encode(View(1, 1, a)) == artifact.encode(View(1, 1, a.astype(">f8")))


@pytest.mark.parametrize("cut", [0, 3, 20, -1])
def test_a_truncated_artifact_is_refused(cut: int) -> None:
    data = artifact.encode(View(1, 1, np.eye(3)))
    with pytest.raises(artifact.ArtifactError):
        artifact.decode(data[:cut])


def test_python_objects_are_refused() -> None:
    with pytest.raises(TypeError):
        artifact.encode(View(1, 1, np.array([object()])))
    with pytest.raises(TypeError):
        artifact.encode(View(1, 1, {1, 2}))  # type: ignore[arg-type]


def test_only_dataclasses_are_built_from_a_header() -> None:
    data = artifact.encode(View(1, 1)).replace(b"wbflow_stages.types.views:View", b"subprocess:Popen..............")
    with pytest.raises((artifact.ArtifactError, AttributeError)):
        artifact.decode(data)
