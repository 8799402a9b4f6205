"""Samples in one cell are merged into one, whatever the order of the views."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fusion import voxels
from wbflow_stages.fusion.voxels import Samples, VoxelGrid


def samples(points: np.ndarray, weight: float = 1.0, footprint: float = 0.01) -> Samples:
    n = len(points)
    one = np.ones(n, np.float32)
    up = np.tile(np.array([0, 0, 1], np.float32), (n, 1))
    colors = np.full((n, 3), 100, np.float32)
    return Samples(points, up, colors, weight * one, 0.5 * one, 2 * one, footprint * one, one / weight)


def merged(*parts: Samples, edge: float = 0.1) -> Samples:
    grid = VoxelGrid(edge, np.zeros(3))
    for part in parts:
        grid.add(grid.sums_of(part))
    found = list(grid.merged())
    return Samples(*(np.concatenate([getattr(part, name) for part in found]) for name in Samples._fields))


def test_points_of_one_cell_become_their_weighted_mean() -> None:
    heavy, light = np.array([[0.52, 0.51, 0.53]]), np.array([[0.56, 0.55, 0.57]])
    found = merged(samples(heavy, 3.0), samples(light, 1.0))
    assert found.points == pytest.approx(0.75 * heavy + 0.25 * light, abs=1e-6)
    assert found.weight == pytest.approx([2.0]) and found.colors == pytest.approx(np.full((1, 3), 100))


def test_the_order_of_the_views_does_not_change_the_merged_points() -> None:
    rng = np.random.default_rng(0)
    one, two = (samples(rng.uniform(-1, 1, (500, 3))) for _ in range(2))
    there, back = merged(one, two), merged(two, one)
    assert there.points == pytest.approx(back.points, abs=1e-5)


def test_merging_in_blocks_equals_merging_in_one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    scattered = samples(rng.uniform(-1, 1, (3000, 3)))
    coarse = samples(rng.uniform(-1, 1, (300, 3)), footprint=0.25)
    whole = merged(scattered, coarse)
    monkeypatch.setattr(voxels, "_BLOCK", 7)
    pieces = merged(scattered, coarse)
    for name, values in whole._asdict().items():
        assert np.array_equal(values, getattr(pieces, name)), name


def test_coarsely_seen_samples_are_merged_into_larger_cells() -> None:
    line = np.column_stack([np.arange(0.05, 1.6, 0.1), np.full((16, 2), 0.05)])
    assert len(merged(samples(line)).points) == 16
    assert len(merged(samples(line, footprint=0.45)).points) == 4
