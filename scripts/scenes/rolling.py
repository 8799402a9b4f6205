"""Snow-covered wagons: tank, box and flat wagons with timber, each a part that is stamped many times."""

from __future__ import annotations

from itertools import pairwise, product
from typing import NamedTuple

import numpy as np

from wbflow_demo.render import textures as paint
from wbflow_demo.render.covers import lettering
from wbflow_demo.render.paint import Colour, Rng, Texture, draw, encode, fractal_noise, mix, shape_of, smoothstep
from wbflow_demo.render.scene import SceneBuilder
from wbflow_stages.types import Float64s

from .shapes import rod
from .tanks import shell

LONG, DECK = 12.0, 1.25
"""Length of a wagon, and height of its floor, in metres."""


class Look(NamedTuple):
    """Indices of the textures that all wagons share."""

    frame: int
    dark: int
    snow: int


def box_side(rng: Rng, texel_m: float, colour: Colour, number: str) -> Texture:
    """Paint the side of a box wagon: boards between posts, a sliding door, numbers, grime at the foot."""
    high = 2.6
    boards = paint.planks(rng, LONG, high, texel_m, colour)
    image = np.asarray(np.square(boards.pixels.astype(np.float32) / np.float32(255)), np.float32)
    shape = shape_of(LONG, high, texel_m)
    posts = np.zeros(shape, np.uint8)
    for x in (0.05, 1.5, 3.0, 4.6, 7.4, 9.0, 10.5, LONG - 0.05):
        draw(posts, np.array([(x, 0.0), (x, high)]) / texel_m, 0.12 / texel_m)
    for start, end in (((4.6, 0.2), (7.4, 0.2)), ((4.6, 2.4), (7.4, 2.4)), ((4.6, 2.4), (7.4, 0.2)), ((0, 2.55), (LONG, 2.55))):
        draw(posts, np.array([start, end]) / texel_m, 0.09 / texel_m)
    mix(image, np.float32(0.55) * np.asarray(colour, np.float32), posts.astype(np.float32) / np.float32(255))
    words = ((number, 1.7, 0.4, 0.32), ("Gbs", 1.7, 0.9, 0.26), (number[3:], 9.1, 1.5, 0.22), ("24 t", 9.1, 0.5, 0.24))
    for text, x, y, tall in words:
        mix(image, (0.62, 0.60, 0.54), 0.85 * lettering(shape, texel_m, text, x, y, tall, bold=0.2))
    depth = np.linspace(0, high, shape[0], dtype=np.float32)[:, None]
    grime = smoothstep(0.9, 0.0, high - depth + 0.5 * fractal_noise(rng, shape, texel_m, 1.0))
    mix(image, (0.11, 0.09, 0.075), 0.6 * grime)
    return encode(image, texel_m)


def box_wagon(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: tuple[Colour, str]) -> SceneBuilder:
    """Return a box wagon with snow on its roof, along x at the origin."""
    part, side = _chassis(build, look), build.add_texture(box_side(rng, texel_m, *skin))
    top = DECK + 2.6
    part.box((0.0, 0.0, DECK), (LONG, 2.7, 2.6), side)
    half = [(1.42, top - 0.02), (1.1, top + 0.22), (0.45, top + 0.36)]
    ridge = half + [(-y, z) for y, z in half[::-1]]
    for k, ((y, z), (y2, z2)) in enumerate(pairwise(ridge)):
        part.quad((LONG / 2 + 0.1, y, z), (-LONG - 0.2, 0, 0), (0, y2 - y, z2 - z), look.snow, (0.0, 0.7 * k))
        for x in (-LONG / 2 - 0.05, LONG / 2 + 0.05):
            part.triangle(np.array([(x, 0.0, top - 0.02), (x, y, z), (x, y2, z2)]), (0, 1, 0), (0, 0, -1), look.frame)
    for x in (-LONG / 2 - 0.02, LONG / 2 + 0.02):
        part.beam((x, -0.9, DECK), (x, -0.9, top), 0.07, look.frame)
    return part


