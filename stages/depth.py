"""Depth of one view from the disparities of all its pairs: triangulated, and kept where pairs agree (`fusion.pair_depth`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .contracts.defaults import NOISE_PX
from .contracts.reasons import Reason, Rejected
from .fusion.pair_depth import NoiseModel, fuse_pairs, offset_px, pair_depth
from .rectification.warping import Side
from .types import MOST_PARTNERS, Camera, DepthMap, Disparity, Float32s, Pair, Rectification


def view_depth(
    camera: Camera,
    cameras: Mapping[str, Camera],
    rectifications: Mapping[Pair, Rectification],
    disparities: Mapping[Pair, Disparity],
    *,
    noise_px: float = NOISE_PX,
) -> DepthMap | Rejected:
    """Depth of one view.

    Parameters
    ----------
    camera : the camera of the view itself.
    cameras : the cameras of the views that form pairs with it, by id.
    rectifications, disparities : of the pairs that contain the view; loaded one at a time.  Of more than 32 pairs, those with
        the most pixels that are exact enough are used; `left_out` of the result names the others.
    noise_px : assumed error of a disparity in pixels, standard deviation.
    """
    noise = NoiseModel(noise_px=noise_px)
    # 1. Triangulate each pair; of too many, keep those with the most exact pixels, so that no more than these are in memory.
    estimates: dict[str, tuple[Float32s, Float32s]] = {}
    usable_pixels: dict[str, int] = {}
    left_out: list[str] = []
    for pair in disparities:
        side: Side = 1 if pair[1] in cameras else 2
        partner = pair[2 - side]
        if pair not in rectifications or partner not in cameras or cameras[partner].component != camera.component:
            continue
        estimates[partner] = pair_depth(camera, cameras[partner], rectifications[pair], disparities[pair], side)
        if len(disparities) > MOST_PARTNERS:
            usable_pixels[partner] = int(np.count_nonzero(noise.usable(*estimates[partner])))
        if len(estimates) > MOST_PARTNERS:
            poorest = min(estimates, key=usable_pixels.__getitem__)
            left_out.append(poorest)
            del estimates[poorest]
    if not estimates:
        return Rejected(Reason.NO_PAIR_DEPTH, {"pairs": len(disparities)})

    # 2. Fuse them per pixel.
    partners = list(estimates)
    depths = [depth for depth, _ in estimates.values()]
    gains = [gain for _, gain in estimates.values()]
    fused = fuse_pairs(camera, depths, gains, partners, noise)
    if not np.isfinite(fused.depth).any():
        return Rejected(Reason.NO_PAIR_DEPTH, {"pairs": len(disparities)})

    # 3. Measure how far each two pairs disagree as a whole: a wrong pose shows there.
    offsets: dict[str, float] = {}
    for (a, b), px in offset_px(depths, gains, noise).items():
        offsets[f"{partners[a]}--{partners[b]}"] = px
    return replace(fused, left_out=tuple(left_out), offset_px=offsets)
