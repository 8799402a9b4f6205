"""A public square of 40 x 40 m, paved with one tile that repeats exactly, with six cameras 2.5 m high around it.

Where only the ground is visible, tiles match wrong tiles; façades, a fountain and other objects are distinct.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from .parts.ground import asphalt, repeating_tiles
from .parts.movers import traffic
from .parts.street import Furniture, bench, furniture_textures, street_lamp, tree
from .parts.structures import Opening, facade
from .render import textures as paint
from .render.cameras import Viewpoint, principal_shift
from .render.light import light_of
from .render.paint import Colour, Rng, Texture
from .render.photograph import DemoSite, Night, Shots, photograph
from .render.scene import STATIC, WATER, Scene, SceneBuilder

HALF = 20.0
"""Half the side of the square, metres."""
TILE_M = 0.8
"""Side of the paving's tile, metres."""
BEARINGS_DEG = (0.0, 42.0, 98.0, 163.0, 229.0, 295.0)
"""Bearings of the six cameras from the centre, east of south; the first three are 42, 56 and 98 degrees apart."""
LAMPS = ((-11.0, -11.0, 4.6), (11.0, -11.0, 4.6), (11.0, 11.0, 4.6), (-11.0, 11.0, 4.6), (0.0, 16.5, 4.6), (0.0, -16.5, 4.6))
WALKS = (
    ((-11.0, -7.0), (11.0, 6.0)),
    ((-11.0, 8.0), (10.0, -9.0)),
    ((-6.0, -10.0), (-7.0, 16.0)),
    ((7.0, -10.0), (5.0, 12.0)),
    ((-10.0, 5.0), (10.0, 6.0)),
    ((-11.0, -5.5), (11.0, -6.0)),
)
BENCHES = ((-5.5, 1.0, 1.7), (5.4, -1.8, -1.4), (1.5, 6.1, 0.2), (-12.5, -3.5, 1.5), (12.8, 2.2, -1.6), (-2.2, -6.3, 3.0))

# side, from, to (metres along it, as seen from the square), height, kind of wall, its tint, shop
HOUSES: tuple[tuple[int, float, float, float, str, Colour, str], ...] = (
    (0, -20.0, -7.5, 11.5, "brick", (1.0, 1.0, 1.0), "RATSKELLER"),
    (0, -7.5, 5.0, 13.5, "ashlar", (1.0, 1.0, 1.0), "STADTSPARKASSE"),
    (0, 5.0, 16.0, 10.5, "plaster", (0.60, 0.45, 0.24), "APOTHEKE"),
    (1, -16.5, -3.0, 12.0, "plaster", (0.55, 0.52, 0.44), "BUCHHANDLUNG"),
    (1, -3.0, 8.0, 10.0, "brick", (1.15, 0.85, 0.75), "CAFE AM MARKT"),
    (1, 8.0, 20.0, 12.5, "plaster", (0.36, 0.43, 0.38), "REISEN"),
    (2, -20.0, -6.0, 14.0, "ashlar", (0.85, 0.88, 0.95), "RATHAUS"),
    (2, -6.0, 4.5, 11.0, "plaster", (0.62, 0.56, 0.35), "BAECKEREI"),
    (2, 4.5, 15.5, 12.0, "brick", (0.8, 0.9, 1.0), "KAUFHAUS"),
    (3, -17.0, -5.5, 10.5, "plaster", (0.50, 0.30, 0.24), "OPTIK"),
    (3, -5.5, 7.0, 13.0, "brick", (1.0, 0.95, 0.8), "MUSEUM"),
    (3, 7.0, 20.0, 11.0, "plaster", (0.44, 0.47, 0.52), "POST"),
)
WALLS: dict[str, Callable[[Rng, float, float, float, Colour], Texture]] = {
    "brick": paint.brick_wall,
    "ashlar": paint.ashlar,
    "plaster": paint.plaster,
}


def square(shots: Shots) -> DemoSite:
    """Render the square, seen by up to six cameras around it; the first three are 42, 56 and 98 degrees apart.

    Raises ValueError for impossible shots.
    """
    shots.check(len(BEARINGS_DEG))
    texel_m = shots.texel_m(12.0, 0.0125, 0.05)
    still = static_square(shots.random(1), texel_m)
    people = traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=18, walks=WALKS)
    night = Night(tuple(viewpoints()[: shots.cameras]), still, people, light_of(shots.light, LAMPS))
    return photograph(night, shots, shots.voxel_m(38.4))


