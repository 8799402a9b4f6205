"""Keypoints of a network that a user supplies: what is found, how they match, and the message for a file of another kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.helpers.made_up_model import two_pictures
from tests.helpers.small_aliked import as_capture, untrained_weights
from wbflow_stages.features import detect
from wbflow_stages.matches import match
from wbflow_stages.matching.local_consensus import local_consensus
from wbflow_stages.matching.turns import matching_turns, turned, turned_axes, turned_back
from wbflow_stages.types import LEARNED, PLAIN, TILTED, Capture, Features, Frame, Matches, Rejected, View

aliked_onnx = pytest.importorskip("aliked_onnx", reason="the script needs the package onnx")

WEIGHTS = Path(__file__).parents[4] / "shared" / "models" / "aliked-n32.pth"


@pytest.fixture(scope="module")
def model() -> Capture:
    return as_capture(untrained_weights())


def picture(width: int = 320, height: int = 224) -> np.ndarray:
    """Smooth random blobs in colour."""
    noise = np.random.default_rng(0).normal(size=(height, width, 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    return np.asarray(np.clip(128 + 320 * smooth, 0, 255), dtype=np.uint8)


def frame_of(image: np.ndarray) -> Frame:
    return Frame(image, np.ones(image.shape[:2], dtype=bool), View(image.shape[1], image.shape[0]))


def found(frame: Frame, model: Capture, **options: Any) -> Features:
    features = detect(frame, model=model, **({"detector": "onnx"} | options))
    assert isinstance(features, Features)
    return features


def test_keypoints_are_in_the_frame_with_descriptors_of_unit_length(model: Capture) -> None:
    features = found(frame_of(picture(311, 203)), model, max_keypoints=300)  # sides that are no multiples of 32
    assert len(features.xy) == 300 and (features.tilts == LEARNED).all()
    assert (features.xy >= -0.5).all() and (features.xy <= [310.5, 202.5]).all()
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1, atol=1e-5)


def test_the_same_pixels_give_the_same_bytes(model: Capture) -> None:
    first, second = (found(frame_of(picture()), model) for _ in range(2))
    for name in ("xy", "descriptors", "responses", "lookalikes"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_keypoints_move_with_the_picture() -> None:
    weights = untrained_weights()
    for level in ("conv2", "conv3", "conv4"):  # stretched to full size from border to border: they depend on the place
        weights[f"{level}.weight"] = np.zeros_like(weights[f"{level}.weight"])
    model = as_capture(weights)
    image = picture()
    moved = np.roll(image, (32, 64), axis=(0, 1))
    before, after = (found(frame_of(pixels), model, max_keypoints=2000) for pixels in (image, moved))
    inner = ((before.xy > 64) & (before.xy < [320 - 128, 224 - 96])).all(axis=1)
    distance = np.linalg.norm(before.xy[inner, None] + [64, 32] - after.xy[None], axis=2).min(axis=1)
    assert inner.sum() > 20 and np.mean(distance < 0.2) > 0.9


def test_no_keypoint_lies_on_masked_pixels(model: Capture) -> None:
    frame = frame_of(picture())
    frame.mask[:, :160] = False
    assert (found(frame, model).xy[:, 0] > 160).all()


def test_a_large_picture_searched_in_tiles_has_keypoints_everywhere_and_none_twice(model: Capture) -> None:
    frame = frame_of(picture(640, 448))
    features = found(frame, model, tile_px=224, max_keypoints=4000)
    cells = {tuple(cell) for cell in (features.xy // 64).astype(int)}
    assert len(cells) == 70
    spacing = np.linalg.norm(features.xy[:, None] - features.xy[None], axis=2) + 1e9 * np.eye(len(features.xy))
    assert spacing.min() > 0.5


def test_a_file_of_another_interface_is_refused_with_what_it_has_and_what_is_wanted() -> None:
    other = Capture("matcher.onnx", np.frombuffer(two_pictures(96, 64), dtype=np.uint8))
    with pytest.raises(ValueError, match=r"matcher.onnx takes image0 .* a detector of image, max_keypoints, min_score"):
        detect(frame_of(picture()), model=other, detector="onnx")


def test_a_detector_without_its_file_says_so() -> None:
    with pytest.raises(ValueError, match="method 'onnx' needs model"):
        detect(frame_of(picture()), detector="onnx")


def test_both_kinds_together_are_matched_each_with_its_own(model: Capture) -> None:
    image = picture()
    turned = np.ascontiguousarray(image[::-1, ::-1])
    features = [found(frame_of(pixels), model, detector="sift+onnx") for pixels in (image, image, turned)]
    kinds = [np.sum(features[0].tilts == kind) for kind in (PLAIN, LEARNED, TILTED)]
    assert min(kinds) > 50 and len(features[0].lookalikes) == kinds[0] + kinds[1]
    assert features[0].descriptors.shape[1] == 128  # SIFT's, the longer ones
    matches = match(features[0], features[1])
    assert isinstance(matches, Matches) and matches.i1 is not None and matches.i2 is not None
    left, right = features[0].tilts[matches.i1], features[1].tilts[matches.i2]
    assert np.array_equal(left == LEARNED, right == LEARNED) and (left == LEARNED).any() and (left != LEARNED).any()
    # upside down, only SIFT keypoints have an orientation that follows
    assert isinstance(match(features[0], features[2]), Matches)


@pytest.mark.parametrize("turn", [1, 2, 3])
def test_a_picture_on_its_side_matches_an_upright_one_if_turned_ones_are_searched(model: Capture, turn: int) -> None:
    image = picture()
    on_its_side = np.ascontiguousarray(np.rot90(image, -turn))
    left = found(frame_of(image), model, turned=True, max_keypoints=400)
    right = found(frame_of(on_its_side), model, turned=True, max_keypoints=400)
    assert set(left.tilts) == {LEARNED, LEARNED + 1, LEARNED + 2, LEARNED + 3} and len(left.lookalikes) == len(left.xy)
    matches = match(left, right)
    assert isinstance(matches, Matches) and matches.i1 is not None and matches.i2 is not None and matches.affine is not None
    # the same places of the picture, and the map of the turn
    size = (right.view.width, right.view.height)
    off = np.linalg.norm(turned(matches.x2, turn, size) - matches.x1, axis=1)
    assert len(off) > 300 and np.median(off) < 0.1
    np.testing.assert_allclose(turned_back(turned(matches.x2, turn, size), turn, size), matches.x2)
    np.testing.assert_allclose(np.median(matches.affine, axis=0), turned_axes(turn), atol=0.02)


def test_without_turned_pictures_each_pair_is_matched_as_it_is(model: Capture) -> None:
    left = found(frame_of(picture()), model)
    assert matching_turns(left, left) == (LEARNED, LEARNED) and set(left.tilts) == {LEARNED}


def made_up(xy: np.ndarray, descriptors: np.ndarray) -> Features:
    n = len(xy)
    frames = np.tile(8 * np.eye(2), (n, 1, 1))
    tilts = np.full(n, LEARNED, np.uint8)
    return Features(xy, frames, descriptors, np.ones(n, np.float32), tilts, View(1600, 1200), plain_keypoints=n)


def test_keypoints_without_orientation_match_between_a_camera_and_one_on_its_side() -> None:
    random = np.random.default_rng(2)
    x1 = random.uniform(100, 1000, (600, 2))
    turn = np.array([[0.1, -0.8], [1.1, 0.2]])  # a quarter turn, foreshortened
    x2 = x1 @ turn.T + [1000, 100]
    descriptors = random.normal(size=(600, 64))
    noisy = descriptors + 0.8 * random.normal(size=descriptors.shape)
    noisy[:300] = random.normal(size=(300, 64))  # half of them are not found again
    left, right = (made_up(x, (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)) for x, d in
                   ((x1, descriptors), (x2, noisy)))  # fmt: skip
    matches = match(left, right)
    assert isinstance(matches, Matches) and matches.i1 is not None
    is_right = matches.i1 == matches.i2
    assert is_right.sum() > 250 and is_right.mean() > 0.95
    assert matches.affine is not None
    np.testing.assert_allclose(np.median(matches.affine, axis=0), turn, atol=0.02)


def test_unrelated_pictures_have_no_matches() -> None:
    random = np.random.default_rng(3)
    sides = []
    for _ in range(2):
        descriptors = random.normal(size=(1500, 64))
        descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
        sides.append(made_up(random.uniform(0, 1000, (1500, 2)), descriptors.astype(np.float32)))
    matches = match(*sides)
    assert isinstance(matches, Rejected) or len(matches.x1) < 15


def test_neighbours_agree_with_right_matches_and_not_with_wrong_ones() -> None:
    random = np.random.default_rng(4)
    x1 = random.uniform(0, 1000, (400, 2))
    affine = np.array([[0.7, 0.3], [-0.2, 1.4]])
    x2 = x1 @ affine.T + 50
    x2[:200] = random.uniform(x2.min(), x2.max(), (200, 2))
    maps, support = local_consensus(x1, x2)
    assert np.quantile(support[200:], 0.05) > np.quantile(support[:200], 0.95)
    np.testing.assert_allclose(np.median(maps[200:], axis=0), affine, atol=0.05)


def test_wide_pairs_of_the_fountain_have_half_as_many_matches_again() -> None:
    if not WEIGHTS.exists():
        pytest.skip("no weights of ALIKED beside the project")
    from onnx_graph import state_dict
    from pairs_with_truth import DATA, photographed

    if not (DATA / "fountain").exists():
        pytest.skip("the photographs of the fountain are not there")
    from wbflow_stages.core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
    from wbflow_stages.geometry import estimate_geometry
    from wbflow_stages.types import Geometry

    views = photographed("fountain", 1024, ["2", "9"])
    left, right = views["2"], views["9"]  # 81 degrees apart
    F = fundamental_from_cameras(left.camera, right.camera)
    trained = as_capture(state_dict(WEIGHTS), "aliked-n32.onnx")
    correct = {}
    for detector in ("sift", "onnx"):
        model = trained if detector == "onnx" else None
        features = [detect(view.frame, model=model, detector=detector) for view in (left, right)]
        matches = match(*features)  # type: ignore[arg-type]
        geometry = estimate_geometry(matches, *features)  # type: ignore[arg-type]
        assert isinstance(geometry, Geometry)
        near = symmetric_epipolar_distance(F, geometry.x1, geometry.x2) < 3
        assert near.mean() > 0.93
        correct[detector] = near.sum()
    assert correct["onnx"] >= 1.5 * correct["sift"]
