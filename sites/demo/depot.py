"""A container depot: stacks of identical containers in straight rows, seen from masts."""

from __future__ import annotations

import itertools

from .parts import ground
from .parts.movers import traffic
from .parts.street import furniture_textures, street_lamp
from .parts.structures import Box, container
from .render import textures as paint
from .render.cameras import Viewpoint, viewpoint_on_post
from .render.light import light_of
from .render.paint import Rng
from .render.photograph import DemoSite, Night, Shots, photograph
from .render.scene import STATIC, Scene, SceneBuilder

COLUMNS = (-19.5, -13.0, -6.5, 6.5, 13.0, 19.5)
"""Centres of the stacks, metres east, with an aisle in the middle."""
ROWS = (-13.0, -10.4, -1.3, 1.3, 10.4, 13.0)
"""Centres of the stacks, metres north: three blocks of two rows."""
LAMPS = tuple((x, y, 8.5) for x in (-24.0, 0.0, 24.0) for y in (-6.0, 6.0))
"""Positions of the lamps, metres."""
MASTS = (
    (-22.0, -27.0, 10.0), (-10.0, -29.0, 9.0), (1.5, -29.5, 10.5), (12.5, -28.5, 9.4),
    (23.0, -26.0, 10.2), (33.0, -14.0, 9.6), (35.0, 2.0, 10.4), (-33.5, -13.0, 9.8),
)  # fmt: skip
"""Positions of the cameras, metres."""


def containers(shots: Shots) -> DemoSite:
    """Render the depot; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(16.0, 0.0166, 0.06)
    # the first two aisles run between the blocks, the third across them; cars do not turn into that one
    aisles = (((-24.0, -5.8), (24.0, -5.8)), ((-24.0, 5.8), (24.0, 5.8)), ((0.0, -18.0), (0.0, 16.0)))
    outside = ((-24.0, -18.0), (24.0, -18.0))
    still = static_depot(shots.random(1), texel_m)
    walks = (outside, *aisles)
    roads = (outside, *aisles[:2])
    moving = traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=8, walks=walks, cars=3, roads=roads)
    night = Night(tuple(viewpoints()[: shots.cameras]), still, moving, light_of(shots.light, LAMPS))
    return photograph(night, shots, shots.voxel_m(57.6, 0.15))


def viewpoints() -> list[Viewpoint]:
    """Return cameras on masts in the south and at the corners, looking over the stacks."""
    return [
        viewpoint_on_post(k, "mast", (x, y, z), (0.22 * x, -4.0 + 0.05 * y, 2.5), 64.0, -0.14)
        for k, (x, y, z) in enumerate(MASTS)
    ]


def static_depot(rng: Rng, texel_m: float) -> Scene:
    """Return the static parts of the depot; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    slabs = build.add_texture(ground.concrete(rng, 40.0, 30.0, texel_m))
    for x, y in itertools.product((-40.0, 0.0), (30.0, 0.0)):
        build.quad((x, y, 0.0), (40.0, 0, 0), (0, -30.0, 0), slabs)
    far = build.add_texture(ground.concrete(rng, 30.0, 30.0, 3 * texel_m))
    build.quad((-90.0, 90.0, -0.03), (180.0, 0, 0), (0, -180.0, 0), far)

    # Two containers, stamped everywhere: stacks can be told apart by their heights only, and by two odd ones on top.
    usual = build.with_same_textures()
    other = build.with_same_textures()
    container(usual, rng, texel_m, Box(0.0, 0.0, 0, 0.0, 6.06, (0.42, 0.10, 0.05), "KOGGE"))
    container(other, rng, texel_m, Box(0.0, 0.0, 0, 0.0, 6.06, (0.05, 0.16, 0.34), "NORDSEE"))
    stacks = list(itertools.product(COLUMNS, ROWS))
    heights = rng.choice([2, 2, 3], size=len(stacks))
    odd = rng.permutation(len(stacks))[:2]
    for k, (x, y) in enumerate(stacks):
        for level in range(heights[k]):
            is_top = level == heights[k] - 1
            part = other if k in odd and is_top else usual
            build.stamp(part, (x, y, 2.6 * level))

    # What stands around them; the lamps in the middle are lights without posts, which would stand in the crossing.
    look = furniture_textures(build, rng, texel_m)
    for x, y, z in LAMPS:
        if x:
            build.stamp(street_lamp(build, look, height=z), (x, y, 0.0))
    fence = build.add_texture(paint.painted_steel(rng, 20.0, 2.2, 2 * texel_m, (0.20, 0.22, 0.21)))
    shed = build.add_texture(paint.brick_wall(rng, 24.0, 7.0, 1.6 * texel_m, sign="CONTAINERDEPOT SUED"))
    build.box((8.0, 34.0, 0.0), (24.0, 8.0, 7.0), fence, sides=shed)
    build.box((-24.0, 30.0, 0.0), (36.0, 0.12, 2.2), fence)
    for x, y, z in MASTS:
        build.tube((1.015 * x, 1.015 * y, 0.0), 0.12, z + 0.3, look.steel, sides=8)
    return build.build()
