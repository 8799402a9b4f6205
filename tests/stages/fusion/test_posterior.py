"""Which points of a cloud stay."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from wbflow_stages.fusion.posterior import surest


@given(arrays(np.float32, st.integers(1, 200), elements=st.floats(0.5, 1.0, width=32)), st.floats(0.5, 1.0))
def test_the_least_probable_points_go_and_no_more_than_have_to(right: np.ndarray, share: float) -> None:
    kept = surest(right, share)
    assert kept.any()
    if kept.all():
        return
    assert right[kept].min() > right[~kept].max()
    more = right >= right[~kept].max()
    assert right[more].mean(dtype=np.float64) < share
    assert right[kept].mean(dtype=np.float64) >= share or more.sum() > len(right) / 2


def test_a_cloud_that_is_right_stays_as_it_is_and_one_that_is_not_is_right_then() -> None:
    rng = np.random.default_rng(0)
    good, poor = rng.uniform(0.85, 1.0, 1000), rng.uniform(0.5, 1.0, 1000)
    assert surest(good.astype(np.float32), 0.9).all()
    kept = surest(poor.astype(np.float32), 0.8)
    assert 0.55 < kept.mean() < 0.85
    assert abs(poor[kept].mean() - 0.8) < 0.002
