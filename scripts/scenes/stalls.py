"""Parts of the market: stalls with awnings and crates of fruit, parasols, the column in the middle."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_demo.render import textures as paint
from wbflow_demo.render.covers import blobs
from wbflow_demo.render.paint import Colour, Rng, Texture, encode, fractal_noise, mix, one_colour, shape_of, weather
from wbflow_demo.render.scene import SceneBuilder

from .shapes import cone


def stripes(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour) -> Texture:
    """Paint the cloth of an awning: stripes of 0.3 m in a colour and in off-white, uneven, weathered and stained."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, (0.53, 0.50, 0.43))
    x = (np.arange(shape[1], dtype=np.float32) + 0.5) * np.float32(texel_m)
    mix(image, colour, np.broadcast_to((x % 0.6 < 0.3).astype(np.float32), shape))
    image *= (1 + 0.10 * fractal_noise(rng, shape, texel_m, 0.9, octaves=4))[..., None]
    weather(rng, image, texel_m, strength=0.18, streaks=0.18)
    mix(image, (0.20, 0.18, 0.14), 0.5 * blobs(rng, shape, texel_m, count=14, radius_m=0.12))
    return encode(image, texel_m)


def fruit(rng: Rng, texel_m: float, tones: tuple[Colour, ...], radius_m: float) -> Texture:
    """Paint a crate filled with round goods of the given tones, each with a highlight and a darker rim."""
    fine = min(texel_m, 0.02)
    shape = shape_of(1.6, 1.2, fine)
    image = one_colour(shape, (0.03, 0.022, 0.015))
    for _ in range(int(2.5 * 1.6 * 1.2 / radius_m**2)):
        x, y = (float(p) for p in rng.uniform((0, 0), shape[::-1]))
        tone = np.asarray(tones[int(rng.integers(len(tones)))]) * rng.uniform(0.7, 1.2)
        for part, shade in ((1.0, 0.55), (0.8, 0.9), (0.4, 1.25)):
            radius, lift = part * radius_m / fine, (1 - part) * 0.4 * radius_m / fine
            cv2.circle(
                image,
                (round(16 * (x - lift)), round(16 * (y - lift))),
                round(16 * radius),
                (shade * tone).tolist(),
                -1,
                cv2.LINE_AA,
                4,
            )
    return encode(image, fine)


def stall(build: SceneBuilder, rng: Rng, texel_m: float, colour: Colour, looks: tuple[int, int, list[int]]) -> SceneBuilder:
    """Return a stall of 3.4 m that faces south: awning, table, and crates on it, in front of it and behind it."""
    part, (wood, steel, goods) = build.with_same_textures(), looks
    cloth = build.add_texture(stripes(rng, 3.6, 3.2, texel_m, colour))
    for x in (-1.6, 1.6):
        part.beam((x, -1.15, 0.0), (x, -1.15, 2.2), 0.07, steel)
        part.beam((x, 1.0, 0.0), (x, 1.0, 2.7), 0.07, steel)
    part.quad((-1.8, 1.1, 2.75), (3.6, 0, 0), (0, -2.5, -0.55), cloth)
    part.quad((-1.8, -1.4, 2.2), (3.6, 0, 0), (0, -0.02, -0.28), cloth, (0.0, 2.6))
    part.box((0.0, -0.7, 0.0), (3.2, 0.9, 0.85), wood, sides=cloth)
    for k in range(6):
        load, x = goods[int(rng.integers(len(goods)))], -1.35 + 0.54 * k + float(rng.normal(0, 0.02))
        part.box((x, -0.75, 0.85), (0.5, 0.75, float(rng.uniform(0.12, 0.3))), load, sides=wood, offset=float(rng.uniform(0, 1)))
        if rng.random() < 0.75:
            high = float(rng.choice((0.28, 0.46, 0.62)))
            part.box(
                (x, -1.62 + float(rng.normal(0, 0.05)), 0.0), (0.52, 0.7, high), load, sides=wood, yaw=float(rng.normal(0, 0.06))
            )
    for k in range(int(rng.integers(2, 5))):
        at, load = (-1.2 + 0.7 * k, 1.45 + float(rng.normal(0, 0.12)), 0.0), goods[k % len(goods)]
        for level in range(int(rng.integers(1, 4))):
            part.box((*at[:2], 0.3 * level), (0.62, 0.45, 0.28), load, sides=wood, yaw=float(rng.normal(0, 0.12)))
    return part


def parasol(build: SceneBuilder, look: tuple[int, int, int, int], at: tuple[float, float], turn: float) -> None:
    """Add a large parasol over a round table with baskets; look: cloth, steel, wood and goods."""
    (cloth, steel, wood, goods), (x, y) = look, at
    build.tube((x, y, 0.0), 0.05, 2.6, steel, sides=8)
    cone(build, (x, y, 2.15), 1.55, 0.6, cloth, sides=8)
    build.tube((x, y, 0.0), 0.9, 0.75, wood, sides=12)
    for k in range(5):
        bearing = turn + 2 * np.pi / 5 * k
        build.tube(
            (x + 0.95 * float(np.cos(bearing)), y + 0.95 * float(np.sin(bearing)), 0.0),
            0.28,
            0.5 + 0.1 * (k % 3),
            goods,
            sides=10,
        )


def column(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Add a column on three steps with eight sides: pedestal with an inscription, shaft, capital, a gilt figure."""
    stone = build.add_texture(paint.ashlar(rng, 14.0, 6.0, 0.7 * texel_m, tint=(0.9, 0.84, 0.74)))
    gilt = build.add_texture(paint.painted_steel(rng, 2.0, 3.0, texel_m, (0.42, 0.27, 0.05)))
    for k, radius in enumerate((2.5, 2.05, 1.6)):
        build.tube((0.0, 0.0, 0.18 * k), radius, 0.18, stone, sides=8)
    words = paint.sign_board(rng, 1.2, 0.8, 0.5 * texel_m, ("ANNO", "1674"), (0.30, 0.27, 0.22), (0.05, 0.045, 0.04))
    build.box((0.0, 0.0, 0.54), (1.5, 1.5, 1.5), stone, yaw=0.25)
    build.box((0.19, -0.75, 0.9), (1.2, 0.08, 0.8), build.add_texture(words), yaw=0.25)
    build.box((0.0, 0.0, 2.04), (1.75, 1.75, 0.18), stone, yaw=0.25)
    build.tube((0.0, 0.0, 2.22), 0.5, 0.25, stone, sides=16)
    build.tube((0.0, 0.0, 2.47), 0.38, 3.4, stone, sides=16)
    build.box((0.0, 0.0, 5.87), (1.0, 1.0, 0.3), stone, yaw=0.25)
    build.tube((0.0, 0.0, 6.17), 0.26, 0.9, gilt, sides=9)
    build.ball((0.0, 0.0, 7.3), (0.3, 0.24, 0.45), gilt, steps=7)
    build.ball((0.0, 0.0, 7.9), (0.15, 0.15, 0.19), gilt, steps=6)
    build.beam((0.2, 0.0, 7.4), (0.75, -0.35, 8.0), 0.12, gilt)
