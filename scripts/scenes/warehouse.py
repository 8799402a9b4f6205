"""A warehouse without a roof: identical rows of shelves filled with boxes; cameras along the walls."""

from __future__ import annotations

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import overcast_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

WIDE, DEEP, HIGH = 32.0, 24.0, 7.5
ROWS, BAYS, LEVELS = (-6.0, 0.0, 6.0), 8, 3
BAY, LEVEL = 2.4, 1.5
"""Length of a bay and height of a level, metres."""
LAMPS = tuple((x, y, 7.0) for x in (-9.0, 0.0, 9.0) for y in (-9.0, -3.0, 3.0, 9.0))
MOUNTS = (
    (-13.0, -11.0, 6.6), (-7.0, -11.4, 6.9), (-1.0, -11.4, 6.5), (5.5, -11.4, 7.0),
    (12.5, -11.0, 6.7), (15.2, -4.0, 6.8), (15.0, 5.0, 6.5), (-15.2, -4.5, 6.9),
)  # fmt: skip


def warehouse(shots: Shots) -> DemoSite:
    """Render the warehouse; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MOUNTS))
    texel_m = shots.texel_m(12.0, 0.0125, 0.05)
    aisles = (((-12.0, -3.0), (12.0, -3.0)), ((-12.0, 3.0), (12.0, 3.0)), ((-12.0, -9.0), (12.0, -9.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_warehouse(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=5, walks=aisles),
        lighting=overcast_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(32.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras high on the walls, looking down into the aisles."""
    return [viewpoint_on_post(k, "wall", (x, y, z), (0.2 * x, 0.5, 1.0), 74.0, -0.15) for k, (x, y, z) in enumerate(MOUNTS)]


def static_warehouse(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    floor = build.add_texture(ground.concrete(rng, WIDE, DEEP, texel_m, slab_m=4.0))
    build.quad((-WIDE / 2, DEEP / 2, 0.0), (WIDE, 0, 0), (0, -DEEP, 0), floor)
    wall = build.add_texture(paint.painted_steel(rng, WIDE, HIGH, texel_m, (0.48, 0.49, 0.47)))
    for corner, right in (
        ((-WIDE / 2, DEEP / 2, HIGH), (WIDE, 0.0, 0.0)),
        ((WIDE / 2, DEEP / 2, HIGH), (0.0, -DEEP, 0.0)),
        ((-WIDE / 2, -DEEP / 2, HIGH), (0.0, DEEP, 0.0)),
        ((WIDE / 2, -DEEP / 2, HIGH), (-WIDE, 0.0, 0.0)),
    ):
        build.quad(corner, right, (0, 0, -HIGH), wall)
    _shelves(build, rng, texel_m)
    door = build.add_texture(paint.roller_door(rng, 4.0, 4.5, texel_m, (0.3, 0.33, 0.36), "3"))
    build.box((-9.0, DEEP / 2 - 0.05, 0.0), (4.0, 0.1, 4.5), door, front=door)
    pallets = build.add_texture(paint.planks(rng, 5.0, 1.5, texel_m, (0.33, 0.25, 0.16)))
    for k in range(9):
        at = (-11.0 + 2.7 * k, float(rng.uniform(-10.4, -9.6)), 0.0)
        build.box(at, (1.2, 0.8, float(rng.uniform(0.15, 0.8))), pallets, yaw=float(rng.normal(0, 0.1)))
    return build.build()


def _shelves(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Three rows of identical bays with blue posts and orange beams; boxes of six kinds, a quarter of the places empty."""
    blue = build.add_texture(paint.painted_steel(rng, 4.0, 5.0, texel_m, (0.06, 0.12, 0.3)))
    orange = build.add_texture(paint.painted_steel(rng, 4.0, 0.5, texel_m, (0.55, 0.2, 0.03)))
    board = build.add_texture(paint.planks(rng, BAY, 1.2, texel_m, (0.42, 0.34, 0.24)))
    words = (("WESER", "12 ST"), ("OBEN",), ("GLAS", "4711"), ("LUEDERS",), ("NR 88", "BREMEN"), ("PUMPEN",))
    tones = ((0.40, 0.29, 0.18), (0.45, 0.36, 0.25), (0.5, 0.48, 0.42), (0.33, 0.22, 0.13), (0.12, 0.2, 0.3), (0.36, 0.1, 0.08))
    kinds = [
        build.add_texture(paint.sign_board(rng, 1.0, 0.9, texel_m, lines, tone, (0.05, 0.05, 0.05)))
        for lines, tone in zip(words, tones, strict=True)
    ]
    length = BAYS * BAY
    for y in ROWS:
        for k in range(BAYS + 1):
            for side in (-0.5, 0.5):
                build.box((k * BAY - length / 2, y + side, 0.0), (0.1, 0.1, LEVELS * LEVEL + 0.6), blue)
        for level in range(1, LEVELS + 1):
            for side in (-0.52, 0.52):
                build.box((0.0, y + side, level * LEVEL - 0.12), (length, 0.06, 0.12), orange)
            build.box((0.0, y, level * LEVEL - 0.03), (length, 1.0, 0.03), board)
        for k in range(BAYS):
            for level in range(LEVELS + 1):
                for place in (-0.6, 0.6):
                    if rng.uniform() < 0.25:
                        continue
                    kind, size = kinds[int(rng.integers(len(kinds)))], rng.uniform((0.8, 0.7, 0.6), (1.05, 0.95, 1.1))
                    at = ((k + 0.5) * BAY - length / 2 + place, y + float(rng.normal(0, 0.03)), level * LEVEL)
                    build.box(at, size, kind, yaw=float(rng.normal(0, 0.03)))
