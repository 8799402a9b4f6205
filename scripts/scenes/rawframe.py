"""Structures of the building site: the pit with foundations, the concrete frame with its scaffold; loam and raw concrete."""

from __future__ import annotations

from itertools import product

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.render.covers import blobs, stones
from wbflow_demo.render.paint import Rng, Texture, draw, encode, fractal_noise, mix, one_colour, shape_of, smoothstep, weather
from wbflow_demo.render.scene import SceneBuilder

from .shapes import rod

WIDE, DEEP = 60.0, 52.0
"""Size of the site, in metres."""
WEST, EAST, SOUTH, NORTH, FLOOR = -8.0, 11.0, -9.0, 3.5, -2.6
"""Edges of the pit, and height of its floor, in metres."""
FRAME, STOREY = (-11.5, 5.5, 5.8, 14.8), 3.1
"""West, east, south and north side of the concrete frame, and height of a storey, in metres."""


def earth(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint trodden loam: damp patches, wheel ruts, spilt sand, stones."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, (0.25, 0.19, 0.125)) * (1 + 0.16 * fractal_noise(rng, shape, texel_m, 0.35, gain=0.8))[..., None]
    mix(image, (0.11, 0.085, 0.06), 0.7 * smoothstep(0.2, 1.6, fractal_noise(rng, shape, texel_m, 4.0)))
    ruts, t = np.zeros(shape, np.uint8), np.linspace(0, 1, 40)[:, None]
    for _ in range(int(width_m / 6)):
        a, b, c = rng.uniform((0, 0), shape[::-1], (3, 2))
        for off in (0.0, 1.8 / texel_m):
            draw(ruts, (1 - t) ** 2 * a + 2 * t * (1 - t) * b + t**2 * c + off, 0.35 / texel_m)
    worn = smoothstep(-0.8, 0.8, fractal_noise(rng, shape, texel_m, 0.6))
    mix(image, (0.12, 0.09, 0.065), 0.6 * worn * ruts.astype(np.float32) / np.float32(255))
    area = int(width_m * height_m)
    mix(image, (0.40, 0.34, 0.24), 0.7 * blobs(rng, shape, texel_m, count=area // 25, radius_m=0.4))
    mix(image, (0.38, 0.36, 0.33), 0.9 * blobs(rng, shape, texel_m, count=2 * area, radius_m=0.06))
    weather(rng, image, texel_m, strength=0.16)
    return encode(image, texel_m)


def cast(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint raw concrete from formwork: panels of different tones with ridges between them, dark holes, runs."""
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, _ = stones(rng, shape, texel_m, (1.2, 0.6), 0.03, bond=0.0, jitter=0.0, warp=0.002)
    grain = 1 + 0.10 * tone + 0.06 * fractal_noise(rng, shape, texel_m, 0.3) + 0.08 * fractal_noise(rng, shape, texel_m, 2.0)
    image = one_colour(shape, (0.34, 0.33, 0.31)) * grain[..., None]
    image *= (1 - 0.25 * (1 - cover))[..., None]
    mix(image, (0.13, 0.125, 0.12), 0.8 * blobs(rng, shape, texel_m, count=int(3 * width_m * height_m), radius_m=0.05))
    weather(rng, image, texel_m, strength=0.14, streaks=0.2)
    return encode(image, texel_m)


def pit(build: SceneBuilder, rng: Rng, look: tuple[int, int, int, int]) -> None:
    """Add sloped sides, a ramp in the east, and on the floor strip foundations with bars and a wall in its formwork."""
    soil, raw, wood, rust = look
    x, y = np.meshgrid(np.linspace(WEST, EAST, 27), np.linspace(SOUTH, NORTH, 19))
    down = np.clip(np.minimum.reduce([(x - WEST) / 2.4, (EAST - x) / 5.5, (y - SOUTH) / 2.0, (NORTH - y) / 2.4]), 0, 1)
    grid = np.stack([x, y, FLOOR * down + rng.normal(0, 0.08, x.shape) * (down > 0)], axis=-1)
    for i, j in np.ndindex(18, 26):
        (a, b), (d, c) = grid[i : i + 2, j : j + 2]
        for corners in (np.array([a, b, c]), np.array([a, c, d])):
            build.triangle(corners, (1, 0, 0), (0, -1, 0), soil, (a[0] + WIDE / 2, DEEP / 2 - a[1]))
    for k, at in enumerate((-5.6, -3.4, -1.0)):
        build.box((-0.3, at, FLOOR - 0.1), (9.4, 0.9, 0.6), raw, offset=1.7 * k)
        for step in range(15):
            for side in (-0.25, 0.25):
                build.beam((-4.6 + 0.6 * step, at + side, FLOOR + 0.5), (-4.6 + 0.6 * step, at + side, FLOOR + 1.2), 0.035, rust)
    build.box((-0.3, -1.0, FLOOR + 0.5), (5.0, 0.3, 1.9), raw, offset=4.0)
    for k in range(9):
        build.box((-2.6 + 0.56 * k, -1.22, FLOOR + 0.5), (0.5, 0.06, 2.0), wood, offset=0.7 * k)
        build.beam((-2.6 + 0.56 * k, -1.25, FLOOR + 1.9), (-2.6 + 0.56 * k, -2.3, FLOOR), 0.08, wood)


def frame(build: SceneBuilder, rng: Rng, texel_m: float, look: tuple[int, ...]) -> None:
    """Add three floors on columns, a stair core, red props under the top floor, a scaffold in the west and south."""
    raw, wood, steel, red, rust = look
    west, east, south, north = FRAME
    slab = build.add_texture(ground.concrete(rng, 18.0, 10.0, texel_m, slab_m=4.0))
    for level in range(3):
        z = 0.1 + STOREY * level
        build.box(
            ((west + east) / 2, (south + north) / 2, z - 0.1),
            (east - west, north - south, 0.3),
            slab,
            sides=raw,
            offset=0.3 * level,
        )
        for x, y in product(np.linspace(west + 0.4, east - 0.4, 5), np.linspace(south + 0.5, north - 0.5, 3)):
            build.box(
                (x, y, z + 0.2), (0.4, 0.4, STOREY - 0.3 if level < 2 else 1.6 if x < 0 else 0.3), raw, offset=float(x - west)
            )
            for a, b in product((-0.14, 0.14), repeat=2):
                build.beam((x + a, y + b, z + 0.2), (x + a, y + b, z + (0.3 if level < 2 else 2.6)), 0.035, rust)
        if level:
            for up, (left, back) in product((0.8, 1.3), ((west, south), (east, north))):
                build.beam((left, back, z + up), (east, south, z + up), 0.1, wood)
    build.box((1.4, 12.2, 0.3), (3.4, 3.6, 8.2), raw, offset=2.0)
    build.box((-6.0, north - 0.2, 0.3), (8.0, 0.25, 2 * STOREY - 0.3), raw, offset=5.0)
    for x, y in product(np.arange(west + 1.2, east - 1.0, 1.4), (south + 0.4, south + 2.0, south + 3.6)):
        rod(build, (x, y, STOREY + 0.3), (x, y, 2 * STOREY), 0.05, red, sides=6)
    standards = [(west - e, y) for e in (0.4, 1.3) for y in np.arange(south - 0.9, north, 2.1)]
    standards += [(x, south - e) for e in (0.3, 1.1) for x in np.arange(west + 1.2, -3.0, 2.1)]
    for x, y in standards:
        build.beam((x, y, 0.0), (x, y, 3 * STOREY + 0.6), 0.07, steel)
    for z in (2.1, 4.2, 6.3, 8.4):
        build.box((west - 0.85, (south + north) / 2 - 0.4, z), (0.8, north - south, 0.06), wood)
        build.box((west + 4.0, south - 0.7, z), (8.6, 0.7, 0.06), wood)
        build.beam((west - 1.3, south - 1.1, z + 1.0), (-3.2, south - 1.1, z + 1.0), 0.06, steel)
        build.beam((west - 1.3, south - 1.1, z + 1.0), (west - 1.3, north, z + 1.0), 0.06, steel)