def viewpoints() -> list[Viewpoint]:
    """Return the six cameras, 2.5 m above the ground, looking down on the square, so that most of each image is paving."""
    found = []
    for k, bearing in enumerate(np.deg2rad(BEARINGS_DEG)):
        # distances and targets vary without a pattern, but are the same in every rendering
        distance = 15.5 + 0.8 * float(np.sin(2.3 * k))
        centre = (distance * float(np.sin(bearing)), -distance * float(np.cos(bearing)), 2.5)
        target = (0.6 * float(np.sin(5.1 * k)), 0.6 * float(np.cos(4.3 * k)), -1.6)
        # lenses differ a little, as real ones of one kind do
        bend = (-0.14 - 0.02 * (k % 3), 0.03, 0.0003, -0.0002, 0.0)
        shift = principal_shift(k)
        found.append(Viewpoint(f"pole-{k + 1}", centre, target, 74.0 + 2.0 * (k % 2), bend, 0.8 * shift[1], shift))
    return found


def static_square(rng: Rng, texel_m: float) -> Scene:
    """Return the static parts of the square; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    _ground(build, rng, texel_m)
    _houses(build, rng, texel_m)
    # random numbers are drawn in this order: textures of later parts depend on it
    look = furniture_textures(build, rng, texel_m)
    _fountain(build, rng, texel_m, look)
    _standing(build, rng, texel_m, look)
    return build.build()


def _ground(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Add 8 x 8 fields of 8 x 8 tiles, edge to edge; a street behind; four iron covers."""
    tiles = build.add_texture(repeating_tiles(rng, TILE_M, 8, 0.5 * texel_m))
    field = 8 * TILE_M
    for i, j in itertools.product(range(-4, 4), range(-4, 4)):
        build.quad((i * field, (j + 1) * field, 0.0), (field, 0, 0), (0, -field, 0), tiles)
    street = build.add_texture(asphalt(rng, 20.0, 20.0, 2 * texel_m))
    build.quad((-60.0, 60.0, -0.02), (120.0, 0, 0), (0, -120.0, 0), street)
    iron = build.add_texture(paint.painted_steel(rng, 1.0, 1.0, texel_m, (0.09, 0.08, 0.07)))
    for x, y in ((-9.3, 3.1), (5.6, -9.4), (10.2, 7.7), (-4.1, -12.3)):
        build.tube((x, y, -0.02), 0.36, 0.023, iron, sides=16)


