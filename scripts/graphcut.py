"""A dense matcher for comparison: graph cuts, which Hao (2011) used.

It makes expansion moves over whole-pixel disparities (Boykov et al., PAMI 2001) on the census costs of semi-global matching.
This is slow, so large pairs are halved until they fit `LARGEST_PX`.  Use it in a site file, with this folder on PYTHONPATH, as
`disparity: {matcher: "graphcut:match_graphcut"}`.  It needs the extra `graphcut`.
"""

from __future__ import annotations

import numpy as np

from wbflow_stages.stereo.census import census_costs
from wbflow_stages.stereo.matcher import DenseMatches, RectifiedPair, halved, mirrored
from wbflow_stages.types import Float32s

LARGEST_PX = 384 * 256
"""Largest number of pixels per image that is matched directly; larger pairs are halved."""
_STEP, _LARGEST_JUMP = 4.0, 2
"""Smoothness penalty per pixel of disparity difference between neighbours, and the difference beyond which it stays constant."""
_CYCLES = 4


def match_graphcut(pair: RectifiedPair) -> DenseMatches:
    """Disparity of both views, in whole pixels of the (possibly halved) matched size.  Raises ImportError without PyMaxflow."""
    if pair.left.size > LARGEST_PX:
        height, width = pair.left.shape
        small = match_graphcut(halved(pair))
        doubled = (np.repeat(np.repeat(a, 2, axis=0), 2, axis=1)[:height, :width] for a in (small.left, small.right))
        left, right = (np.ascontiguousarray(2 * a) for a in doubled)
    else:
        left, right = _left_disparity(pair), np.ascontiguousarray(_left_disparity(mirrored(pair))[:, ::-1])
    return DenseMatches(left, right, np.ones_like(left), np.ones_like(right))


def _left_disparity(pair: RectifiedPair) -> Float32s:
    try:
        from maxflow.fastmin import aexpansion_grid
    except ImportError as error:
        raise ImportError("matcher 'graphcut' needs PyMaxflow: pip install 'wbflow[graphcut]'") from error
    costs = census_costs(pair).astype(np.float64)
    labels = np.arange(costs.shape[2])
    jumps = _STEP * np.minimum(np.abs(labels[:, None] - labels), _LARGEST_JUMP).astype(np.float64)
    best = aexpansion_grid(costs, jumps, max_cycles=_CYCLES, labels=np.argmin(costs, axis=2))
    return np.asarray(pair.disparity_min + best, dtype=np.float32)
