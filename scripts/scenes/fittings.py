"""Furniture of the machine shop, as parts to stamp: workbenches with tools, racks of bars, a portal crane."""

from __future__ import annotations

from itertools import product

import numpy as np

from wbflow_demo.render import textures as paint
from wbflow_demo.render.paint import Rng, Texture, draw, encode, fractal_noise, mix, one_colour, shape_of
from wbflow_demo.render.scene import SceneBuilder

from .machines import Look, Skin, panel
from .shapes import rod


def tool_board(rng: Rng, texel_m: float) -> Texture:
    """Paint a grey board of 2.3 x 0.9 m on which spanners, saws and files hang in three rows."""
    shape = shape_of(2.3, 0.9, texel_m)
    image = one_colour(shape, (0.26, 0.29, 0.30)) * (1 + 0.04 * fractal_noise(rng, shape, texel_m, 0.4))[..., None]
    for tone in ((0.04, 0.04, 0.045), (0.45, 0.06, 0.03), (0.55, 0.54, 0.52)):
        tools = np.zeros(shape, np.uint8)
        for k in range(16):
            x, y, long = float(rng.uniform(0.1, 2.2)), 0.08 + 0.28 * (k % 3), float(rng.uniform(0.1, 0.22))
            lean, wide = float(rng.normal(0, 0.02)), float(rng.uniform(0.02, 0.045))
            draw(tools, np.array([(x, y), (x + lean, y + long)]) / texel_m, wide / texel_m)
            draw(tools, np.array([(x - 0.03, y), (x + 0.03, y + 0.01)]) / texel_m, 0.04 / texel_m)
        mix(image, tone, tools.astype(np.float32) / np.float32(255))
    return encode(image, texel_m)


def bench(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: Skin) -> SceneBuilder:
    """Return a workbench with drawers, a vice, tools and boxes, and a tool board behind it."""
    part, coat = build.with_same_textures(), build.add_texture(panel(rng, 2.4, 0.8, texel_m, skin[0]))
    wood = build.add_texture(paint.planks(rng, 2.4, 0.8, texel_m, (0.38, 0.27, 0.16)))
    part.box((0.0, 0.0, 0.84), (2.4, 0.8, 0.06), wood)
    for x in (-0.8, 0.8):
        part.box((x, 0.0, 0.0), (0.7, 0.7, 0.84), coat, offset=x + 0.9)
    part.box((0.0, 0.38, 0.9), (2.3, 0.05, 0.9), build.add_texture(tool_board(rng, texel_m)))
    part.box((-0.9, -0.25, 0.9), (0.2, 0.35, 0.22), look.dark)
    for k in range(7):
        size = rng.uniform((0.1, 0.1, 0.06), (0.35, 0.25, 0.26))
        texture = look[int(rng.integers(5))]
        part.box((-0.6 + 0.26 * k, float(rng.uniform(-0.2, 0.15)), 0.9), size, texture, yaw=float(rng.normal(0, 0.4)))
    return part


def rack(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: Skin) -> SceneBuilder:
    """Return a cantilever rack, 4 m long, with bars, pipes and sections on its arms."""
    part, blue = build.with_same_textures(), build.add_texture(paint.painted_steel(rng, 2.0, 2.4, texel_m, skin[0]))
    rust = build.add_texture(paint.painted_steel(rng, 4.0, 1.0, texel_m, (0.17, 0.10, 0.07)))
    for x in (-1.5, 0.0, 1.5):
        part.beam((x, 0.3, 0.0), (x, 0.3, 2.4), 0.14, blue)
        for z in (0.25, 0.8, 1.35, 1.9):
            part.beam((x, 0.3, z), (x, -0.5, z + 0.05), 0.09, blue)
    for level, k in product(range(4), range(6)):
        z, y, tip = 0.34 + 0.55 * level, -0.4 + 0.12 * k, float(rng.uniform(1.5, 2.1))
        texture = (rust, look.bare, look.dark, rust)[int(rng.integers(4))]
        if rng.random() < 0.5:
            rod(part, (-tip, y, z), (float(rng.uniform(1.3, 2.1)), y, z), float(rng.uniform(0.03, 0.06)), texture, sides=8)
        else:
            part.beam((-tip, y, z), (float(rng.uniform(1.3, 2.1)), y, z), float(rng.uniform(0.05, 0.1)), texture)
    return part


def gantry(build: SceneBuilder, look: Look) -> SceneBuilder:
    """Return a portal crane on castors, 4.6 m wide and 3.9 m high, with a hoist that holds a shaft."""
    part = build.with_same_textures()
    for x, y in product((-2.2, 2.2), (-0.9, 0.9)):
        part.beam((x, y, 0.15), (x, 0.25 * y, 3.6), 0.12, look.yellow)
        part.ball((x, y, 0.1), (0.1, 0.06, 0.1), look.dark, steps=5)
    for x in (-2.2, 2.2):
        part.beam((x, -0.9, 0.2), (x, 0.9, 0.2), 0.12, look.yellow)
        part.beam((x, -0.6, 1.6), (x, 0.6, 1.6), 0.08, look.yellow)
    part.box((0.0, 0.0, 3.6), (5.0, 0.16, 0.3), look.yellow)
    part.box((0.5, 0.0, 3.2), (0.5, 0.4, 0.36), look.red)
    rod(part, (0.5, 0.0, 3.2), (0.5, 0.0, 1.5), 0.02, look.dark, sides=6)
    for x in (-0.3, 1.3):
        part.beam((0.5, 0.0, 1.5), (x, 0.0, 1.05), 0.03, look.dark)
    rod(part, (-0.7, 0.0, 1.0), (1.7, 0.0, 1.0), 0.11, look.bare)
    rod(part, (0.2, 0.0, 1.0), (0.8, 0.0, 1.0), 0.2, look.bare, sides=14)
    for x in (0.2, 0.8):
        part.ball((x, 0.0, 1.0), (0.01, 0.2, 0.2), look.bare, steps=5)
    return part
