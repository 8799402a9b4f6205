"""A railway station: two platforms, tracks between them, repeating sleepers, posts and windows; cameras above the platforms."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.street import bench, furniture_textures
from wbflow_demo.parts.structures import Opening, facade
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

LONG, HIGH, EDGES = 60.0, 0.9, (-5.5, 5.5)
"""Length and height of the platforms, and y of the edges of the southern and the northern one, in metres."""
TRACKS = (-3.0, 3.0)
LAMPS = tuple((x, y, 4.6) for x in (-18.0, -6.0, 6.0, 18.0) for y in (-8.5, 8.5))
POSTS = (
    (-17.0, -8.0, 4.6), (-9.5, -9.0, 5.2), (-2.0, -8.5, 4.4), (6.0, -9.0, 5.0),
    (14.0, -8.2, 4.7), (19.0, 8.8, 5.1), (0.5, 9.0, 4.8), (-18.0, 8.6, 5.3),
)  # fmt: skip


def platform(shots: Shots) -> DemoSite:
    """Render the station; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(POSTS))
    texel_m = shots.texel_m(14.0, 0.0145, 0.05)
    walks = (((-20.0, -8.0), (20.0, -7.5)), ((-20.0, 8.0), (20.0, 7.5)), ((-12.0, -7.0), (10.0, -9.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_platform(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=10, walks=walks),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(40.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras above both platforms, looking across the tracks at the middle of the station."""
    return [viewpoint_on_post(k, "post", (x, y, z), (0.15 * x, -0.35 * y, 0.8), 76.0, -0.16) for k, (x, y, z) in enumerate(POSTS)]


def static_platform(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    look = furniture_textures(build, rng, texel_m)
    ballast = build.add_texture(ground.gravel(rng, 20.0, 12.0, texel_m))
    for x in (-30.0, -10.0, 10.0):
        build.quad((x, 6.0, 0.0), (20.0, 0, 0), (0, -12.0, 0), ballast)
    _tracks(build, rng, texel_m)
    for side in (-1, 1):
        _side(build, rng, texel_m, side)
        for x in (-14.0, -3.0, 9.0):
            build.stamp(bench(build, look), (x, side * 9.2, HIGH), yaw=0.02 * x)
        for x in np.arange(-24.0, 25.0, 6.0):
            build.tube((float(x), side * 8.6, HIGH), 0.12, 3.6, look.steel, sides=10)
    _wagons(build, rng, texel_m)
    boards = (("GLEIS 1", "NORD"), ("GLEIS 2", "SUED"), ("AUSGANG",), ("HAFENSTADT",))
    for k, lines in enumerate(boards):
        front = build.add_texture(paint.sign_board(rng, 2.2, 0.7, texel_m, lines, (0.04, 0.10, 0.3), (0.7, 0.7, 0.68)))
        build.box((-15.0 + 10.0 * k, 8.4 if k % 2 else -8.4, 3.4), (2.2, 0.1, 0.7), front, front=front)
    for k, tone in enumerate(((0.35, 0.06, 0.05), (0.07, 0.2, 0.1), (0.5, 0.4, 0.05))):
        case = build.add_texture(paint.painted_steel(rng, 2.0, 2.0, texel_m, tone, stripes=k == 2))
        build.box((-8.0 + 9.0 * k, -9.6, HIGH), (0.9, 0.7, 1.8), case)
        build.box((4.0 - 9.0 * k, 9.7, HIGH), (1.2, 0.8, 1.4), case, yaw=0.2)
    return build.build()


def _tracks(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Two tracks: identical sleepers every 0.6 m, and rails."""
    wood = build.add_texture(paint.planks(rng, 2.6, 0.4, texel_m, (0.13, 0.10, 0.08)))
    rail = build.add_texture(paint.painted_steel(rng, 8.0, 0.5, texel_m, (0.20, 0.12, 0.08)))
    for y in TRACKS:
        for x in np.arange(-LONG / 2, LONG / 2, 0.6):
            build.box((float(x), y, 0.0), (0.26, 2.6, 0.14), wood)
        for gauge in (-0.72, 0.72):
            build.box((0.0, y + gauge, 0.14), (LONG, 0.08, 0.16), rail)


def _side(build: SceneBuilder, rng: Rng, texel_m: float, side: int) -> None:
    """A platform with a white line along its edge, and the building behind it with many identical windows."""
    slabs = ground.concrete(rng, 20.0, 8.0, texel_m, slab_m=2.0)
    line = ground.with_lines(
        slabs, np.array([((0.0, 0.7 if side < 0 else 7.3), (20.0, 0.7 if side < 0 else 7.3))], np.float32), 0.2, rng
    )
    top = build.add_texture(line)
    edge = build.add_texture(paint.ashlar(rng, 20.0, 1.0, texel_m))
    for x in (-30.0, -10.0, 10.0):
        build.quad((x, EDGES[1] + 8.0 if side > 0 else EDGES[0], HIGH), (20.0, 0, 0), (0, -8.0, 0), top)
        face = ((x, EDGES[1], HIGH), (20.0, 0, 0)) if side > 0 else ((x + 20.0, EDGES[0], HIGH), (-20.0, 0, 0))
        build.quad(face[0], face[1], (0, 0, -HIGH), edge)
    wall = build.add_texture(paint.brick_wall(rng, LONG, 6.5, texel_m, sign="HAUPTBAHNHOF" if side > 0 else "GUETERAMT"))
    sill = build.add_texture(paint.plaster(rng, 3.0, 1.0, texel_m, (0.4, 0.38, 0.34)))
    glass = build.add_texture(paint.window(1.4, 2.2, texel_m))
    openings = [Opening(1.5 + 3.0 * k, 1.6, 1.4, 2.2, glass) for k in range(19)]
    corner = np.array([-LONG / 2 * side, side * 13.4, HIGH + 6.5])
    facade(build, corner, np.array([float(side), 0, 0]), (LONG, 6.5), wall, openings, sill)


def _wagons(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Three flat wagons on the northern track, two of them with the same load."""
    steel = build.add_texture(paint.painted_steel(rng, 10.0, 1.0, texel_m, (0.24, 0.10, 0.07)))
    load = [build.add_texture(paint.planks(rng, 8.0, 1.6, texel_m, tone)) for tone in ((0.34, 0.25, 0.15), (0.16, 0.22, 0.28))]
    dark = build.add_texture(paint.cloth(rng, texel_m, (0.03, 0.03, 0.03)))
    for k, x in enumerate((-14.0, 0.5, 15.0)):
        build.box((x, TRACKS[1], 1.0), (12.0, 2.7, 0.35), steel)
        build.box((x, TRACKS[1], 1.35), (7.0, 2.2, 0.9), load[k % 2])
        for along in (-4.6, -3.2, 3.2, 4.6):
            for across in (-0.75, 0.75):
                build.ball((x + along, TRACKS[1] + across, 0.72), (0.45, 0.08, 0.45), dark, steps=6)
