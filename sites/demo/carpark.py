"""A car park: marked bays, cars of one model in few colours, a supermarket behind them, and cameras on posts around it."""

from __future__ import annotations

import itertools

import numpy as np

from .parts.ground import asphalt, lawn, with_lines
from .parts.movers import Way, traffic
from .parts.street import Furniture, car, car_textures, furniture_textures, street_lamp, tree
from .parts.structures import Opening, facade
from .render import textures as paint
from .render.cameras import Viewpoint, viewpoint_on_post
from .render.light import light_of
from .render.paint import Rng
from .render.photograph import DemoSite, Night, Shots, photograph
from .render.scene import STATIC, Scene, SceneBuilder

WIDE, DEEP = 50.0, 36.0
BAY_M, BAYS = 2.5, 18
ROWS = ((-15.0, 1), (-3.6, 1), (1.6, -1), (13.0, -1))
"""For each row of bays: the northing of its middle in metres, and the direction of its cars' noses (1: north, -1: south)."""
LAMPS = tuple((x, y, 6.0) for x in (-18.0, -6.0, 6.0, 18.0) for y in (-9.5, 7.5))
MASTS = (
    (-22.0, -21.0, 5.6), (-8.0, -22.0, 6.2), (7.0, -21.5, 5.4), (21.0, -21.0, 6.0),
    (27.5, -6.0, 5.8), (27.0, 9.0, 6.3), (-27.0, -7.0, 6.0), (-27.5, 8.0, 5.5),
)  # fmt: skip


def carpark(shots: Shots) -> DemoSite:
    """Render the car park; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(14.0, 0.0145, 0.06)
    lanes = (((-23.0, -9.3), (23.0, -9.3)), ((-23.0, 7.3), (23.0, 7.3)))
    still = static_carpark(shots.random(1), texel_m)
    walks = (*lanes, ((-20.0, 16.6), (20.0, 16.6)))
    moving = traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=9, walks=walks, cars=3, roads=lanes)
    night = Night(tuple(viewpoints()[: shots.cameras]), still, moving, light_of(shots.light, LAMPS))
    return photograph(night, shots, shots.voxel_m(48.0))


def viewpoints() -> list[Viewpoint]:
    """Return cameras on posts at the edge, looking over the bays."""
    return [
        viewpoint_on_post(k, "post", (x, y, z), (0.25 * x, 0.5 + 0.1 * y, 0.8), 68.0, -0.15) for k, (x, y, z) in enumerate(MASTS)
    ]


def static_carpark(rng: Rng, texel_m: float) -> Scene:
    """Return the static parts of the car park; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    look = furniture_textures(build, rng, texel_m)
    _ground(build, rng, texel_m, look)
    cars = car_textures(build, rng, texel_m)
    models = [car(build, cars, colour) for colour in range(3)]
    for (y, nose), k in itertools.product(ROWS, range(BAYS)):
        # most cars have one colour, as in a fleet's or a dealer's yard; one bay in six is free
        chance = rng.uniform()
        aside = rng.normal(0, 0.06)
        turn = rng.normal(0, 0.012)
        if chance < 5 / 6:
            if chance < 0.55:
                model = models[0]
            elif chance < 0.72:
                model = models[1]
            else:
                model = models[2]
            x = BAY_M * (k + 0.5 - BAYS / 2)
            build.stamp(model, (x + float(aside), y + float(2 * aside), 0.0), yaw=nose * np.pi / 2 + float(turn))
    _shop(build, rng, texel_m)
    _edge(build, rng, look)
    return build.build()


