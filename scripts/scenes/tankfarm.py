"""A corner of a refinery: pale tanks behind a bund, racks of parallel pipes, pumps, drums; cameras on poles around it."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.structures import barrels
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

from .shapes import rod, run_of_pipe
from .tanks import gas_tank, pump_house, shell, tank

WIDE = 52.0
LAMPS = tuple((x, y, 8.0) for x in (-13.0, 0.0, 13.0) for y in (-10.0, 4.5))
POLES = (
    (-20.7, 5.9, 10.5), (-21.0, -4.5, 11.0), (-15.6, -14.1, 9.0), (-5.0, -19.9, 8.0),
    (6.5, -20.0, 9.8), (16.2, -12.6, 8.4), (21.1, -4.1, 9.2), (21.0, 6.0, 10.5),
)  # fmt: skip
"""Camera positions in metres, neighbours 27 to 34 degrees apart as seen from the middle, which no tank hides from any of them."""
TANKS = (
    (-7.6, 10.8, 4.2, 7.0, "T-101"), (2.2, 11.4, 3.6, 6.2, "T-102"), (9.6, 10.2, 2.4, 5.2, "T-103"),
    (-11.4, -5.6, 1.8, 2.8, "D-7"), (-13.2, -0.9, 1.4, 2.6, "D-8"), (12.4, -1.2, 1.2, 4.4, "V-20"),
)  # fmt: skip
"""East, north, radius and height of each tank, in metres, and its number."""
FAR = ((-27.0, 31.0, 8.0, 9.0), (-6.0, 36.0, 9.0, 9.5), (17.0, 33.0, 8.0, 8.5), (36.0, 18.0, 7.0, 8.0), (-37.0, 8.0, 6.5, 7.5),
       (37.0, -12.0, 6.5, 8.0), (-36.0, -16.0, 7.0, 8.0))  # fmt: skip


def tankfarm(shots: Shots) -> DemoSite:
    """Render the tank farm; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(POLES))
    texel_m = shots.texel_m(18.0, 0.0145, 0.06)
    ways = (((-9.0, -2.5), (10.0, -3.0)), ((-6.0, -5.5), (6.0, -6.0)), ((7.5, -4.0), (8.0, 1.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_tankfarm(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=5, walks=ways),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(44.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the pipes in the middle."""
    return [viewpoint_on_post(k, "pole", (x, y, z), (0.08 * x, 1.0, 1.0), 68.0, -0.14) for k, (x, y, z) in enumerate(POLES)]


def static_tankfarm(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    earth = build.add_texture(ground.gravel(rng, WIDE, WIDE, texel_m))
    build.quad((-WIDE / 2, WIDE / 2, 0.0), (WIDE, 0, 0), (0, -WIDE, 0), earth)
    lawn = build.add_texture(ground.lawn(rng, 30.0, 30.0, 2 * texel_m))
    build.quad((-56.0, 56.0, -0.05), (112.0, 0, 0), (0, -112.0, 0), lawn)
    pad = build.add_texture(ground.concrete(rng, 26.0, 14.0, texel_m, slab_m=3.5, text="LADEPLATZ 3"))
    build.box((0.0, -3.5, 0.0), (26.0, 14.0, 0.08), pad)
    wall = build.add_texture(ground.concrete(rng, 26.0, 1.2, texel_m, slab_m=2.6))
    for k in (-1, 1):
        build.box((0.0, 11.5 + 5.9 * k, 0.0), (27.0, 0.3, 0.9), wall)
        build.box((13.4 * k, 11.5, 0.0), (11.6, 0.3, 0.9), wall, yaw=np.pi / 2)
    steel = build.add_texture(paint.painted_steel(rng, 4.0, 4.0, texel_m, (0.33, 0.34, 0.34)))
    yellow = build.add_texture(paint.painted_steel(rng, 4.0, 2.0, texel_m, (0.55, 0.40, 0.04)))
    for k, (x, y, radius, high, name) in enumerate(TANKS):
        colour = (0.66, 0.66, 0.63) if k % 2 == 0 else (0.50, 0.52, 0.53)
        tank(build, rng, texel_m, (x, y, radius, high), (colour, name), (wall, steel, yellow))
    for k, (x, y, radius, high) in enumerate(FAR):
        skin = build.add_texture(shell(rng, 2 * np.pi * radius, high, 2 * texel_m, (0.58, 0.58, 0.56), f"T-{201 + k}"))
        build.tube((x, y, 0.0), radius, high, skin, sides=40)
        build.tube((x, y, high - 0.9), radius + 0.2, 0.2, steel, sides=40)
    _pipes(build, rng, texel_m, steel, yellow)
    _loading(build, rng, texel_m, steel)
    for x, y, z in POLES:
        build.tube((1.03 * x, 1.03 * y, 0.0), 0.11, z + 0.3, steel, sides=8)
    return build.build()


def _pipes(build: SceneBuilder, rng: Rng, texel_m: float, steel: int, yellow: int) -> None:
    """A pipe rack of two levels along the bund, pipes from it to the tanks, and pipes with valves on supports across the pad."""
    tones = ((0.55, 0.55, 0.53), (0.42, 0.43, 0.44), (0.46, 0.38, 0.16), (0.17, 0.23, 0.18), (0.29, 0.17, 0.12))
    lag = [build.add_texture(paint.painted_steel(rng, 2.0, 30.0, texel_m, tone)) for tone in tones]
    for x in np.linspace(-15.0, 15.0, 8):
        for y in (1.7, 4.3):
            build.box((float(x), y, 0.0), (0.24, 0.24, 3.5), steel)
        for z in (2.2, 3.3):
            build.beam((float(x), 1.5, z), (float(x), 4.5, z), 0.2, steel)
    for z, ys in ((2.3, (1.95, 2.4, 2.75, 3.1, 3.7, 4.05)), (3.4, (1.9, 2.25, 2.6, 3.2, 3.55, 4.0))):
        for k, y in enumerate(ys):
            radius = (0.16, 0.1, 0.08, 0.2, 0.09, 0.12)[(k + int(z)) % 6]
            rod(build, (-16.5, y, z + radius), (16.5, y, z + radius), radius, lag[(k + int(2 * z)) % 5])
    for k, (x, y, radius, high, _) in enumerate(TANKS[:3]):
        for off, z in ((-0.5, 0.6), (0.5, 0.8)):
            a = (x + off, 3.0 + 0.4 * off, 2.5)
            run_of_pipe(build, [a, (x + off, 5.0, 2.5), (x + off, 5.0, z + 0.6), (x + off, 6.4, z + 0.6), (x + off, 6.4, z),
                                (x + off, y - radius + 0.1, z)], 0.12 + 0.03 * k, lag[k])  # fmt: skip
        run_of_pipe(build, [(x - radius - 0.25, y, 0.4), (x - radius - 0.25, y, high + 0.6), (x, y, high + 0.9)], 0.08, lag[4])
    for k, x in enumerate((-4.6, -4.1, -3.7, -3.2, -2.5, 4.0, 4.5, 5.2)):
        y = -7.0 - 0.3 * k
        path = [(x, 2.2, 2.4), (x, 0.4, 2.4), (x, 0.4, 0.45), (x, y, 0.45), (x, y, 0.1)]
        run_of_pipe(build, path, 0.09 + 0.03 * (k % 3), lag[k % 5])
        wheel = build.add_texture(paint.cloth(rng, texel_m, ((0.5, 0.04, 0.03), (0.04, 0.12, 0.4))[k % 2]))
        for y in (-1.0 - 0.35 * (k % 3), -4.6 + 0.3 * (k % 2)):
            build.ball((x, y, 0.45), (0.22, 0.26, 0.22), wheel, steps=6)
            build.beam((x, y, 0.5), (x, y, 1.0), 0.05, steel)
            build.tube((x, y, 1.0), 0.22, 0.05, wheel, sides=12)
    for y in (-0.2, -2.4, -4.0, -6.0):
        build.box((-3.6, y, 0.08), (3.4, 0.2, 0.26), yellow)
        build.box((4.6, y, 0.08), (2.4, 0.2, 0.26), yellow)


def _loading(build: SceneBuilder, rng: Rng, texel_m: float, steel: int) -> None:
    """The loading pad: a pump house, a gas tank, pumps, drums and signs."""
    pump_house(build, rng, texel_m, steel)
    gas_tank(build, rng, texel_m, steel)
    tones = ((0.05, 0.15, 0.35), (0.40, 0.05, 0.04), (0.06, 0.22, 0.12), (0.5, 0.4, 0.08))
    drums = [build.add_texture(paint.painted_steel(rng, 1.9, 0.9, texel_m, tone)) for tone in tones]
    barrels(build, rng, (-0.6, -8.4), drums, count=11)
    barrels(build, rng, (-8.2, -4.6), drums[:2], count=6)
    for k, x in enumerate((-7.6, -6.2, 0.0, 1.3, 2.6, 7.2)):
        build.box((x, 0.2, 0.08), (0.8, 1.5, 0.25), steel)
        rod(build, (x, -0.4, 0.65), (x, 0.4, 0.65), 0.3, drums[k % 4], sides=14)
        build.tube((x, 0.6, 0.33), 0.28, 0.6, drums[(k + 1) % 4])
        run_of_pipe(build, [(x, 0.6, 0.9), (x, 0.6, 1.6), (x, 2.0, 1.6), (x, 2.0, 2.4)], 0.09, steel)
    for k, lines in enumerate((("RAUCHEN", "VERBOTEN"), ("TOR 3",), ("EX-ZONE", "1"))):
        board = build.add_texture(paint.sign_board(rng, 1.4, 0.9, texel_m, lines, (0.6, 0.5, 0.05), (0.3, 0.03, 0.03)))
        build.box((-9.0 + 8.0 * k, 5.4, 0.95), (1.4, 0.06, 0.9), board)
