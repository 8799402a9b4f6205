"""Known distances between cameras give observed poses their scale, where nothing else does."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.contracts.observation_figures import ObservedCamera
from wbflow_stages.observed.distances import scaled_by_distances
from wbflow_stages.types import ObservedPoses, Placement, Survey


def poses(metric: bool = False) -> ObservedPoses:
    """Two cameras one unit apart, and a place between them."""
    placements = {
        "gate": Placement(np.eye(3), np.array([1.0, 0, 0]), 0.01, 0.1, metric),
        "roof": Placement(np.eye(3), np.array([2.0, 0, 0]), 0.02, 0.1, metric),
    }
    cameras = {"gate": ObservedCamera(9, 9, 0.2, sigma_m=0.01), "mast": ObservedCamera(1, reason="seen once")}
    return ObservedPoses(placements, track=np.array([[1.5, 2, 0]]), cameras=cameras, halves_m=0.03, metric=metric)


SURVEY = Survey(("mast", "gate", "roof"), distances=((1, 2, 12.0), (0, 1, 5.0)))


def test_a_distance_makes_observed_poses_metric() -> None:
    found = scaled_by_distances(poses(), {}, SURVEY)
    assert found.metric and found.scale == "known distances between cameras"
    gate, roof = (found.placements[name] for name in ("gate", "roof"))
    assert gate.C is not None and roof.C is not None
    assert np.linalg.norm(gate.C - roof.C) == pytest.approx(12)
    assert gate.metric and gate.sigma_m == pytest.approx(0.12) and gate.sigma_deg == 0.1
    assert found.track[0].tolist() == pytest.approx([18, 24, 0])
    assert found.halves_m == pytest.approx(0.36) and found.cameras["gate"].sigma_m == pytest.approx(0.12)


def test_a_stated_position_stays_where_it_is() -> None:
    stated = {"gate": Placement(C=np.array([1.0, 0, 0]))}
    found = scaled_by_distances(poses(), stated, SURVEY)
    gate, roof = (found.placements[name].C for name in ("gate", "roof"))
    assert gate is not None and roof is not None
    assert gate.tolist() == [1, 0, 0] and roof.tolist() == pytest.approx([13, 0, 0])


def test_poses_with_a_scale_and_cameras_without_a_distance_stay_as_they_are() -> None:
    metric = poses(metric=True)
    assert scaled_by_distances(metric, {}, SURVEY) is metric
    without = poses()
    assert scaled_by_distances(without, {}, Survey()) is without
