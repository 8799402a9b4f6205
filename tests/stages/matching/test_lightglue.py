"""LightGlue on the site's keypoints, with small models made here: what it is given, what comes out, what is refused.

LightGlue itself is measured by `scripts/bench_matching.py`, from weights that are no part of the project.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.helpers.made_up_lightglue import two_keypoint_sets
from tests.helpers.made_up_model import two_pictures
from wbflow_stages.features import detect
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.types import (
    LEARNED,
    PLAIN,
    TILTED,
    Capture,
    Features,
    Float64s,
    Frame,
    Geometry,
    Int32s,
    Matches,
    Uint8s,
    View,
)

sys.path.insert(0, str(Path(__file__).parents[3] / "scripts"))
lightglue_onnx = pytest.importorskip("lightglue_onnx", reason="the script needs the package onnx")

WIDTH, HEIGHT = 1600, 1200
K = np.array([[1400.0, 0, 800], [0, 1400.0, 600], [0, 0, 1]])


def capture(model: bytes) -> Capture:
    return Capture("mine.onnx", np.frombuffer(model, dtype=np.uint8))


def learned(xy: Float64s, descriptors: Float64s, kind: int = LEARNED) -> Features:
    n = len(xy)
    units = (descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)).astype(np.float32)
    frames = np.tile(8 * np.eye(2), (n, 1, 1))
    view = View(WIDTH, HEIGHT, K)
    return Features(xy, frames, units, np.ones(n, np.float32), np.full(n, kind, np.uint8), view, plain_keypoints=n)


def two_views(count: int = 400) -> tuple[Features, Features]:
    """Keypoints of points in space in two views; the right ones are in reverse order."""
    random = np.random.default_rng(0)
    X = random.uniform([-4, -3, 8], [4, 3, 14], (count, 3))
    a = np.radians(20)
    R = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    x1 = X @ K.T
    x2 = (X @ R.T + [-3, 0, 1]) @ K.T
    descriptors = random.normal(size=(count, 64))
    seen = [x[:, :2] / x[:, 2:] + random.normal(scale=0.3, size=(count, 2)) for x in (x1, x2)]
    return learned(seen[0], descriptors), learned(seen[1][::-1], descriptors[::-1])


def matched(left: Features, right: Features, model: bytes, **options: Any) -> tuple[Matches, Int32s, Int32s]:
    """The matches, and the rows of their keypoints."""
    matches = match(left, right, matcher="lightglue", model=capture(model), **options)
    assert isinstance(matches, Matches) and matches.i1 is not None and matches.i2 is not None
    return matches, matches.i1, matches.i2


def picture() -> Uint8s:
    noise = np.random.default_rng(0).normal(size=(240, 320, 3))
    return np.asarray(np.clip(128 + 320 * cv2.GaussianBlur(noise, (0, 0), 2.5), 0, 255), dtype=np.uint8)


def sift_features() -> Features:
    image = picture()
    features = detect(Frame(image, np.ones(image.shape[:2], dtype=bool), View(320, 240)), max_keypoints=400)
    assert isinstance(features, Features)
    return features


@pytest.mark.parametrize("floats", [False, True], ids=["int64", "float32"])
def test_matches_are_pairs_of_the_cameras_own_keypoints_with_the_models_scores(floats: bool) -> None:
    left, right = two_views()
    matches, i1, i2 = matched(left, right, two_keypoint_sets(floats=floats))
    assert matches.matcher == "lightglue" and len(matches.x1) == 400
    np.testing.assert_array_equal(i1 + i2, np.full(400, 399))  # the right ones are reversed
    np.testing.assert_array_equal(matches.x2, right.xy[i2])
    np.testing.assert_allclose(matches.probability, 1, atol=1e-5)


def test_geometry_guides_further_matches_of_keypoints_that_the_model_did_not_get() -> None:
    left, right = two_views()
    few, _, _ = matched(left, right, two_keypoint_sets(), max_keypoints=150)
    assert len(few.x1) == 150
    geometry = estimate_geometry(few, left, right)
    assert isinstance(geometry, Geometry) and geometry.i1 is not None and geometry.i2 is not None
    assert len(geometry.x1) > 300 and (geometry.i1 + geometry.i2 == 399).mean() > 0.99


def test_the_model_gets_pixels_and_the_size_of_the_picture() -> None:
    left, right = two_views()
    matches, i1, _ = matched(left, right, two_keypoint_sets("x"))
    np.testing.assert_allclose(matches.probability, np.clip(left.xy[i1, 0] / WIDTH, 0, 1), atol=1e-6)


def test_matches_of_low_score_are_dropped() -> None:
    left, right = two_views()
    matches, _, _ = matched(left, right, two_keypoint_sets("x"), min_score=0.5)
    assert 0 < len(matches.x1) < 400 and (matches.x1[:, 0] >= WIDTH / 2).all()


def test_the_model_gets_keypoints_of_a_turned_picture_in_that_picture() -> None:
    upright, other = two_views()
    # the left camera lies on its side: its network saw the picture turned by one quarter
    turned_view = replace(upright.view, width=HEIGHT, height=WIDTH)
    sideways = replace(
        upright, xy=np.column_stack([HEIGHT - 1 - upright.xy[:, 1], upright.xy[:, 0]]), tilts=upright.tilts + 1, view=turned_view
    )
    decoys = replace(learned(sideways.xy, np.random.default_rng(9).normal(size=(400, 64))), view=turned_view)
    both = replace(
        sideways,
        xy=np.concatenate([decoys.xy, sideways.xy]),
        frames=np.concatenate([decoys.frames, sideways.frames]),
        descriptors=np.concatenate([decoys.descriptors, sideways.descriptors]),
        responses=np.ones(800, np.float32),
        tilts=np.concatenate([decoys.tilts, sideways.tilts]),
    )
    matches, i1, i2 = matched(both, other, two_keypoint_sets("x"))
    assert len(i1) == 400 and (i1 - 400 + i2 == 399).all()
    np.testing.assert_allclose(matches.probability, np.clip(upright.xy[i1 - 400, 0] / WIDTH, 0, 1), atol=1e-6)


@pytest.mark.parametrize("score", ["scale", "angle", "element"])
def test_a_model_of_sift_gets_sigma_angle_and_descriptor_as_opencv_has_them(score: str) -> None:
    features = sift_features()
    matches, i1, _ = matched(features, features, two_keypoint_sets(score, of_sift=True))
    assert (features.tilts[i1] == PLAIN).all()

    # OpenCV's keypoints, and what the model should get of them
    grey = cv2.cvtColor(picture(), cv2.COLOR_RGB2GRAY)
    theirs, descriptors = cv2.SIFT.create(contrastThreshold=0.01, enable_precise_upscale=True).detectAndCompute(grey, None)
    places = np.array([keypoint.pt for keypoint in theirs])
    angles = np.radians([keypoint.angle for keypoint in theirs])
    wanted = {
        "scale": np.array([keypoint.size for keypoint in theirs]) / 2 / 100,
        "angle": np.angle(np.exp(1j * angles)) / (2 * np.pi) + 0.5,
        "element": np.sqrt(descriptors[:, 1] / descriptors.sum(axis=1)),
    }[score]

    # those at the same place with the same angle
    columns = features.frames[i1, :, 0]
    own_angles = np.arctan2(columns[:, 1], columns[:, 0])
    is_same = np.linalg.norm(places[None] - matches.x1[:, None], axis=2) < 0.3
    is_same &= np.abs(np.angle(np.exp(1j * (angles[None] - own_angles[:, None])))) < 0.1
    row, other = np.nonzero(is_same)
    assert len(row) > 150
    np.testing.assert_allclose(np.median(np.abs(matches.probability[row] - wanted[other])), 0, atol=0.004)


def test_each_kind_of_keypoints_of_a_union_goes_to_its_own_model() -> None:
    left, right = two_views()
    both = []
    for side in (left, right):
        sift = learned(side.xy + 3, np.random.default_rng(1).normal(size=(400, 128)), PLAIN)
        tilted = learned(side.xy[:50], np.random.default_rng(2).normal(size=(50, 128)), TILTED)
        parts = (sift, side, tilted)
        descriptors = [np.pad(part.descriptors, ((0, 0), (0, 128 - part.descriptors.shape[1]))) for part in parts]
        both.append(
            Features(
                np.concatenate([part.xy for part in parts]),
                np.concatenate([part.frames for part in parts]),
                np.concatenate(descriptors),
                np.concatenate([part.responses for part in parts]),
                np.concatenate([part.tilts for part in parts]),
                side.view,
                plain_keypoints=400,
            )
        )
    for model, kind in (
        (two_keypoint_sets(length=64), LEARNED),  # without the zeros that made them as long as SIFT's
        (two_keypoint_sets(length=128, of_sift=True), PLAIN),
    ):
        _, i1, i2 = matched(both[0], both[1], model)
        assert len(i1) == 400 and (both[0].tilts[i1] == kind).all() and (both[1].tilts[i2] == kind).all()


def test_a_picture_without_learned_keypoints_beside_one_that_has_some_has_no_matches() -> None:
    left, right = two_views()
    others = learned(right.xy, np.ones((400, 64)), PLAIN)
    result = match(left, others, matcher="lightglue", model=capture(two_keypoint_sets()))
    assert not isinstance(result, Matches) and result.figures == {"matches": 0, "needed": 8}


def test_a_model_of_learned_keypoints_refuses_those_of_sift_and_says_what_to_detect() -> None:
    features = sift_features()
    with pytest.raises(ValueError, match=r"mine.onnx matches keypoints of a learned detector.*features: {detector: onnx, model"):
        matched(features, features, two_keypoint_sets())


def test_a_model_of_sift_refuses_learned_keypoints() -> None:
    left, right = two_views()
    with pytest.raises(ValueError, match=r"mine.onnx matches SIFT keypoints.*features: {detector: sift}"):
        matched(left, right, two_keypoint_sets(of_sift=True))


def test_descriptors_of_another_length_are_refused_with_both_lengths() -> None:
    left, right = two_views()
    with pytest.raises(ValueError, match=r"mine.onnx takes descriptors of 256 numbers, the keypoints' have 64: use the detector"):
        matched(left, right, two_keypoint_sets(length=256))


def test_a_file_of_another_interface_is_refused_with_what_it_has_and_what_is_wanted() -> None:
    left, right = two_views()
    with pytest.raises(ValueError, match=r"mine.onnx takes image0 .* a matcher of kpts0, .* is run by matcher: onnx"):
        matched(left, right, two_pictures(96, 64))


def untrained_lightglue(of_sift: bool = False) -> bytes:
    """LightGlue as `scripts/lightglue_onnx.py` writes it, small and with random weights."""
    random = np.random.default_rng(5)
    channels = 16
    weights = {"posenc.Wr.weight": random.normal(size=(2, 4 if of_sift else 2))}
    sizes = {"input_proj": (channels, 64), "log_assignment.1.final_proj": (channels, channels)}
    sizes["log_assignment.1.matchability"] = (1, channels)
    for layer in range(2):
        sizes[f"self_attn.{layer}.Wqkv"] = (3 * channels, channels)
        for name in (f"self_attn.{layer}.out_proj", *(f"cross_attn.{layer}.{part}" for part in ("to_qk", "to_v", "to_out"))):
            sizes[name] = (channels, channels)
        for name in (f"self_attn.{layer}.ffn", f"cross_attn.{layer}.ffn"):
            sizes |= {f"{name}.0": (2 * channels, 2 * channels), f"{name}.3": (channels, 2 * channels)}
            weights |= {f"{name}.1.weight": np.ones(2 * channels), f"{name}.1.bias": np.zeros(2 * channels)}
    sizes["log_assignment.0.final_proj"] = (channels, channels)
    for name, (out, into) in sizes.items():
        weights |= {f"{name}.weight": random.normal(0, into**-0.5, (out, into)), f"{name}.bias": np.zeros(out)}
    weights["log_assignment.1.matchability.bias"] += 3.0
    arrays = {name: value.astype(np.float32) for name, value in weights.items()}
    text: bytes = lightglue_onnx.lightglue(arrays, least_score=0).SerializeToString()
    return text


def test_the_network_written_from_weights_does_not_depend_on_the_order_of_keypoints_or_their_common_place() -> None:
    left, right = two_views(60)
    model = untrained_lightglue()
    first, i1, i2 = matched(left, right, model)
    assert len(i1) >= 8 and len(np.unique(i2)) == len(i2)

    # the same points, in another order, 30 px further to the right: places are encoded relative to each other
    order = np.random.default_rng(6).permutation(60)
    moved = learned(right.xy[order] + [30, 0], right.descriptors[order].astype(np.float64))
    again, j1, j2 = matched(left, moved, model)
    np.testing.assert_array_equal(i1, j1)
    np.testing.assert_array_equal(i2, order[j2])
    np.testing.assert_allclose(first.probability, again.probability, atol=1e-4)


def test_the_network_of_keypoints_with_frames_takes_them() -> None:
    left, right = (learned(side.xy, side.descriptors.astype(np.float64), PLAIN) for side in two_views(60))
    _, i1, _ = matched(left, right, untrained_lightglue(of_sift=True))
    assert len(i1) >= 8
