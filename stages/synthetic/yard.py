"""The demo site: a harbour-like yard seen by up to eight fixed cameras, with exact truth."""

from __future__ import annotations

import numpy as np

from .cameras import MOUNTS, choose_mounts, viewpoint_of
from .layout import static_yard, yard_light
from .movers import movers
from .shooting import Daytime, DemoSite, Night, check_arguments, photograph


def yard(
    cameras: int = 8,
    size: tuple[int, int] = (1280, 720),
    captures: int = 3,
    seed: int = 0,
    light: Daytime = "day",
    *,
    threads: int = 2,
) -> DemoSite:
    """Render the yard.

    Parameters
    ----------
    cameras : int
        How many neighbours of the half ring, 1 to 8.
    size : tuple of int
        Width and height, pixels.
    captures : int
        Of each camera.
    seed : int
        Of textures, movers, exposures and noise.
    light : Daytime
        Afternoon, dusk or night with lamps, or a night without them ("dark").
    threads : int
        Of rendering (the result does not depend on it).

    Raises
    ------
    ValueError
        Impossible arguments.
    """
    check_arguments(size, captures, cameras, len(MOUNTS))
    mounts = choose_mounts(cameras)
    texel_m = float(np.clip(0.0098 * 1280 / size[0], 0.0098, 0.1))
    night = Night(
        viewpoints=tuple(viewpoint_of(mount) for mount in mounts),
        still=static_yard(np.random.default_rng([seed, 1]), texel_m, choose_mounts(len(MOUNTS))),
        traffic=tuple(movers(np.random.default_rng([seed, 2]), max(texel_m, 0.02), captures)),
        lighting=yard_light(light),
    )
    # about two pixels in the middle of the yard
    voxel_m = float(np.clip(round(51.2 / size[0], 2), 0.02, 0.1))
    return photograph(night, size, seed, light, voxel_m, threads)
