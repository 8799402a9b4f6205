"""Objects in streets and on squares: cars, trees, benches and lamps."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..render import textures as paint
from ..render.paint import Colour, Rng, Texture, encode, fractal_noise, shape_of
from ..render.scene import GLOWING, SceneBuilder

CAR_PAINTS = ((0.42, 0.43, 0.44), (0.045, 0.047, 0.052), (0.62, 0.62, 0.61), (0.05, 0.10, 0.24), (0.36, 0.035, 0.03))


@dataclass(frozen=True)
class CarTextures:
    """Numbers of the textures that all cars of a scene share."""

    paints: tuple[int, ...]
    glass: int
    dark: int
    light: int
    plate: int


def car_textures(build: SceneBuilder, rng: Rng, texel_m: float) -> CarTextures:
    """Add the textures of cars to a scene."""
    # cars are seen from nearby, so their texels are fine
    fine = min(texel_m, 0.03)
    paints = tuple(build.add_texture(_lacquer(rng, fine, colour)) for colour in CAR_PAINTS)
    glass = build.add_texture(paint.cloth(rng, fine, (0.045, 0.055, 0.062)))
    dark = build.add_texture(paint.cloth(rng, fine, (0.03, 0.03, 0.033)))
    light = build.add_texture(paint.cloth(rng, fine, (0.70, 0.68, 0.62)))
    plate = build.add_texture(paint.sign_board(rng, 0.52, 0.12, 0.01, ("HH WB 417",), (0.75, 0.75, 0.72), (0.03, 0.03, 0.05)))
    return CarTextures(paints, glass, dark, light, plate)


def _lacquer(rng: Rng, texel_m: float, colour: Colour) -> Texture:
    """Paint car lacquer, dusty towards the bottom."""
    shape = shape_of(4.0, 1.0, texel_m)
    dust = np.linspace(1.03, 0.9, shape[0], dtype=np.float32)[:, None] * (1 + 0.025 * fractal_noise(rng, shape, texel_m, 0.5))
    return encode(dust[..., None] * np.asarray(colour, np.float32), texel_m)


def car(build: SceneBuilder, look: CarTextures, colour: int, *, length: float = 4.3) -> SceneBuilder:
    """Return a car at the origin, nose along +x, as a part to `stamp`."""
    part = build.with_same_textures()
    body = look.paints[colour % len(look.paints)]
    half = length / 2
    wide = 1.76
    part.box((0.0, 0.0, 0.26), (length, wide, 0.28), look.dark, sides=body)
    part.box((0.0, 0.0, 0.54), (length - 0.12, wide, 0.34), body)
    # the cabin: glass all round, under a painted roof; its eight corners are those of a car of 4.3 m
    low = [np.array([x * (length / 4.3), y, 0.88]) for x, y in ((0.95, 0.80), (-1.75, 0.80), (-1.75, -0.80), (0.95, -0.80))]
    top = [np.array([x * (length / 4.3), y, 1.44]) for x, y in ((0.25, 0.62), (-1.20, 0.62), (-1.20, -0.62), (0.25, -0.62))]
    for k, (a, c) in enumerate(zip(low, top, strict=True)):
        b = low[(k + 1) % 4]
        d = top[(k + 1) % 4]
        for corners in (np.array([a, b, d]), np.array([a, d, c])):
            part.triangle(corners, (b - a) / np.linalg.norm(b - a), (0, 0, -1), look.glass)
        part.beam(a, c, 0.07, body)
    part.box((-0.475 * length / 4.3, 0.0, 1.43), (1.5 * length / 4.3, 1.28, 0.05), body)
    for along, side in itertools.product((-0.30 * length, 0.31 * length), (-0.74, 0.74)):
        part.ball((along, side, 0.31), (0.31, 0.17, 0.31), look.dark, steps=5)
    for side in (-0.62, 0.62):
        part.box((half - 0.03, side, 0.58), (0.08, 0.34, 0.16), look.light)
        part.box((-half + 0.03, side, 0.60), (0.08, 0.30, 0.16), look.paints[4])
    for end, height in ((half, 0.40), (-half, 0.42)):
        part.box((end, 0.0, height), (0.52, 0.03, 0.12), look.plate, yaw=np.pi / 2)
    return part


@dataclass(frozen=True)
class Furniture:
    """Numbers of the textures of trees, benches and posts."""

    bark: int
    crown: int
    wood: int
    steel: int
    stone: int
    bulb: int


def furniture_textures(build: SceneBuilder, rng: Rng, texel_m: float) -> Furniture:
    """Add the textures of street furniture to a scene."""
    return Furniture(
        bark=build.add_texture(paint.planks(rng, 1.0, 3.0, texel_m, (0.13, 0.10, 0.075))),
        crown=build.add_texture(paint.leaves(rng, texel_m)),
        wood=build.add_texture(paint.planks(rng, 2.0, 1.0, texel_m)),
        steel=build.add_texture(paint.painted_steel(rng, 2.0, 5.0, texel_m, (0.10, 0.11, 0.11))),
        stone=build.add_texture(paint.plaster(rng, 3.0, 2.0, texel_m, (0.40, 0.38, 0.34))),
        bulb=build.add_texture(paint.cloth(rng, 0.02, (0.9, 0.88, 0.8))),
    )


def tree(build: SceneBuilder, rng: Rng, look: Furniture, *, height: float = 6.0) -> SceneBuilder:
    """Return a tree at the origin, a trunk and a crown of leafy lumps, as a part to `stamp`."""
    part = build.with_same_textures()
    part.tube((0.0, 0.0, 0.0), 0.03 * height, 0.55 * height, look.bark, sides=9)
    for _ in range(9):
        turn = rng.uniform(0, 2 * np.pi)
        out = rng.uniform(0, 0.2) * height
        up = rng.uniform(0.52, 0.88) * height
        size = rng.uniform(0.11, 0.19, 3) * height
        part.ball((out * np.cos(turn), out * np.sin(turn), up), size, look.crown, steps=6)
    return part


def bench(build: SceneBuilder, look: Furniture) -> SceneBuilder:
    """Return a bench at the origin, 1.8 m along x, as a part to `stamp`."""
    part = build.with_same_textures()
    for k in range(3):
        part.box((0.0, -0.15 + 0.15 * k, 0.44), (1.8, 0.11, 0.04), look.wood)
    for k in range(2):
        part.box((0.0, 0.24, 0.58 + 0.15 * k), (1.8, 0.03, 0.10), look.wood)
    for side in (-0.7, 0.7):
        part.box((side, 0.0, 0.0), (0.08, 0.45, 0.44), look.steel)
    return part


def street_lamp(build: SceneBuilder, look: Furniture, *, height: float) -> SceneBuilder:
    """Return a post with a lamp head at the origin, as a part to `stamp`; its light source must be placed at `height`."""
    part = build.with_same_textures()
    part.tube((0.0, 0.0, 0.0), 0.11, 0.9, look.steel, sides=8)
    part.tube((0.0, 0.0, 0.9), 0.06, height - 0.85, look.steel, sides=8)
    part.kind = GLOWING
    part.ball((0.0, 0.0, height + 0.12), (0.2, 0.2, 0.1), look.bulb, steps=4)
    return part
