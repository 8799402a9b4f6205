"""The depth of one view is refined with all views around it, on a yard whose depth is known exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.helpers.exact_scene import Yard, make_yard, true_depth
from wbflow_stages.core.cameras import scaled_intrinsics
from wbflow_stages.fuse import fuse
from wbflow_stages.refine import refine
from wbflow_stages.types import INVALID, Camera, Cloud, DepthMap, Frame, Rejected


def refined(yard: Yard, name: str, **parameters: Any) -> DepthMap:
    answer = refine(*inputs(yard, name), **parameters)
    assert isinstance(answer, DepthMap)
    return answer


def inputs(yard: Yard, name: str) -> tuple[Frame, Camera, DepthMap, dict[str, Frame], dict[str, Camera]]:
    """Arguments of `refine` for a view: its frame, camera and depth from pairs, and the views around it."""
    around = [other for other in yard.cameras if other != name]
    depth = yard.depth(name)
    assert isinstance(depth, DepthMap)
    return yard.frames[name], yard.cameras[name], depth, {n: yard.frames[n] for n in around}, {n: yard.cameras[n] for n in around}


def errors(yard: Yard, name: str, depth: np.ndarray) -> np.ndarray:
    return np.asarray(np.abs(depth / true_depth(yard.cameras[name]) - 1))


def punched(yard: Yard, size: int = 12) -> Yard:
    """The same yard, with square holes in every disparity."""

    def holes(values: np.ndarray) -> np.ndarray:
        v, u = np.mgrid[0 : values.shape[0], 0 : values.shape[1]]
        return np.where((u // size % 3 == 0) & (v // size % 3 == 0), INVALID, values).astype(np.int16)

    punch = {p: replace(d, left=holes(d.left), right=holes(d.right)) for p, d in yard.disparities.items()}
    return replace(yard, disparities=punch)


@pytest.fixture(scope="module")
def noisy() -> Yard:
    return make_yard((-24, -8, 8, 24), noise_px=0.5)


def test_refinement_reduces_the_noise_of_the_pairs(noisy: Yard) -> None:
    name = list(noisy.cameras)[1]
    start = noisy.depths()[name]
    after = refined(noisy, name)
    both = np.isfinite(start.depth) & np.isfinite(after.depth)
    before_error, after_error = errors(noisy, name, start.depth)[both], errors(noisy, name, after.depth)[both]
    assert np.median(after_error) < 0.35 * np.median(before_error)
    assert both.sum() > 0.95 * np.isfinite(start.depth).sum()


def test_sigma_of_refined_depth_is_about_its_error(noisy: Yard) -> None:
    name = list(noisy.cameras)[1]
    after = refined(noisy, name)
    ratio = errors(noisy, name, after.depth) / (after.sigma / after.depth)
    assert 0.05 < np.nanmedian(ratio) < 1.5  # rendered images are free of noise


def test_holes_are_filled_from_their_borders() -> None:
    yard = punched(make_yard((-24, -8, 8, 24), noise_px=0.2))
    name = list(yard.cameras)[1]
    start = yard.depths()[name]
    after = refined(yard, name)
    filled = np.isfinite(after.depth) & ~np.isfinite(start.depth)
    assert filled.sum() > 0.4 * (~np.isfinite(start.depth)).sum()
    assert np.percentile(errors(yard, name, after.depth)[filled], 80) < 0.004


def test_filled_depth_that_only_one_other_view_shows_is_not_sure() -> None:
    rng, shares = np.random.default_rng(0), []
    for degrees in ((-8, 8), (-24, -8, 8, 24)):
        yard = punched(make_yard(degrees, noise_px=0.2))
        noise = {n: rng.normal(0, 8, f.image.shape) for n, f in yard.frames.items()}
        grainy = {n: replace(f, image=np.clip(f.image + noise[n], 0, 255).astype(np.uint8)) for n, f in yard.frames.items()}
        name = list(yard.cameras)[1]
        after = refined(replace(yard, frames=grainy), name)
        filled = np.isfinite(after.depth) & ~np.isfinite(yard.depths()[name].depth)
        assert after.sure[np.isfinite(after.depth) & ~filled].mean() > 0.7
        shares.append(float(after.sure[filled].mean()))
    assert shares[0] < 0.5 * shares[1]


def test_refined_slopes_are_those_of_the_surface(noisy: Yard) -> None:
    name = list(noisy.cameras)[1]
    camera, after = noisy.cameras[name], refined(noisy, name)
    q = 1 / true_depth(camera)
    truth = np.gradient(q, axis=0)
    smooth = np.isfinite(after.depth) & (np.abs(np.gradient(truth, axis=0)) < 1e-6)
    flat = 0.15 * np.median(np.abs(truth[smooth]))
    assert np.median(np.abs(after.slope_y - truth)[smooth]) < flat


def test_refined_depth_improves_the_cloud(noisy: Yard) -> None:
    depths = {name: refined(noisy, name) for name in noisy.cameras}
    plain = fuse(noisy.frames, noisy.cameras, noisy.depths(), voxel_m=0.04)
    better = fuse(noisy.frames, noisy.cameras, noisy.depths(), depths, voxel_m=0.04)
    assert isinstance(plain, Cloud) and isinstance(better, Cloud)
    assert np.median(noisy.distance(better.points)) < 0.7 * np.median(noisy.distance(plain.points))
    assert len(better.points) > 0.9 * len(plain.points)


def test_masked_pixels_stay_without_depth(noisy: Yard) -> None:
    name = next(iter(noisy.cameras))
    frame = noisy.frames[name]
    mask = frame.mask.copy()
    mask[:, :100] = False
    frames = noisy.frames | {name: Frame(frame.image, mask, frame.view)}
    after = refined(replace(noisy, frames=frames), name)
    assert not np.isfinite(after.depth[:, :100]).any() and np.isfinite(after.depth[:, 100:]).any()


def test_the_same_inputs_give_the_same_bytes(noisy: Yard) -> None:
    name = list(noisy.cameras)[2]
    one, two = refined(noisy, name), refined(noisy, name)
    assert one.depth.tobytes() == two.depth.tobytes() and one.support.tobytes() == two.support.tobytes()


def test_views_without_suitable_partners_are_rejected_with_the_reason(noisy: Yard) -> None:
    given = inputs(noisy, next(iter(noisy.cameras)))
    aside = refine(*given, min_angle_deg=80, max_angle_deg=90)
    assert isinstance(aside, Rejected) and "angle" in aside.reason
    elsewhere = {name: replace(camera, component=1) for name, camera in given[4].items()}
    alone = refine(*given[:4], elsewhere)
    assert isinstance(alone, Rejected) and "angle" in alone.reason


def test_a_view_at_seventy_degrees_is_used_where_it_alone_shows_the_surface() -> None:
    yard = make_yard((-35, -19, 35), noise_px=0.5)
    name, near, wide = yard.cameras
    frame, camera, start, frames, cameras = inputs(yard, name)
    after = refine(frame, camera, start, {wide: frames[wide]}, cameras)
    assert isinstance(after, DepthMap) and after.partners == (wide,)
    both = np.isfinite(start.depth) & np.isfinite(after.depth)
    assert both.sum() > 0.8 * np.isfinite(start.depth).sum()
    assert np.median(errors(yard, name, after.depth)[both]) < 0.3 * np.median(errors(yard, name, start.depth)[both])
    beside = refined(yard, name)
    assert beside.partners == (near, wide), "the nearest in angle first"
    also = both & np.isfinite(beside.depth)
    worst = [np.percentile(errors(yard, name, found.depth)[also], 90) for found in (beside, after)]
    assert worst[0] < 1.2 * worst[1]


def test_frames_of_different_sizes_work_together() -> None:
    """The left camera's image is 1.5 times as large; the depth of the middle one starts from its pair with the right one."""
    small, large = make_yard((-12, 0, 12), noise_px=0.3), make_yard((-12, 0, 12), width=360)
    left, middle, right = small.cameras
    disparities = {pair: d for pair, d in small.disparities.items() if pair == (middle, right)}
    frames, cameras = small.frames | {left: large.frames[left]}, small.cameras | {left: large.cameras[left]}
    after = refined(replace(small, frames=frames, cameras=cameras, disparities=disparities), middle)
    assert after.partners == (left, right)
    assert (after.support & 1).astype(bool).mean() > 0.4  # the large image confirms many pixels
    assert np.nanmedian(errors(small, middle, after.depth)) < 0.004


