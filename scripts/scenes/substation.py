"""An electrical switchyard: gantries with wires, rows of insulators, ribbed transformers, a control house; cameras on masts."""

from __future__ import annotations

from itertools import product

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.structures import Opening
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.covers import blobs, stones
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng, Texture, encode, fractal_noise, mix, one_colour, shape_of, smoothstep, weather
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

from .lineside import four_walls
from .rawframe import cast
from .shapes import rod
from .switchgear import PHASES, apparatus, gantries, transformer

WIDE = 54.0
MASTS = ((-18.3, -8.1, 11.6), (-10.9, -16.8, 12.4), (0.2, -20.0, 11.2), (11.0, -16.7, 12.8), (18.6, -7.6, 11.8))
"""Camera positions in metres, neighbours 28 to 31 degrees apart as seen from the middle."""
LAMPS = tuple((1.03 * x, 1.03 * y, z + 0.4) for x, y, z in MASTS)
PATHS = ((0.0, -5.4, 40.0, 1.6), (0.0, 4.6, 40.0, 3.2), (-12.6, -1.0, 1.4, 30.0), (13.2, -1.0, 1.4, 30.0))
"""Concrete paths: middle (east, north), width and depth, in metres."""


def substation(shots: Shots) -> DemoSite:
    """Render the switchyard; it has 5 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(18.0, 0.0145, 0.06)
    walks = (
        ((-12.0, -5.4), (12.0, -5.4)),
        ((-12.0, 4.6), (12.0, 4.6)),
        ((-12.6, -9.0), (-12.6, 6.0)),
        ((13.2, -9.0), (13.2, 6.0)),
    )
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_substation(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=6, walks=walks),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(44.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the middle row of insulators."""
    return [viewpoint_on_post(k, "mast", (x, y, z), (0.08 * x, 0.5, 0.8), 68.0, -0.14) for k, (x, y, z) in enumerate(MASTS)]


