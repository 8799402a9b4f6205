"""An airport apron: concrete slabs with painted lines, white aircraft of one type, a terminal; cameras on roof and masts."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.ground import lawn, with_lines
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.street import car, car_textures, furniture_textures, street_lamp
from wbflow_demo.parts.structures import Opening, facade
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

WIDE, DEEP = 90.0, 56.0
STANDS = (-28.0, 0.0, 28.0)
LAMPS = tuple((x, 25.0, 14.0) for x in (-40.0, -14.0, 14.0, 40.0))
MASTS = (
    (-42.0, 26.0, 13.0), (-14.0, 27.0, 10.5), (14.0, 27.0, 11.0), (42.0, 26.0, 13.5),
    (46.0, -6.0, 15.0), (30.0, -33.0, 14.0), (-30.0, -33.0, 14.5), (-46.0, -6.0, 15.5),
)  # fmt: skip


def apron(shots: Shots) -> DemoSite:
    """Render the apron; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(28.0, 0.03, 0.08)
    roads = (((-40.0, -24.0), (40.0, -24.0)), ((-40.0, 22.0), (40.0, 22.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_apron(shots.random(1), texel_m),
        traffic=traffic(
            shots.random(2),
            max(texel_m, 0.02),
            shots.captures,
            people=8,
            walks=(*roads, ((-14.0, -15.0), (-14.0, 18.0))),
            cars=3,
            roads=roads,
        ),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(80.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras on the terminal's roof and on light masts, looking over the stands."""
    return [
        viewpoint_on_post(k, "apron", (x, y, z), (0.2 * x, -2.0 + 0.05 * y, 1.0), 72.0, -0.15)
        for k, (x, y, z) in enumerate(MASTS)
    ]


def static_apron(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    _ground(build, rng, texel_m)
    _stands(build, rng, texel_m)
    _terminal(build, rng, texel_m)
    _service(build, rng, texel_m)
    look = furniture_textures(build, rng, texel_m)
    for x, y, z in LAMPS:
        build.stamp(street_lamp(build, look, height=z), (x, y, 0.0))
    for x, y, z in MASTS[4:]:
        build.tube((1.02 * x, 1.02 * y, 0.0), 0.15, z + 0.3, look.steel, sides=8)
    return build.build()


def _ground(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Slabs with lead-in and stop lines, and grass around."""
    lines = [((0.0, DEEP / 2 + 22.0), (WIDE, DEEP / 2 + 22.0)), ((0.0, 6.0), (WIDE, 6.0))]
    for x in STANDS:
        lines.append(((WIDE / 2 + x, 6.0), (WIDE / 2 + x, DEEP / 2 + 22.0)))
        for y in (10.0, 14.0, 18.0):
            lines.append(((WIDE / 2 + x - 1.5, y), (WIDE / 2 + x + 1.5, y)))
    surface = with_lines(
        ground.concrete(rng, WIDE, DEEP, texel_m, slab_m=7.5), np.array(lines, np.float32), 0.3, rng, (0.55, 0.42, 0.06)
    )
    build.quad((-WIDE / 2, DEEP / 2, 0.0), (WIDE, 0, 0), (0, -DEEP, 0), build.add_texture(surface))
    grass = build.add_texture(lawn(rng, 30.0, 30.0, 3 * texel_m))
    build.quad((-120.0, 120.0, -0.05), (240.0, 0, 0), (0, -240.0, 0), grass)


def _stands(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """On each stand, an aircraft of the same type and its passenger bridge."""
    plane = _aircraft(build, rng, texel_m)
    for k, x in enumerate(STANDS):
        at = (x + float(rng.normal(0, 0.3)), 2.0 + float(rng.normal(0, 0.4)), 0.0)
        build.stamp(plane, at, yaw=float(rng.normal(0, 0.01)))
        bridge = build.add_texture(paint.painted_steel(rng, 12.0, 2.6, texel_m, (0.5, 0.5, 0.48)))
        build.box((x - 4.5, 20.0, 3.4), (2.4, 13.0, 2.6), bridge, yaw=0.12 * (k - 1))
        build.tube((x - 4.5, 15.0, 0.0), 0.4, 3.4, bridge)


def _service(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Cars and carts at random places."""
    looks = car_textures(build, rng, texel_m)
    for k in range(9):
        at = (float(rng.uniform(-40, 40)), float(rng.choice([-20.0, 18.0])) + float(rng.normal()), 0.0)
        build.stamp(car(build, looks, k % 3), at, yaw=float(rng.uniform(0, 6)))
    tarp = [build.add_texture(paint.painted_steel(rng, 3.0, 1.6, texel_m, c)) for c in ((0.4, 0.1, 0.05), (0.1, 0.2, 0.4))]
    for k in range(16):
        x, y = float(rng.uniform(-42, 42)), float(rng.choice([-21.0, -18.0, 16.0]))
        build.box((x, y, 0.3), (2.0, 1.5, 1.5), tarp[k % 2], yaw=float(rng.uniform(0, 3)))


def _aircraft(build: SceneBuilder, rng: Rng, texel_m: float) -> SceneBuilder:
    """An aircraft of 22 m, nose to the north, as a part to stamp."""
    part = build.with_same_textures()
    skin = build.add_texture(paint.plaster(rng, 24.0, 4.0, texel_m, (0.72, 0.72, 0.73)))
    tail = build.add_texture(paint.sign_board(rng, 3.5, 4.0, texel_m, ("WB", "AIR"), (0.05, 0.15, 0.4), (0.7, 0.7, 0.7)))
    dark = build.add_texture(paint.cloth(rng, texel_m, (0.04, 0.04, 0.045)))
    part.ball((0.0, 0.0, 2.6), (1.5, 11.0, 1.5), skin, steps=14)
    for side in (-1, 1):
        part.box((side * 6.0, -0.5, 2.0), (10.0, 2.6, 0.25), skin, yaw=-side * 0.35)
        part.box((side * 2.2, -9.2, 3.2), (3.6, 1.4, 0.15), skin, yaw=-side * 0.3)
        part.ball((side * 4.2, 1.2, 1.3), (0.7, 1.6, 0.7), dark, steps=8)
        part.tube((side * 1.9, -0.5, 0.0), 0.3, 1.6, dark, sides=8)
    part.tube((0.0, 8.0, 0.0), 0.25, 1.6, dark, sides=8)
    part.box((0.0, -9.5, 3.6), (0.3, 2.6, 3.8), tail)
    return part


def _terminal(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """A terminal with two storeys of identical windows, and a board with the number of each stand."""
    top, width = 8.0, 84.0
    wall = build.add_texture(paint.painted_steel(rng, width, top, texel_m, (0.50, 0.50, 0.52)))
    sill = build.add_texture(paint.plaster(rng, 3.0, 1.0, texel_m, (0.30, 0.30, 0.31)))
    glass = build.add_texture(paint.window(3.2, 2.8, texel_m))
    openings = [Opening(1.0 + 4.0 * k, level, 3.2, 2.8, glass) for k in range(20) for level in (0.8, 4.4)]
    facade(build, np.array([-width / 2, 28.5, top]), np.array([1.0, 0, 0]), (width, top), wall, openings, sill)
    build.quad((-width / 2, 50.0, top), (width, 0, 0), (0, -21.5, 0), sill)
    for k, x in enumerate(STANDS):
        front = build.add_texture(paint.sign_board(rng, 3.0, 1.5, texel_m, (f"{k + 11}",), (0.6, 0.5, 0.05), (0.02, 0.02, 0.02)))
        build.box((x, 28.2, 6.4), (3.0, 0.3, 1.5), front, front=front)
