"""The standard deviation of a point is about its error, whatever the model of pixel noise believed."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.fusion.certainty import depth_variance
from wbflow_stages.fusion.visibility import CrossCheck
from wbflow_stages.types import DepthMap

ROWS, COLUMNS = 60, 80
EVERYWHERE = np.mgrid[0:ROWS, 0:COLUMNS].reshape(2, -1)


def variance(noise: float, views: int, believed: float, depth: float = 20.0) -> tuple[float, float]:
    """What is said of a view's depth, and what is true, where each pair of views errs by `noise`, a share of the depth."""
    errors = np.random.default_rng(views).normal(0, noise, (views, views, ROWS, COLUMNS))
    pairs = np.triu(np.ones((views, views)), 1)[..., None, None] * errors
    own = (pairs + pairs.swapaxes(0, 1)).sum(axis=1) / (views - 1)  # a view's depth is the mean of its pairs'
    scatter = ((own[1:] - own[0]) ** 2).sum(axis=0).astype(np.float32)
    count = np.full((ROWS, COLUMNS), views - 1, np.uint8)
    flat = np.zeros((ROWS, COLUMNS), np.float32)
    known = np.ones((ROWS, COLUMNS), bool)
    z = np.full((ROWS, COLUMNS), depth, np.float32)
    seen = DepthMap(z, (believed * z).astype(np.float32), flat, flat, known.astype(np.uint32), ("other",), known)
    check = CrossCheck(count, count.astype(np.uint16), count, count, count, count, scatter, flat)
    return float(depth_variance(seen, check, *EVERYWHERE).mean()), float(own[0].var()) * depth**2


@pytest.mark.parametrize("noise", [0.0004, 0.004])
@pytest.mark.parametrize("views", [3, 4, 8])
def test_views_that_share_pairs_show_their_errors_all_the_same(noise: float, views: int) -> None:
    said, true = variance(noise, views, believed=0.001)
    assert np.sqrt(said / true) == pytest.approx(1.0, abs=0.25), "what was believed still counts a little"


def test_one_other_view_says_nothing_for_its_errors_are_the_same() -> None:
    calm, wild = (variance(noise, 2, believed=0.001)[0] for noise in (0.0004, 0.004))
    assert calm == pytest.approx(wild)
    assert 0.5 < np.sqrt(calm) / (0.001 * 20.0) < 1.0


def test_what_was_believed_counts_little_where_views_tell_another_thing() -> None:
    low, high = (variance(0.001, 6, believed)[0] for believed in (0.0003, 0.003))
    assert np.sqrt(high / low) < 1.3
