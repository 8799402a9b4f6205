"""The demo yard: a harbour yard seen by up to eight fixed cameras.

It is about 40 x 30 m, x east, y north, z up; the quay and the water lie south."""

from __future__ import annotations

import itertools

import numpy as np

from .parts import ground, weak
from .parts.movers import movers
from .parts.structures import Box, Opening, barrels, container, crane, crates, facade, heap, lamp_post
from .render import textures as paint
from .render.cameras import CENTRE, MOUNTS, choose_mounts
from .render.light import light_of
from .render.paint import Rng
from .render.photograph import DemoSite, Night, Shots, photograph
from .render.scene import GLOWING, STATIC, UP, WATER, Scene, SceneBuilder, axes_of

WALL_TOP = 9.2
"""Height of the northern and eastern walls, metres."""

SHED_TOP = 8.0
"""Height of the western shed, metres."""

LAMPS = (
    (5.0, 28.2, 6.3), (15.0, 28.2, 6.3), (25.0, 28.2, 6.3), (35.0, 28.2, 6.3),
    (38.2, 20.5, 6.3), (1.8, 22.0, 6.0), (13.0, 8.1, 6.8), (28.5, 7.6, 6.8),
)  # fmt: skip

CONTAINERS = (
    # east, north, level, heading, length, paint, shipping line
    Box(17.6, 19.4, 0, 0.07, 6.06, (0.05, 0.14, 0.36), "NORDSEE"),
    Box(17.5, 19.5, 1, 0.12, 6.06, (0.42, 0.07, 0.05), "HANSA LINE"),
    Box(22.4, 17.2, 0, 1.23, 6.06, (0.55, 0.29, 0.03), "KOGGE"),
    Box(33.2, 23.4, 0, -0.22, 6.06, (0.10, 0.30, 0.22), "BALTIKA"),
    Box(33.0, 23.5, 1, -0.18, 6.06, (0.55, 0.53, 0.50), "MEERWIND"),
    Box(31.4, 13.6, 0, 1.46, 12.19, (0.30, 0.05, 0.06), "TRANSHAFEN"),
    Box(9.2, 9.2, 0, -0.4, 6.06, (0.05, 0.22, 0.33), "OSTWIND"),
    Box(20.4, 24.0, 0, -0.05, 6.06, (0.17, 0.18, 0.19), "KONTOR"),
)

# east, north, and number of stacks or drums
CRATES = ((9.8, 28.0, 3), (22.4, 28.2, 3), (37.2, 17.4, 2), (2.4, 19.0, 2), (27.4, 20.6, 2), (10.8, 18.6, 2), (18.0, 15.4, 3))
BARRELS = ((28.0, 28.4, 9), (2.0, 25.5, 7), (24.6, 21.8, 6), (36.6, 27.8, 8), (10.6, 12.2, 5))
WOOD = ((0.36, 0.25, 0.14), (0.27, 0.21, 0.15), (0.42, 0.33, 0.2))
DRUMS = ((0.06, 0.14, 0.34), (0.40, 0.10, 0.04), (0.12, 0.25, 0.14))


def static_yard(rng: Rng, texel_m: float, surfaces: str = "standard") -> Scene:
    """Return the static parts of the yard."""
    build = SceneBuilder()
    build.kind = STATIC
    _ground(build, rng, texel_m, surfaces)
    _buildings(build, rng, texel_m, surfaces)
    for box in CONTAINERS:
        container(build, rng, texel_m, box)
    crane(build, rng, (7.0, 21.5), texel_m, height=10.0, reach=11.0, bearing=0.45)
    _clutter(build, rng, texel_m)
    return build.build()


