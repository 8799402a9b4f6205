"""A rival geometry of the matches is found where a scene repeats, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from tests.stages.twoview.test_pair_score import GOOD, VIEW, K, solid_pair
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.matching.candidates import view_pairs
from wbflow_stages.twoview.pair_score import pair_score
from wbflow_stages.twoview.rival_pose import RivalPose
from wbflow_stages.twoview.rival_search import find_rival
from wbflow_stages.twoview.robust import TwoView
from wbflow_stages.types import Features, Geometry, Matches

SHIFT = np.array([260.0, 0])


def repeated(seed: int) -> tuple[Features, Features]:
    """Two views of a solid; each image also shows a copy of it, shifted by `SHIFT` in both."""
    views = []
    for view in solid_pair(seed, lookalikes=False):
        xy = np.concatenate([view.xy * 0.6, view.xy * 0.6 + SHIFT])
        wobble = np.random.default_rng(seed).normal(0, 0.01, view.descriptors.shape).astype(np.float32)
        again = view.descriptors + wobble
        again /= np.linalg.norm(again, axis=1, keepdims=True)
        views.append(
            replace(
                view,
                xy=xy,
                descriptors=np.concatenate([view.descriptors, again]),
                frames=np.concatenate([view.frames, view.frames]),
                responses=np.concatenate([view.responses, view.responses]),
                tilts=np.concatenate([view.tilts, view.tilts]),
            )
        )
    return views[0], views[1]


def row_of_houses() -> tuple[Features, Features]:
    """Two views, 3 m apart, of four identical houses, each 5 m wide; keypoints are sorted by house, then by point."""
    rng = np.random.default_rng(5)
    house = np.column_stack([rng.uniform(0, 5, 80), rng.uniform(-3, 3, 80), rng.uniform(14, 17, 80)])
    X = np.concatenate([house + np.array([5 * k - 10, 0, 0]) for k in range(4)])
    descriptors = np.tile(rng.random((80, 128)).astype(np.float32) ** 3, (4, 1))
    views = []
    for x in (-1.5, 1.5):
        image = (X - [x, 0, 0]) @ K.T
        xy = image[:, :2] / image[:, 2:] + rng.normal(0, 0.3, (len(X), 2))
        seen = np.abs(descriptors + rng.normal(0, 0.02, descriptors.shape).astype(np.float32))
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        frames = np.repeat(np.eye(2)[None] * 4, len(X), axis=0)
        views.append(Features(xy, frames, seen, np.ones(len(X), np.float32), np.zeros(len(X), np.uint8), VIEW))
    return views[0], views[1]


def test_the_next_house_of_a_row_is_a_rival_although_it_fits_the_epipolar_lines() -> None:
    left, right = row_of_houses()
    same = np.arange(320, dtype=np.int32)
    F = np.linalg.inv(K).T @ np.array([[0, 0, 0], [0, 0, 3.0], [0, -3.0, 0]]) @ np.linalg.inv(K)
    accepted = TwoView(F / np.linalg.norm(F), np.ones(320, bool), np.eye(3), np.array([-1.0, 0, 0]))
    rival = find_rival(left, right, view_pairs(left, right, tilted=False), same, same, accepted)
    assert rival.inliers > 0.25 * len(same) and rival.turned_deg < 1
    assert rival.ambiguous(len(same))


def scene_with_two_copies(size_m: float) -> tuple[Features, Features]:
    """Two views, 3 m apart, of ground that does not repeat (240 points) and two copies of a thing (60 points each)."""
    rng = np.random.default_rng(8)
    ground = np.column_stack([rng.uniform(-9, 9, 240), rng.uniform(-5, 5, 240), rng.uniform(13, 20, 240)])
    thing = rng.uniform(-0.5, 0.5, (60, 3)) * [size_m, size_m, 1.0]
    X = np.concatenate([ground, thing + np.array([-5.0, 1.0, 15.0]), thing + np.array([4.0, -1.0, 17.0])])
    descriptors = rng.random((300, 128)).astype(np.float32) ** 3
    descriptors = np.concatenate([descriptors, descriptors[240:]])
    views = []
    for x in (-1.5, 1.5):
        image = (X - [x, 0, 0]) @ K.T
        seen = np.abs(descriptors + rng.normal(0, 0.02, descriptors.shape).astype(np.float32))
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        xy = image[:, :2] / image[:, 2:] + rng.normal(0, 0.3, (len(X), 2))
        frames = np.repeat(np.eye(2)[None] * 4, len(X), axis=0)
        views.append(Features(xy, frames, seen, np.ones(len(X), np.float32), np.zeros(len(X), np.uint8), VIEW))
    return views[0], views[1]


@pytest.mark.parametrize(("size_m", "rivals"), [(0.9, False), (2.5, True)])
def test_a_duplicated_thing_is_a_rival_only_if_it_is_large(size_m: float, rivals: bool) -> None:
    left, right = scene_with_two_copies(size_m)
    same = np.arange(360, dtype=np.int32)
    F = np.linalg.inv(K).T @ np.array([[0, 0, 0], [0, 0, 3.0], [0, -3.0, 0]]) @ np.linalg.inv(K)
    accepted = TwoView(F / np.linalg.norm(F), np.ones(360, bool), np.eye(3), np.array([-1.0, 0, 0]))
    rival = find_rival(left, right, view_pairs(left, right, tilted=False), same, same, accepted)
    assert rival.ambiguous(len(same)) == rivals
    assert (rival.inliers > 60) == rivals


def geometry_of_pair(left: Features, right: Features) -> Geometry:
    matches = match(left, right)
    assert isinstance(matches, Matches)
    geometry = estimate_geometry(matches, left, right, min_score=-30.0)
    assert isinstance(geometry, Geometry)
    return geometry


def test_a_repeated_scene_has_a_rival_and_a_unique_one_has_none() -> None:
    once, twice = geometry_of_pair(*solid_pair(3, lookalikes=False)), geometry_of_pair(*repeated(3))
    assert once.rival_inliers < 0.02 * once.inliers
    assert twice.rival_inliers > 0.2 * twice.inliers


@pytest.mark.parametrize(
    ("elsewhere", "turned_deg", "ambiguous"), [(0, 0.0, False), (90, 0.0, True), (40, 2.0, False), (40, 90.0, True)]
)
def test_a_rival_with_much_support_makes_a_pair_ambiguous(elsewhere: int, turned_deg: float, ambiguous: bool) -> None:
    rival = RivalPose(elsewhere, elsewhere, turned_deg)
    assert rival.ambiguous(GOOD.inliers) == ambiguous
    score = pair_score(replace(GOOD, angle_deg=20.0, rival=rival))
    assert score == 0 if ambiguous else score > 1


def test_more_rival_support_or_less_angle_lowers_the_score() -> None:
    good = replace(GOOD, angle_deg=20.0, rival=RivalPose())
    for worse in (replace(good, rival=RivalPose(inliers=60)), replace(good, angle_deg=2.0)):
        assert pair_score(worse) < pair_score(good)
