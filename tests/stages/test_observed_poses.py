"""Cameras are placed by what moves before them: exact synthetic truth, wrong observations, clocks, frames and failures."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_observations import read_rolex
from observed_scenes import ObservedScene, Recording, camera_ring, plain_lens, record, walk

from wbflow_stages.core.lenses import lens_pixels
from wbflow_stages.core.rotations import Similarity, angle_between_deg, nearest_rotation
from wbflow_stages.observed_poses import solve_observations
from wbflow_stages.types import Bools, Float64s, Lens, Observations, ObservedPoses, Placement, Rejected, ThingSurvey


def make_scene(seed: int, cameras: int = 4, path: str = "flight", spread_deg: float = 120, **recorded: float) -> ObservedScene:
    """Cameras on an arc around a moving thing, 15 m away, for a minute unless `recorded` says otherwise."""
    recorded.setdefault("seconds", 60.0)
    rng = np.random.default_rng(seed)
    ring = camera_ring(cameras, 15, spread_deg, rng)
    lenses = {name: plain_lens() for name in ring}
    return record(ring, lenses, path, 15, Recording(**recorded), rng)


def solved(scene: ObservedScene, survey: ThingSurvey | None = None, **stated: Placement) -> ObservedPoses:
    """The result, which must not be a rejection."""
    result = solve_observations(scene.observations, scene.lenses, stated, survey)
    assert isinstance(result, ObservedPoses), result
    return result


def to_truth(result: ObservedPoses, scene: ObservedScene) -> Similarity:
    """The similarity that best brings the placed cameras to their true poses."""
    names = list(result.placements)
    turns = np.zeros((3, 3))
    for name in names:
        true_R = scene.truth[name].R
        R = result.placements[name].R
        assert true_R is not None and R is not None
        turns += true_R.T @ R
    R = nearest_rotation(turns)
    source = np.array([result.placements[n].C for n in names])
    target = np.array([scene.truth[n].C for n in names])
    a = (source - source.mean(axis=0)) @ R.T
    b = target - target.mean(axis=0)
    scale = float(np.sum(a * b) / np.sum(a * a))
    return Similarity(scale, R, target.mean(axis=0) - scale * R @ source.mean(axis=0))


def errors(result: ObservedPoses, scene: ObservedScene, similarity: Similarity) -> tuple[Float64s, Float64s]:
    """Distances in metres and angles in degrees from the truth, in the order of the placements."""
    distances = []
    angles = []
    for name, placement in result.placements.items():
        truth = scene.truth[name]
        assert placement.C is not None and placement.R is not None and truth.R is not None
        distances.append(np.linalg.norm(similarity.points(placement.C[None])[0] - truth.C))
        angles.append(angle_between_deg(placement.R @ similarity.R.T, truth.R))
    return np.array(distances), np.array(angles)


@pytest.mark.parametrize("path", ["walk", "flight"])
def test_synchronous_cameras_are_placed_within_millimetres(path: str) -> None:
    scene = make_scene(0, path=path)
    result = solved(scene)
    assert list(result.placements) == ["cam0", "cam1", "cam2", "cam3"]
    distances, angles = errors(result, scene, to_truth(result, scene))
    assert distances.max() < 0.02
    assert angles.max() < 0.05
    assert result.reprojection_px is not None and result.reprojection_px < 1.5
    assert not result.metric
    for name, camera in result.cameras.items():
        assert abs(camera.offset - scene.offsets[name]) < 0.003


def test_clocks_that_differ_by_a_second_are_found() -> None:
    scene = make_scene(1, offset_s=0.5)
    result = solved(scene)
    distances, _ = errors(result, scene, to_truth(result, scene))
    assert len(distances) == 4
    assert distances.max() < 0.02
    for name, camera in result.cameras.items():
        assert abs(camera.offset - scene.offsets[name]) < 0.005


def test_a_third_of_the_observations_may_be_wrong() -> None:
    scene = make_scene(0, offset_s=0.5, wrong_share=0.3)
    result = solved(scene)
    distances, angles = errors(result, scene, to_truth(result, scene))
    assert len(distances) == 4
    assert distances.max() < 0.05
    assert angles.max() < 0.15
    shares = [camera.used / camera.observations for camera in result.cameras.values()]
    assert max(shares) < 0.8


def survey_of(scene: ObservedScene, offset: float = 0.0, origin: tuple[float, float, float] = (0, 0, 0)) -> ThingSurvey:
    """The thing's own positions every half second, good to 0.5 m, by a clock that is `offset` behind that of the first camera."""
    rng = np.random.default_rng(5)
    rows = slice(250, -250, 12)
    position = scene.path[rows] + origin + rng.normal(0, 0.5, scene.path[rows].shape)
    count = len(position)
    return ThingSurvey(("lamp",), np.zeros(count, np.int32), scene.path_times[rows] - offset, position, np.full(count, np.nan))