def _ground(build: SceneBuilder, rng: Rng, texel_m: float, surfaces: str) -> None:
    """Add cobbles (or half asphalt, half snow), the concrete quay with its edge, and the water."""
    east, south = np.array([1.0, 0, 0]), np.array([0, -1.0, 0])
    if surfaces == "weak":
        for x, paving in ((0.0, weak.wet_asphalt), (20.0, weak.snow)):
            build.quad((x, 30.0, 0.0), 20 * east, 24 * south, build.add_texture(paving(rng, 20.0, 24.0, texel_m)))
    else:
        build.quad((0.0, 30.0, 0.0), 40 * east, 24 * south, build.add_texture(ground.cobbles(rng, 40.0, 24.0, texel_m)))
    quay = build.add_texture(ground.concrete(rng, 60.0, 11.0, texel_m, text="FREIHALTEN   KRAN 07   HALT"))
    build.quad((-10.0, 6.0, 0.0), 60 * east, 11 * south, quay)
    build.quad((-10.0, -5.0, 0.0), 60 * east, -1.8 * UP, quay)
    apron = build.add_texture(ground.concrete(rng, 14.0, 30.0, 2 * texel_m))
    for x in (-14.0, 40.0):
        build.quad((x, 36.0, -0.02), 14 * east, 30 * south, apron)
    build.kind = WATER
    build.quad((-150.0, -5.0, -1.8), 340 * east, 150 * south, build.add_texture(ground.water(rng, 30.0, 30.0, 4 * texel_m)))
    build.kind = STATIC


def _buildings(build: SceneBuilder, rng: Rng, texel_m: float, surfaces: str) -> None:
    """Add two similar brick warehouses, a plastered shed opposite, a gatehouse and an office, all with the same window."""
    pane = build.add_texture(paint.window(1.2, 1.8, texel_m))
    stone = build.add_texture(ground.concrete(rng, 2.0, 1.0, texel_m))
    _facades(build, rng, texel_m, pane, stone, surfaces)
    tiles = build.add_texture(paint.roof_tiles(rng, 42.0, 6.6, 1.5 * texel_m))
    build.quad((-1.0, 35.0, WALL_TOP + 3.4), (42.0, 0, 0), (0, -5.5, -3.6), tiles)
    build.quad((45.0, 31.5, WALL_TOP + 3.4), (0, -20.0, 0), (-5.5, 0, -3.6), tiles)
    build.quad((-5.0, 12.4, 10.6), (0, 18.5, 0), (5.4, 0, -2.8), tiles)
    brick = build.add_texture(paint.brick_wall(rng, 7.0, 6.0, texel_m, tint=(0.9, 0.95, 1.0)))
    build.box((-1.5, 8.0, 0.0), (5.4, 6.0, 5.6), stone, sides=brick)
    build.box((41.6, 7.6, 0.0), (5.4, 6.2, 6.6), stone, sides=brick)
    for y in (6.2, 9.4):
        build.box((1.22, y, 2.6), (1.2, 0.06, 1.8), stone, yaw=np.pi / 2, front=pane)
        build.box((38.88, y, 3.2), (1.2, 0.06, 1.8), stone, yaw=-np.pi / 2, front=pane)
    for x in (6.0, 17.0, 31.0):
        build.box((x, 33.0, WALL_TOP), (0.9, 0.7, 4.6), stone, sides=brick)
    steel = build.add_texture(paint.painted_steel(rng, 10.0, 1.0, texel_m, (0.25, 0.26, 0.25)))
    for x in (0.35, 9.85, 20.0, 30.3, 39.5):
        build.tube((x, 29.9, 0.0), 0.07, WALL_TOP, steel, sides=8)
    build.beam((-0.5, 29.75, WALL_TOP), (40.0, 29.75, WALL_TOP), 0.16, steel)
    build.beam((39.75, 12.4, WALL_TOP), (39.75, 30.5, WALL_TOP), 0.16, steel)
    _signs(build, rng, texel_m)


