"""Clouds as PLY files: reading returns what was written, whatever the coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wbflow.cache.ply import ply_bytes, read_ply
from wbflow_stages.io.clouds import cloud_columns
from wbflow_stages.types import Cloud


def some_cloud(origin: tuple[float, float, float]) -> Cloud:
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 20, (500, 3)) + origin
    flat = np.zeros((500, 3))
    return Cloud(
        points,
        flat.astype(np.float32),
        flat.astype(np.uint8),
        np.ones(500, np.float32),
        np.full(500, 2, np.uint16),
        np.full(500, 5.0, np.float32),
    )


@pytest.mark.parametrize(
    ("origin", "kind"), [((0.0, 0.0, 0.0), "float32"), ((565000.0, 5930000.0, 30.0), "float64")], ids=["local", "utm"]
)
def test_coordinates_are_exact_to_half_a_millimetre(tmp_path: Path, origin: tuple[float, float, float], kind: str) -> None:
    cloud = some_cloud(origin)
    (tmp_path / "cloud.ply").write_bytes(ply_bytes(cloud_columns(cloud)))
    table = read_ply(tmp_path / "cloud.ply")
    read = np.stack([table[name] for name in "xyz"], axis=1)
    assert read.dtype == kind  # single precision where it suffices: half the file size, and old viewers can read it
    assert np.abs(read - cloud.points).max() < 0.0005


def test_an_empty_cloud_can_be_written_and_read(tmp_path: Path) -> None:
    whole = some_cloud((0.0, 0.0, 0.0))
    empty = Cloud(*(getattr(whole, name)[:0] for name in ("points", "normals", "colors", "confidence", "views", "sigma_mm")))
    (tmp_path / "cloud.ply").write_bytes(ply_bytes(cloud_columns(empty)))
    assert len(read_ply(tmp_path / "cloud.ply")["x"]) == 0
