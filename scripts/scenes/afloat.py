"""The barge of the harbour, and what changes from capture to capture: the waves of the water, a forklift."""

from __future__ import annotations

from itertools import product

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.structures import Box, container, heap
from wbflow_demo.render import textures as paint
from wbflow_demo.render.paint import Rng, encode, fractal_noise, shape_of
from wbflow_demo.render.scene import MOVING, STATIC, WATER, Scene, SceneBuilder

LONG, EDGE, FAR, LEVEL = 64.0, -4.0, -15.0, -1.6
"""Length of the quay, y of its edge and of the opposite edge, and height of the water, in metres."""


def waves(build: SceneBuilder, rng: Rng, texel_m: float) -> int:
    """A texture of dark water with weak waves that reflects the sky."""
    ripples = fractal_noise(rng, shape_of(24.0, 11.0, 2 * texel_m), 2 * texel_m, 1.6, octaves=4, stretch=0.5)
    colour = np.asarray((0.050, 0.066, 0.062), np.float32)
    return build.add_texture(encode((1 + 0.2 * ripples)[..., None] * colour, 2 * texel_m, gloss=0.6))


def water(build: SceneBuilder, texture: int, z: float) -> None:
    """The basin in small pieces (4 x 5.5 m), since moving facets that reach behind a camera are not rendered again."""
    build.kind = WATER
    for x, y in product(np.arange(-LONG / 2, LONG / 2, 4.0), (EDGE, EDGE - 5.5)):
        build.quad((float(x), float(y), z), (4.0, 0, 0), (0, -5.5, 0), texture, (float(x) + LONG / 2, EDGE - float(y)))
    build.kind = STATIC


def afloat(rng: Rng, texel_m: float, captures: int) -> list[Scene]:
    """Different waves and another place of the forklift for each capture."""
    build = SceneBuilder()
    sheets = [waves(build, rng, texel_m) for _ in range(captures)]
    build.kind = MOVING
    yellow, dark = (build.add_texture(paint.painted_steel(rng, 3.0, 2.0, texel_m, c)) for c in ((0.5, 0.33, 0.03), (0.04,) * 3))
    lift = build.with_same_textures()
    lift.box((-0.2, 0.0, 0.3), (1.9, 1.15, 0.9), yellow)
    lift.box((-0.1, 0.0, 2.1), (1.5, 1.15, 0.08), yellow)
    for a, s in product((-0.7, 0.5), (-0.5, 0.5)):
        lift.beam((a, s, 1.2), (a, s, 2.1), 0.08, dark)
        lift.ball((a, s, 0.3), (0.3, 0.12, 0.3), dark, steps=5)
    for s in (-0.35, 0.35):
        lift.beam((0.95, s, 0.05), (0.95, s, 2.6), 0.12, dark)
        lift.beam((0.95, s, 0.15), (2.0, s, 0.15), 0.1, dark)
    scenes = []
    for texture in sheets:
        build = build.with_same_textures()
        build.stamp(lift, (float(rng.uniform(-12, 12)), float(rng.normal(4.0, 0.5)), 0.0), yaw=float(rng.uniform(0, 6)))
        water(build, texture, LEVEL)
        scenes.append(build.build())
    return scenes


def barge(build: SceneBuilder, rng: Rng, texel_m: float, planks: int) -> None:
    """A moored barge of 30 m, bow to the west, with gravel in its hold, two containers, a wheelhouse, and mooring lines."""
    hull = build.add_texture(paint.painted_steel(rng, 30.0, 2.4, texel_m, (0.11, 0.05, 0.045)))
    deck = build.add_texture(paint.painted_steel(rng, 30.0, 6.0, texel_m, (0.17, 0.22, 0.19)))
    white = build.add_texture(paint.plaster(rng, 6.0, 3.0, texel_m, (0.62, 0.61, 0.57)))
    gravel = build.add_texture(ground.gravel(rng, 7.0, 7.0, texel_m))
    y, low, top = EDGE - 3.3, LEVEL - 0.6, LEVEL + 1.3
    outline = np.array([(-16.5, y), (-14.5, y - 1.7), (-11.5, y - 2.6), (13.0, y - 2.6), (14.0, y - 1.6), (14.0, y + 1.6),
                        (13.0, y + 2.6), (-11.5, y + 2.6), (-14.5, y + 1.7)])  # fmt: skip
    for k, (a, b) in enumerate(zip(outline, np.roll(outline, -1, axis=0), strict=True)):
        build.quad((*a, top), (*(b - a), 0.0), (0, 0, low - top), hull, (3.0 * k, 0.0))
        corners = np.array([(0.0, y, top), (*a, top), (*b, top)])
        build.triangle(corners, (1, 0, 0), (0, -1, 0), deck, (16.5, 3.0))
        build.beam((*a, top + 0.1), (*b, top + 0.1), 0.2, hull)
    for side in (-1.9, 1.9):
        build.box((-1.5, y + side, top), (19.0, 0.15, 0.8), hull)
    for x in (-11.0, -3.4, 8.0):
        build.box((x, y, top), (0.15, 3.8, 0.8), hull)
    pile = build.with_same_textures()
    for x in (1.0, -1.2, 3.2):
        heap(pile, rng, (x, 0.0), 1.85, 1.3, gravel)
    build.stamp(pile, (1.3, y, top + 0.1))
    build.box((2.3, y, top), (11.2, 3.6, 0.25), gravel)
    for k, (colour, name) in enumerate((((0.06, 0.16, 0.36), "KUESTE"), ((0.50, 0.30, 0.05), "MARSCH"))):
        load = build.with_same_textures()
        container(load, rng, texel_m, Box(0.0, 0.0, 0, 0.03, 6.06, colour, name))
        build.stamp(load, (-7.2, y, top + 0.1 + 2.6 * k))
    pane = build.add_texture(paint.window(2.6, 1.2, texel_m))
    build.box((10.8, y, top), (4.0, 4.2, 1.5), white)
    build.box((10.6, y, top + 1.5), (2.6, 3.0, 1.6), white, sides=pane)
    build.box((10.6, y, top + 3.1), (3.2, 3.6, 0.12), deck)
    build.tube((12.4, y + 1.0, top + 1.5), 0.2, 1.8, hull, sides=8)
    build.box((12.4, y - 1.2, top + 1.5), (1.2, 0.8, 0.5), planks)
    for x, quay in ((-13.5, -21.0), (-10.5, -7.0), (8.0, 7.0), (13.5, 21.0)):
        build.beam((x, y + 2.0, top + 0.3), (quay, EDGE + 0.7, 0.5), 0.05, planks)
