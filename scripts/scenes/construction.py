"""A building site: an excavated pit, a raw concrete frame of three storeys, stacks of material, a crane; cameras on masts."""

from __future__ import annotations

from itertools import product

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.structures import Box, container, crane, crates, heap
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

from .rawframe import DEEP, EAST, NORTH, SOUTH, WEST, WIDE, cast, earth, frame, pit
from .shapes import rod

MASTS = ((-20.7, -2.6, 9.2), (-15.1, -13.6, 8.4), (-3.6, -19.7, 10.2), (10.5, -17.2, 8.8), (20.3, -4.4, 9.8))
"""Camera positions in metres, neighbours 30 to 39 degrees apart as seen from the pit."""
LAMPS = (*((1.03 * x, 1.03 * y, z + 0.4) for x, y, z in MASTS), (-9.0, 4.5, 7.0), (6.0, 4.5, 7.0))


def construction(shots: Shots) -> DemoSite:
    """Render the site; it has 5 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(18.0, 0.0145, 0.06)
    walks = (((-9.0, 4.6), (12.0, 4.6)), ((-9.6, -9.0), (-9.4, 4.0)), ((-9.0, -11.0), (12.0, -10.6)), ((12.4, -8.0), (12.6, 6.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_construction(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=7, walks=walks),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(44.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the northern edge of the pit."""
    return [viewpoint_on_post(k, "mast", (x, y, z), (0.08 * x, 0.5, 0.3), 68.0, -0.14) for k, (x, y, z) in enumerate(MASTS)]


def static_construction(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    soil = build.add_texture(earth(rng, WIDE, DEEP, texel_m))
    left, top = -WIDE / 2, DEEP / 2
    beside = ((left, top, -left, NORTH), (left, SOUTH, -left, -top), (left, NORTH, WEST, SOUTH), (EAST, NORTH, -left, SOUTH))
    for x, y, right, bottom in beside:
        build.quad((x, y, 0.0), (right - x, 0, 0), (0, bottom - y, 0), soil, (x - left, top - y))
    far = build.add_texture(ground.lawn(rng, 30.0, 30.0, 2 * texel_m))
    build.quad((-70.0, 70.0, -4.0), (140.0, 0, 0), (0, -140.0, 0), far)
    raw = build.add_texture(cast(rng, 18.0, 10.0, texel_m))
    wood = build.add_texture(paint.planks(rng, 8.0, 3.0, texel_m, (0.42, 0.31, 0.18)))
    steel, rust, red = (build.add_texture(paint.painted_steel(rng, 6.0, 2.0, texel_m, tone))
                        for tone in ((0.36, 0.37, 0.38), (0.20, 0.10, 0.06), (0.45, 0.07, 0.04)))  # fmt: skip
    pit(build, rng, (soil, raw, wood, rust))
    frame(build, rng, texel_m, (raw, wood, steel, red, rust))
    crane(build, rng, (9.4, 9.0), texel_m, height=18.0, reach=17.0, bearing=3.7)
    _material(build, rng, texel_m, (wood, rust, red))
    _around(build, rng, texel_m, steel)
    return build.build()


def _material(build: SceneBuilder, rng: Rng, texel_m: float, look: tuple[int, int, int]) -> None:
    """Stacks of planks, bricks and pipes, bundles of bars, crates, heaps of gravel, office containers."""
    wood, rust, red = look
    bricks = build.add_texture(paint.brick_wall(rng, 4.0, 2.0, texel_m))
    tar = build.add_texture(paint.cloth(rng, texel_m, (0.05, 0.06, 0.07)))
    spots = [(-13.0 + float(rng.normal(0, 0.5)), -7.4 + 1.7 * k) for k in range(7)]
    spots += [(-6.4 + 2.6 * k, -12.2 - 0.2 * (k % 2)) for k in range(6)]
    for k, (x, y) in enumerate(spots):
        size = ((3.4, 1.1), (1.1, 1.0), (2.2, 1.2))[k % 3]
        build.box((x, y, 0.0), (size[0], size[1], 0.14), wood, yaw=0.05 * (k % 4))
        build.box(
            (x, y, 0.14),
            (*size, float(rng.uniform(0.4, 1.1))),
            (wood, bricks, tar)[k % 3],
            yaw=0.05 * (k % 4),
            offset=1.1 * (k % 4),
        )
    for k, level in ((k, high) for high in range(3) for k in range(5 - high)):
        y, z = -3.4 + 0.52 * (k + 0.5 * level), 0.26 + 0.45 * level
        rod(build, (13.4, y, z), (17.6, y, z), 0.26, (red, rust, tar)[(k + level) % 3], sides=12)
    for k in range(12):
        build.beam((12.8, -7.0 + 0.09 * k, 0.1), (18.4, -6.7 + 0.08 * k, 0.1 + 0.06 * (k % 3)), 0.07, rust)
    crates(build, rng, (13.0, 1.6), [wood, bricks], rows=4, levels=2)
    gravel = build.add_texture(ground.gravel(rng, 8.0, 8.0, texel_m))
    for x, y, radius, high in ((-16.5, 7.5, 2.6, 1.7), (14.6, -11.4, 2.8, 1.8), (-9.4, -15.6, 2.4, 1.3)):
        heap(build, rng, (x, y), radius, high, gravel)
    container(build, rng, texel_m, Box(17.6, 9.0, 0, 1.45, 6.06, (0.42, 0.40, 0.34), "BAUBUERO"))
    container(build, rng, texel_m, Box(17.6, 9.0, 1, 1.45, 6.06, (0.10, 0.22, 0.36), "NORDBAU"))
    container(build, rng, texel_m, Box(13.6, 14.5, 0, 0.1, 6.06, (0.44, 0.28, 0.05), "LAGER 2"))


def _around(build: SceneBuilder, rng: Rng, texel_m: float, steel: int) -> None:
    """A hoarding in the north, a fence of bars in the west and east, houses in the background, masts."""
    tones = ((0.40, 0.38, 0.33), (0.16, 0.24, 0.33), (0.34, 0.26, 0.16))
    boards = [build.add_texture(paint.planks(rng, 6.0, 2.1, texel_m, tone)) for tone in tones]
    sign = build.add_texture(
        paint.sign_board(rng, 5.0, 2.6, texel_m, ("NORDBAU", "WOHNEN AM PARK"), (0.62, 0.60, 0.55), (0.05, 0.12, 0.3))
    )
    for k in range(10):
        build.box((-27.0 + 6.0 * k, 20.0, 0.0), (5.96, 0.08, 2.1), boards[(k * k) % 3], yaw=float(rng.normal(0, 0.01)))
    build.box((10.0, 19.8, 1.9), (5.0, 0.1, 2.6), sign)
    for side, y in product((-25.0, 25.0), np.arange(-21.0, 20.0, 3.0)):
        build.box((side, y, 0.0), (0.1, 0.06, 2.0), steel)
        for z in (0.3, 1.1, 1.9):
            build.beam((side, y, z), (side, y + 3.0, z), 0.05, steel)
    for k in range(7):
        wall = build.add_texture(paint.brick_wall(rng, 13.0, 9.0, 2 * texel_m, (1.0, 0.9 + 0.05 * (k % 3), 0.8)))
        build.box((-48.0 + 16.0 * k, 33.0 + 2.0 * (k % 3), -4.0), (13.0, 9.0, 12.0 + 1.5 * (k % 4)), wall)
    for x, y, z in MASTS:
        build.tube((1.03 * x, 1.03 * y, 0.0), 0.12, z + 0.3, steel, sides=8)
