"""The matchers find the same points again, whatever their order, and say so when there is nothing to find."""

import numpy as np
import pytest

from wbflow_stages.matches import match
from wbflow_stages.types import Features, Matches, Rejected, View

RNG = np.random.default_rng(7)


def random_features(n: int, rng: np.random.Generator = RNG) -> Features:
    descriptors = rng.random((n, 128)).astype(np.float32) ** 3
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    xy = rng.uniform(0, [640, 480], (n, 2))
    frames = np.repeat(np.eye(2)[None] * 4, n, axis=0)
    return Features(xy, frames, descriptors, np.ones(n, np.float32), np.zeros(n, np.uint8), View(640, 480), keypoints=n)


def seen_again(left: Features, order: np.ndarray, move: np.ndarray) -> Features:
    """The same keypoints in another order, their descriptors a little different, moved in the image."""
    noisy = left.descriptors[order] + RNG.normal(0, 0.01, (len(order), 128)).astype(np.float32)
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    return Features(left.xy[order] + move, left.frames[order], noisy, left.responses[order], left.tilts[order], left.view)


@pytest.mark.parametrize("matcher", ["mutual", "kdtree"])
def test_shuffled_keypoints_find_themselves(matcher):
    left = random_features(400)
    order = RNG.permutation(400)
    found = match(left, seen_again(left, order, np.array([5.0, -3.0])), matcher=matcher)
    assert isinstance(found, Matches) and found.matcher == matcher
    assert len(found.i1) >= 390
    assert (order[found.i2] == found.i1).mean() > 0.99
    good = order[found.i2] == found.i1
    np.testing.assert_allclose(found.x2[good] - found.x1[good], np.broadcast_to([5.0, -3.0], (good.sum(), 2)))


@pytest.mark.parametrize("matcher", ["mutual", "kdtree"])
def test_the_same_features_give_the_same_matches(matcher):
    left, right = random_features(300), random_features(300)
    right = Features(**{**vars(right), "descriptors": np.roll(left.descriptors, 3, axis=0)})
    a, b = match(left, right, matcher=matcher), match(left, right, matcher=matcher)
    assert isinstance(a, Matches) and isinstance(b, Matches)
    assert a.i1.tobytes() == b.i1.tobytes() and a.i2.tobytes() == b.i2.tobytes()


@pytest.mark.parametrize("matcher", ["mutual", "kdtree"])
def test_strangers_are_rejected_with_their_count(matcher):
    found = match(random_features(300), random_features(300), matcher=matcher)
    assert isinstance(found, Rejected) and found.figures["matches"] < 8
    assert isinstance(match(random_features(0), random_features(300), matcher=matcher), Rejected)
