"""A market hall in the middle of a walled green, with cameras on a circle around it: views from different sides look alike.

`hall_4` and `hall_2`, with their light, are bit-identical after a quarter and a half turn, respectively.  `hall` is almost
symmetric, with distinct objects on each side.  The sky is overcast.
"""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.ground import lawn
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.street import bench, car, car_textures, furniture_textures, street_lamp, tree
from wbflow_demo.parts.structures import Opening, facade
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint
from wbflow_demo.render.light import overcast_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.renderer import OPEN_SKY, PreparedScene, SkyGrid, build_atlas, spiral
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

HALF, HEIGHT, EDGE = 8.0, 8.4, 35.6
"""Half the side of the hall, height of its walls, and half the side of the ground, in metres."""
VIEWS, RADIUS, EYE = 12, 26.5, 4.6
LAMPS = tuple((x, y, 4.4) for x, y in ((16.0, -9.5), (9.5, 16.0), (-16.0, 9.5), (-9.5, -16.0)))
WALKS = (
    ((-15.0, -12.0), (15.0, -11.0)),
    ((12.0, -15.0), (11.5, 15.0)),
    ((15.0, 12.0), (-15.0, 11.5)),
    ((-12.0, 15.0), (-12.0, -15.0)),
)


def hall(shots: Shots) -> DemoSite:
    """Render the hall with distinct sides; all halls have 12 cameras, 30 degrees apart.  Raises ValueError for bad shots."""
    return _render(shots, 1)


def hall_2(shots: Shots) -> DemoSite:
    """Render the hall that looks the same after half a turn."""
    return _render(shots, 2)


def hall_4(shots: Shots) -> DemoSite:
    """Render the hall that looks the same after a quarter turn."""
    return _render(shots, 4)


def _render(shots: Shots, symmetry: int) -> DemoSite:
    shots.check(VIEWS)
    texel_m = shots.texel_m(12.0, 0.0125, 0.05)
    still = static_hall(shots.random(1), texel_m, symmetry)
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=still,
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=10, walks=WALKS),
        lighting=overcast_of(shots.light, LAMPS),
        sky=even_sky(still),
    )
    return photograph(night, shots, shots.voxel_m(38.4))


def viewpoints() -> list[Viewpoint]:
    """Twelve cameras on a circle; a quarter turn maps each, including its lens, to its third neighbour."""
    found = []
    for k in range(VIEWS):
        bearing = np.deg2rad(11.0 + 30.0 * (k % 3))
        x, y = RADIUS * float(np.sin(bearing)), -RADIUS * float(np.cos(bearing))
        for _ in range(k // 3):
            x, y = -y, x
        shift = (float(np.sin(2.0 * (k % 3) + 0.5)), float(np.cos(1.7 * (k % 3))))
        bend = (-0.13, 0.025, 0.0003, -0.0002, 0.0)
        found.append(Viewpoint(f"ring-{k + 1:02}", (x, y, EYE), (0.0, 0.0, 4.0), 62.0, bend, 0.7 * shift[0], shift))
    return found


def even_sky(still: Scene) -> SkyGrid:
    """Visibility of the sky, sampled in directions that are invariant under a quarter turn.

    The grid's cells must be invariant as well, and none may lie in a wall: the size of the ground (`EDGE`) ensures both.
    """
    some = spiral(16)
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]], np.float32)
    directions = np.concatenate([some @ np.linalg.matrix_power(quarter, k).T for k in range(4)])
    return PreparedScene(still, overcast_of("day", ()), build_atlas(still.textures), OPEN_SKY).sky_grid(directions)


def static_hall(rng: Rng, texel_m: float, symmetry: int) -> Scene:
    """Everything that stands still; `symmetry`: 4 for four equal sides, 2 for two equal pairs, 1 for distinct objects on each."""
    build = SceneBuilder()
    build.kind = STATIC
    front = _quarter(build, rng, texel_m, portal=True)
    aside = _quarter(build, rng, texel_m, portal=False) if symmetry == 2 else front
    for k in range(4):
        build.stamp(aside if k % 2 else front, quarters=k)
    if symmetry == 1:
        _distinct(build, rng, texel_m)
    return build.build()


