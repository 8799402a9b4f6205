"""Matchers find the same points again in any order, and report when there is nothing to find."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from wbflow_stages.matches import match
from wbflow_stages.types import Features, Float64s, Int64s, Matches, Rejected, View

RNG = np.random.default_rng(7)


def random_features(n: int, rng: np.random.Generator = RNG) -> Features:
    descriptors = rng.random((n, 128)).astype(np.float32) ** 3
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    xy = rng.uniform(0, [640, 480], (n, 2))
    frames = np.repeat(np.eye(2)[None] * 4, n, axis=0)
    ones = np.ones(n, np.float32)
    return Features(xy, frames, descriptors, ones, np.zeros(n, np.uint8), View(640, 480))


def seen_again(left: Features, order: np.ndarray, move: np.ndarray) -> Features:
    """The same keypoints in another order, with slightly different descriptors, moved in the image."""
    noisy = left.descriptors[order] + RNG.normal(0, 0.01, (len(order), 128)).astype(np.float32)
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    ones, plain = left.responses[order], left.tilts[order]
    return Features(left.xy[order] + move, left.frames[order], noisy, ones, plain, left.view)


MATCHERS = ["structural", "hao2011-dominance", "mutual", "kdtree"]


@pytest.mark.parametrize("matcher", MATCHERS)
def test_shuffled_keypoints_are_matched_to_themselves(matcher: str) -> None:
    left = random_features(400)
    order = RNG.permutation(400)
    found = match(left, seen_again(left, order, np.array([5.0, -3.0])), matcher=matcher)
    assert isinstance(found, Matches) and found.matcher == matcher
    assert found.i1 is not None and found.i2 is not None
    assert len(found.i1) >= 390
    assert (order[found.i2] == found.i1).mean() > 0.99
    good = order[found.i2] == found.i1
    np.testing.assert_allclose(found.x2[good] - found.x1[good], np.broadcast_to([5.0, -3.0], (good.sum(), 2)))


@pytest.mark.parametrize("matcher", MATCHERS)
def test_the_same_features_give_the_same_matches(matcher: str) -> None:
    left, right = random_features(300), random_features(300)
    right = Features(**{**vars(right), "descriptors": np.roll(left.descriptors, 3, axis=0)})
    a, b = match(left, right, matcher=matcher), match(left, right, matcher=matcher)
    assert isinstance(a, Matches) and isinstance(b, Matches)
    for one, other in ((a.i1, b.i1), (a.i2, b.i2)):
        assert one is not None and other is not None and one.tobytes() == other.tobytes()


@pytest.mark.parametrize("matcher", ["mutual", "kdtree"])
def test_unrelated_features_are_rejected_with_their_number_of_matches(matcher: str) -> None:
    found = match(random_features(300), random_features(300), matcher=matcher)
    assert isinstance(found, Rejected) and found.figures["matches"] < 8


@pytest.mark.parametrize("matcher", MATCHERS)
def test_too_few_keypoints_are_rejected(matcher: str) -> None:
    assert isinstance(match(random_features(0), random_features(300), matcher=matcher), Rejected)
    assert isinstance(match(random_features(300), random_features(3), matcher=matcher), Rejected)


def test_an_unknown_matcher_is_refused_and_the_known_ones_are_listed() -> None:
    with pytest.raises(ValueError, match="structural, hao2011-dominance, hao2011, mutual, kdtree"):
        match(random_features(20), random_features(20), matcher="foo")


@pytest.mark.parametrize(
    ("matcher", "option", "own"), [("mutual", {"dominance": 2.0}, "ratio"), ("structural", {"ratio": 0.7}, "dominance")]
)
def test_a_parameter_of_another_matcher_is_refused_and_its_own_are_listed(matcher: str, option: dict[str, Any], own: str) -> None:
    with pytest.raises(TypeError, match=f"{matcher!r} does not read .*; its parameters: .*{own}"):
        match(random_features(20), random_features(20), matcher=matcher, **option)


def test_unrelated_features_have_almost_no_structural_matches() -> None:
    found = match(random_features(300), random_features(300))
    assert isinstance(found, Rejected) or len(found.x1) < 25


def test_the_published_dominance_test_never_accepts_hundreds_of_features() -> None:
    left = random_features(400)
    found = match(left, seen_again(left, RNG.permutation(400), np.zeros(2)), matcher="hao2011")
    assert isinstance(found, Rejected)


def repeated_windows(seed: int) -> tuple[Features, Features]:
    """A facade of 12 x 8 equal windows of 4 keypoints each, and 150 distinct ones; an affine map leads to the right view."""
    rng = np.random.default_rng(seed)
    gx, gy = np.meshgrid(np.arange(12) * 50 + 40, np.arange(8) * 55 + 40)
    corners = np.array([[0, 0], [14, 0], [0, 20], [14, 20]])
    windows = (np.column_stack([gx.ravel(), gy.ravel()])[:, None] + corners).reshape(-1, 2).astype(float)
    xy = np.r_[windows + rng.normal(0, 0.3, windows.shape), rng.uniform(0, [640, 480], (150, 2))]
    base = random_features(4 + 150, rng).descriptors
    descriptors = np.r_[np.tile(base[:4], (96, 1)), base[4:]]
    A, shift = np.array([[0.7, 0.05], [-0.1, 0.95]]), np.array([30.0, 40.0])

    def view(points: Float64s, frames: Float64s, order: Int64s) -> Features:
        noisy = np.abs(descriptors[order] + rng.normal(0, 0.02, (len(order), 128)).astype(np.float32))
        noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
        n = len(order)
        ones = np.ones(n, np.float32)
        return Features(points[order], frames[order], noisy, ones, np.zeros(n, np.uint8), View(640, 480))

    n = len(xy)
    frames = np.repeat(np.eye(2)[None] * 4, n, axis=0)
    order = np.arange(n)
    return view(xy, frames, order), view(xy @ A.T + shift + rng.normal(0, 0.3, xy.shape), frames * np.sqrt(0.67), order)


def test_repeated_windows_are_distinguished_by_their_arrangement() -> None:
    left, right = repeated_windows(3)
    structural, mutual = match(left, right), match(left, right, matcher="mutual")
    assert isinstance(structural, Matches) and isinstance(mutual, Matches)
    structural_right, mutual_right = (np.asarray(found.i1 == found.i2) for found in (structural, mutual))
    assert structural_right.mean() > 0.95
    assert structural_right.sum() > 1.8 * mutual_right.sum()


def test_matches_are_one_to_one_and_more_dominance_leaves_fewer() -> None:
    left, right = repeated_windows(4)
    loose, strict = match(left, right), match(left, right, dominance=3.0)
    assert isinstance(loose, Matches) and isinstance(strict, Matches)
    assert loose.i1 is not None and loose.i2 is not None
    assert len(np.unique(loose.i1)) == len(loose.i1) and len(np.unique(loose.i2)) == len(loose.i2)
    assert len(strict.x1) < len(loose.x1)
    assert loose.probability.min() > 0.44 and strict.probability.min() > 0.74


def test_tilted_keypoints_are_used_only_if_plain_matches_are_weak() -> None:
    left, right = repeated_windows(5)
    tilts1, tilts2 = ((np.arange(len(left.xy)) % 5 == rest).astype(np.uint8) for rest in (3, 4))
    left, right = Features(**{**vars(left), "tilts": tilts1}), Features(**{**vars(right), "tilts": tilts2})
    enough, weak = match(left, right, weak_matches=10), match(left, right, weak_matches=10_000)
    assert isinstance(enough, Matches) and isinstance(weak, Matches)
    assert not enough.tilted and weak.tilted
    assert not tilts1[enough.i1].any() and not tilts2[enough.i2].any()
    assert tilts1[weak.i1].any() and tilts2[weak.i2].any() and not (tilts1[weak.i1] & tilts2[weak.i2]).any()