def _ground(build: SceneBuilder, rng: Rng, texel_m: float, look: Furniture) -> None:
    """Add asphalt with painted bays and arrows, kerbed islands, and grass around."""
    lines: list[Way] = []
    for (y, _), k in itertools.product(ROWS, range(BAYS + 1)):
        x = WIDE / 2 + BAY_M * (k - BAYS / 2)
        top = DEEP / 2 - y
        lines.append(((x, top - 2.5), (x, top + 2.5)))
    for y, x in itertools.product((-9.3, 7.3), (8.0, 20.0, 32.0, 44.0)):
        tip = (x + 2.0, DEEP / 2 - y)
        lines += [((x + back, DEEP / 2 - y + aside), tip) for back, aside in ((0.0, 0.0), (1.3, -0.5), (1.3, 0.5))]
    surface = with_lines(asphalt(rng, WIDE, DEEP, texel_m), np.array(lines, np.float32), 0.11, rng)
    build.quad((-WIDE / 2, DEEP / 2, 0.0), (WIDE, 0, 0), (0, -DEEP, 0), build.add_texture(surface))
    grass = build.add_texture(lawn(rng, 20.0, 20.0, 2 * texel_m))
    build.quad((-70.0, 70.0, -0.05), (140.0, 0, 0), (0, -140.0, 0), grass)
    for y in (-DEEP / 2, DEEP / 2):
        build.box((0.0, y, -0.1), (WIDE + 0.4, 0.2, 0.2), look.stone)
    for x in (-WIDE / 2, WIDE / 2):
        build.box((x, 0.0, -0.1), (0.2, DEEP, 0.2), look.stone)
    for x, (y, _) in itertools.product((-23.6, 23.6), ROWS):
        build.box((x, y, -0.1), (1.6, 4.8, 0.22), look.stone)


def _shop(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Add a long low supermarket behind the northern row."""
    top = 5.4
    width = 42.0
    wall = build.add_texture(paint.painted_steel(rng, width, top, texel_m, (0.52, 0.52, 0.50)))
    sill = build.add_texture(paint.plaster(rng, 3.0, 1.0, texel_m, (0.30, 0.30, 0.31)))
    glass = build.add_texture(paint.window(3.0, 2.6, texel_m))
    doors = build.add_texture(paint.window(4.0, 2.6, texel_m))
    openings = [Opening(2.0 + 4.2 * k, top - 2.8, 3.0, 2.6, glass) for k in (0, 1, 2, 6, 7, 8)]
    openings.append(Opening(18.5, top - 2.9, 4.0, 2.9, doors, depth=0.4))
    facade(build, (-width / 2, 21.0, top), (1, 0, 0), (width, top), wall, openings, sill)
    build.quad((-width / 2, 40.0, top), (width, 0, 0), (0, -19.4, 0), sill)
    build.box((0.0, 20.8, top - 0.5), (width, 0.6, 0.7), sill)
    for x, text, tone in ((-13.0, "FRISCHMARKT", (0.45, 0.04, 0.04)), (11.0, "GETRAENKE", (0.05, 0.15, 0.35))):
        front = build.add_texture(paint.sign_board(rng, 8.0, 1.2, texel_m, (text,), tone, (0.75, 0.74, 0.70)))
        build.box((x, 20.75, 3.6), (8.0, 0.3, 1.2), front)


def _edge(build: SceneBuilder, rng: Rng, look: Furniture) -> None:
    """Add lamps in the lanes' middle, trolley shelters, trees, and the cameras' posts."""
    for x, y, z in LAMPS:
        build.stamp(street_lamp(build, look, height=z), (x, y - 2.6 if y < 0 else y + 2.6, 0.0))
    for x in (-3.75, 11.25):
        for side, y in itertools.product((-1.1, 1.1), (11.2, 14.8)):
            build.beam((x + side, y, 0.0), (x + side, y, 2.2), 0.07, look.steel)
        build.box((x, 13.0, 2.2), (2.4, 4.0, 0.08), look.steel)
    for k, side in itertools.product(range(9), (-31.0, 31.0)):
        height = float(rng.uniform(5.5, 8.0))
        build.stamp(tree(build, rng, look, height=height), (side + float(rng.normal()), -22.0 + 6.5 * k, 0.0))
    for x in np.arange(-26.0, 27.0, 7.5):
        build.stamp(tree(build, rng, look, height=float(rng.uniform(4.5, 6.5))), (float(x), -27.0 + float(rng.normal()), 0.0))
    for x, y, z in MASTS:
        build.tube((1.02 * x, 1.02 * y, 0.0), 0.08, z + 0.3, look.steel, sides=8)
