"""A quarry: a floor of crushed stone, three steps of broken rock in a half ring, heaps, a lorry; cameras across the floor."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.street import car, car_textures
from wbflow_demo.parts.structures import heap
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng, Texture, cracks, encode, fractal_noise, mix, one_colour, shape_of, weather
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder
from wbflow_stages.types import Float64s

LAMPS = ((-14.0, -6.0, 9.0), (14.0, -6.0, 9.0))
MASTS = (
    (-27.0, -19.0, 8.0), (-17.0, -24.0, 9.5), (-6.0, -26.0, 7.5), (6.0, -26.5, 10.0),
    (17.0, -24.0, 8.5), (27.0, -18.5, 9.0), (33.0, -8.0, 11.0), (-33.0, -7.0, 10.5),
)  # fmt: skip
STEP, RISE, SLOPE, RADIUS = 6.0, 5.0, 1.4, 20.0
"""Depth and height of a step, how far its face leans back, and radius at which the first step begins, in metres."""


def quarry(shots: Shots) -> DemoSite:
    """Render the quarry; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(20.0, 0.02, 0.06)
    roads = (((-20.0, -8.0), (18.0, -6.0)), ((-12.0, -14.0), (10.0, 8.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_quarry(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=5, walks=roads, cars=2, roads=roads),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(64.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras on masts in the open half, looking at the steps."""
    return [viewpoint_on_post(k, "rim", (x, y, z), (0.25 * x, 8.0, 3.0), 66.0, -0.15) for k, (x, y, z) in enumerate(MASTS)]


def static_quarry(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    stone = build.add_texture(ground.gravel(rng, 30.0, 30.0, texel_m))
    for x in (-60.0, -30.0, 0.0, 30.0):
        for y in (30.0, 0.0):
            build.quad((x, y, 0.0), (30.0, 0, 0), (0, -30.0, 0), stone)
    _steps(build, rng, build.add_texture(rock(rng, 24.0, 24.0, texel_m)))
    for x, y, radius, height in ((-9.0, 4.0, 3.2, 2.2), (3.0, 9.0, 2.6, 1.9), (12.0, 1.0, 3.8, 2.6)):
        heap(build, rng, (x, y), radius, height, stone)
    looks = car_textures(build, rng, texel_m)
    build.stamp(car(build, looks, 1, length=6.5), (-2.0, -4.0, 0.0), yaw=0.5)
    build.stamp(car(build, looks, 3), (8.0, -9.0, 0.0), yaw=2.0)
    yellow = build.add_texture(paint.painted_steel(rng, 5.0, 4.0, texel_m, (0.5, 0.34, 0.03)))
    build.box((-15.0, -1.0, 0.6), (4.2, 2.4, 1.6), yellow, yaw=0.7)
    build.box((-14.2, -0.4, 2.2), (1.8, 1.7, 1.4), yellow, yaw=0.7)
    build.beam((-13.4, 0.2, 2.6), (-10.5, 2.6, 4.6), 0.4, yellow)
    build.beam((-10.5, 2.6, 4.6), (-8.8, 4.0, 1.2), 0.35, yellow)
    for x, y, z in MASTS:
        build.tube((1.03 * x, 1.03 * y, 0.0), 0.12, z + 0.3, yellow, sides=8)
    return build.build()


def rock(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint broken limestone: beds, cracks, rust stains, weathering."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, (0.42, 0.39, 0.33))
    image *= (1 + 0.22 * fractal_noise(rng, shape, texel_m, 3.0))[..., None]
    beds = fractal_noise(rng, shape[::-1], texel_m, 1.2, stretch=6.0).T
    mix(image, (0.22, 0.19, 0.15), 0.5 * np.clip(beds - 0.6, 0, 1))
    mix(image, (0.38, 0.24, 0.12), 0.35 * np.clip(fractal_noise(rng, shape, texel_m, 5.0) - 0.8, 0, 1))
    mix(image, (0.08, 0.07, 0.06), 0.8 * cracks(rng, shape, texel_m, count=int(width_m * height_m / 2), length_m=1.6))
    weather(rng, image, texel_m, strength=0.2, streaks=0.1)
    return encode(image, texel_m)


def _steps(build: SceneBuilder, rng: Rng, texture: int) -> None:
    """Three faces and the steps between them, roughened at the scale of a metre, around the northern half of the floor."""
    bearings = np.linspace(-0.15, np.pi + 0.15, 72)
    profile = [(0.0, 0.0)]
    for k in range(3):
        base = k * (STEP + SLOPE)
        profile += [(base + SLOPE * t, RISE * (k + t)) for t in (0.25, 0.5, 0.75, 1.0)]
        profile += [(base + SLOPE + STEP * t, RISE * (k + 1)) for t in (0.25, 0.5, 0.75, 1.0)]
    out, up = np.array(profile).T
    rough = rng.normal(0, 0.35, (len(bearings), len(profile), 3)) * np.where(np.arange(len(profile)) > 0, 1.0, 0.2)[None, :, None]
    radius = RADIUS + out[None, :] + 1.5 * np.sin(3.1 * bearings)[:, None]
    at = np.stack(
        [radius * np.cos(bearings)[:, None], radius * np.sin(bearings)[:, None], np.tile(up, (len(bearings), 1))], axis=-1
    )
    at += rough
    for i in range(len(bearings) - 1):
        for j in range(len(profile) - 1):
            a, b, c, d = at[i, j], at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]
            _facet(build, np.array([a, c, b]), texture)
            _facet(build, np.array([a, d, c]), texture)


def _facet(build: SceneBuilder, corners: Float64s, texture: int) -> None:
    """Add a triangle that faces the middle of the floor or the sky, textured along its own plane."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    towards = np.array([-corners[0, 0], -corners[0, 1], 12.0])
    corners = corners if normal @ towards > 0 else corners[::-1]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    u = np.cross((0.0, 0.0, 1.0), normal)
    u = u / np.linalg.norm(u) if np.linalg.norm(u) > 1e-6 else np.array([1.0, 0, 0])
    v = np.cross(normal / np.linalg.norm(normal), u)
    x, y, z = corners[0]
    build.triangle(corners, u, -v, texture, (float(20 * np.arctan2(y, x)) % 12.0, float(-1.3 * z + np.hypot(x, y)) % 12.0))
