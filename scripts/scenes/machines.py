"""Machines of the shop, of painted steel with panels: each is a part to stamp, at the origin, with its front to the south."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wbflow_demo.render import Place
from wbflow_demo.render import textures as paint
from wbflow_demo.render.covers import blobs
from wbflow_demo.render.paint import Colour, Rng, Texture, draw, encode, fractal_noise, mix, one_colour, shape_of, smoothstep
from wbflow_demo.render.scene import SceneBuilder

from .shapes import rod

Skin = tuple[Colour, str]
"""Colour of a machine, and its maker's name."""


class Look(NamedTuple):
    """Indices of the textures that all machines share."""

    steel: int
    dark: int
    bare: int
    yellow: int
    red: int


def panel(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour) -> Texture:
    """Paint a machine's covers: lacquer with seams, air slots, small spots, greasy stains, a dirty foot."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, colour) * (1 + 0.03 * fractal_noise(rng, shape, texel_m, 0.8, octaves=5))[..., None]
    seams = np.zeros(shape, np.uint8)
    for x in np.arange(0.0, width_m, max(width_m / max(round(width_m / 0.9), 1), 0.4)):
        draw(seams, np.array([(x, 0.0), (x, height_m)]) / texel_m, 0.015 / texel_m, 150)
    for y in (0.02, 0.45 * height_m):
        draw(seams, np.array([(0.0, y), (width_m, y)]) / texel_m, 0.015 / texel_m, 150)
    left = 0.08 * width_m + float(rng.uniform(0, 0.4 * width_m))
    for k in range(6):
        y = 0.6 * height_m + 0.05 * k
        draw(seams, np.array([(left, y), (left + 0.4, y)]) / texel_m, 0.022 / texel_m)
    mix(image, (0.03, 0.03, 0.03), seams.astype(np.float32) / np.float32(255))
    mix(image, (0.06, 0.05, 0.04), 0.4 * blobs(rng, shape, texel_m, count=int(14 * width_m * height_m), radius_m=0.025))
    mix(image, (0.08, 0.07, 0.06), 0.35 * smoothstep(0.7, 2.2, fractal_noise(rng, shape, texel_m, 0.5, octaves=5)))
    up = height_m - np.arange(shape[0], dtype=np.float32)[:, None] * np.float32(texel_m)
    mix(image, (0.07, 0.06, 0.05), 0.6 * smoothstep(0.5, 0.0, up + 0.15 * fractal_noise(rng, shape, texel_m, 0.4)))
    return encode(image, texel_m)


def plate(part: SceneBuilder, build: SceneBuilder, rng: Rng, texel_m: float, name: str, at: Place) -> None:
    """Add a maker's plate to a machine's front; at: the middle of its lower edge."""
    board = paint.sign_board(rng, 0.9, 0.22, min(texel_m, 0.02), (name,), (0.55, 0.54, 0.50), (0.05, 0.09, 0.25))
    part.box(at, (0.9, 0.02, 0.22), build.add_texture(board))


def lathe(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: Skin) -> SceneBuilder:
    """Return a lathe of 3.4 m: bed on two feet, headstock with chuck and work, carriage, tailstock, a tray of chips."""
    part, coat = build.with_same_textures(), build.add_texture(panel(rng, 3.4, 1.4, texel_m, skin[0]))
    part.box((-1.2, 0.0, 0.0), (1.0, 0.9, 0.75), coat)
    part.box((1.3, 0.0, 0.0), (0.7, 0.8, 0.75), coat, offset=1.0)
    part.box((0.1, -0.1, 0.3), (1.7, 1.0, 0.1), look.dark)
    part.box((0.1, 0.0, 0.75), (3.3, 0.42, 0.22), look.bare)
    part.box((-1.2, 0.0, 0.75), (1.0, 0.85, 0.72), coat, offset=1.6)
    rod(part, (-0.7, 0.0, 1.2), (-0.5, 0.0, 1.2), 0.24, look.bare, sides=14)
    part.ball((-0.5, 0.0, 1.2), (0.02, 0.24, 0.24), look.dark, steps=5)
    rod(part, (-0.5, 0.0, 1.2), (0.9, 0.0, 1.2), 0.08, look.bare)
    part.box((0.35, -0.1, 0.97), (0.5, 0.7, 0.16), coat, offset=0.4)
    part.box((0.35, -0.05, 1.13), (0.22, 0.3, 0.12), look.dark)
    part.ball((0.35, -0.5, 0.85), (0.14, 0.03, 0.14), look.dark, steps=6)
    part.box((1.15, 0.0, 0.97), (0.45, 0.34, 0.36), coat, offset=2.2)
    part.ball((1.45, 0.0, 1.15), (0.03, 0.16, 0.16), look.dark, steps=6)
    part.box((-0.1, 0.44, 0.9), (2.6, 0.05, 0.75), coat, offset=0.7)
    part.box((-1.5, -0.44, 1.22), (0.3, 0.05, 0.18), look.dark)
    plate(part, build, rng, texel_m, skin[1], (-1.2, -0.44, 0.9))
    return part


def mill(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: Skin) -> SceneBuilder:
    """Return a closed milling machine: a housing with a glass door, a panel on an arm, a lamp of two colours, a chip bin."""
    part, (colour, name) = build.with_same_textures(), skin
    coat = build.add_texture(panel(rng, 2.8, 2.3, texel_m, colour))
    pale = build.add_texture(panel(rng, 2.8, 2.3, texel_m, (0.55, 0.55, 0.53)))
    part.box((0.0, 0.2, 0.12), (2.7, 1.7, 0.75), coat)
    part.box((0.0, 0.3, 0.87), (2.6, 1.5, 1.25), pale, front=coat)
    part.box((-0.2, -0.47, 1.0), (1.5, 0.06, 0.95), look.dark)
    part.box((-0.2, -0.51, 1.45), (0.05, 0.06, 0.4), look.bare)
    part.box((0.1, 0.7, 2.12), (1.1, 0.9, 0.55), coat)
    part.beam((1.2, -0.5, 1.75), (1.2, -0.85, 1.6), 0.08, look.bare)
    words = ("N10 G0", "X 42.1", "Z -7.3")
    screen = paint.sign_board(rng, 0.55, 0.7, min(texel_m, 0.02), words, (0.05, 0.09, 0.14), (0.45, 0.60, 0.55))
    part.box((1.2, -0.9, 1.05), (0.55, 0.1, 0.7), look.dark, front=build.add_texture(screen))
    plate(part, build, rng, texel_m, name, (-0.7, -0.67, 0.5))
    part.tube((1.1, 0.4, 2.12), 0.035, 0.3, look.bare, sides=6)
    for k, light in enumerate((look.yellow, look.red)):
        part.tube((1.1, 0.4, 2.42 + 0.12 * k), 0.06, 0.12, light, sides=8)
    part.box((-1.75, 0.3, 0.0), (0.7, 0.9, 0.8), look.yellow)
    return part


def press(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: Skin) -> SceneBuilder:
    """Return a hydraulic press of 3 m: two columns, a head, a ram over a table, a pipe, a cabinet, striped guards."""
    part, coat = build.with_same_textures(), build.add_texture(panel(rng, 2.0, 3.0, texel_m, skin[0]))
    stripes = build.add_texture(paint.painted_steel(rng, 1.5, 1.5, texel_m, (0.55, 0.40, 0.03), stripes=True))
    for x in (-0.7, 0.7):
        part.box((x, 0.0, 0.0), (0.3, 1.2, 3.0), coat, offset=x + 0.7)
        part.box((x, -0.66, 0.9), (0.1, 0.1, 1.3), stripes)
    part.box((0.0, 0.0, 2.2), (1.1, 1.1, 0.8), coat)
    part.box((0.0, 0.0, 0.0), (1.1, 1.0, 0.9), coat, offset=0.5)
    plate(part, build, rng, texel_m, skin[1], (0.0, -0.56, 2.5))
    part.tube((0.0, 0.0, 1.6), 0.17, 0.6, look.bare)
    part.box((0.0, 0.0, 1.42), (0.8, 0.6, 0.18), look.dark)
    part.tube((0.0, 0.0, 3.0), 0.3, 0.45, coat)
    rod(part, (0.3, 0.1, 3.3), (1.25, 0.3, 1.7), 0.04, look.dark, sides=7)
    part.box((1.35, 0.2, 0.0), (0.7, 0.7, 1.7), coat, offset=1.1)
    return part


def drill(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: Skin) -> SceneBuilder:
    """Return a column drill, 2 m high."""
    part, coat = build.with_same_textures(), build.add_texture(panel(rng, 1.0, 1.0, texel_m, skin[0]))
    part.box((0.0, 0.0, 0.0), (0.6, 0.8, 0.12), look.dark)
    part.tube((0.0, 0.2, 0.12), 0.09, 1.8, look.bare)
    part.box((0.0, -0.1, 0.9), (0.5, 0.5, 0.06), look.bare)
    part.box((0.0, 0.0, 1.5), (0.4, 0.75, 0.45), coat)
    part.tube((0.0, -0.22, 1.2), 0.05, 0.32, look.bare, sides=8)
    for k in range(3):
        part.beam((0.2, -0.1, 1.6), (0.24, -0.1 + 0.3 * np.cos(2.1 * k), 1.6 + 0.3 * np.sin(2.1 * k)), 0.03, look.dark)
    return part
