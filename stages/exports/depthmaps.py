"""Depth of each view as files: float PFM, and 16-bit PNG with a scale."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..fuse import view_depth
from ..fusion.depth import NoiseModel
from ..types import Camera, DepthMap, Disparity, Pair, Rectification
from .rasters import pfm, png, stepped


def pair_depth_map(
    name: str,
    cameras: Mapping[str, Camera],
    rectifications: Mapping[Pair, Rectification],
    disparities: Mapping[Pair, Disparity],
    noise_px: float = NoiseModel.noise_px,
) -> DepthMap | None:
    """Depth of a view that was not refined, from all its pairs; None where it has none.  noise_px: as in `fuse`."""
    return view_depth(name, cameras, rectifications, disparities, NoiseModel(noise_px=noise_px))


def depth_files(depth: DepthMap) -> tuple[dict[str, bytes], float]:
    """Files of the depths that are sure, by suffix, and the steps of the PNG in a unit of length.

    PNG: 0 is unknown, else depth = (value - 1) / steps.  PFM: float32, bottom row first, infinite where unknown.
    """
    # a depth that needs another view to be believed is no answer when this view is looked at alone
    sure = np.where(depth.sure, depth.depth, np.nan).astype(np.float32)
    values, steps = stepped(sure, 0.0)
    return {".png": png(values), ".pfm": pfm(sure)}, steps