def _quarter(build: SceneBuilder, rng: Rng, texel_m: float, *, portal: bool) -> SceneBuilder:
    """The south side, its part of the roof, and the ground in front of it."""
    part = build.with_same_textures()
    stone = build.add_texture(paint.ashlar(rng, 6.0, HEIGHT, texel_m, tint=(0.85, 0.83, 0.8)))
    tint = (1.0, 0.95, 0.9) if portal else (0.85, 0.95, 1.1)
    wall = build.add_texture(paint.brick_wall(rng, 2 * HALF, HEIGHT, texel_m, tint=tint, sign="MARKTHALLE" if portal else ""))
    tall, low = (build.add_texture(paint.window(w, h, texel_m)) for w, h in ((1.3, 3.0), (1.3, 1.2)))
    door = build.add_texture(paint.planks(rng, 2.6, 3.2, texel_m, (0.09, 0.16, 0.12)))
    openings = [Opening(x, HEIGHT - 5.4, 1.3, 3.0, tall) for x in (1.6, 3.9, 10.8, 13.1)]
    openings += [Opening(x, HEIGHT - 1.9, 1.3, 1.2, low) for x in (1.6, 3.9, 10.8, 13.1)]
    middle = Opening(6.7, HEIGHT - 3.2, 2.6, 3.2, door, depth=0.36) if portal else Opening(7.35, HEIGHT - 5.4, 1.3, 3.0, tall)
    facade(part, np.array([-HALF, -HALF, HEIGHT]), np.array([1.0, 0, 0]), (2 * HALF, HEIGHT), wall, [*openings, middle], stone)
    for x in (-7.55, -2.9, 2.9, 7.55):
        part.box((x, -HALF - 0.05, 0.0), (0.7, 0.5, HEIGHT), stone)
    part.box((0.0, -HALF - 0.1, HEIGHT - 0.1), (2 * HALF + 0.5, 0.7, 0.45), stone)
    if portal:
        for k in range(3):
            part.box((0.0, -HALF - 0.9 + 0.3 * k, 0.0), (4.4 - 0.4 * k, 1.8 - 0.5 * k, 0.15 * (k + 1)), stone)
        part.box((0.0, -HALF - 0.6, 3.5), (3.8, 1.5, 0.22), stone)
    _roof(part, build, rng, texel_m, stone)
    _green(part, build, rng, texel_m)
    return part


def _roof(part: SceneBuilder, build: SceneBuilder, rng: Rng, texel_m: float, stone: int) -> None:
    """A slope towards the lantern, a corner turret, and a side of the lantern with its window."""
    tiles = build.add_texture(paint.roof_tiles(rng, 17.0, 7.5, 1.5 * texel_m))
    eaves, ridge = np.array([HALF + 0.3, -HALF - 0.3, HEIGHT + 0.3]), np.array([2.2, -2.2, HEIGHT + 3.2])
    mirror = np.array([-1.0, 1.0, 1.0])
    down = np.array([0.0, -1.0, -0.55]) / np.hypot(1.0, 0.55)
    part.triangle(np.array([eaves * mirror, eaves, ridge]), np.array([1.0, 0, 0]), down, tiles)
    part.triangle(np.array([eaves * mirror, ridge, ridge * mirror]), np.array([1.0, 0, 0]), down, tiles)
    part.box((-HALF, -HALF, 0.0), (1.7, 1.7, HEIGHT + 2.4), stone)
    copper = build.add_texture(paint.painted_steel(rng, 4.0, 4.0, texel_m, (0.16, 0.30, 0.25)))
    for k in range(4):
        turn = np.array([np.cos(np.pi / 4 + np.pi / 2 * k), np.sin(np.pi / 4 + np.pi / 2 * k), 0])
        beside = np.array([-turn[1], turn[0], 0])
        foot, top = np.array([-HALF, -HALF, HEIGHT + 2.4]), np.array([-HALF, -HALF, HEIGHT + 5.0])
        part.triangle(np.array([foot + 1.35 * turn, foot + 1.35 * beside, top]), beside, np.array([0, 0, -1.0]), copper)
    glass = build.add_texture(paint.window(4.0, 1.6, texel_m))
    part.quad((-2.2, -2.2, HEIGHT + 5.0), (4.4, 0, 0), (0, 0, -2.2), glass)
    part.triangle(
        np.array([[-2.6, -2.6, HEIGHT + 5.0], [2.6, -2.6, HEIGHT + 5.0], [0, 0, HEIGHT + 7.4]]),
        np.array([1.0, 0, 0]),
        down,
        copper,
    )


