"""Depth of one view from the disparities of all its pairs: triangulated, and kept where pairs agree (`fusion.pair_depth`)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .fusion.pair_depth import NoiseModel, fuse_pairs, pair_depth
from .reasons import Reason, Rejected
from .rectification.warping import Side
from .types import Camera, DepthMap, Disparity, Pair, Rectification


def view_depth(
    camera: Camera,
    cameras: Mapping[str, Camera],
    rectifications: Mapping[Pair, Rectification],
    disparities: Mapping[Pair, Disparity],
    *,
    noise_px: float = 0.35,
) -> DepthMap | Rejected:
    """Depth of one view.

    Parameters
    ----------
    camera
        Of the view itself.
    cameras
        Of the views that it makes pairs with, by id.
    rectifications, disparities
        Of the pairs that the view is part of; looked at one at a time.
    noise_px
        Assumed error of a disparity in pixels, standard deviation.
    """
    depths, gains, partners = [], [], []
    for pair in disparities:
        side: Side = 1 if pair[1] in cameras else 2
        other = pair[2 - side]
        if pair not in rectifications or other not in cameras or cameras[other].component != camera.component:
            continue
        depth, gain = pair_depth(camera, cameras[other], rectifications[pair], disparities[pair], side)
        depths.append(depth)
        gains.append(gain)
        partners.append(other)
    found = fuse_pairs(camera, depths, gains, partners, NoiseModel(noise_px=noise_px)) if depths else None
    if found is None or not np.isfinite(found.depth).any():
        return Rejected(Reason.NO_PAIR_DEPTH, {"pairs": len(disparities)})
    return found
