"""A shunting yard under snow: white ground with barely visible tracks, wagons of three types, wires; cameras on masts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.structures import crates, heap
from wbflow_demo.parts.weak import snow
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import Light, light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import Daytime, DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder
from wbflow_stages.types import Float64s

from .lineside import catenary, hut, lever, rails, signal_box, spruce
from .rolling import Look, box_wagon, tank_wagon, timber_wagon
from .snowfield import DEEP, WIDE, needles, yard_under_snow

TRACKS = (-9.0, -4.5, 0.0, 4.5, 9.0)
"""y of the straight tracks, in metres north."""
SWITCHES = (((-15.0, -4.5), (-1.0, 0.0)), ((1.0, 0.0), (15.0, 4.5)), ((-9.0, 9.0), (-23.0, 4.5)), ((6.0, -9.0), (20.0, -4.5)))
"""Connecting tracks: the point where each leaves one track, and the point where it joins the next, in metres."""
WAGONS = (
    ("box", -24.6, 0), ("box", -11.6, 0), ("box", 19.0, 0), ("timber", -24.0, 1), ("timber", 13.5, 1), ("timber", 26.6, 1),
    ("tank", -22.0, 2), ("tank", 22.5, 2), ("tank", -19.8, 3), ("tank", -32.8, 3), ("tank", 18.6, 3), ("tank", 31.6, 3),
    ("box", -24.0, 4), ("timber", 6.8, 4), ("box", 24.0, 4),
)  # fmt: skip
"""Type, metres east, and index of the track of each wagon; the middle of the yard is kept free."""
MASTS = (
    (-19.5, -11.4, 8.6), (-9.6, -19.0, 7.6), (3.0, -21.0, 9.6), (14.8, -15.6, 8.2),
    (21.6, -6.7, 9.8), (20.6, 11.4, 8.4), (-21.4, 6.8, 9.2), (-13.0, 16.6, 8.0),
)  # fmt: skip
POLES = tuple((x + 2.5 * (y < 0), y) for x in (-27.0, -8.6, 9.2, 27.0) for y in (-6.75, 2.25))
"""Catenary masts, each between two tracks."""
HEAPS = (
    (-6.6, -11.8, 1.3, 0.6), (7.4, -11.9, 1.6, 0.8), (1.2, 12.4, 1.4, 0.7), (13.6, 13.8, 1.9, 1.0), (-12.6, 12.2, 1.2, 0.5),
    (9.6, -16.8, 2.0, 1.1), (-15.2, -15.6, 1.7, 0.8),
)  # fmt: skip
"""Heaps of cleared snow: east, north, radius and height, in metres."""
LAMPS = tuple((1.03 * x, 1.03 * y, z + 0.5) for x, y, z in MASTS)


def railyard(shots: Shots) -> DemoSite:
    """Render the yard; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(18.0, 0.0145, 0.06)
    walks = (((-9.0, -2.2), (9.0, -2.4)), ((-8.0, 2.4), (9.0, 2.2)), ((-14.0, -13.2), (10.0, -13.4)), ((-9.0, 11.6), (9.0, 12.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_railyard(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=6, walks=walks),
        lighting=winter_light(shots.light),
    )
    return photograph(night, shots, shots.voxel_m(44.0))


def winter_light(light: Daytime) -> Light:
    """By day, a low sun through thin cloud, at the reduced exposure of cameras that look at snow; else the usual light."""
    lit = light_of(light, LAMPS)
    if light != "day":
        return lit
    towards = np.array([-0.62, -0.60, 0.50])
    sun = tuple((towards / np.linalg.norm(towards)).tolist())
    return replace(
        lit, sun_direction=sun, sun=(0.68, 0.62, 0.53), sky=(0.40, 0.43, 0.48), ground=(0.36, 0.37, 0.39), haze=(0.60, 0.63, 0.67)
    )


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the switches in the middle."""
    return [viewpoint_on_post(k, "mast", (x, y, z), (0.08 * x, 0.0, 0.6), 68.0, -0.14) for k, (x, y, z) in enumerate(MASTS)]


def paths() -> list[Float64s]:
    """Centre lines of all tracks, (n, 2) each, in metres: straight ones first, then those of the switches."""
    t = np.linspace(0, 1, 15)[:, None]
    bend = 3 * t**2 - 2 * t**3
    straight = [np.array([(-WIDE / 2, y), (WIDE / 2, y)]) for y in TRACKS]
    return straight + [np.hstack([x0 + (x1 - x0) * t, y0 + (y1 - y0) * bend]) for (x0, y0), (x1, y1) in SWITCHES]


def static_railyard(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    white = build.add_texture(snow(rng, 30.0, 30.0, texel_m))
    build.quad((-70.0, 70.0, -0.05), (140.0, 0, 0), (0, -140.0, 0), white)
    build.quad((-WIDE / 2, DEEP / 2, 0.0), (WIDE, 0, 0), (0, -DEEP, 0), build.add_texture(yard_under_snow(rng, texel_m, paths())))
    steel = build.add_texture(paint.painted_steel(rng, 8.0, 1.0, texel_m, (0.17, 0.13, 0.10)))
    look = Look(steel, build.add_texture(paint.cloth(rng, texel_m, (0.05, 0.045, 0.04))), white)
    for path in paths():
        rails(build, path, steel)
    for (x, y), (end, _) in SWITCHES:
        lever(build, (x + (2.0 if end > x else -2.0), y - 1.7), look)
    _wagons(build, rng, texel_m, look)
    grey = build.add_texture(paint.painted_steel(rng, 3.0, 9.0, texel_m, (0.30, 0.32, 0.31)))
    catenary(build, POLES, TRACKS[:4], (grey, look.dark))
    signal_box(build, rng, texel_m, (6.5, 18.4), white)
    hut(build, rng, texel_m, (-2.6, -13.6), white)
    hut(build, rng, texel_m, (-7.2, 14.8), white)
    _lying_about(build, rng, texel_m, look)
    for x, y, z in MASTS:
        build.tube((1.03 * x, 1.03 * y, 0.0), 0.13, z + 0.4, grey, sides=8)
        build.box((1.03 * x, 1.03 * y, z + 0.4), (0.5, 0.5, 0.16), grey)
    return build.build()


def _wagons(build: SceneBuilder, rng: Rng, texel_m: float, look: Look) -> None:
    """Rows of wagons: two looks of each of the three types, repeated."""
    reds = (((0.20, 0.075, 0.05), "31 80 2450"), ((0.14, 0.10, 0.075), "21 80 1511"))
    greys = (((0.36, 0.37, 0.37), "VTG 7830"), ((0.24, 0.27, 0.25), "KVG 7912"))
    logs = (((0.19, 0.13, 0.085), (0.50, 0.36, 0.20)), ((0.14, 0.11, 0.09), (0.42, 0.27, 0.14)))
    parts = {
        "box": [box_wagon(build, rng, texel_m, look, skin) for skin in reds],
        "tank": [tank_wagon(build, rng, texel_m, look, skin) for skin in greys],
        "timber": [timber_wagon(build, rng, texel_m, look, skin) for skin in logs],
    }
    for k, (kind, x, track) in enumerate(WAGONS):
        build.stamp(parts[kind][(k // 2) % 2], (x, TRACKS[track], 0.08), quarters=2 * (k % 3 == 1))


def _lying_about(build: SceneBuilder, rng: Rng, texel_m: float, look: Look) -> None:
    """Heaps of snow, stacks of sleepers, crates, two posts, and a ring of trees."""
    wood = [build.add_texture(paint.planks(rng, 3.0, 1.5, texel_m, c)) for c in ((0.16, 0.12, 0.09), (0.34, 0.25, 0.15))]
    for x, y, radius, high in HEAPS:
        heap(build, rng, (x, y), radius, high, look.snow)
    for x, y, yaw in ((-4.2, 6.8, 0.05), (4.6, -6.9, -0.08), (-6.2, -6.6, 0.1), (3.4, 11.2, 0.02)):
        for level in range(3):
            for k in range(4 - level):
                at = (x, y + (0.3 * k + 0.15 * level - 0.45), 0.17 * level)
                build.box(at, (2.5, 0.26, 0.16), look.snow if level + (k % 2) > 2 else wood[0], sides=wood[0], yaw=yaw)
    crates(build, rng, (1.0, -14.2), wood, rows=3, levels=2)
    crates(build, rng, (-4.0, 13.6), wood, rows=2, levels=2)
    for y in (-0.8, 0.8):
        build.beam((-9.0, 2.25 + y, 0.0), (-9.0, 2.25 + y, 0.9), 0.16, look.frame)
    bark = build.add_texture(paint.planks(rng, 1.0, 3.0, texel_m, (0.10, 0.08, 0.06)))
    tree = spruce(build, bark, build.add_texture(needles(rng, texel_m)))
    for bearing in np.linspace(0, 2 * np.pi, 64, endpoint=False):
        away = np.array([47.0, 35.0]) + rng.uniform(-1, 7)
        x, y = away * (np.cos(bearing), np.sin(bearing))
        build.stamp(tree, (float(x), float(y), float(rng.uniform(-1.6, 0.0))), yaw=float(rng.uniform(0, 6)))