def _green(part: SceneBuilder, build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """A quarter of the ground: cobbles with lawn around them, benches, a lamp, tubs, and the wall and trees at the edge."""
    look = furniture_textures(build, rng, texel_m)
    cobbles = build.add_texture(ground.cobbles(rng, 18.0, 18.0, texel_m))
    grass = build.add_texture(lawn(rng, 18.0, 36.0, 1.6 * texel_m))
    part.quad((0.0, 0.0, 0.0), (18.0, 0, 0), (0, -18.0, 0), cobbles)
    part.quad((18.0, 0.0, 0.0), (EDGE - 18.0, 0, 0), (0, -EDGE, 0), grass)
    part.quad((0.0, -18.0, 0.0), (18.0, 0, 0), (0, 18.0 - EDGE, 0), grass, (0.0, 18.0))
    part.beam((0.0, -18.0, 0.0), (18.0, -18.0, 0.0), 0.24, look.stone)
    part.beam((18.0, 0.0, 0.0), (18.0, -18.0, 0.0), 0.24, look.stone)
    part.stamp(street_lamp(build, look, height=4.4), (16.0, -9.5, 0.0))
    seat = bench(build, look)
    for x, y, yaw in ((5.5, -13.6, 0.1), (11.4, -4.0, 1.5)):
        part.stamp(seat, (x, y, 0.0), yaw=yaw)
    for x in (-3.9, 3.9):
        part.tube((x, -10.2, 0.0), 0.55, 0.6, look.stone, sides=10)
        part.stamp(tree(build, rng, look, height=2.6), (x, -10.2, 0.3))
    wall = build.add_texture(paint.brick_wall(rng, 2 * EDGE - 1.0, 3.0, 1.6 * texel_m))
    part.quad((-EDGE + 0.5, 0.5 - EDGE, 3.0), (2 * EDGE - 1.0, 0, 0), (0, 0, -3.0), wall)
    part.quad((EDGE - 0.5, 0.5 - EDGE, 3.0), (1.0 - 2 * EDGE, 0, 0), (0, 0, -3.0), wall)
    for x in (-27.5, -20.0, -12.0, -4.5, 3.0, 10.5, 18.5, 26.0):
        part.stamp(tree(build, rng, look, height=float(rng.uniform(6.5, 9.0))), (x, -31.0 + float(rng.uniform(-1.5, 1.5)), 0.0))


def _distinct(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Objects that distinguish the sides: boards, two parked cars, a kiosk, a red door, a flag."""
    look = furniture_textures(build, rng, texel_m)
    boards = (("NORDSEITE", "FISCH & FLEISCH"), ("OBST", "GEMUESE"), ("BLUMEN", "SO 8-13 UHR"), ("TROEDEL", "JEDEN SAMSTAG"))
    tones = ((0.62, 0.45, 0.05), (0.05, 0.16, 0.34), (0.42, 0.06, 0.05), (0.12, 0.28, 0.14))
    for k, (lines, tone) in enumerate(zip(boards, tones, strict=True)):
        side = build.with_same_textures()
        front = build.add_texture(paint.sign_board(rng, 2.6, 1.1, texel_m, lines, tone, (0.75, 0.73, 0.68)))
        side.box((1.0 - 0.7 * k, -HALF - 0.42, 5.4), (2.6, 0.08, 1.1), front, front=front)
        build.stamp(side, quarters=k)
    cars = car_textures(build, rng, texel_m)
    build.stamp(car(build, cars, 4), (13.5, 4.5, 0.0), yaw=1.4)
    build.stamp(car(build, cars, 0), (-3.5, 14.5, 0.0), yaw=0.1)
    kiosk = build.add_texture(paint.planks(rng, 2.8, 2.5, texel_m, (0.32, 0.10, 0.07)))
    build.box((-13.0, -4.8, 0.0), (2.8, 2.0, 2.5), kiosk, yaw=1.4)
    build.box((-13.0, -4.8, 2.5), (3.3, 2.5, 0.14), look.steel, yaw=1.4)
    red = build.add_texture(paint.planks(rng, 2.6, 3.2, texel_m, (0.40, 0.05, 0.04)))
    build.box((0.0, -HALF + 0.33, 0.0), (2.5, 0.04, 3.1), red)
    build.tube((7.5, -14.8, 0.0), 0.06, 7.0, look.steel, sides=8)
    flag = build.add_texture(paint.sign_board(rng, 1.8, 1.1, texel_m, ("HAMBURG",), (0.5, 0.04, 0.04), (0.75, 0.74, 0.7)))
    build.quad((7.56, -14.8, 6.9), (1.6, 0.5, -0.1), (0.1, 0, -1.1), flag)
