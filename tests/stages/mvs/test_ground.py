"""The ground plane is found from all views together, and maps its points exactly from one view to another."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.flat_ground import cameras, frame_of, texture
from wbflow_stages.core.cameras import backproject, project
from wbflow_stages.core.parallel import THREADS
from wbflow_stages.mvs.ground import find_ground, ground_homography, inverse_depth_line
from wbflow_stages.types import Float32s


def pictures(height: float, repeated: int = 0) -> dict[str, Float32s]:
    """Grey images of flat ground; repeated: side in texels of the tile that it repeats, 0 for none."""
    ground = texture()
    if repeated:
        tile = ground[:repeated, :repeated]
        ground = np.tile(tile, (ground.shape[0] // repeated + 1,) * 2)[: ground.shape[0], : ground.shape[1]]
    return {name: frame_of(camera, ground, height).image[..., 0].astype(np.float32) for name, camera in cameras().items()}


@pytest.mark.parametrize("height", [0.0, 0.7])
def test_flat_ground_is_found_to_a_centimetre(height: float) -> None:
    plane = find_ground(pictures(height), cameras())
    assert plane is not None
    assert plane[2] > 0.9999
    assert abs(-plane[3] - height) < 0.01


def test_the_number_of_threads_does_not_change_the_ground(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = pictures(0.0)
    alone = find_ground(seen, cameras())
    monkeypatch.setenv(THREADS, "2")
    together = find_ground(seen, cameras())
    assert alone is not None and together is not None
    assert alone.tobytes() == together.tobytes()


@pytest.mark.parametrize("tile", [20, 25, 40])
def test_ground_of_repeated_tiles_is_never_found_at_a_wrong_height(tile: int) -> None:
    plane = find_ground(pictures(0.0, repeated=tile), cameras())
    assert plane is None or abs(plane[3]) < 0.02


def test_views_without_a_common_plane_have_no_ground() -> None:
    noise = {name: 255 * np.random.default_rng(k).random((240, 320)).astype(np.float32) for k, name in enumerate(cameras())}
    assert find_ground(noise, cameras()) is None


def test_the_ground_homography_maps_ground_points_to_the_other_camera() -> None:
    one, two = list(cameras().values())[:2]
    X = np.array([[0.0, 0.0, 0.3], [1.0, -0.5, 0.3], [-1.2, 0.8, 0.3]])
    H = ground_homography(one, two, np.array([0.0, 0.0, 1.0, -0.3]))
    x1, x2 = project(one, X)[0], project(two, X)[0]
    mapped = np.column_stack([x1, np.ones(3)]) @ H.T
    assert (mapped[:, 2] > 0).all()
    np.testing.assert_allclose(mapped[:, :2] / mapped[:, 2:], x2, atol=1e-9)


def test_the_inverse_depth_of_the_ground_is_that_of_points_on_it() -> None:
    camera = cameras()["c0"]
    line = inverse_depth_line(camera, np.array([0.0, 0.0, 1.0, 0.0]))
    pixels = np.array([[20.0, 200.0], [160.0, 120.0], [300.0, 230.0]])
    X = backproject(camera, pixels, 1 / (np.column_stack([pixels, np.ones(3)]) @ line))
    np.testing.assert_allclose(X[:, 2], 0.0, atol=1e-9)