def test_the_reference_surface_is_used_where_tonights_pairs_have_no_depth(noisy: Yard) -> None:
    name = list(noisy.cameras)[1]
    frame, camera, depth, frames, cameras = inputs(noisy, name)
    then = refined(noisy, name)
    hole = np.zeros(depth.depth.shape, bool)
    hole[40:100, 60:140] = True
    torn = replace(depth, depth=np.where(hole, np.nan, depth.depth).astype(np.float32))
    found = refine(frame, camera, torn, frames, cameras, camera, then)
    assert isinstance(found, DepthMap)
    known = hole & then.sure & np.isfinite(then.depth)
    assert (found.sure & np.isfinite(found.depth))[known].mean() > 0.9
    assert np.nanmedian(errors(noisy, name, found.depth)[known]) < 0.002


def test_a_reference_that_the_photographs_contradict_is_not_used(noisy: Yard) -> None:
    name = list(noisy.cameras)[1]
    frame, camera, depth, frames, cameras = inputs(noisy, name)
    then = refined(noisy, name)
    elsewhere = replace(then, depth=(0.9 * then.depth).astype(np.float32))
    found = refine(frame, camera, depth, frames, cameras, camera, elsewhere)
    assert isinstance(found, DepthMap)
    known = found.sure & np.isfinite(found.depth)
    assert known.mean() > 0.9 * (then.sure & np.isfinite(then.depth)).mean()
    assert np.mean(errors(noisy, name, found.depth)[known] > 0.05) < 0.02


