"""Graph cuts can be used as a plug-in dense matcher."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.dots import as_they_are, frame_of, stereo_pair, true_disparity
from wbflow_stages.disparity import match_dense
from wbflow_stages.rectification.warping import disparity_px
from wbflow_stages.types import Disparity


def test_graph_cuts_match_a_small_pair_to_whole_pixels() -> None:
    pytest.importorskip("maxflow")
    left, right = stereo_pair()
    truth = true_disparity(*left.shape)
    rectification = as_they_are(left, right, float(np.floor(truth.min() - 3)), float(np.ceil(truth.max() + 3)))
    found = match_dense(frame_of(left), frame_of(right), rectification, matcher="graphcut:match_graphcut")
    assert isinstance(found, Disparity)
    partner = np.arange(truth.shape[1]) - truth
    inside = (partner > 8) & (partner < truth.shape[1] - 9)
    assert np.mean(np.abs(disparity_px(found, 1) - truth)[inside] <= 1) > 0.85
