"""Even surfaces are put on planes fitted to their depths; other surfaces stay as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_scene import make_yard, true_depth
from tests.helpers.weak_wall import Relief, make_wall
from wbflow_stages.mvs import plane_prior as flats
from wbflow_stages.mvs.kernels import Support
from wbflow_stages.mvs.textureless import RegionPlane, planes_of_regions, textureless_regions
from wbflow_stages.refine import refine
from wbflow_stages.types import DepthMap, Float32s, Uint8s

SHAPE = (120, 200)
WALL = (40.0, 0.02, -0.01)  # at the middle, in pixels of a source, and its change per pixel in x and y
NOISE_PX = 0.8


def plane(at_middle: float, along_x: float, along_y: float) -> Float32s:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.asarray(at_middle + along_x * (x - SHAPE[1] / 2) + along_y * (y - SHAPE[0] / 2), dtype=np.float32)


def plaster() -> Uint8s:
    """A bright, nearly even wall with six richly textured windows."""
    rng = np.random.default_rng(0)
    image = rng.integers(198, 202, (*SHAPE, 3)).astype(np.uint8)
    for left in range(20, 200, 60):
        for top in (15, 70):
            image[top : top + 30, left : left + 25] = rng.integers(0, 120, (30, 25, 3))
    return image


def fitted_planes(image: Uint8s, depths: Float32s) -> list[RegionPlane]:
    regions = textureless_regions(image, np.ones(SHAPE, bool), 1)
    return planes_of_regions(regions, depths, 1)


def noisy(depths: Float32s, seed: int = 1) -> Float32s:
    return (depths + np.random.default_rng(seed).normal(0, NOISE_PX, SHAPE)).astype(np.float32)


def test_a_wall_plane_averages_noise_and_ignores_outliers() -> None:
    depths = noisy(plane(*WALL))
    rng = np.random.default_rng(2)
    far = rng.random(SHAPE) < 0.2
    depths[far] += rng.uniform(-30, 30, int(far.sum())).astype(np.float32)
    best = fitted_planes(plaster(), depths)[0]
    assert np.abs(best.plane - WALL) @ (1, 50, 30) < 0.2 * NOISE_PX
    assert 0.7 * NOISE_PX < best.spread < 1.4 * NOISE_PX


def test_a_wall_cut_into_pieces_by_pipes_is_one_plane() -> None:
    image = plaster()
    image[:, 65:67] = image[:, 130:132] = 90
    best = fitted_planes(image, noisy(plane(*WALL)))[0]
    assert len(best.regions) == 3


def test_an_adjacent_wall_at_another_depth_is_another_plane() -> None:
    image, depths = plaster(), plane(*WALL)
    image[:, 130:132] = 90
    depths[:, 131:] -= np.float32(5)
    planes = fitted_planes(image, noisy(depths))
    assert [len(each.regions) for each in planes] == [1, 1]
    assert sorted(np.round(each.plane[0] - WALL[0]) for each in planes) == [-5, 0]


def test_textured_pictures_have_no_even_regions() -> None:
    image = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    assert not fitted_planes(image, plane(*WALL))


def test_windows_are_not_part_of_the_region_of_the_plaster() -> None:
    image = plaster()
    inside = (image < 120).any(axis=2)
    regions = textureless_regions(image, np.ones(SHAPE, bool), 1)
    wall = regions[60, 5]
    assert wall > 0
    assert (regions[~inside] == wall).mean() > 0.95
    assert (regions[inside] == wall).mean() < 0.2  # rims one pixel wide


def test_ground_of_very_low_contrast_is_found_by_its_plane() -> None:
    """With 1/50 of the yard's contrast and noise of half a grey level, only 0.08 of the pixels are sure without planes."""
    yard, rng = make_yard((-24, -8, 8, 24), noise_px=0.5), np.random.default_rng(0)
    frames = {name: replace(frame, image=faint(frame.image, rng)) for name, frame in yard.frames.items()}
    name = list(yard.cameras)[1]
    start, camera = yard.depth(name), yard.cameras[name]
    assert isinstance(start, DepthMap)
    after = refine(frames[name], camera, start, frames, {n: c for n, c in yard.cameras.items() if n != name})
    assert isinstance(after, DepthMap)
    error = np.abs(after.depth / true_depth(camera) - 1)[after.sure]
    assert after.sure.mean() > 0.4
    assert np.median(error) < 0.003


@pytest.mark.parametrize(
    ("relief", "within"),
    [
        pytest.param(lambda x, z: 0.1 * np.sin(2 * np.pi * x), 0.97, id="waves of 10 cm"),
        pytest.param(lambda x, z: 1 - np.sqrt(np.maximum(4 - x * x, 0)) * (np.abs(x) < 2), 0.95, id="tank"),
    ],
)
def test_painted_surfaces_with_relief_are_not_flattened_to_planes(relief: Relief, within: float) -> None:
    """If depths alone decided where planes are used, only 0.42 of the waves would be within 5 cm."""
    wall = make_wall(relief)
    others = {name: camera for name, camera in wall.cameras.items() if name != wall.name}
    after = refine(wall.frames[wall.name], wall.cameras[wall.name], wall.start(), wall.frames, others)
    assert isinstance(after, DepthMap)
    assert after.sure.mean() > 0.9
    assert (np.abs(after.depth - wall.truth)[after.sure] < 0.05).mean() > within


@pytest.mark.parametrize(("moves", "noisy"), [(1.0, True), (0.3, False)], ids=["far source", "near source"])
def test_scatter_is_measured_in_pixels_of_the_source_that_sees_it(moves: float, noisy: bool) -> None:
    """Depths that scatter by 0.8 px of the median source are noisy, unless their source has only 0.3 of its parallax."""
    scale, ones = np.float32(5000), np.ones(SHAPE, np.float32)
    laid = flats._Laid(plane(*WALL)[None].repeat(3, 0), ones, np.ones(SHAPE, bool), NOISE_PX * ones)
    support = Support(ones, ones, np.ones(SHAPE, np.uint32), (moves * scale) ** 2 * ones)
    assert (flats._noisy(laid, support, scale, 1) == noisy).all()


def test_a_region_of_random_depths_is_doubted_but_not_the_wall_around_it() -> None:
    rng = np.random.default_rng(0)
    usable = np.ones(SHAPE, bool)
    usable[:, [69, 70, 71, 110, 111, 112]] = False
    depths = noisy(plane(*WALL))
    depths[:, 72:110] += rng.uniform(-12, 12, (SHAPE[0], 38)).astype(np.float32)
    regions = textureless_regions(np.full((*SHAPE, 3), 200, np.uint8), usable, 1)
    doubted = flats._doubted(regions, planes_of_regions(regions, depths, 1))
    assert doubted[:, 73:109].all()
    assert not doubted[:, :69].any()
    assert not doubted[:, 113:].any()


def faint(image: Uint8s, rng: np.random.Generator) -> Uint8s:
    return np.round(200 + 0.02 * (image.astype(np.float64) - 128) + rng.normal(0, 0.5, image.shape)).astype(np.uint8)