def test_a_survey_of_the_thing_gives_scale_and_frame_far_from_the_origin() -> None:
    scene = make_scene(2)
    origin = (313334.0, 5154531.0, 400.0)
    result = solved(scene, survey_of(scene, 0.4, origin))
    assert result.metric
    assert result.survey_m is not None and 0.5 < result.survey_m < 1.0
    identity = Similarity(1.0, np.eye(3), -np.array(origin))
    distances, angles = errors(result, scene, identity)
    assert distances.max() < 0.4
    assert angles.max() < 1.0
    # and within the frame no precision is lost
    distances, _ = errors(result, scene, to_truth(result, scene))
    assert distances.max() < 0.02


def test_two_known_cameras_give_the_frame() -> None:
    scene = make_scene(3)
    known = {"cam0": scene.truth["cam0"], "cam3": scene.truth["cam3"]}
    result = solved(scene, None, **known)
    assert result.metric
    distances, angles = errors(result, scene, Similarity())
    assert distances.max() < 0.03
    assert angles.max() < 0.1


def test_a_focal_length_that_is_off_is_said() -> None:
    scene = make_scene(4)
    K = np.array(scene.lenses["cam2"].K)
    K[:2, :2] *= 1.03
    result = solved(replace(scene, lenses={**scene.lenses, "cam2": replace(scene.lenses["cam2"], K=K)}))
    changes = {name: camera.focal_change for name, camera in result.cameras.items()}
    assert [name for name, change in changes.items() if change is not None] == ["cam2"]
    assert changes["cam2"] == pytest.approx(1 / 1.03 - 1, abs=0.003)
    assert any("cam2: its focal length" in note for note in result.notes)


def test_a_focal_length_of_which_the_field_of_view_is_stated_is_solved() -> None:
    scene = make_scene(4)
    # the true field of view is 82 degrees
    wide = Lens(hfov_deg=78.0, width=1920, height=1080, distortion=scene.lenses["cam1"].distortion)
    result = solved(replace(scene, lenses={**scene.lenses, "cam1": wide}))
    stated_focal = 960 / np.tan(np.deg2rad(39))
    assert list(result.focal_scales) == ["cam1"]
    assert result.focal_scales["cam1"] * stated_focal == pytest.approx(1100, rel=0.005)
    assert result.cameras["cam1"].focal_change is None


def without(observations: Observations, rows: Bools) -> Observations:
    """The observations without some rows."""
    keep = ~rows
    return replace(
        observations,
        camera=observations.camera[keep],
        thing=observations.thing[keep],
        time=observations.time[keep],
        xy=observations.xy[keep],
        sigma_px=observations.sigma_px[keep],
    )


def rejected(observations: Observations | None, scene: ObservedScene) -> str:
    """The reason of a rejection."""
    result = solve_observations(observations, scene.lenses, {})
    assert isinstance(result, Rejected), result
    return result.reason


def test_no_observations_are_said() -> None:
    scene = make_scene(0, cameras=2, seconds=20)
    assert rejected(None, scene) == "there are no observations of things"


def test_one_camera_alone_is_said() -> None:
    scene = make_scene(0, cameras=2, seconds=20)
    alone = without(scene.observations, scene.observations.camera == 1)
    assert rejected(alone, scene).startswith("1 cameras have observations and a known lens")


