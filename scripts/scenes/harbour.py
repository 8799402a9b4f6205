"""A quay: a basin with different waves in every image, stone walls, a barge, a portal crane, timber; cameras on both sides."""

from __future__ import annotations

from itertools import product

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.structures import Box, Opening, barrels, container, crates, facade, heap
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, UP, Scene, SceneBuilder, joined

from .afloat import EDGE, FAR, LEVEL, LONG, afloat, barge, water, waves

BACK, TOP = 17.0, 7.5
"""y of the warehouse's front, and its height, in metres."""
LAMPS = tuple((x, y, 8.0) for x in (-18.0, 0.0, 18.0) for y in (-17.0, 12.0))
POLES = (
    (-20.0, -17.5, 8.0), (-9.0, -22.0, 9.5), (4.5, -21.5, 8.5), (17.0, -17.5, 9.0),
    (22.5, -2.5, 8.2), (17.0, 12.5, 9.2), (-16.0, 12.5, 8.6), (-22.0, -1.5, 9.0),
)  # fmt: skip


def harbour(shots: Shots) -> DemoSite:
    """Render the quay; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(POLES))
    texel_m = shots.texel_m(18.0, 0.0145, 0.06)
    ways = (((-18.0, 1.0), (18.0, 1.5)), ((-14.0, 7.0), (14.0, 6.5)), ((-9.0, -17.0), (10.0, -18.0)))
    people = traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=8, walks=ways)
    others = afloat(shots.random(4), max(texel_m, 0.02), shots.captures)
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_harbour(shots.random(1), texel_m),
        traffic=tuple(joined(one, other) for one, other in zip(people, others, strict=True)),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(44.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look at the crane and the barge from both sides of the basin."""
    return [viewpoint_on_post(k, "pole", (x, y, z), (0.1 * x, -1.0, 0.6), 68.0, -0.14) for k, (x, y, z) in enumerate(POLES)]


