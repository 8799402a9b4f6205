"""The demo site: a harbour-like yard seen by up to eight fixed cameras, with exact truth."""

from __future__ import annotations

from .cameras import MOUNTS, choose_mounts, viewpoint_of
from .layout import static_yard, yard_light
from .movers import movers
from .shooting import DemoSite, Night, photograph
from .shots import Shots


def yard(shots: Shots) -> DemoSite:
    """Render the yard: up to 8 neighbours of a half ring.  Raises ValueError for impossible shots."""
    shots.check(len(MOUNTS))
    mounts = choose_mounts(shots.cameras)
    texel_m = shots.texel_m(0.0098 * 1280, 0.0098, 0.1)
    night = Night(
        viewpoints=tuple(viewpoint_of(mount) for mount in mounts),
        still=static_yard(shots.random(1), texel_m, choose_mounts(len(MOUNTS)), shots.surfaces),
        traffic=tuple(movers(shots.random(2), max(texel_m, 0.02), shots.captures)),
        lighting=yard_light(shots.light),
    )
    # about two pixels in the middle of the yard
    voxel_m = shots.voxel_m(51.2)
    return photograph(night, shots, voxel_m)
