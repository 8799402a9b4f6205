"""Triangulated points of tracks, and the part of the tracks that suffices while views are added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_pairs import look
from wbflow_stages.core.cameras import project
from wbflow_stages.sfm.tracks import FIELDS, Tracks, spread_tracks
from wbflow_stages.sfm.triangulation import residuals, triangulate

K = np.array([[800.0, 0, 399.5], [0, 800, 299.5], [0, 0, 1]])
CAMERAS = {view: look(K, np.array([2.0 * view - 3, -8, 0.3 * view]), np.zeros(3)) for view in range(4)}


def tracks_of(X: np.ndarray, views: tuple[int, ...] = (0, 1, 2, 3)) -> Tracks:
    """Tracks in which every view sees every point."""
    xy = np.stack([project(CAMERAS[view], X)[0] for view in views], axis=1).reshape(-1, 2)
    count, each = len(X), len(views)
    return Tracks(np.repeat(np.arange(count, dtype=np.int32), each), np.tile(np.array(views, np.int32), count), xy, count)


def some_points(count: int = 50) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.5, 1.5, (count, 3))


@pytest.mark.parametrize("views", [(0, 1), (0, 1, 2, 3)])
def test_points_are_triangulated_where_their_rays_meet(views: tuple[int, ...]) -> None:
    X = some_points()
    tracks = tracks_of(X, views)
    found = triangulate(CAMERAS, tracks, np.ones(len(tracks.track), bool), 1.0)
    assert np.allclose(found, X, atol=1e-9)
    assert np.abs(residuals(CAMERAS, tracks, found)).max() < 1e-8


def test_single_and_parallel_rays_give_no_point() -> None:
    tracks = tracks_of(some_points(5))
    assert np.isnan(triangulate(CAMERAS, tracks, tracks.view == 2, 1.0)).all()
    twins = dict.fromkeys(CAMERAS, CAMERAS[0])
    same = replace(tracks, xy=np.repeat(tracks.xy[::4], 4, axis=0))
    assert np.isnan(triangulate(twins, same, np.ones(len(same.track), bool), 1.0)).all()


def test_residuals_are_inf_without_a_camera_and_nan_behind_one() -> None:
    X = np.array([[0.0, 0.0, 0.0], [0.0, -20.0, 0.0]])
    tracks = tracks_of(X)
    some = {view: CAMERAS[view] for view in (0, 1)}
    found = residuals(some, tracks, X)
    assert np.isinf(found[tracks.view > 1]).all()
    assert np.isnan(found[(tracks.view < 2) & (tracks.track == 1)]).all()


def test_a_selection_of_the_tracks_still_covers_each_view() -> None:
    X = np.random.default_rng(0).uniform(-1.5, 1.5, (5000, 3))
    tracks = tracks_of(X)
    use = np.ones(len(tracks.track), bool)
    use[tracks.view > 1] = tracks.track[tracks.view > 1] % 2 == 0  # two views see only every other track
    part = spread_tracks(tracks, use, 3)
    assert part.sum() < 0.5 * len(X)
    low, high = np.minimum(tracks.xy.min(axis=0), 0), tracks.xy.max(axis=0)
    field = np.minimum(((tracks.xy - low) / (high - low) * FIELDS).astype(int), np.array(FIELDS) - 1)
    for view in CAMERAS:
        there, kept = np.zeros(FIELDS, int), np.zeros(FIELDS, int)
        mine = use & (tracks.view == view)
        np.add.at(there, tuple(field[mine].T), 1)
        np.add.at(kept, tuple(field[mine & part[tracks.track]].T), 1)
        assert (kept >= np.minimum(there, 3)).all()
    assert part[::2].sum() > 2 * part[1::2].sum()  # long tracks are preferred
