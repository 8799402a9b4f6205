"""The disparities of pairs are fused into one cloud."""

from __future__ import annotations

import sys
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from tests.helpers.exact_scene import Yard, make_yard, true_depth
from wbflow_stages.core.parallel import THREADS
from wbflow_stages.depth import view_depth
from wbflow_stages.fuse import fuse
from wbflow_stages.fusion.pair_depth import inverse_depth_slopes
from wbflow_stages.fusion.planning import natural_voxel, subsample
from wbflow_stages.fusion.visibility import TrustedDepth, cross_check
from wbflow_stages.types import INVALID, Cloud, DepthMap, Float32s, Frame, Rejected, View


def fused(yard: Yard, **parameters: Any) -> Cloud:
    cloud = fuse(yard.frames, yard.cameras, yard.depths(), **parameters)
    assert isinstance(cloud, Cloud)
    return cloud


def test_exact_disparities_give_points_on_the_surfaces() -> None:
    yard = make_yard()
    cloud = fused(yard)
    assert len(cloud.points) > 8000
    assert set(cloud.sample_counts) == set(yard.cameras) and sum(cloud.sample_counts.values()) > len(cloud.points), (
        "by view, before they are merged"
    )
    distance = yard.distance(cloud.points)
    assert np.percentile(distance, 95) < 0.01  # at 9 m, where a pixel covers 3.4 cm and disparities are stored to 1/16 px
    assert np.median(distance) < 0.004


def test_normals_have_unit_length_face_the_cameras_and_fit_their_surface() -> None:
    yard = make_yard()
    cloud = fused(yard)
    assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1, atol=1e-5)
    toward = np.mean([camera.C for camera in yard.cameras.values()], axis=0) - cloud.points
    assert (np.einsum("ni,ni->n", toward, cloud.normals) > 0).mean() > 0.99
    ground = (np.abs(cloud.points[:, 2]) < 0.02) & (cloud.points[:, 1] < 3.0)
    assert np.median(cloud.normals[ground] @ [0, 0, 1]) > 0.995


@pytest.mark.parametrize("exposures", [(1.0, 1.0, 1.0), (1.0, 0.6, 1.1)])
def test_a_surface_has_one_colour_whatever_the_exposures(exposures: tuple[float, float, float]) -> None:
    """Colours are the true ones times one common factor; without balancing, different exposures would show as patches."""
    yard = make_yard(exposures=exposures)
    cloud = fused(yard)
    truth, seen = yard.colour(cloud.points), cloud.colors.astype(float)
    factor = np.median(seen / truth)
    assert min(exposures) <= factor + 0.01 and factor <= max(exposures)
    assert np.abs(seen - factor * truth).mean() < 4


def test_wrong_matches_are_outvoted() -> None:
    yard = make_yard((-30, -15, 0, 15, 30), noise_px=0.2, wrong=0.15)
    lenient, strict = fused(yard), fused(yard, min_consistent_pairs=3)
    share = [(yard.distance(cloud.points) > 0.15).mean() for cloud in (lenient, strict)]
    assert share[0] < 0.15 and share[1] < 0.01
    assert len(strict.points) > 0.5 * len(lenient.points)