def _houses(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Add houses around the square, all with the same two windows, each with its own wall, shop and roof."""
    panes = [build.add_texture(paint.window(w, h, texel_m)) for w, h in ((1.1, 1.7), (1.3, 2.0))]
    sill = build.add_texture(paint.plaster(rng, 3.0, 1.0, texel_m, (0.45, 0.43, 0.39)))
    glass = build.add_texture(paint.window(2.4, 2.3, texel_m))
    tiles = build.add_texture(paint.roof_tiles(rng, 14.0, 5.0, 1.5 * texel_m))
    for k, (side, start, end, height, kind, tint, shop) in enumerate(HOUSES):
        width = end - start
        wall = WALLS[kind](rng, width, height, texel_m, tint)
        # every house is built on the northern side, then turned to its own
        house = build.with_same_textures()
        door = build.add_texture(paint.planks(rng, 1.3, 2.4, texel_m, ((0.20, 0.11, 0.06), (0.07, 0.14, 0.10))[k % 2]))
        openings = _openings(width, height, panes[k % 2], glass, door)
        facade(house, (start, HALF, height), (1, 0, 0), (width, height), build.add_texture(wall), openings, sill)
        front = build.add_texture(paint.sign_board(rng, 4.5, 0.7, texel_m, (shop,), tint, (0.05, 0.05, 0.06)))
        house.box((start + 0.5 * width, HALF - 0.08, 3.15), (4.5, 0.12, 0.7), front)
        house.box((start + 0.5 * width, HALF - 0.1, height - 0.35), (width, 0.5, 0.35), sill)
        # the roof, the two side walls and a chimney
        house.quad((start, HALF + 6.0, height + 4.0), (width, 0, 0), (0, -6.3, -4.0), tiles)
        house.quad((end, HALF, height), (0, 8.0, 0), (0, 0, -height), sill)
        house.quad((start, HALF + 8.0, height), (0, -8.0, 0), (0, 0, -height), sill)
        house.box((start + (0.25 + 0.4 * (k % 2)) * width, HALF + 3.0, height + 1.2), (0.9, 0.7, 2.6), sill)
        build.stamp(house, quarters=side)


def _openings(width: float, height: float, pane: int, shop: int, door: int) -> list[Opening]:
    """Return storeys of windows every 2.2 m, two shop windows and a door between them."""
    columns = int((width - 0.8) / 2.2)
    first = 0.5 * (width - 2.2 * columns) + 0.45
    tops = np.arange(height - 5.9, 0.5, -2.75)
    found = [Opening(first + 2.2 * k, float(top), 1.3, 1.75, pane) for top in tops for k in range(columns)]
    middle = 0.5 * width
    found += [Opening(middle + x, height - 2.85, 2.4, 2.3, shop, depth=0.22) for x in (-4.2, 1.8)]
    return [*found, Opening(middle - 0.65, height - 2.4, 1.3, 2.4, door, depth=0.3)]


def _fountain(build: SceneBuilder, rng: Rng, texel_m: float, look: Furniture) -> None:
    """Add an eight-sided basin with water, a pedestal with an inscription, and a figure on it."""
    stone = build.add_texture(paint.ashlar(rng, 14.0, 1.5, texel_m, tint=(0.8, 0.8, 0.82)))
    bronze = build.add_texture(paint.painted_steel(rng, 2.0, 3.0, texel_m, (0.09, 0.15, 0.12)))
    build.tube((0.0, 0.0, 0.0), 2.6, 0.15, stone, sides=8)
    build.tube((0.0, 0.0, 0.15), 2.2, 0.5, stone, sides=8, top=False)
    build.kind = WATER
    build.tube((0.0, 0.0, 0.5), 2.18, 0.05, build.add_texture(paint.cloth(rng, texel_m, (0.05, 0.07, 0.07))), sides=8)
    build.kind = STATIC
    # the rim, as eight beams
    ring = np.linspace(0, 2 * np.pi, 9)
    for a, b in itertools.pairwise(ring):
        build.beam((2.25 * np.cos(a), 2.25 * np.sin(a), 0.66), (2.25 * np.cos(b), 2.25 * np.sin(b), 0.66), 0.22, stone)
    build.box((0.0, 0.0, 0.2), (1.1, 1.1, 1.7), stone, yaw=0.2)
    words = paint.sign_board(rng, 0.9, 0.6, 0.5 * texel_m, ("ANNO", "1887"), (0.20, 0.15, 0.07), (0.02, 0.02, 0.02))
    build.box((0.11, -0.56, 1.0), (0.9, 0.05, 0.6), build.add_texture(words), yaw=0.2)
    build.box((0.0, 0.0, 1.9), (1.3, 1.3, 0.14), look.stone, yaw=0.2)
    # the figure: two legs, a body, a head, one arm raised
    for side in (-0.16, 0.16):
        build.tube((side, 0.05 * side, 2.0), 0.13, 0.95, bronze, sides=9)
    build.ball((0.0, 0.0, 3.3), (0.32, 0.24, 0.55), bronze, steps=7)
    build.ball((0.03, -0.05, 4.0), (0.16, 0.17, 0.21), bronze, steps=6)
    build.beam((0.25, 0.0, 3.6), (0.95, -0.45, 4.25), 0.14, bronze)
    build.beam((-0.28, 0.0, 3.6), (-0.45, -0.25, 2.85), 0.14, bronze)


def _standing(build: SceneBuilder, rng: Rng, texel_m: float, look: Furniture) -> None:
    """Add lamps, benches, trees in tubs, a kiosk, an advertising column, bicycle stands, bollards and the cameras' poles."""
    for x, y, z in LAMPS:
        build.stamp(street_lamp(build, look, height=z), (x, y, 0.0))
    seat = bench(build, look)
    for x, y, yaw in BENCHES:
        build.stamp(seat, (x, y, 0.0), yaw=yaw)
    for x, y in ((-14.2, 8.6), (-9.4, 14.6), (13.8, -7.2), (9.0, 14.2), (-14.6, -13.2)):
        build.tube((x, y, 0.0), 0.7, 0.55, look.stone, sides=12)
        build.stamp(tree(build, rng, look, height=float(rng.uniform(4.6, 5.8))), (x, y, 0.4), yaw=float(rng.uniform(0, 6)))
    green = build.add_texture(paint.planks(rng, 3.0, 2.6, texel_m, (0.06, 0.13, 0.09)))
    build.box((-12.0, -14.6, 0.0), (3.0, 2.2, 2.6), green, yaw=0.5)
    build.box((-12.0, -14.6, 2.6), (3.6, 2.8, 0.15), look.steel, yaw=0.5)
    posters = ("ZIRKUS 3.12.", "OPER: AIDA", "FLOHMARKT SO")
    column = paint.sign_board(rng, 4.0, 2.3, texel_m, posters, (0.6, 0.5, 0.2), (0.3, 0.04, 0.05))
    build.tube((12.2, -13.4, 0.0), 0.64, 2.7, build.add_texture(column), sides=18)
    build.tube((12.2, -13.4, 2.7), 0.75, 0.2, look.steel, sides=18)
    for y in (9.0 + 0.7 * k for k in range(7)):
        # three bars of an arch
        stand = ((14.4, y, 0.0), (14.4, y, 0.8), (15.2, y, 0.8), (15.2, y, 0.0))
        for i, j in ((0, 1), (3, 2), (1, 2)):
            build.beam(stand[i], stand[j], 0.06, look.steel)
    for k in range(9):
        build.tube((-17.5, -14.0 + 3.4 * k, 0.0), 0.13, 0.85, look.steel, sides=9)
    for viewpoint in viewpoints():
        x, y, _ = viewpoint.centre
        # just behind the camera, which must not see its own pole
        build.tube((1.025 * x, 1.025 * y, 0.0), 0.07, 2.8, look.steel, sides=8)
