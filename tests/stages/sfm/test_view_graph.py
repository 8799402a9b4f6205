"""Focal lengths of cameras with unknown lenses, as the pairs of the whole site vote for them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from tests.helpers.exact_pairs import HEIGHT, WIDTH, look, pair_geometry
from wbflow_stages.core.cameras import project
from wbflow_stages.sfm.view_graph import guess_lenses
from wbflow_stages.types import View

TOLERANCE = 0.03
"""Largest relative error of a focal length: those that are tried lie 2 % apart."""
CALIBRATED = 3
"""Number of cameras whose lens is known, which stand before the others."""


def guessed_focals(focals: list[float]) -> tuple[list[float], list[int]]:
    """Guessed focal lengths (pixels) of cameras that really have these ones, and the number of the lens of each.

    All see the same points as some calibrated cameras do; the pairs of all are exact.
    """
    rng = np.random.default_rng(1)
    X = rng.uniform([-2.5, -1.5, -1.5], [2.5, 1.5, 1.5], (300, 3))
    cameras = {}
    views = {}
    for k, focal in enumerate([1000.0] * CALIBRATED + focals):
        angle = np.radians(12.0) * k
        K = np.array([[focal, 0, (WIDTH - 1) / 2], [0, focal, (HEIGHT - 1) / 2], [0, 0, 1]])
        C = 12.0 * np.array([np.sin(angle), -np.cos(angle), 0.0]) + rng.uniform(-0.3, 0.3, 3) + [0, 0, 1.5 * (k % 2)]
        # axes that meet in a point would leave the focal lengths open
        cameras[str(k)] = look(K, C, rng.uniform(-0.8, 0.8, 3))
        views[str(k)] = View(WIDTH, HEIGHT, K, True) if k < CALIBRATED else View(WIDTH, HEIGHT, None, False)
    pixels = {name: project(camera, X)[0] for name, camera in cameras.items()}
    geometries = {}
    for left, right in combinations(cameras, 2):
        geometries[int(left), int(right)] = pair_geometry(cameras, views, pixels, (left, right), 0.0)
    lenses = guess_lenses(tuple(views.values()), geometries)
    unknown = range(CALIBRATED, len(cameras))
    return [float(lenses.K[k][0, 0]) for k in unknown], [lenses.solved[k] for k in unknown]


def test_cameras_with_equal_lenses_share_one() -> None:
    focals, lenses = guessed_focals([1300.0] * 3)
    assert lenses == [CALIBRATED] * 3
    assert focals == pytest.approx([1300.0] * 3, rel=TOLERANCE)


@pytest.mark.parametrize("true_focals", [[700.0, 1500.0, 1100.0], [1100.0, 700.0, 1500.0]])
def test_each_camera_has_its_own_focal_length_if_lenses_differ(true_focals: list[float]) -> None:
    focals, lenses = guessed_focals(true_focals)
    assert lenses == [CALIBRATED, CALIBRATED + 1, CALIBRATED + 2]
    assert focals == pytest.approx(true_focals, rel=TOLERANCE)