def test_the_best_of_a_hundred_pairs_of_a_view_are_used_and_the_others_named() -> None:
    """Every fourth pair has disparities in only half of the image: all of these pairs are left out."""
    yard = make_yard((-20, 0), width=80)
    ((left, right), disparity), *_ = yard.disparities.items()
    values = disparity.left.copy()
    values[: len(values) // 2] = INVALID
    half = replace(disparity, left=values)
    partners = [f"p{k:02d}" for k in range(100)]
    disparities = {(left, name): half if k % 4 == 0 else disparity for k, name in enumerate(partners)}
    rectifications = dict.fromkeys(disparities, yard.rectifications[left, right])
    others = dict.fromkeys(partners, yard.cameras[right])
    depth = view_depth(yard.cameras[left], others, rectifications, disparities, noise_px=0.05)
    assert isinstance(depth, DepthMap)
    assert len(depth.partners) == 32 and {*depth.partners} | {*depth.left_out} == set(partners)
    assert set(partners[::4]) <= {*depth.left_out}
    one = yard.depth(left, noise_px=0.05)
    assert isinstance(one, DepthMap) and not one.left_out
    np.testing.assert_allclose(depth.depth, one.depth, rtol=1e-6)


def test_more_than_64_pairs_of_a_surface_are_counted() -> None:
    """Thirteen identical views, each with eight pairs of its own that all support the depth."""
    camera = make_yard((0,), width=16).cameras["cam+0"]
    flat, bits = np.full((12, 16), 5.0, np.float32), np.full((12, 16), 0xFF, np.uint32)
    level, sure = np.zeros_like(flat), np.ones(flat.shape, bool)
    names = [f"v{k}" for k in range(13)]
    maps = {name: DepthMap(flat, 0.01 * flat, level, level, bits, tuple(f"{name}-{k}" for k in range(8)), sure) for name in names}
    grey = Frame(np.zeros((12, 16, 3), np.uint8), sure, View(16, 12))
    trusted = {name: TrustedDepth(grey, depth, flat) for name, depth in maps.items()}
    check = cross_check(names[0], names[1:], dict.fromkeys(names, camera), trusted.__getitem__)
    assert (check.pairs == 13 * 8).all()
    assert (check.cameras == 13 * 9).all()
    few = cross_check(names[0], names[1:8], dict.fromkeys(names, camera), trusted.__getitem__)
    assert (few.pairs == 64).all()


def test_confidence_separates_good_from_bad_points_and_sigma_fits_the_error() -> None:
    yard = make_yard((-30, -15, 0, 15, 30), noise_px=0.3, wrong=0.1)
    cloud = fused(yard)
    distance = yard.distance(cloud.points)
    sure = cloud.confidence >= np.median(cloud.confidence)
    assert (distance[sure] > 0.1).mean() < 0.3 * (distance[~sure] > 0.1).mean()
    assert cloud.confidence.min() >= 0 and cloud.confidence.max() <= 1
    good = distance < 0.1
    assert 0.2 < np.median(distance[good]) / np.median(cloud.sigma_mm[good] / 1000) < 2
    assert cloud.views.max() <= 5 and cloud.views.min() >= 2


def voxel(yard: Yard) -> float:
    depths = yard.depths()
    return natural_voxel(yard.cameras, {name: subsample(yard.frames[name], depths[name]) for name in yard.cameras})


@pytest.mark.parametrize(("scale", "metres"), [(0.1, (0, 0, 0)), (100.0, (0, 0, 0)), (1.0, (565000.0, 5930000.0, 30.0))])
def test_scale_and_position_of_the_world_do_not_change_the_cloud(scale: float, metres: tuple[float, float, float]) -> None:
    edge = voxel(make_yard())
    x, y, z = (edge * round(away / edge) for away in metres)  # keeps voxel borders in place, so that as many points are merged
    yard = make_yard(scale=scale, shift=(x, y, z))
    here, there = fused(make_yard()), fused(yard)
    assert len(there.points) == pytest.approx(len(here.points), rel=0.001)
    assert np.median(there.sigma_mm) == pytest.approx(scale * np.median(here.sigma_mm), rel=0.001)
    assert np.percentile(yard.distance(there.points), 95) < 0.011


def test_the_number_of_threads_does_not_change_the_cloud(monkeypatch: pytest.MonkeyPatch) -> None:
    yard = make_yard((-30, -15, 0, 15, 30), noise_px=0.3, wrong=0.1)
    alone = fused(yard)
    monkeypatch.setenv(THREADS, "3")
    together = fused(yard)
    for field in fields(Cloud):
        one, other = getattr(alone, field.name), getattr(together, field.name)
        assert one.tobytes() == other.tobytes() if isinstance(one, np.ndarray) else one == other


def test_the_voxel_size_can_be_set() -> None:
    cloud = fused(make_yard(), voxel_m=0.2)
    assert len(np.unique(np.floor(cloud.points / 0.2), axis=0)) > 0.5 * len(cloud.points)
    assert len(cloud.points) < 5000


def test_masked_pixels_give_no_points() -> None:
    yard = make_yard()
    frames = {name: Frame(f.image, np.zeros_like(f.mask), f.view) for name, f in yard.frames.items()}
    assert isinstance(fuse(frames, yard.cameras, yard.depths()), Rejected)


def test_views_and_clouds_without_pairs_are_rejected_with_the_reason() -> None:
    yard = make_yard()
    name, *others = yard.cameras
    alone = view_depth(yard.cameras[name], {other: yard.cameras[other] for other in others}, {}, {})
    assert isinstance(alone, Rejected) and "no pair" in alone.reason
    answer = fuse(yard.frames, yard.cameras, {})
    assert isinstance(answer, Rejected) and "no view has depth" in answer.reason


def test_pairs_of_unsolved_cameras_are_ignored() -> None:
    yard = make_yard()
    known = replace(yard, cameras={name: yard.cameras[name] for name in list(yard.cameras)[:2]})
    cloud = fuse(yard.frames, known.cameras, known.depths())
    assert isinstance(cloud, Cloud) and cloud.views.max() == 2


def test_the_same_inputs_give_the_same_bytes() -> None:
    clouds = [fused(make_yard(noise_px=0.3)) for _ in range(2)]
    for name in ("points", "normals", "colors", "confidence", "views", "sigma_mm"):
        assert getattr(clouds[0], name).tobytes() == getattr(clouds[1], name).tobytes()


class CountingMapping(Mapping[str, DepthMap]):
    """A lazy mapping that counts the loads, and the most depth maps that were in memory at once."""

    def __init__(self, items: Mapping[str, DepthMap]) -> None:
        self.kept, self.most = dict(items), 0
        self.loaded: list[weakref.ref[Float32s]] = []

    def __getitem__(self, key: str) -> DepthMap:
        depth = replace(self.kept[key], depth=self.kept[key].depth.copy())
        self.loaded.append(weakref.ref(depth.depth))
        self.most = max(self.most, sum(array() is not None for array in self.loaded))
        return depth

    def __contains__(self, key: object) -> bool:
        return key in self.kept

    def __iter__(self) -> Iterator[str]:
        return iter(self.kept)

    def __len__(self) -> int:
        return len(self.kept)


def test_depth_maps_of_a_large_site_are_never_all_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[fuse.__module__], "_IN_MEMORY_PX", 0)  # as if the views had twelve million pixels
    yard = make_yard(tuple(range(-57, 58, 6)), width=120, max_angle=18)
    lazy = CountingMapping(yard.depths())
    assert isinstance(fuse(yard.frames, yard.cameras, lazy, check_views=4), Cloud)
    assert len(yard.cameras) == 20 and lazy.most <= 9
    assert len(lazy.loaded) < 4 * len(yard.cameras)


