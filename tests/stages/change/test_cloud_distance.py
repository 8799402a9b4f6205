"""Distances between clouds have the right size and sign, and a level of detection with the stated error rate."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wbflow_stages.change.cloud_distance import Distances, MeasuredCloud, cloud_distances
from wbflow_stages.types import Float64s

SIGMA, RADIUS, REACH = 0.01, 0.12, 1.0


def surface(seed: int, n: int = 40_000, step: float = 0.0) -> MeasuredCloud:
    """Hilly ground of 10 x 10 m with noise; raised by a step where x > 6."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 10, (n, 2))
    z = 0.3 * np.sin(xy[:, 0]) * np.cos(0.7 * xy[:, 1]) + step * (xy[:, 0] > 6)
    X = np.column_stack([xy, z])
    return MeasuredCloud(X + rng.normal(0, SIGMA, (n, 1)) * normals_at(X), np.full(n, SIGMA))


def normals_at(X: Float64s) -> Float64s:
    slope_x = 0.3 * np.cos(X[:, 0]) * np.cos(0.7 * X[:, 1])
    slope_y = -0.21 * np.sin(X[:, 0]) * np.sin(0.7 * X[:, 1])
    n = np.column_stack([-slope_x, -slope_y, np.ones(len(X))])
    return np.asarray(n / np.linalg.norm(n, axis=1, keepdims=True), np.float64)


def core_points() -> Float64s:
    x, y = np.meshgrid(np.arange(0.5, 9.6, 0.3), np.arange(0.5, 9.6, 0.3))
    flat = np.column_stack([x.ravel(), y.ravel()])
    return np.column_stack([flat, 0.3 * np.sin(flat[:, 0]) * np.cos(0.7 * flat[:, 1])])


def measured(first: MeasuredCloud, second: MeasuredCloud, registration: float = 0.0) -> Distances:
    core = core_points()
    limits = {"radius": RADIUS, "reach": REACH, "registration": registration}
    return cloud_distances(core, normals_at(core), first, second, **limits)  # type: ignore[arg-type]


def test_a_step_is_measured_and_unchanged_points_stay_below_the_detection_level() -> None:
    found = measured(surface(0), surface(1, step=0.1))
    raised, level = core_points()[:, 0] > 6.2, core_points()[:, 0] < 5.8
    steep = normals_at(core_points())[:, 2]
    assert np.median(found.distance[raised] / steep[raised]) == pytest.approx(0.1, abs=0.003)
    assert (np.abs(found.distance[raised]) > found.detectable[raised]).mean() > 0.99
    # at 95 % confidence, one in twenty unchanged points exceeds the level
    assert (np.abs(found.distance[level]) > found.detectable[level]).mean() == pytest.approx(0.05, abs=0.03)


def test_registration_uncertainty_makes_small_changes_undetectable() -> None:
    found = measured(surface(0), surface(1, step=0.02), registration=0.05)
    assert (found.detectable > 0.09).all()
    assert not (np.abs(found.distance) > found.detectable).any()


def test_distance_is_unknown_where_one_cloud_has_too_few_points() -> None:
    far = MeasuredCloud(surface(1).points + np.array([0, 0, 5.0]), surface(1).sigma)
    found = measured(surface(0), far)
    assert np.isnan(found.distance).all()
    assert found.count1.min() > 0
    assert (found.count2 == 0).all()


def test_exchanging_two_clouds_changes_the_sign_of_the_distance() -> None:
    one, two = surface(0), surface(1, step=0.1)
    assert np.array_equal(measured(one, two).distance, -measured(two, one).distance)


@pytest.mark.skipif(importlib.util.find_spec("py4dgeo") is None, reason="py4dgeo (the extra oracle) is not installed")
def test_py4dgeo_gives_the_same_distances_within_its_uncertainty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # it writes a log to the working directory
    import py4dgeo

    first, second = surface(0), surface(1, step=0.1)
    core = core_points()

    class WithNormals(py4dgeo.M3C2):  # type: ignore[misc]
        def directions(self) -> Any:
            return normals_at(core)

    epochs = py4dgeo.Epoch(first.points), py4dgeo.Epoch(second.points)
    theirs = WithNormals(epochs=epochs, corepoints=core, cyl_radius=RADIUS, normal_radii=[0.5], max_distance=REACH)
    distances, uncertainties = theirs.run()
    found = measured(first, second)
    common = np.isfinite(distances) & np.isfinite(found.distance)
    assert common.mean() > 0.95
    agree = np.abs(distances[common] - found.distance[common]) <= uncertainties["lodetection"][common]
    assert agree.mean() > 0.99
    ratio = found.detectable[common] / uncertainties["lodetection"][common]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)  # py4dgeo takes the spread, we the points' sigma: equal here
