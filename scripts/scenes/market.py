"""An old town's market square: setts, stalls with striped awnings, a column, gabled houses on three sides; cameras all around."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic, van
from wbflow_demo.parts.street import bench, furniture_textures, street_lamp, tree
from wbflow_demo.parts.structures import crates
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Colour, Rng, Texture
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

from .oldtown import House, house, setts, timber_frame
from .stalls import column, fruit, parasol, stall, stripes

EAST, NORTH = 16.0, 15.0
"""Distances of the house fronts from the middle, in metres."""
MOUNTS = (
    (-9.5, -12.0, 6.2), (1.0, -14.0, 5.8), (11.5, -10.5, 6.5), (15.1, 0.8, 7.4),
    (12.4, 12.4, 8.2), (1.4, 14.1, 6.8), (-10.8, 13.3, 8.6), (-15.1, -0.5, 7.0),
)  # fmt: skip
"""Camera positions (metres): three on lamp posts, five on houses, neighbours 40 to 53 degrees apart as seen from the column."""
LAMPS = (*((1.03 * x, 1.03 * y, z + 0.35) for x, y, z in MOUNTS[:3]), (-12.5, 5.5, 4.4), (12.0, 6.5, 4.4), (-3.0, 11.5, 4.4))
PALETTE: tuple[Colour, ...] = (
    (0.36, 0.06, 0.05), (0.07, 0.20, 0.10), (0.08, 0.13, 0.30), (0.52, 0.37, 0.09), (0.44, 0.19, 0.06), (0.47, 0.43, 0.34),
)  # fmt: skip
STALLS = (
    (-9.2, 7.6, 0.1), (-4.6, 6.6, -0.06), (0.6, 7.0, 0.04), (5.4, 6.7, -0.1), (9.6, 8.4, -0.35),
    (-7.6, -6.6, 3.05), (-3.0, -7.2, 3.2), (2.4, -6.5, 3.1), (7.0, -7.0, 3.35),
    (-10.2, -1.6, 1.5), (-10.6, 2.9, 1.66), (10.4, 2.6, -1.5), (10.2, -2.4, -1.62),
)  # fmt: skip
"""East, north (metres) and yaw of the stalls, which face the column."""
WALLS: dict[str, Callable[[Rng, float, float, float, Colour], Texture]] = {
    "timber": timber_frame,
    "plaster": paint.plaster,
    "brick": paint.brick_wall,
}
OCHRE, BLUE, ROSE, PALE, WARM = (0.52, 0.36, 0.16), (0.36, 0.42, 0.50), (0.45, 0.24, 0.18), (0.58, 0.53, 0.44), (1.0, 0.95, 0.9)
ROWS: dict[int, tuple[tuple[float, float, float, bool, str, Colour, str], ...]] = {
    0: ((7.0, 8.6, 4.4, True, "timber", PALE, "ZUM ANKER"), (6.9, 9.4, 4.0, True, "plaster", OCHRE, "BAECKEREI"),
        (9.2, 8.8, 3.6, False, "plaster", BLUE, "RATSKELLER"), (6.9, 8.2, 4.6, True, "brick", WARM, "APOTHEKE")),
    1: ((6.9, 7.8, 4.2, True, "plaster", PALE, "KAESE"), (7.2, 8.4, 4.6, True, "timber", OCHRE, "BUCHLADEN"),
        (6.9, 8.8, 4.2, True, "plaster", ROSE, "WEINSTUBE")),
    3: ((9.2, 8.0, 3.4, False, "brick", WARM, "POST"), (7.0, 8.6, 4.5, True, "timber", PALE, "UHREN"),
        (6.9, 7.6, 4.0, True, "plaster", BLUE, "TUCHE")),
}  # fmt: skip
"""Houses of the north (0), west (1) and east side (3), left to right: width, eaves, roof's rise, gable, wall, colour, shop."""


def market(shots: Shots) -> DemoSite:
    """Render the market; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MOUNTS))
    texel_m = shots.texel_m(14.0, 0.0145, 0.05)
    walks = (((-9.0, 4.3), (9.0, 4.4)), ((-9.0, -4.2), (9.0, -4.3)), ((-7.0, -3.0), (-6.5, 3.0)), ((6.6, 3.0), (7.0, -3.2)),
             ((-12.0, -10.6), (12.0, -9.8)), ((-12.5, 10.8), (11.0, 11.2)), ((-13.4, -8.0), (-13.2, 8.0)))  # fmt: skip
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_market(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=14, walks=walks),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(38.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the foot of the column."""
    names = ("lamp",) * 3 + ("house",) * 5
    places = enumerate(zip(names, MOUNTS, strict=True))
    return [viewpoint_on_post(k, name, (x, y, z), (0.06 * x, 0.06 * y, 1.2), 70.0, -0.15) for k, (name, (x, y, z)) in places]


