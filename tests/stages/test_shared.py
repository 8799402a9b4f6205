"""What posed cameras see in common."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wbflow_stages.shared import find_shared
from wbflow_stages.types import Camera, PairCheck, Poses

K = np.array([[400.0, 0, 319.5], [0, 400.0, 239.5], [0, 0, 1]])
CAMERAS = {f"c{k}": Camera(K, np.eye(3), np.array([k, 0.0, 0.0]), 640, 480) for k in range(4)}
PLACED = Poses(CAMERAS, metric=True, source="solved")


def pairs(poses: Poses) -> list[tuple[str, str]]:
    found = find_shared(poses)
    return [(found.cameras[i], found.cameras[j]) for i, j in found.pairs.tolist()]


def test_neighbours_share_more_than_cameras_far_apart() -> None:
    found = find_shared(PLACED)
    share = dict(zip(pairs(PLACED), found.shared.tolist(), strict=True))
    assert len(share) == 6
    assert share["c0", "c1"] > share["c0", "c3"] > 0
    assert found.angle_deg[0] < found.angle_deg[2]


def test_a_pair_that_contradicts_the_cameras_is_not_listed() -> None:
    checks = {"c0--c1": PairCheck(False, "no", "contradicts-cameras"), "c1--c2": PairCheck(True)}
    assert ("c0", "c1") not in pairs(replace(PLACED, pair_checks=checks))
    assert ("c1", "c2") in pairs(replace(PLACED, pair_checks=checks))


def test_cameras_in_different_components_share_nothing() -> None:
    apart = {name: replace(camera, component=k % 2) for k, (name, camera) in enumerate(CAMERAS.items())}
    assert pairs(replace(PLACED, cameras=apart)) == [("c0", "c2"), ("c1", "c3")]
    alone = {**CAMERAS, "c3": replace(CAMERAS["c3"], component=1)}
    assert pairs(replace(PLACED, cameras=alone)) == [("c0", "c1"), ("c0", "c2"), ("c1", "c2")]
