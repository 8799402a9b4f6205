"""Everything that a stage receives can be written to ordinary files and read back bit for bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.images import read_image
from wbflow_stages.exports.plain import read, write
from wbflow_stages.types import Camera, Capture, Features, Frame, Lens, View

RANDOM = np.random.default_rng(5)


def round_trip(value: Any, folder: Path) -> Any:
    return read(json.loads(json.dumps(write(value, folder, "value"))), folder)


@pytest.mark.parametrize(
    ("array", "form"),
    [
        (RANDOM.integers(0, 256, (40, 50, 3), np.uint8), ".png"),
        (RANDOM.integers(0, 2, (40, 50)).astype(bool), ".png"),
        (RANDOM.integers(0, 65536, (40, 50), np.uint16), ".png"),
        (RANDOM.standard_normal((90, 2)) * 1e-300, ".csv"),
        (np.where(RANDOM.random((90, 3)) < 0.2, np.nan, RANDOM.standard_normal((90, 3))).astype(np.float32), ".csv"),
        (RANDOM.integers(-9, 9, 300), ".csv"),
        (RANDOM.standard_normal((90, 128)).astype(np.float32), ".npy"),
        (RANDOM.integers(-9, 9, (40, 50), np.int16), ".npy"),
        (np.array([0.1, np.inf, 1e300]), ""),
        (np.zeros((0, 4), np.float32), ""),
    ],
)
def test_arrays_are_written_in_the_expected_format_and_read_back_bit_for_bit(array: Any, form: str, tmp_path: Path) -> None:
    again = round_trip(array, tmp_path)
    assert again.dtype == array.dtype
    assert again.shape == array.shape
    assert again.tobytes() == array.tobytes()
    assert [path.suffix for path in tmp_path.iterdir()] == ([form] if form else [])


def test_a_frame_is_written_as_an_ordinary_colour_image(tmp_path: Path) -> None:
    red = np.zeros((30, 40, 3), np.uint8)
    red[..., 0] = 255
    frame = round_trip(Frame(red, np.ones((30, 40), bool), View(40, 30, np.eye(3)), notes=("a note",)), tmp_path)
    assert read_image(tmp_path / "value.image.png")[0, 0].tolist() == [0, 0, 255], "OpenCV says blue first"
    assert (frame.image == red).all()
    assert frame.notes == ("a note",)
    assert frame.view.width == 40


def test_a_capture_is_written_as_the_original_file(tmp_path: Path) -> None:
    data = RANDOM.integers(0, 256, 5000, np.uint8)
    (again,) = round_trip([Capture("gate/2026-11-20.jpg", data)], tmp_path)
    assert (tmp_path / "value.0.2026-11-20.jpg").read_bytes() == data.tobytes()
    assert (again.name, again.data.tobytes()) == ("gate/2026-11-20.jpg", data.tobytes())


def test_mappings_keep_their_order_and_their_keys_of_pairs(tmp_path: Path) -> None:
    cameras = {("gate", "roof"): Camera(np.eye(3), np.eye(3), np.zeros(3), 8, 6), ("a", "b"): Lens(hfov_deg=70.0)}
    again = round_trip(cameras, tmp_path)
    assert list(again) == list(cameras)
    assert ("gate", "roof") in again
    assert again["a", "b"].hfov_deg == 70.0
    assert again["gate", "roof"].radial == (0.0, 0.0)


def test_keypoints_are_written_as_a_csv_table(tmp_path: Path) -> None:
    n = 100
    xy, scores = RANDOM.random((n, 2)), RANDOM.random(n).astype(np.float32)
    descriptors = RANDOM.random((n, 128)).astype(np.float32)
    features = Features(xy, np.tile(np.eye(2), (n, 1, 1)), descriptors, scores, np.zeros(n, np.uint8), View(8, 6))
    again = round_trip(features, tmp_path)
    assert np.array_equal(np.loadtxt(tmp_path / "value.xy.csv", delimiter=","), xy)
    assert again.descriptors.tobytes() == descriptors.tobytes()
