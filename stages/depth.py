"""Depth of one view from the disparities of all its pairs: triangulated, and kept where pairs agree (`fusion.pair_depth`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

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
    noise_px: float = 0.35,
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
            left_out.append(min(estimates, key=usable_pixels.__getitem__))
            del estimates[left_out[-1]]
    if estimates:
        partners, (depths, gains) = list(estimates), ([estimate[k] for estimate in estimates.values()] for k in (0, 1))
        fused = fuse_pairs(camera, depths, gains, partners, noise)
        if np.isfinite(fused.depth).any():
            differences = {f"{partners[a]}--{partners[b]}": px for (a, b), px in offset_px(depths, gains, noise).items()}
            return replace(fused, left_out=tuple(left_out), offset_px=differences)
    return Rejected(Reason.NO_PAIR_DEPTH, {"pairs": len(disparities)})