def exactly_refined(yard: Yard, support: int, sure: bool) -> dict[str, DepthMap]:
    """The true depth of every view, as if refined.  support: bit mask of the other views that show it."""
    refined = {}
    for name, camera in yard.cameras.items():
        depth = true_depth(camera).astype(np.float32)
        partners = tuple(other for other in yard.cameras if other != name)
        slopes = inverse_depth_slopes(depth, camera.K[0, 0])
        shown = np.full(depth.shape, support, np.uint32)
        refined[name] = DepthMap(depth, 0.001 * depth, *slopes, shown, partners, np.full(depth.shape, sure))
    return refined


def test_refined_depth_replaces_the_depth_of_the_pairs() -> None:
    yard = make_yard()
    cloud = fuse(yard.frames, yard.cameras, yard.depths(), exactly_refined(yard, 0b01, sure=True))
    assert isinstance(cloud, Cloud)
    assert np.percentile(yard.distance(cloud.points), 95) < 0.001


def test_pair_depth_is_kept_where_refinement_is_not_sure() -> None:
    yard = make_yard()
    refined = exactly_refined(yard, 0b01, sure=False)
    for name, view in refined.items():
        view.depth[...] *= np.float32(1.05) + 0 * yard.depths()[name].depth  # nan where pairs have no depth
    cloud, pairs = fuse(yard.frames, yard.cameras, yard.depths(), refined), fused(yard)
    assert isinstance(cloud, Cloud)
    assert (yard.distance(cloud.points) < 0.1).mean() > 0.95
    assert len(cloud.points) > 0.9 * len(pairs.points)


def test_refined_depth_of_untextured_areas_is_used_only_if_pairs_fill_them() -> None:
    """Refinement puts a plane on the sky as on a wall, but pairs have no depths in the sky."""
    yard, points = make_yard(), []
    for filled in (True, False):
        frames, depths = dict(yard.frames), dict(yard.depths())
        for name, frame in frames.items():
            image, depth = frame.image.copy(), depths[name].depth.copy()
            image[: len(image) // 3] = 210
            depth[: len(image) // 3] = true_depth(yard.cameras[name])[: len(image) // 3] if filled else np.nan
            frames[name], depths[name] = replace(frame, image=image), replace(depths[name], depth=depth)
        cloud = fuse(frames, yard.cameras, depths, exactly_refined(yard, 0b11, sure=True))
        assert isinstance(cloud, Cloud)
        points.append((cloud.colors > 200).all(axis=1).sum())
    assert points[0] > 1000 and points[1] < 0.1 * points[0]


def test_rough_depth_gives_as_dense_a_cloud_as_exact_depth() -> None:
    yard, points = make_yard(), []
    for sigma in (0.001, 0.008):
        refined = exactly_refined(yard, 0b11, sure=True)
        for view in refined.values():
            view.sigma[:] = sigma * view.depth
        cloud = fuse(yard.frames, yard.cameras, yard.depths(), refined, voxel_m=0.05)
        assert isinstance(cloud, Cloud)
        points.append(len(cloud.points))
    assert points[1] > 0.95 * points[0]


def test_requiring_more_confidence_leaves_fewer_but_more_reliable_points() -> None:
    yard = make_yard((-30, -15, 0, 15, 30), noise_px=0.3, wrong=0.15)
    all_of_them, sure = fused(yard), fused(yard, confidence=0.9)
    assert 0.3 * len(all_of_them.points) < len(sure.points) < len(all_of_them.points)
    wrong = [(yard.distance(cloud.points) > 0.15).mean() for cloud in (all_of_them, sure)]
    assert wrong[1] < 0.5 * wrong[0]
    assert sure.confidence.min() >= 0.9


def test_a_refined_depth_hidden_in_the_other_view_of_its_pair_is_removed() -> None:
    yard = make_yard((-10, 10))
    refined = exactly_refined(yard, 0b01, sure=True)
    wrong = next(iter(refined.values()))
    wrong.depth[:, 60:120] *= np.float32(1.1)
    cloud = fuse(yard.frames, yard.cameras, yard.depths(), refined)
    assert isinstance(cloud, Cloud) and (yard.distance(cloud.points) < 0.1).all()
    assert len(cloud.points) > 3000