def strewn(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint coarse gravel of varying tone: sand that shows through, weeds, dark and pale stones."""
    shape = shape_of(width_m, height_m, texel_m)
    _, tone, relief = stones(rng, shape, texel_m, (0.17, 0.13), 0.02, bond=0.5, jitter=0.3, warp=0.05)
    grain = 1 + 0.16 * tone + 0.12 * relief + 0.2 * fractal_noise(rng, shape, texel_m, 1.5, gain=0.75)
    image = one_colour(shape, (0.22, 0.21, 0.195)) * np.clip(grain, 0.3, 2)[..., None]
    mix(image, (0.34, 0.30, 0.22), 0.7 * smoothstep(0.5, 1.6, fractal_noise(rng, shape, texel_m, 2.5)))
    area = int(width_m * height_m)
    mix(image, (0.08, 0.10, 0.045), 0.8 * blobs(rng, shape, texel_m, count=area // 6, radius_m=0.22))
    for grey in (0.07, 0.42):
        mix(image, (grey, grey, 0.95 * grey), 0.9 * blobs(rng, shape, texel_m, count=area, radius_m=0.08))
    weather(rng, image, texel_m, strength=0.16)
    return encode(image, texel_m)


def static_substation(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    lawn = build.add_texture(ground.lawn(rng, 30.0, 30.0, 2 * texel_m))
    build.quad((-60.0, 60.0, -0.05), (120.0, 0, 0), (0, -120.0, 0), lawn)
    gravel = build.add_texture(strewn(rng, WIDE, WIDE, texel_m))
    build.quad((-WIDE / 2, WIDE / 2, 0.0), (WIDE, 0, 0), (0, -WIDE, 0), gravel)
    slabs = build.add_texture(ground.concrete(rng, 40.0, 4.0, texel_m, slab_m=1.6))
    for k, (x, y, wide, deep) in enumerate(PATHS):
        build.box((x, y, 0.0), (max(wide, deep), min(wide, deep), 0.06), slabs, yaw=np.pi / 2 * (deep > wide), offset=0.3 * k)
    raw = build.add_texture(cast(rng, 12.0, 6.0, texel_m))
    zinc, grey, brown = (build.add_texture(paint.painted_steel(rng, 6.0, 4.0, texel_m, tone))
                         for tone in ((0.40, 0.42, 0.43), (0.25, 0.30, 0.29), (0.20, 0.085, 0.05)))  # fmt: skip
    wire = build.add_texture(paint.cloth(rng, texel_m, (0.06, 0.06, 0.06)))
    gantries(build, (zinc, brown, wire, raw))
    for y, kind in ((-8.6, 0), (-2.6, 1)):
        for k, x in enumerate(PHASES):
            build.stamp(apparatus(build, (zinc, brown, raw, grey), kind if k % 3 else 2), (x, y + 0.04 * (k % 2), 0.0))
    for k, x in enumerate((-8.2, 0.0, 8.2)):
        build.stamp(transformer(build, rng, texel_m, (grey, brown, raw), f"T{k + 1}"), (x, 9.4, 0.0))
        build.box((x + 4.1, 9.4, 0.0), (0.35, 6.0, 4.2), raw, offset=2.3 * k)
    _control_house(build, rng, texel_m, zinc)
    _around(build, rng, texel_m, (zinc, grey, slabs))
    return build.build()


def _control_house(build: SceneBuilder, rng: Rng, texel_m: float, zinc: int) -> None:
    """A brick house with a flat roof, windows and doors."""
    brick = build.add_texture(paint.brick_wall(rng, 8.0, 3.4, texel_m, sign="UW OST"))
    pane, door = (
        build.add_texture(paint.window(1.0, 1.2, texel_m)),
        build.add_texture(paint.planks(rng, 1.2, 2.2, texel_m, (0.1, 0.2, 0.16))),
    )
    holes = [
        Opening(0.6, 0.9, 1.0, 1.2, pane),
        Opening(2.3, 1.2, 1.1, 2.2, door),
        *(Opening(4.2 + 1.6 * k, 0.9, 1.0, 1.2, pane) for k in range(2)),
    ]
    four_walls(build, (17.6, 8.0), (6.0, 8.0, 3.4), brick, holes, zinc)
    build.box((17.6, 8.0, 3.4), (6.6, 8.6, 0.3), build.add_texture(ground.asphalt(rng, 7.0, 9.0, texel_m)), sides=zinc)


def _around(build: SceneBuilder, rng: Rng, texel_m: float, look: tuple[int, int, int]) -> None:
    """Cabinets, cable drums, covers of a trench, a fence with signs, a hedge behind it, masts."""
    zinc, grey, slabs = look
    for k in range(24):
        build.box((-11.4 + 1.0 * k, -6.9, 0.0), (0.94, 0.7, 0.08 + 0.03 * (k % 3 == 0)), slabs, offset=1.7 * k % 30)
    for k, (x, y) in enumerate(((-2.4, -3.4), (1.8, -1.2), (-10.6, -11.0), (3.6, 2.9), (-4.4, 2.8), (10.8, -11.2))):
        build.box((x, y, 0.0), (1.1, 0.6, 1.5), grey, offset=0.9 * k, yaw=float(rng.normal(0, 0.03)))
    wood = build.add_texture(paint.planks(rng, 6.0, 3.0, texel_m))
    for x, y, yaw in ((-16.8, 2.0, 0.4), (-16.2, 5.0, -0.2), (8.6, -13.4, 1.0), (-6.6, -13.8, 0.3)):
        ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        for off, radius, texture in ((-0.5, 0.9, wood), (0.5, 0.9, wood), (0.0, 0.6, grey)):
            for end in (-0.06, 0.06) if radius == 0.9 else (0.0,):
                build.box(np.array([x, y, 0.0]) + (off + end) * ahead, (0.1, 1.7, 1.7), texture, yaw=yaw)
            rod(build, np.array([x, y, 0.9]) - 0.5 * ahead, np.array([x, y, 0.9]) + 0.5 * ahead, 0.6, grey)
    sign = build.add_texture(paint.sign_board(rng, 1.2, 0.9, texel_m, ("HOCH", "SPANNUNG"), (0.6, 0.5, 0.05), (0.03, 0.03, 0.03)))
    for quarter, k in product(range(4), range(16)):
        part = build.with_same_textures()
        part.box((-24.0 + 3.2 * k, 25.0, 0.0), (0.1, 0.1, 2.3), zinc)
        for z in (0.2, 0.9, 1.6, 2.2):
            part.beam((-25.6 + 3.2 * k, 25.0, z), (-22.4 + 3.2 * k, 25.0, z), 0.05, zinc)
        if k % 4 == 1:
            part.box((-22.5 + 3.2 * k, 24.9, 0.9), (1.2, 0.05, 0.9), sign)
        build.stamp(part, quarters=quarter)
    hedge = build.add_texture(paint.leaves(rng, texel_m))
    for k in range(26):
        build.ball((-50.0 + 4.0 * k, 31.0 + 2.0 * (k % 3), 1.5), (3.0, 2.0, 3.0 + 0.7 * (k % 4)), hedge, steps=6)
    for x, y, z in MASTS:
        build.tube((1.03 * x, 1.03 * y, 0.0), 0.12, z + 0.3, zinc, sides=8)