def static_market(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    build.quad((-20.0, 19.0, 0.0), (40.0, 0, 0), (0, -38.0, 0), build.add_texture(setts(rng, 40.0, 38.0, texel_m)))
    street = build.add_texture(ground.asphalt(rng, 30.0, 30.0, 2 * texel_m))
    build.quad((-60.0, 60.0, -0.05), (120.0, 0, 0), (0, -120.0, 0), street)
    _houses(build, rng, texel_m)
    column(build, rng, texel_m)
    look = furniture_textures(build, rng, texel_m)
    _stalls(build, rng, texel_m, look.steel)
    for x, y, z in LAMPS:
        build.stamp(street_lamp(build, look, height=z), (x, y, 0.0))
    for x, y, z in MOUNTS[3:]:
        out = (EAST - 0.1 if x > 15 else -EAST + 0.1 if x < -15 else 1.06 * x, y if abs(x) > 15 else NORTH - 0.1, z + 0.25)
        build.beam((x, y, z + 0.25), out, 0.08, look.steel)
    seat = bench(build, look)
    for x, y, yaw in ((-3.2, -11.8, 3.0), (5.6, -12.2, 3.2), (-6.4, 12.4, 0.1), (6.4, 12.2, -0.1)):
        build.stamp(seat, (x, y, 0.0), yaw=yaw)
    for k, (x, y) in enumerate(((-16.5, -18.5), (-8.0, -19.0), (0.5, -18.6), (9.0, -19.2), (16.5, -18.4), (-13.4, 11.8))):
        build.tube((x, y, 0.0), 0.7, 0.5, look.stone, sides=10)
        build.stamp(tree(build, rng, look, height=4.2 + 0.4 * (k % 3)), (x, y, 0.3), yaw=1.3 * k)
    for k in range(11):
        build.tube((-15.0 + 3.0 * k, -16.4, 0.0), 0.13, 0.85, look.stone, sides=8)
    return build.build()


def _houses(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """The rows on three sides of the square, and a ring of houses behind them."""
    pane = build.add_texture(paint.window(0.9, 1.45, texel_m))
    stone = build.add_texture(paint.plaster(rng, 3.0, 1.0, texel_m, (0.42, 0.40, 0.35)))
    tiles = build.add_texture(paint.roof_tiles(rng, 12.0, 8.0, 1.5 * texel_m))
    tones: tuple[Colour, ...] = ((0.06, 0.13, 0.08), (0.20, 0.06, 0.04), (0.07, 0.11, 0.18), (0.16, 0.10, 0.05))
    for side, row in ROWS.items():
        x = -NORTH if side == 0 else -13.0 if side == 3 else -8.0
        for k, (width, eaves, rise, gable, kind, colour, shop) in enumerate(row):
            wall = build.add_texture(WALLS[kind](rng, width, eaves, texel_m, colour))
            it = House(width, eaves, rise, wall, tones[(k + side) % 4], gable)
            part, moved = house(build, rng, texel_m, it, (pane, stone, tiles), shop), build.with_same_textures()
            moved.stamp(part, (x, NORTH if side == 0 else EAST, 0.0))
            build.stamp(moved, quarters=side)
            x += width + 0.03
    far = [build.add_texture(paint.plaster(rng, 7.0, 8.0, 2 * texel_m, c)) for c in ((0.50, 0.45, 0.34), (0.46, 0.30, 0.22))]
    for k, (side, along) in enumerate(product((0, 1, 2, 3), np.arange(-36.0, 36.0, 7.2))):
        it = House(7.0, 7.0 + 0.8 * (k % 3), 4.0, far[k % 2], tones[k % 4])
        moved = build.with_same_textures()
        moved.stamp(house(build, rng, 2 * texel_m, it, (pane, stone, tiles)), (float(along), 32.0, 0.0))
        build.stamp(moved, quarters=side)


def _stalls(build: SceneBuilder, rng: Rng, texel_m: float, steel: int) -> None:
    """Thirteen stalls, four parasols, a delivery van, crates."""
    wood = [build.add_texture(paint.planks(rng, 3.0, 1.5, texel_m, c)) for c in ((0.40, 0.29, 0.17), (0.27, 0.20, 0.13))]
    tones = (
        (0.60, 0.24, 0.02),
        (0.48, 0.04, 0.03),
        (0.22, 0.36, 0.05),
        (0.62, 0.50, 0.08),
        (0.30, 0.22, 0.12),
        (0.16, 0.04, 0.12),
    )
    goods = [
        build.add_texture(fruit(rng, texel_m, (tone, tones[k - 2] if k % 3 == 0 else tone), 0.05)) for k, tone in enumerate(tones)
    ]
    for k, (x, y, yaw) in enumerate(STALLS):
        build.stamp(stall(build, rng, texel_m, PALETTE[5 * k % 6], (wood[k % 2], steel, goods)), (x, y, 0.0), yaw=yaw)
    for k, at in enumerate(((4.2, 1.6), (-4.4, -1.9), (-12.4, -8.2), (12.9, -6.8))):
        cloth = build.add_texture(stripes(rng, 3.1, 3.1, texel_m, PALETTE[(2 * k + 1) % 6]))
        parasol(build, (cloth, steel, wood[0], goods[(2 * k + 1) % 6]), at, 0.7 * k)
    white, dark, glass = (
        build.add_texture(paint.painted_steel(rng, 4.0, 3.0, texel_m, c)) for c in ((0.55,) * 3, (0.03,) * 3, (0.05, 0.06, 0.07))
    )
    board = build.add_texture(paint.sign_board(rng, 3.4, 1.9, texel_m, ("OBST", "HANSEN"), (0.6, 0.6, 0.55), (0.05, 0.25, 0.08)))
    van(build, (-1.2, -16.6, 0.0), 0.1, (white, board, dark, glass))
    for x, y in ((2.6, -10.6), (-13.8, 8.8), (12.6, 3.6)):
        crates(build, rng, (x, y), wood, rows=2, levels=2)
