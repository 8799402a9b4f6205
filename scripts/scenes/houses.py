"""A row of identical houses along a street: neighbouring cameras look at the same house, or at the next one."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts.ground import asphalt, lawn, repeating_tiles, with_lines
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.street import Furniture, bench, car, car_textures, furniture_textures, street_lamp, tree
from wbflow_demo.parts.structures import Opening, facade
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, principal_shift
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

PITCH_M, HOUSES = 8.0, 9
"""Width of a house, and number of houses in the row."""
LOOKS = ((-13.5, -8.0), (-10.0, -8.5), (-6.5, -1.0), (-1.5, 0.5), (1.0, 8.5), (6.5, 8.0), (10.0, 15.5), (14.0, 16.5))
"""x (metres east) of each camera, and of the point that it looks at."""
LAMPS = tuple((PITCH_M * k + 4.0, 2.4, 4.6) for k in range(-4, 4))


def houses(shots: Shots) -> DemoSite:
    """Render the street; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(LOOKS))
    texel_m = shots.texel_m(12.0, 0.0125, 0.05)
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_houses(shots.random(1), texel_m),
        traffic=traffic(
            shots.random(2),
            max(texel_m, 0.02),
            shots.captures,
            people=9,
            walks=(((-24.0, 3.3), (24.0, 3.3)), ((-20.0, -6.0), (20.0, -6.0))),
            cars=3,
            roads=(((-22.0, -3.6), (22.0, -3.6)), ((-24.0, -0.9), (24.0, -0.9))),
        ),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(38.4))


def viewpoints() -> list[Viewpoint]:
    """Cameras across the street, about 3.4 m high."""
    found = []
    for k, (x, target) in enumerate(LOOKS):
        shift = principal_shift(k)
        bend = (-0.13 - 0.01 * (k % 3), 0.025, 0.0002, 0.0003, 0.0)
        centre = (x, -8.6 - 0.5 * float(np.sin(1.3 * k)), 3.4 + 0.3 * float(np.cos(2.1 * k)))
        found.append(Viewpoint(f"street-{k + 1}", centre, (target, 7.5, 2.6), 64.0, bend, 0.8 * shift[0], shift))
    return found


