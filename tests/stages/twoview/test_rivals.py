"""A second pattern of matches is found where a scene repeats, and only there."""

from dataclasses import replace

import numpy as np
import pytest

from tests.stages.twoview.test_pair_score import GOOD, solid_pair
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.twoview.pair_score import pair_score
from wbflow_stages.twoview.rivals import Rival
from wbflow_stages.types import Features, Geometry, Matches

SHIFT = np.array([260.0, 0])


def repeated(seed: int) -> tuple[Features, Features]:
    """Two views of a solid, of which each image shows a second copy, shifted by the same in both."""
    views = []
    for view in solid_pair(seed, lookalikes=False):
        xy = np.concatenate([view.xy * 0.6, view.xy * 0.6 + SHIFT])
        wobble = np.random.default_rng(seed).normal(0, 0.01, view.descriptors.shape).astype(np.float32)
        again = view.descriptors + wobble
        again /= np.linalg.norm(again, axis=1, keepdims=True)
        views.append(
            replace(
                view,
                xy=xy,
                descriptors=np.concatenate([view.descriptors, again]),
                frames=np.concatenate([view.frames, view.frames]),
                responses=np.concatenate([view.responses, view.responses]),
                tilts=np.concatenate([view.tilts, view.tilts]),
            )
        )
    return views[0], views[1]


def found(left: Features, right: Features) -> Geometry:
    matches = match(left, right)
    assert isinstance(matches, Matches)
    geometry = estimate_geometry(matches, left, right, min_score=-30.0)
    assert isinstance(geometry, Geometry)
    return geometry


def test_what_repeats_has_a_rival_and_what_does_not_has_none() -> None:
    once, twice = found(*solid_pair(3, lookalikes=False)), found(*repeated(3))
    assert once.rival_inliers < 0.02 * once.inliers
    assert twice.rival_inliers > 0.2 * twice.inliers


@pytest.mark.parametrize(
    ("elsewhere", "turned_deg", "ambiguous"), [(0, 0.0, False), (90, 0.0, True), (40, 2.0, False), (40, 90.0, True)]
)
def test_a_rival_with_much_support_leaves_a_pair_undecided(elsewhere: int, turned_deg: float, ambiguous: bool) -> None:
    rival = Rival(elsewhere, elsewhere, turned_deg)
    assert rival.ambiguous(GOOD.inliers) == ambiguous
    score = pair_score(replace(GOOD, angle_deg=20.0, rival=rival))
    assert score == 0 if ambiguous else score > 1


def test_more_rivals_and_less_angle_are_a_lower_score() -> None:
    good = replace(GOOD, angle_deg=20.0, rival=Rival())
    for worse in (replace(good, rival=Rival(inliers=60)), replace(good, angle_deg=2.0)):
        assert pair_score(worse) < pair_score(good)