def static_harbour(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    steel = build.add_texture(paint.painted_steel(rng, 12.0, 3.0, texel_m, (0.10, 0.20, 0.33)))
    rust = build.add_texture(paint.painted_steel(rng, 12.0, 2.0, texel_m, (0.22, 0.11, 0.07)))
    wood = [build.add_texture(paint.planks(rng, 5.0, 2.0, texel_m, c)) for c in ((0.40, 0.29, 0.17), (0.29, 0.22, 0.15))]
    _quays(build, rng, texel_m, rust)
    _warehouse(build, rng, texel_m)
    barge(build, rng, texel_m, wood[1])
    _crane(build, rng, texel_m, steel)
    for x in np.arange(-28.0, 29.0, 7.0):
        for y in (EDGE + 0.7, FAR - 0.7):
            build.tube((float(x), y, 0.0), 0.2, 0.55, rust, sides=10)
            build.ball((float(x), y, 0.58), (0.32, 0.32, 0.14), rust, steps=5)
    for k, (x, y) in enumerate(product((-13.0, -10.8, 8.6, 10.9, 13.2), (6.0, 9.4))):
        for level in range(int(rng.integers(1, 4))):
            size = (1.6 + 0.3 * float(rng.random()), 2.8 + 0.4 * float(rng.random()), 0.62)
            build.box(
                (x, y + float(rng.normal(0, 0.15)), 0.72 * level), size, wood[k % 2], yaw=float(rng.normal(0, 0.05)), offset=k
            )
    for x, y, rows in ((-6.0, 9.5, 4), (2.5, 12.0, 3), (15.0, 1.2, 2), (-16.0, 0.5, 2), (-4.0, -17.5, 3), (9.0, -18.5, 2)):
        crates(build, rng, (x, y), wood, rows=rows, levels=3)
    barrels(build, rng, (6.4, 1.2), [steel, rust], count=7)
    heap(build, rng, (-9.0, 1.2), 2.2, 1.3, build.add_texture(ground.gravel(rng, 5.0, 5.0, texel_m)))
    container(build, rng, texel_m, Box(-1.5, 14.0, 0, 0.05, 6.06, (0.42, 0.09, 0.05), "NORDSUND"))
    container(build, rng, texel_m, Box(17.0, 7.0, 0, 1.5, 6.06, (0.10, 0.27, 0.20), "FAIRWAY"))
    for x, y, z in POLES:
        build.tube((1.03 * x, 1.03 * y, 0.0), 0.12, z + 0.3, steel, sides=8)
    return build.build()


def _quays(build: SceneBuilder, rng: Rng, texel_m: float, rust: int) -> None:
    """Both quays (setts, concrete with three rails, stone walls with fenders), and a static sheet of water."""
    strip = build.add_texture(ground.concrete(rng, LONG, 9.5, texel_m, text="LIEGEPLATZ 3   KRAN 12"))
    build.quad((-LONG / 2, EDGE + 9.5, 0.0), (LONG, 0, 0), (0, -9.5, 0), strip)
    for north, deep in ((BACK, BACK - EDGE - 9.5), (FAR, 13.0)):
        setts = build.add_texture(ground.cobbles(rng, LONG, deep, texel_m))
        build.quad((-LONG / 2, north, 0.0), (LONG, 0, 0), (0, -deep, 0), setts)
    wall = build.add_texture(paint.ashlar(rng, LONG, 3.0, texel_m, (0.75, 0.76, 0.72)))
    for y, east in ((EDGE, LONG), (FAR, -LONG)):
        build.quad((-east / 2, y, 0.0), (east, 0, 0), (0, 0, -3.0), wall)
    for y in (1.6, 7.2, 8.6):
        build.box((0.0, EDGE + y, 0.0), (LONG, 0.09, 0.07), rust)
    fender = build.add_texture(paint.planks(rng, 2.0, 3.0, texel_m, (0.10, 0.08, 0.06)))
    for x in np.arange(-30.0, 31.0, 4.0):
        for y in (EDGE - 0.15, FAR + 0.15):
            build.box((float(x), y, -2.4), (0.35, 0.3, 2.3), fender)
    water(build, waves(build, rng, texel_m), LEVEL - 0.02)


def _warehouse(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """A brick front with doors and many identical windows, and its roof."""
    wide = LONG - 10.0
    wall = build.add_texture(paint.brick_wall(rng, wide, TOP, texel_m, sign="SPEICHER 4  STUECKGUT"))
    sill = build.add_texture(paint.plaster(rng, 3.0, 1.0, texel_m, (0.42, 0.40, 0.36)))
    glass = build.add_texture(paint.window(1.3, 1.5, texel_m))
    tones = ((0.12, 0.22, 0.30), (0.30, 0.12, 0.08), (0.16, 0.25, 0.17))
    doors = [build.add_texture(paint.roller_door(rng, 3.6, 3.4, texel_m, c, str(k + 1))) for k, c in enumerate(tones)]
    openings = [Opening(2.2 + 8.0 * k, TOP - 3.4, 3.6, 3.4, doors[k % 3], depth=0.3) for k in range(7)]
    openings += [Opening(1.2 + 2.7 * k, 1.0, 1.3, 1.5, glass) for k in range(19)]
    facade(build, np.array([-wide / 2, BACK, TOP]), np.array([1.0, 0, 0]), (wide, TOP), wall, openings, sill)
    tiles = build.add_texture(paint.roof_tiles(rng, wide, 7.0, 1.5 * texel_m))
    build.quad((-wide / 2, BACK + 6.0, TOP + 3.0), (wide, 0, 0), (0, -6.4, -3.2), tiles)


def _crane(build: SceneBuilder, rng: Rng, texel_m: float, steel: int) -> None:
    """A portal over the rails with a turning cabin, and a jib with a grab over the barge."""
    yellow = build.add_texture(paint.painted_steel(rng, 5.0, 4.0, texel_m, (0.55, 0.36, 0.03)))
    dark = build.add_texture(paint.cloth(rng, texel_m, (0.04,) * 3))
    south, north, high = EDGE + 1.6, EDGE + 8.6, 6.0
    for x, y in product((0.5, 5.5), (south, north)):
        build.box((x, y, 0.1), (1.7, 0.5, 0.5), dark)
        build.beam((x, y, 0.5), (x + (0.5 if x < 3 else -0.5), y, high), 0.45, steel)
    for y in (south, north):
        build.beam((0.8, y, 2.6), (5.2, y, 2.6), 0.25, steel)
        build.beam((0.8, y, 2.6), (4.9, y, high), 0.18, steel)
    build.box((3.0, 1.1, high), (5.0, 8.0, 0.6), steel)
    build.tube((3.0, 1.0, high + 0.6), 1.0, 0.7, dark)
    build.box((3.0, 1.4, high + 1.3), (2.6, 4.0, 2.2), yellow, front=dark)
    build.box((3.0, 4.0, high + 1.3), (2.4, 1.4, 1.5), dark)
    foot, tip, mast = np.array([3.0, -0.8, high + 1.8]), np.array([1.0, -8.5, 14.5]), np.array([3.0, 1.6, high + 6.0])
    for a in (-0.6, 0.6):
        side = np.array([a, 0.0, 0.0])
        build.beam(foot + side, tip + side / 4, 0.22, yellow)
        build.beam(mast + side - 2.6 * UP, mast + side / 2, 0.2, yellow)
        build.beam(mast, tip + side / 4, 0.06, dark)
    for k in range(7):
        out = np.array([(0.6 - 0.064 * k) * (-1) ** k, 0.0, 0.0])
        build.beam(foot + k / 7 * (tip - foot) + out, foot + (k + 1) / 7 * (tip - foot) - out, 0.1, yellow)
    build.beam(tip, tip - 8.5 * UP, 0.06, dark)
    build.box(tip - 9.6 * UP, (1.6, 1.0, 1.1), dark, yaw=0.4)
