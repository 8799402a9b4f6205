"""A building site: unfinished brick walls behind scaffolding, piers on a slab, timber, containers; cameras on masts around it."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.structures import Box, Opening, container, facade, heap
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

WIDE, DEEP = 52.0, 40.0
LAMPS = tuple((x, y, 8.0) for x in (-16.0, 0.0, 16.0) for y in (-14.0, 14.0))
MASTS = (
    (-17.0, -15.0, 7.5), (-8.0, -17.5, 8.5), (2.0, -18.0, 7.0), (12.0, -16.5, 9.0),
    (20.0, -8.0, 8.0), (21.0, 3.0, 7.5), (-21.0, -4.0, 8.5), (-19.0, 7.0, 7.8),
)  # fmt: skip


def building(shots: Shots) -> DemoSite:
    """Render the building site; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(18.0, 0.0145, 0.06)
    ways = (((-14.0, -10.0), (14.0, -11.0)), ((-15.0, -8.0), (-14.0, 8.0)), ((2.0, -5.0), (12.0, -4.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_building(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=6, walks=ways),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(44.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the slab."""
    return [viewpoint_on_post(k, "mast", (x, y, z), (0.1 * x, 1.0, 1.0), 68.0, -0.12) for k, (x, y, z) in enumerate(MASTS)]


def static_building(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    earth = build.add_texture(ground.gravel(rng, WIDE, DEEP, texel_m))
    build.quad((-WIDE / 2, DEEP / 2, 0.0), (WIDE, 0, 0), (0, -DEEP, 0), earth)
    slab = build.add_texture(ground.concrete(rng, 22.0, 16.0, texel_m, slab_m=5.5))
    build.box((0.0, 3.0, 0.0), (22.0, 16.0, 0.4), slab)
    _walls(build, rng, texel_m)
    _scaffold(build, rng, texel_m)
    pier = build.add_texture(paint.plaster(rng, 3.0, 3.0, texel_m, (0.42, 0.41, 0.39)))
    rod = build.add_texture(paint.painted_steel(rng, 2.0, 1.0, texel_m, (0.2, 0.1, 0.06)))
    for x in (-7.5, -2.5, 2.5, 7.5):
        build.box((x, -1.5, 0.4), (0.5, 0.5, 2.6), pier)
        for a in (-0.18, 0.18):
            build.beam((x + a, -1.5 + a, 3.0), (x + a, -1.5 + a, 3.8), 0.04, rod)
    timber = build.add_texture(paint.planks(rng, 6.0, 2.0, texel_m, (0.42, 0.3, 0.17)))
    bricks = build.add_texture(paint.brick_wall(rng, 3.0, 2.0, texel_m))
    for k in range(7):
        x = -12.0 + 4.0 * k
        high = float(rng.uniform(0.4, 1.3))
        build.box((x, -8.5 + float(rng.normal(0, 0.4)), 0.0), (3.2 if k % 2 else 1.1, 1.1, high), timber if k % 2 else bricks,
                  yaw=float(rng.normal(0, 0.2)))  # fmt: skip
    container(build, rng, texel_m, Box(-15.5, 8.0, 0, 1.5, 6.06, (0.08, 0.2, 0.34), "BAULOGIS"))
    container(build, rng, texel_m, Box(16.5, 6.0, 0, 1.2, 6.06, (0.45, 0.3, 0.05), "KRANHAUS"))
    heap(build, rng, (15.0, -5.0), 3.0, 1.6, build.add_texture(ground.gravel(rng, 6.0, 6.0, texel_m)))
    return build.build()


def _walls(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """The back wall with six equal openings and an uneven top, and one side wall of the house."""
    wall = build.add_texture(paint.brick_wall(rng, 20.0, 4.5, texel_m))
    sill = build.add_texture(paint.plaster(rng, 2.0, 1.0, texel_m, (0.45, 0.43, 0.4)))
    hole = build.add_texture(paint.cloth(rng, texel_m, (0.03, 0.03, 0.03)))
    openings = [Opening(1.4 + 3.1 * k, 1.4, 1.3, 1.6, hole) for k in range(6)]
    facade(build, np.array([-10.0, 9.0, 4.9]), np.array([1.0, 0.0, 0.0]), (20.0, 4.5), wall, openings, sill)
    for k in range(8):
        high = float(rng.uniform(0.15, 0.9))
        build.box((-8.75 + 2.5 * k, 9.2, 4.9), (2.5, 0.3, high), wall, offset=2.5 * k)
    side = build.add_texture(paint.brick_wall(rng, 9.0, 3.5, texel_m))
    facade(build, np.array([9.5, 9.0, 3.4]), np.array([0.0, -1.0, 0.0]), (9.0, 3.0), side,
           [Opening(3.0, 0.6, 1.2, 1.6, hole)], sill)  # fmt: skip


def _scaffold(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """A scaffold in front of the back wall: standards, ledgers and two decks."""
    steel = build.add_texture(paint.painted_steel(rng, 4.0, 1.0, texel_m, (0.36, 0.37, 0.38)))
    deck = build.add_texture(paint.planks(rng, 20.0, 1.0, texel_m, (0.4, 0.3, 0.18)))
    for x in np.linspace(-10.0, 10.0, 9):
        for y in (7.4, 8.4):
            build.beam((float(x), y, 0.4), (float(x), y, 6.4), 0.07, steel)
    for z in (2.4, 4.4):
        build.box((0.0, 7.9, z), (20.0, 0.9, 0.06), deck)
        build.beam((-10.0, 7.4, z + 1.0), (10.0, 7.4, z + 1.0), 0.06, steel)
