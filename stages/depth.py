"""Depth of one view from the disparities of all its pairs: triangulated, and kept where pairs agree (`fusion.pair_depth`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from .fusion.pair_depth import MOST_PAIRS, NoiseModel, apart_px, fuse_pairs, pair_depth, usable_pixels
from .reasons import Reason, Rejected
from .rectification.warping import Side
from .types import Camera, DepthMap, Disparity, Float32s, Pair, Rectification


@dataclass(frozen=True, eq=False)
class _PairDepth:
    """What one pair says of the view."""

    partner: str
    depth: Float32s
    gain: Float32s
    pixels: int
    """How many it knows well enough; 0 where nobody asks."""


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
    camera : of the view itself.
    cameras : of the views that it makes pairs with, by id.
    rectifications, disparities : of the pairs that the view is part of; looked at one at a time.  Of more than 32 those are taken
        that know most pixels well enough; `left_out` of the result names the others.
    noise_px : assumed error of a disparity in pixels, standard deviation.
    """
    noise = NoiseModel(noise_px=noise_px)
    found: list[_PairDepth] = []
    left_out: list[str] = []
    for pair in disparities:
        side: Side = 1 if pair[1] in cameras else 2
        other = pair[2 - side]
        if pair not in rectifications or other not in cameras or cameras[other].component != camera.component:
            continue
        depth, gain = pair_depth(camera, cameras[other], rectifications[pair], disparities[pair], side)
        found.append(_PairDepth(other, depth, gain, usable_pixels(depth, gain, noise) if len(disparities) > MOST_PAIRS else 0))
        if len(found) > MOST_PAIRS:
            worst = min(found, key=lambda pair: pair.pixels)
            found.remove(worst)
            left_out.append(worst.partner)
    if found:
        fused = fuse_pairs(camera, [p.depth for p in found], [p.gain for p in found], [p.partner for p in found], noise)
        if np.isfinite(fused.depth).any():
            apart = apart_px([p.depth for p in found], [p.gain for p in found], noise)
            named = {f"{found[a].partner}--{found[b].partner}": px for (a, b), px in apart.items()}
            return replace(fused, left_out=tuple(left_out), apart_px=named)
    return Rejected(Reason.NO_PAIR_DEPTH, {"pairs": len(disparities)})