def test_the_reference_of_a_camera_that_has_moved_is_not_used(noisy: Yard) -> None:
    name = list(noisy.cameras)[1]
    frame, camera, depth, frames, cameras = inputs(noisy, name)
    turned = replace(camera, C=camera.C + 0.01)
    found = refine(frame, camera, depth, frames, cameras, turned, refined(noisy, name))
    assert isinstance(found, DepthMap)
    assert np.array_equal(found.depth, refined(noisy, name).depth, equal_nan=True)


def test_a_much_coarser_view_improves_the_refined_depth(noisy: Yard) -> None:
    """One view has a third of the pixels along each side."""
    coarse, name, *_ = noisy.cameras
    frame, camera, depth, frames, cameras = inputs(noisy, name)
    small = cameras[coarse]
    size = (small.width // 3, small.height // 3)
    image = cv2.resize(frames[coarse].image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    K = scaled_intrinsics(small.K, size[0] / small.width, size[1] / small.height)
    cameras = {**cameras, coarse: replace(small, K=K, width=size[0], height=size[1])}
    mixed = {**frames, coarse: replace(frames[coarse], image=image, mask=np.ones(image.shape[:2], bool))}
    without = {other: frames[other] for other in frames if other != coarse}
    accuracy = []
    for views in (mixed, without):
        found = refine(frame, camera, depth, views, cameras)
        assert isinstance(found, DepthMap)
        accuracy.append((errors(noisy, name, np.where(found.sure, found.depth, np.nan)) < 0.01).mean())
    assert accuracy[0] > accuracy[1]
