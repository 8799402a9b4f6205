"""Poses that keypoints do not determine are adjusted to the ground, if it shows more than repeated stones."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from tests.helpers.exact_pairs import geometry_of
from tests.helpers.flat_ground import cameras, frame_of, texture
from wbflow_stages.core.cameras import project, relative_pose
from wbflow_stages.core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Camera, Float32s, Frame, Geometry, Pair, Placement, Poses, View

STONE = 25
"""Side of a stone in texels."""


def paving() -> Float32s:
    """Identical stones with stains that do not repeat."""
    stone = np.tile(texture(1)[:STONE, :STONE], (36, 36))
    return np.clip(0.5 * stone + 0.5 * texture(2), 1, 254).astype(np.float32)


def row_errors(seen: dict[str, Camera]) -> list[float]:
    """Median distance of ground points to the epipolar lines of these cameras, pixels, for each pair."""
    across = np.linspace(-2, 2, 9)
    X = np.column_stack([*(axis.ravel() for axis in np.meshgrid(across, across)), np.zeros(81)])
    x = {name: project(camera, X)[0] for name, camera in cameras().items()}
    return [
        float(np.median(symmetric_epipolar_distance(fundamental_from_cameras(seen[a], seen[b]), x[a], x[b])))
        for a, b in combinations(seen, 2)
    ]


def no_keypoints(frames: dict[str, Frame]) -> dict[Pair, Geometry]:
    found = {}
    for a, b in combinations(cameras(), 2):
        one, two = cameras()[a], cameras()[b]
        F, none = fundamental_from_cameras(one, two), np.zeros((1, 2))
        pose = relative_pose(one, two)
        geometry = geometry_of(F, none, none, np.zeros(1, int), frames[a].view, frames[b].view, *pose)
        found[a, b] = replace(geometry, good_probability=0.1)
    return found


def test_rough_poses_are_adjusted_to_paving_and_uncertain_without_its_frames() -> None:
    rng = np.random.default_rng(3)
    frames = {name: frame_of(camera, paving()) for name, camera in cameras().items()}
    views: dict[str, View] = {name: replace(frame.view, focal_known=True) for name, frame in frames.items()}
    known = {}
    for name, camera in cameras().items():
        R = rotation_matrix(np.radians(0.3) * rng.normal(size=3)) @ camera.R
        known[name] = Placement(R, camera.C + 0.05 * rng.normal(size=3), 0.05, 0.3)
    pairs = no_keypoints(frames)
    before = solve_poses(views, known, pairs)
    after = solve_poses(views, known, pairs, None, frames)
    assert isinstance(before, Poses) and isinstance(after, Poses)
    assert set(before.issues_of("uncertain")) == set(known) and not after.issues_of("uncertain")
    assert max(row_errors(dict(before.cameras))) > 0.8
    assert max(row_errors(dict(after.cameras))) < 0.15
    assert set(after.sources.values()) == {"refined"}