def static_houses(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    look = furniture_textures(build, rng, texel_m)
    house = _house(build, rng, texel_m, look)
    first = -(HOUSES // 2)
    for k in range(first, first + HOUSES):
        build.stamp(house, (PITCH_M * k, 0.0, 0.0))
    _street(build, rng, texel_m)
    cars = car_textures(build, rng, texel_m)
    for x, colour in ((-18.0, 0), (-8.6, 0), (-0.5, 2), (7.7, 0), (22.4, 1)):
        build.stamp(car(build, cars, colour), (x, 1.05, 0.0), yaw=np.pi * (colour % 2))
    for x in (-15.0, 10.4):
        build.stamp(bench(build, look), (x, 2.9, 0.0))
    for x in (-30.0, -21.0, 3.2, 19.5, 31.0):
        build.stamp(tree(build, rng, look, height=float(rng.uniform(6.0, 8.5))), (x, 22.0, 0.0))
    for viewpoint in viewpoints():
        x, y, z = viewpoint.centre
        build.tube((x, y - 0.3, 0.0), 0.07, z + 0.3, look.steel, sides=8)
    return build.build()


def _house(build: SceneBuilder, rng: Rng, texel_m: float, look: Furniture) -> SceneBuilder:
    """One house with its front garden, hedge, path, bins and lamp: from x = 0 to `PITCH_M`, with the front at y = 8."""
    part = build.with_same_textures()
    height, deep = 5.6, 9.0
    wall = build.add_texture(paint.brick_wall(rng, PITCH_M, height, texel_m))
    tiles = build.add_texture(paint.roof_tiles(rng, PITCH_M, 6.4, 1.5 * texel_m))
    sill = build.add_texture(paint.plaster(rng, 3.0, 1.0, texel_m, (0.55, 0.53, 0.48)))
    wide, small = (build.add_texture(paint.window(w, h, texel_m)) for w, h in ((2.2, 1.5), (1.1, 1.3)))
    door = build.add_texture(paint.planks(rng, 1.1, 2.2, texel_m, (0.05, 0.12, 0.22)))
    openings = [
        Opening(0.9, 3.15, 2.2, 1.5, wide),
        Opening(5.3, height - 2.2, 1.1, 2.2, door, depth=0.3),
        Opening(0.9, 0.75, 1.1, 1.3, small),
        Opening(2.9, 0.75, 1.1, 1.3, small),
        Opening(5.4, 0.75, 1.1, 1.3, small),
    ]
    facade(part, np.array([0.0, 8.0, height]), np.array([1.0, 0, 0]), (PITCH_M, height), wall, openings, sill)
    part.quad((0.0, 8.0 + deep / 2, height + 3.4), (PITCH_M, 0, 0), (0, -deep / 2 - 0.4, -3.7), tiles)
    part.quad((PITCH_M, 8.0 + deep / 2, height + 3.4), (-PITCH_M, 0, 0), (0, deep / 2 + 0.4, -3.7), tiles)
    part.box((1.7, 11.6, height + 1.5), (0.8, 0.8, 3.0), wall)
    part.box((5.9, 7.5, 2.55), (1.7, 1.1, 0.12), sill)
    part.box((5.85, 7.4, 0.0), (1.5, 1.0, 0.15), sill)
    part.tube((7.8, 7.9, 0.0), 0.05, height, look.steel, sides=7)
    part.beam((0.0, 7.6, height - 0.25), (PITCH_M, 7.6, height - 0.25), 0.14, look.steel)
    grass = build.add_texture(lawn(rng, 5.2, 3.6, texel_m))
    part.quad((0.0, 8.0, 0.02), (5.2, 0, 0), (0, -3.6, 0), grass)
    path = build.add_texture(repeating_tiles(rng, 0.4, 8, texel_m))
    part.quad((5.2, 8.0, 0.02), (PITCH_M - 5.2, 0, 0), (0, -3.6, 0), path)
    part.box((2.6, 4.5, 0.0), (5.2, 0.4, 0.85), look.crown)
    for x in (5.25, 7.9):
        part.box((x, 4.5, 0.0), (0.3, 0.4, 1.1), wall)
    for x in (7.0, 7.45):
        part.box((x, 7.3, 0.0), (0.42, 0.5, 0.95), look.steel)
    part.stamp(tree(build, rng, look, height=2.4), (1.4, 6.2, 0.0))
    part.stamp(street_lamp(build, look, height=4.6), (4.0, 2.4, 0.0))
    return part


def _street(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Pavements of repeating slabs, kerbs, and the carriageway with its broken line."""
    slabs = build.add_texture(repeating_tiles(rng, 0.5, 8, 0.6 * texel_m))
    field = 4.0
    for k in range(-10, 10):
        build.quad((k * field, 4.4, 0.0), (field, 0, 0), (0, -2.2, 0), slabs)
        build.quad((k * field, -4.9, 0.0), (field, 0, 0), (0, -field, 0), slabs)
    stone = build.add_texture(paint.plaster(rng, 6.0, 0.5, texel_m, (0.33, 0.32, 0.30)))
    for y in (2.1, -4.85):
        for k in range(-20, 20):
            build.box((2.0 * k + 1.0, y, -0.1), (1.98, 0.14, 0.12), stone)
    road = asphalt(rng, 40.0, 7.0, texel_m)
    dashes = np.array([[(3.0 * k + 0.4, 3.45), (3.0 * k + 1.9, 3.45)] for k in range(14)], np.float32)
    number = build.add_texture(with_lines(road, dashes, 0.12, rng))
    for x in (-40.0, 0.0):
        build.quad((x, 2.1, -0.04), (40.0, 0, 0), (0, -7.0, 0), number)
    around = build.add_texture(lawn(rng, 20.0, 20.0, 2 * texel_m))
    build.quad((-70.0, 60.0, -0.06), (140.0, 0, 0), (0, -110.0, 0), around)
