"""Estimates of which views share ground."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbflow_stages.overlap import estimate_overlap
from wbflow_stages.types import Features, Overlap, Placement, View

K = np.array([[800.0, 0, 511.5], [0, 800.0, 383.5], [0, 0, 1]])
VIEW = View(1024, 768, K)


def looking(position: npt.ArrayLike, target: npt.ArrayLike) -> Placement:
    """A camera at `position` that looks at `target`; z is up in the world."""
    forward = np.subtract(target, position) / np.linalg.norm(np.subtract(target, position))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return Placement(np.stack([right, np.cross(forward, right), forward]), np.asarray(position, float))


def ring(
    degrees: Sequence[float], radius: float = 10.0, scale: float = 1.0, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> dict[str, Placement]:
    """Cameras on a circle about the origin that look inward."""
    at = {f"{d}": np.array([radius * np.cos(np.radians(d)), radius * np.sin(np.radians(d)), 1.0]) for d in degrees}
    return {name: looking(scale * p + shift, np.asarray(shift) * 1.0) for name, p in at.items()}


def angle_and_share(overlap: Overlap, left: str, right: str) -> tuple[float, float]:
    row = np.flatnonzero((overlap.pairs == [overlap.cameras.index(left), overlap.cameras.index(right)]).all(axis=1))[0]
    return float(overlap.angle_deg[row]), float(overlap.shared[row])


def from_poses(placements: dict[str, Placement]) -> Overlap:
    return estimate_overlap(dict.fromkeys(placements, VIEW), placements, {})


def test_cameras_on_a_ring_see_the_middle_at_the_angle_between_them() -> None:
    overlap = from_poses(ring([0, 15, 40, 100]))
    assert overlap.source == "poses" and len(overlap.pairs) == 6
    for left, right, angle in (("0", "15", 15), ("15", "40", 25), ("0", "100", 100)):
        assert angle_and_share(overlap, left, right)[0] == pytest.approx(angle, rel=0.15)
    assert (
        angle_and_share(overlap, "0", "15")[1]
        > angle_and_share(overlap, "0", "40")[1]
        > angle_and_share(overlap, "0", "100")[1]
        > 0.05
    )


def test_a_camera_that_looks_away_shares_nothing() -> None:
    placements = ring([0, 15]) | {"away": looking([12.0, 0, 1], [30.0, 0, 1])}
    overlap = from_poses(placements)
    assert angle_and_share(overlap, "0", "15")[1] > 0.5
    assert angle_and_share(overlap, "0", "away")[1] < 0.02 and angle_and_share(overlap, "15", "away")[1] < 0.02


@settings(deadline=None)
@given(scale=st.floats(0.01, 100.0), shift=st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_overlap_does_not_depend_on_position_and_scale_of_the_world(scale: float, shift: tuple[float, float, float]) -> None:
    here, there = from_poses(ring([0, 20, 50])), from_poses(ring([0, 20, 50], scale=scale, shift=shift))
    assert np.allclose(here.angle_deg, there.angle_deg, atol=0.01)
    assert np.allclose(here.shared, there.shared, atol=0.02)


def test_parallel_cameras_share_less_if_they_are_farther_apart() -> None:
    placements = {f"{x}": looking([x, 0.0, 1.0], [x, 100.0, 1.0]) for x in (0, 1, 3)}
    overlap = from_poses(placements)
    assert angle_and_share(overlap, "0", "1")[1] > angle_and_share(overlap, "0", "3")[1] > 0
    assert 3 < angle_and_share(overlap, "0", "1")[0] < angle_and_share(overlap, "0", "3")[0]


def features(descriptors: np.ndarray) -> Features:
    n = len(descriptors)
    return Features(
        np.zeros((n, 2)),
        np.tile(np.eye(2), (n, 1, 1)),
        (descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)).astype(np.float32),
        np.ones(n, np.float32),
        np.zeros(n, np.uint8),
        View(1024, 768),
    )


def appearance(n: int, cameras: int, step: int) -> dict[str, Features]:
    """Each camera sees `n` points of a long row, `step` points further along than the camera before, with its own noise."""
    rng = np.random.default_rng(0)
    world = rng.normal(size=(n + cameras * step, 128))
    return {f"c{k}": features(world[k * step : k * step + n] + 0.3 * rng.normal(size=(n, 128))) for k in range(cameras)}


def test_without_poses_pairs_are_ranked_by_appearance() -> None:
    seen = appearance(500, 5, 150)
    overlap = estimate_overlap({name: View(1024, 768) for name in seen}, {}, seen)
    assert overlap.source == "appearance" and np.isnan(overlap.angle_deg).all()
    shared = [angle_and_share(overlap, "c0", f"c{k}")[1] for k in range(1, 5)]
    assert shared[0] == pytest.approx(350 / 500, abs=0.05) and shared[1] == pytest.approx(200 / 500, abs=0.05)
    assert shared[3] < 0.02  # nothing in common


def test_a_long_lens_overlaps_the_short_one_but_not_another_long_one() -> None:
    """With three times the focal length, it sees a ninth of the other image, and fine detail there is large here."""
    rng = np.random.default_rng(4)
    short, long = View(1536, 1024, K * [[1.5], [1.5], [1]]), View(512, 341, K * [[1.5], [1.5], [1]])
    size = 1.7 * rng.pareto(1.2, 8000) + 1.7  # of keypoints in the image of the short lens
    world = rng.normal(size=(8000, 128))

    def seen(rows: npt.NDArray[np.int64], times: float, view: View) -> Features:
        plain = features(world[rows] + 0.3 * rng.normal(size=(len(rows), 128)))
        return replace(plain, frames=plain.frames * (times * size[rows])[:, None, None], view=view)

    middle, elsewhere = np.arange(0, 900), np.arange(900, 1800)
    views = {"short": short, "long": long, "other": long}
    found = {"short": seen(np.arange(8000), 1.0, short), "long": seen(middle, 3.0, long), "other": seen(elsewhere, 3.0, long)}
    overlap = estimate_overlap(views, {}, found)
    assert angle_and_share(overlap, "short", "long")[1] > 0.5 and angle_and_share(overlap, "short", "other")[1] > 0.5
    assert angle_and_share(overlap, "long", "other")[1] < 0.05


def test_a_camera_without_a_pose_is_paired_by_appearance() -> None:
    seen = appearance(300, 3, 50)
    placements = {"c0": looking([10, 0, 1], [0, 0, 0]), "c1": looking([9, 3, 1], [0, 0, 0])}
    overlap = estimate_overlap(dict.fromkeys(seen, VIEW), placements, seen)
    assert overlap.source == "mixed" and len(overlap.pairs) == 3
    assert angle_and_share(overlap, "c0", "c1")[0] > 5
    angle, shared = angle_and_share(overlap, "c1", "c2")
    assert np.isnan(angle) and shared > 0.5


def test_without_poses_and_features_there_are_no_pairs() -> None:
    assert len(estimate_overlap({"a": View(1024, 768), "b": View(1024, 768)}, {}, {}).pairs) == 0


def test_estimating_the_overlap_of_a_pair_takes_milliseconds() -> None:
    seen = appearance(600, 12, 40)
    start = time.process_time()
    overlap = estimate_overlap({name: View(1024, 768) for name in seen}, {}, seen)
    assert (time.process_time() - start) / len(overlap.pairs) < 0.04  # a hundred cameras have 4950 pairs


def test_many_views_are_compared_selectively_without_missing_neighbours() -> None:
    """Sixty views along a row of points: each shares some with the five views before it and the five after it."""
    seen = appearance(120, 60, 20)
    views = {name: View(1024, 768) for name in seen}
    overlap = estimate_overlap(views, {}, seen, candidates=14)
    assert len(overlap.pairs) <= 60 * 14 < 60 * 59 // 2
    found = {(i, j): shared for (i, j), shared in zip(overlap.pairs.tolist(), overlap.shared, strict=True)}
    near = [(i, i + step) for step in (1, 2, 3) for i in range(60 - step)]
    assert all(found.get(pair, 0.0) > 0.2 for pair in near)
    few = estimate_overlap({name: views[name] for name in list(views)[:32]}, {}, seen)
    assert len(few.pairs) == 32 * 31 // 2


def test_overlap_of_many_posed_cameras_equals_that_of_few_without_empty_pairs() -> None:
    placements = ring(np.linspace(0, 351, 40).tolist()) | {"away": looking([0.0, 0, 500], [1.0, 0, 900])}
    many, few = from_poses(placements), from_poses({name: placements[name] for name in list(placements)[:6]})
    for left, right in few.pairs.tolist():
        angle, shared = angle_and_share(few, few.cameras[left], few.cameras[right])
        assert angle_and_share(many, many.cameras[left], many.cameras[right]) == pytest.approx((angle, shared), rel=0.1, abs=0.05)
    away = many.cameras.index("away")
    assert (many.pairs != away).all()
    assert (many.shared > 0).all()
    assert (np.diff(many.pairs @ [len(many.cameras), 1]) > 0).all(), "in the order of the site file"
