"""Parts of a tank farm: tanks of pale steel with numbers, stairs and railings, a lying gas tank, a pump house."""

from __future__ import annotations

import itertools

import numpy as np

from wbflow_demo.parts.structures import Opening, facade
from wbflow_demo.render import textures as paint
from wbflow_demo.render.covers import lettering, stones
from wbflow_demo.render.paint import Colour, Rng, Texture, encode, fractal_noise, mix, one_colour, shape_of, smoothstep
from wbflow_demo.render.scene import UP, SceneBuilder

from .shapes import cone, rod


def shell(rng: Rng, around_m: float, high_m: float, texel_m: float, colour: Colour, name: str) -> Texture:
    """Paint the wall of a tank: nearly uniform, with faint plates, rust runs from the rim, a dirty foot, its name three times."""
    shape = shape_of(around_m, high_m, texel_m)
    tone = 1 + 0.03 * fractal_noise(rng, shape, texel_m, 3.0) + 0.015 * fractal_noise(rng, shape, texel_m, 0.06, octaves=2)
    image = one_colour(shape, colour) * tone[..., None]
    cover, plate, _ = stones(rng, shape, texel_m, (4.5, 1.6), 0.03, bond=0.5, jitter=0.02, warp=0.0)
    image *= (1 + 0.02 * plate - 0.2 * (1 - cover))[..., None]
    depth = np.linspace(0, high_m, shape[0], dtype=np.float32)[:, None]
    runs = smoothstep(0.9, 2.3, fractal_noise(rng, shape, texel_m, 0.6, octaves=5, stretch=10.0))
    mix(image, paint.RUST, runs * (0.2 + 0.5 * smoothstep(0.6 * high_m, 0.0, depth)))
    dirt = smoothstep(0.8, 0.0, high_m - depth + 0.4 * fractal_noise(rng, shape, texel_m, 1.2))
    mix(image, (0.20, 0.17, 0.13), 0.55 * dirt)
    size = 0.16 * high_m
    for k, about in enumerate(("KL. A II", "MAX 85 %", "ERDEN")):
        left = (0.12 + 0.31 * k) * around_m
        for text, top, tall in ((name, 0.24 * high_m, size), (about, 0.46 * high_m, 0.3 * size)):
            mix(image, (0.05, 0.10, 0.22), np.float32(0.9) * lettering(shape, texel_m, text, left, top, tall, bold=0.2))
    return encode(image, texel_m)


def tank(
    build: SceneBuilder,
    rng: Rng,
    texel_m: float,
    at: tuple[float, float, float, float],
    skin: tuple[Colour, str],
    look: tuple[int, ...],
) -> None:
    """Add a tank on a concrete ring, with rim, railing, winding stair, manhole, and a short pipe on its roof."""
    (x, y, radius, high), (colour, name), (stone, steel, yellow) = at, skin, look
    wall = build.add_texture(shell(rng, 2 * np.pi * radius, high, texel_m, colour, name))
    roof = build.add_texture(paint.painted_steel(rng, 2 * radius, 2 * radius, texel_m, colour))
    build.tube((x, y, 0.0), radius + 0.3, 0.25, stone, sides=32)
    build.tube((x, y, 0.25), radius, high - 0.25, wall, sides=48, top=False)
    build.tube((x, y, high - 0.5), radius + 0.1, 0.1, steel, sides=48)
    cone(build, (x, y, high), radius, 0.14 * radius, roof, sides=48)
    turn = np.linspace(0, 2 * np.pi, max(int(4 * radius), 8) + 1)
    rim = np.column_stack([x + radius * np.cos(turn), y + radius * np.sin(turn), np.full(len(turn), high)])
    for p, q in itertools.pairwise(rim):
        build.beam(p, p + UP, 0.05, yellow)
        for up in (0.5, 1.0):
            build.beam(p + up * UP, q + up * UP, 0.045, yellow)
    first, rise = float(rng.uniform(3.4, 4.2)), np.arange(0.4, high, 0.22)
    for k, z in enumerate(rise):
        bearing = first + 0.26 * k / radius
        out = np.array([np.cos(bearing), np.sin(bearing), 0.0])
        tread = np.array([x, y, z]) + (radius + 0.4) * out
        build.box(tread, (0.75, 0.28, 0.05), steel, yaw=bearing)
        if k % 3 == 0:
            build.beam(tread + 0.35 * out, tread + 0.35 * out + (0, 0, 1.0), 0.05, yellow)
            ahead = 0.78 * np.array([-out[1], out[0], 0.0]) + (0, 0, 1.66)
            build.beam(tread + 0.35 * out + (0, 0, 1.0), tread + 0.35 * out + ahead, 0.05, yellow)
    rod(build, (x + 0.5 * radius, y, high), (x + 0.5 * radius, y, high + 0.5), 0.25, steel)
    rod(build, (x, y - radius + 0.1, 0.9), (x, y - radius - 0.3, 0.9), 0.35, steel, sides=14)


def gas_tank(build: SceneBuilder, rng: Rng, texel_m: float, steel: int) -> None:
    """Add a lying tank with round ends, on two saddles."""
    gas = build.add_texture(shell(rng, 7.0, 4.4, texel_m, (0.62, 0.62, 0.60), "LPG"))
    rod(build, (7.0, -7.6, 1.7), (11.3, -6.8, 1.7), 1.1, gas, sides=32)
    for end in ((7.0, -7.6, 1.7), (11.3, -6.8, 1.7)):
        build.ball(end, (0.75, 1.09, 1.09), gas, steps=12)
    for x in (7.6, 10.8):
        build.box((x, -9.0 + 0.19 * x, 0.0), (0.4, 1.8, 1.2), steel, yaw=0.18)


def pump_house(build: SceneBuilder, rng: Rng, texel_m: float, steel: int) -> None:
    """Add a brick hut with a door and a window on each side, and a roof of rusty sheet metal."""
    brick = build.add_texture(paint.brick_wall(rng, 4.4, 2.8, texel_m, sign="PUMPEN"))
    door = build.add_texture(paint.planks(rng, 1.2, 2.2, texel_m, (0.08, 0.16, 0.24)))
    pane = build.add_texture(paint.window(1.0, 0.9, texel_m))
    sheet = build.add_texture(paint.container_roof(rng, 5.0, 4.0, texel_m, (0.30, 0.31, 0.30)))
    for k in range(4):
        turn, half = 0.25 + k * np.pi / 2, (2.2, 1.6)[k % 2]
        right, out = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([np.sin(turn), -np.cos(turn), 0.0])
        corner = np.array([-9.0, -10.6, 2.8]) - half * right + (1.6, 2.2)[k % 2] * out
        openings = [Opening(0.5, 0.6, 1.2, 2.2, door), Opening(2.0, 0.8, 1.0, 0.9, pane)]
        facade(build, corner, right, (2 * half, 2.8), brick, openings, steel)
    build.box((-9.0, -10.6, 2.8), (5.0, 3.8, 0.14), sheet, yaw=0.25)