def _facades(build: SceneBuilder, rng: Rng, texel_m: float, pane: int, sill: int, surfaces: str) -> None:
    """Add the walls that close the yard in the north, east and west."""
    colours = ((0.13, 0.24, 0.19), (0.13, 0.24, 0.19), (0.10, 0.16, 0.30), (0.35, 0.33, 0.30), (0.13, 0.24, 0.19))
    doors = [build.add_texture(paint.roller_door(rng, 3.4, 3.4, texel_m, c, str(k + 1))) for k, c in enumerate(colours)]
    gate = build.add_texture(paint.planks(rng, 3.4, 3.4, texel_m))
    if surfaces == "weak":
        north = weak.white_plaster(rng, 40.0, WALL_TOP, texel_m)
        east = weak.white_plaster(rng, 18.0, WALL_TOP, texel_m)
        west = weak.white_plaster(rng, 17.0, SHED_TOP, texel_m)
    else:
        north = paint.brick_wall(rng, 40.0, WALL_TOP, texel_m, sign="WERFT & LAGERHAUS HANSEN")
        east = paint.brick_wall(rng, 18.0, WALL_TOP, texel_m, sign="LAGERHAUS II")
        west = paint.plaster(rng, 17.0, SHED_TOP, texel_m)
    for texture, corner, right, width, leaves in (
        (north, (0.0, 30.0, WALL_TOP), (1.0, 0.0, 0.0), 40.0, [doors[0], gate, doors[1], doors[2]]),
        (east, (40.0, 30.5, WALL_TOP), (0.0, -1.0, 0.0), 18.0, [doors[4], gate]),
        (west, (0.0, 13.0, SHED_TOP), (0.0, 1.0, 0.0), 17.0, [doors[3]]),
    ):
        size = (width, corner[2])
        facade(build, corner, right, size, build.add_texture(texture), _bays(size, pane, leaves), sill)


def _bays(size: tuple[float, float], pane: int, doors: list[int]) -> list[Opening]:
    """Return rows of the same window every 2.5 m; doors, evenly spaced, replace ground-floor windows."""
    width, height = size
    columns = [0.65 + 2.5 * k for k in range(int((width - 0.65) / 2.5))]
    # 1. The doors.
    at = [width * (k + 0.5) / len(doors) - 1.7 for k in range(len(doors))]
    openings = [Opening(x, height - 3.4, 3.4, 3.4, door, depth=0.3) for x, door in zip(at, doors, strict=True)]
    # 2. Rows of windows from the ground floor up, as long as there is wall above them.
    for row in range(int(height / 2.7)):
        top = height - 3.1 - 2.7 * row
        if top <= 0.2:
            continue
        for x in columns:
            beside_doors = all(x + 1.4 < a or x > a + 3.6 for a in at)
            if row > 0 or beside_doors:
                openings.append(Opening(x, top, 1.2, 1.8, pane))
    return openings