def tank_wagon(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: tuple[Colour, str]) -> SceneBuilder:
    """Return a tank wagon along x at the origin: a lying cylinder with snow on top, a dome, a ladder, a walkway."""
    part, radius, half, z = _chassis(build, look), 1.35, 5.1, DECK + 1.5
    wall = build.add_texture(shell(rng, 2 * half, 0.5 * np.pi * radius, texel_m, *skin))
    for side in (-1, 1):
        turn = np.linspace(0.0, np.pi, 17)
        ring = np.column_stack([-side * radius * np.sin(turn), z + radius * np.cos(turn)])
        for k, ((y, up), (y2, up2)) in enumerate(pairwise(ring)):
            under = 0.22 * k * radius / np.pi * 2
            texture = look.snow if k < 2 else wall
            part.quad((side * half, -y, up), (-2 * side * half, 0, 0), (0, y - y2, up2 - up), texture, (0.0, under))
        part.ball((side * half, 0.0, z), (0.42, radius, radius), wall, steps=10)
        part.box((side * 3.6, 0.0, DECK - 0.1), (0.5, 2.3, 0.7), look.frame)
    part.tube((0.4, 0.0, z + radius - 0.1), 0.42, 0.45, look.frame)
    part.ball((0.4, 0.0, z + radius + 0.36), (0.44, 0.44, 0.12), look.snow, steps=5)
    part.box((-0.9, 0.0, z + radius + 0.05), (1.6, 0.5, 0.06), look.frame)
    for x in (-1.25, -0.75):
        part.beam((x, -1.42, DECK - 0.2), (x, -1.0, z + radius), 0.06, look.frame)
    for up in np.arange(DECK, z + radius, 0.35):
        part.beam((-1.25, -1.38, float(up)), (-0.75, -1.38, float(up)), 0.05, look.frame)
    return part


def timber_wagon(build: SceneBuilder, rng: Rng, texel_m: float, look: Look, skin: tuple[Colour, Colour]) -> SceneBuilder:
    """Return a flat wagon along x at the origin: two piles of logs between stakes, snow on top; skin: bark and cut ends."""
    part = _chassis(build, look)
    bark = build.add_texture(paint.planks(rng, 1.5, 5.2, texel_m, skin[0]))
    cut = build.add_texture(paint.cloth(rng, texel_m, skin[1]))
    part.box((0.0, 0.0, DECK - 0.12), (LONG, 2.7, 0.14), look.snow, sides=look.frame)
    for x, y in product((-5.2, -3.2, -0.9, 0.9, 3.2, 5.2), (-1.3, 1.3)):
        part.beam((x, y, DECK), (x, y, DECK + 1.9), 0.1, look.frame)
    for x in (-3.0, 3.0):
        for level in range(4):
            for y in np.linspace(-1.02, 1.02, 5) if level % 2 == 0 else np.linspace(-0.78, 0.78, 4):
                radius, off = float(rng.uniform(0.19, 0.26)), rng.normal(0, (0.08, 0.02, 0.02))
                start, end = np.array([x - 2.55, y, DECK + 0.26 + 0.43 * level]) + off, np.array([5.1, *rng.normal(0, 0.02, 2)])
                rod(part, start, start + end, radius, bark, sides=9)
                for tip in (start, start + end):
                    part.ball(tip, (0.02, radius, radius), cut, steps=4)
                if level == 3:
                    rest = np.add(start, (float(rng.uniform(0.05, 0.4)), 0.0, radius))
                    _cap(part, rest, (float(rng.uniform(4.2, 4.7)), 0.8 * radius), look.snow)
    return part


def _cap(part: SceneBuilder, start: Float64s, size: tuple[float, float], snow: int) -> None:
    """Snow on a log along x; size: its length and half its width, in metres."""
    for side in (-1, 1):
        ridge = np.add(start, (0.0, 0.0, 0.07))
        part.quad(ridge, (size[0], 0, 0), (0, side * size[1], -0.13), snow, (float(start[0]), float(start[1])))


def _chassis(build: SceneBuilder, look: Look) -> SceneBuilder:
    """A frame with wheels, axle boxes and buffers, along x at the origin."""
    part = build.with_same_textures()
    for y in (-1.05, 1.05):
        part.box((0.0, y, 0.92), (LONG, 0.16, 0.33), look.frame)
    part.box((0.0, 0.0, 1.05), (LONG - 0.2, 2.0, 0.18), look.frame)
    for x in (-LONG / 2, LONG / 2):
        part.box((x, 0.0, 0.9), (0.14, 2.6, 0.36), look.frame)
        for y in (-0.87, 0.87):
            rod(part, (0.98 * x, y, 1.06), (1.08 * x, y, 1.06), 0.1, look.dark, sides=8)
            part.ball((1.08 * x, y, 1.06), (0.05, 0.22, 0.22), look.dark, steps=5)
    for x, y in product((-4.9, -3.1, 3.1, 4.9), (-0.76, 0.76)):
        part.ball((x, y, 0.62), (0.46, 0.07, 0.46), look.dark, steps=7)
        part.box((x, 1.35 * y, 0.5), (0.4, 0.16, 0.3), look.frame)
    for x, y in product((-4.0, 4.0), (-1.02, 1.02)):
        part.box((x, y, 0.72), (2.6, 0.1, 0.24), look.frame)
    return part