def test_cameras_that_never_see_the_thing_at_once_are_said() -> None:
    scene = make_scene(0, cameras=2, seconds=60)
    o = scene.observations
    apart = without(o, ((o.camera == 0) & (o.time > 20)) | ((o.camera == 1) & (o.time < 40)))
    assert rejected(apart, scene).startswith("no two cameras see a thing at the same time")


def test_a_thing_on_a_line_is_said() -> None:
    scene = make_scene(0, cameras=3, seconds=40)
    path = np.column_stack([np.linspace(-5, 5, 1000), np.linspace(2, -3, 1000), np.linspace(1, 3, 1000)])
    on_line = seen_along(path, scene)
    assert rejected(on_line, scene).startswith("3 of 3 cameras see the thing on one straight line only")


def test_cameras_that_follow_different_things_are_not_placed() -> None:
    scene = make_scene(0, cameras=2, seconds=60, path="walk")
    other = make_scene(7, cameras=2, seconds=60, path="walk")
    o = scene.observations
    p = other.observations
    ours = without(o, o.camera == 1)
    theirs = without(p, p.camera == 0)
    mixed = Observations(
        o.cameras,
        o.things,
        np.concatenate([ours.camera, theirs.camera]),
        np.concatenate([ours.thing, theirs.thing]),
        np.concatenate([ours.time, theirs.time]),
        np.concatenate([ours.xy, theirs.xy]),
        np.concatenate([ours.sigma_px, theirs.sigma_px]),
    )
    assert rejected(mixed, scene).startswith("none of the 1 pairs of cameras has a pose")


def test_a_flat_track_before_three_cameras_is_enough() -> None:
    scene = make_scene(0, cameras=3, seconds=40)
    flat = walk(np.arange(1500) / 25, 15, np.random.default_rng(1))
    flat[:, 2] = 1.5
    result = solve_observations(seen_along(flat, scene), scene.lenses, {})
    assert isinstance(result, ObservedPoses)
    distances, angles = errors(result, scene, to_truth(result, scene))
    assert len(distances) == 3
    assert distances.max() < 0.1
    assert angles.max() < 0.5


def seen_along(path: Float64s, scene: ObservedScene) -> Observations:
    """What the cameras of a scene see of a thing on a path (n, 3), 25 times a second, with noise of a pixel."""
    rng = np.random.default_rng(0)
    xy = []
    for name, truth in scene.truth.items():
        assert truth.R is not None and truth.C is not None
        xy.append(lens_pixels(scene.lenses[name], (path - truth.C) @ truth.R.T))
    count = len(path)
    cameras = len(scene.truth)
    return Observations(
        tuple(scene.truth),
        ("lamp",),
        np.repeat(np.arange(cameras, dtype=np.int32), count),
        np.zeros(cameras * count, np.int32),
        np.tile(np.arange(count) / 25, cameras),
        np.concatenate(xy) + rng.normal(size=(cameras * count, 2)),
        np.full(cameras * count, np.nan),
    )


def test_results_are_the_same_every_time() -> None:
    scene = make_scene(5, cameras=3, seconds=30, offset_s=0.5)
    first = solved(scene)
    second = solved(scene)
    assert repr(first.cameras) == repr(second.cameras)
    assert np.array_equal(first.track, second.track)


@pytest.fixture(scope="module")
def rolex() -> ObservedPoses:
    """Five cameras placed by a drone and its GPS."""
    folder = Path(os.environ.get("WBFLOW_DATA", Path(__file__).parents[3] / "shared" / "data")) / "rolex"
    if not folder.is_dir():
        pytest.skip(f"the data of rolex are not in {folder}")
    observations, lenses, survey = read_rolex(folder)
    result = solve_observations(observations, lenses, {}, survey)
    assert isinstance(result, ObservedPoses), result
    return result


@pytest.mark.xfail(strict=True, reason="measured: 5.9 cm and 0.061 degrees")
def test_halves_of_the_flight_agree_within_5_cm(rolex: ObservedPoses) -> None:
    assert rolex.halves_m is not None and rolex.halves_deg is not None
    assert rolex.halves_m < 0.05 and rolex.halves_deg < 0.05