def _signs(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Add boards on the façades."""
    boards = (
        ((3.2, 29.86, 4.95), (2.6, 0.06, 0.8), ("LADEZONE A",), (0.60, 0.42, 0.04), (0.03, 0.03, 0.03)),
        ((13.1, 29.86, 3.75), (2.2, 0.06, 0.7), ("TOR 2  EINFAHRT",), (0.05, 0.13, 0.35), (0.7, 0.7, 0.68)),
        ((26.4, 29.86, 3.75), (2.8, 0.06, 0.7), ("RAUCHEN VERBOTEN",), (0.70, 0.69, 0.65), (0.45, 0.03, 0.03)),
        ((36.6, 29.86, 2.0), (1.3, 0.06, 1.6), ("HALLE", "IV", "SUED"), (0.10, 0.28, 0.16), (0.7, 0.7, 0.68)),
    )
    for place, size, lines, colour, ink in boards:
        front = build.add_texture(paint.sign_board(rng, size[0], size[2], texel_m, lines, colour, ink))
        build.box(place, size, front)


def _clutter(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Add crates, drums, a parked lorry, heaps of gravel, bollards, lamps and the cameras' masts."""
    wood = [build.add_texture(paint.planks(rng, 5.0, 1.5, texel_m, tone)) for tone in WOOD]
    stencil = paint.sign_board(rng, 4.0, 1.0, texel_m, ("OBEN", "VORSICHT 40 KG"), (0.38, 0.28, 0.16), (0.05, 0.04, 0.04))
    wood.append(build.add_texture(stencil))
    drums = [build.add_texture(paint.painted_steel(rng, 1.9, 0.9, texel_m, tone)) for tone in DRUMS]
    for x, y, rows in CRATES:
        crates(build, rng, (x, y), wood, rows=rows, levels=3)
    for x, y, count in BARRELS:
        barrels(build, rng, (x, y), drums, count=count)
    _lorry(build, rng, texel_m)
    gravel = build.add_texture(ground.gravel(rng, 4.0, 4.0, texel_m))
    heap(build, rng, (36.2, 20.0), 1.9, 1.3, gravel)
    heap(build, rng, (4.2, 27.8), 1.7, 1.1, gravel)
    for x in np.arange(-6.0, 48.0, 6.0):
        build.tube((float(x), -4.3, 0.0), 0.22, 0.7, drums[1], sides=10)
    steel = build.add_texture(paint.painted_steel(rng, 3.0, 9.0, texel_m, (0.30, 0.31, 0.31)))
    _lamp_holders(build, rng, steel)
    for x, y, z in (mount.centre for mount in MOUNTS):
        outward = np.array([x - CENTRE[0], y - CENTRE[1], 0.0])
        build.tube(np.array([x, y, 0.0]) + 0.45 / np.linalg.norm(outward) * outward, 0.1, z + 0.3, steel, sides=8)


def _lamp_holders(build: SceneBuilder, rng: Rng, steel: int) -> None:
    """Add arms on the walls, two posts, and a bulb just above each light's position."""
    for x, y, z in LAMPS[6:]:
        lamp_post(build, (x, y - 1.1), z + 0.25, steel)
    walls = [(x, 30.0) for x, _, _ in LAMPS[:4]] + [(40.0, LAMPS[4][1]), (0.0, LAMPS[5][1])]
    for (x, y, z), (wall_x, wall_y) in zip(LAMPS[:6], walls, strict=True):
        build.beam((wall_x, wall_y, z + 0.15), (x, y, z + 0.25), 0.08, steel)
    bulb = build.add_texture(paint.cloth(rng, 0.02, (0.9, 0.88, 0.8)))
    build.kind = GLOWING
    for x, y, z in LAMPS:
        build.ball((x, y, z + 0.12), (0.17, 0.17, 0.1), bulb, steps=4)
    build.kind = STATIC


def _lorry(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Add a flatbed lorry parked for the night, with a crate on it."""
    red = build.add_texture(paint.painted_steel(rng, 3.0, 3.0, texel_m, (0.42, 0.06, 0.05)))
    bed = build.add_texture(paint.planks(rng, 5.0, 2.5, texel_m))
    dark = build.add_texture(paint.cloth(rng, texel_m, (0.03, 0.03, 0.035)))
    words = ("MASCHINENTEILE", "HAMBURG  7/12")
    crate = build.add_texture(paint.sign_board(rng, 4.4, 1.4, texel_m, words, (0.40, 0.30, 0.17), (0.06, 0.05, 0.05)))
    build.box((4.6, 10.2, 0.6), (2.3, 1.9, 2.1), red, yaw=1.35)
    build.box((3.75, 6.6, 0.9), (4.9, 2.3, 0.2), bed, yaw=1.35)
    build.box((3.75, 6.4, 1.1), (2.6, 1.8, 1.4), crate, yaw=1.35)
    ahead, left = axes_of(1.35)
    for along, side in itertools.product((3.7, 0.4, -1.1), (-0.95, 0.95)):
        build.ball(np.array([3.75, 6.6, 0.45]) + along * ahead + side * left, (0.46, 0.46, 0.46), dark, steps=7)


def yard_texel_m(shots: Shots) -> float:
    """Return the side of a texel, metres: that of a pixel some ten metres away."""
    return shots.texel_m(0.0098 * 1280, 0.0098, 0.1)


def yard(shots: Shots) -> DemoSite:
    """Render the yard with up to 8 neighbouring cameras of a half ring.  Raises ValueError for impossible shots."""
    shots.check(len(MOUNTS))
    texel_m = yard_texel_m(shots)
    still = static_yard(shots.random(1), texel_m, shots.surfaces)
    moving = tuple(movers(shots.random(2), max(texel_m, 0.02), shots.captures))
    night = Night(choose_mounts(shots.cameras), still, moving, light_of(shots.light, LAMPS))
    # a voxel is about two pixels wide in the middle of the yard
    return photograph(night, shots, shots.voxel_m(51.2))
