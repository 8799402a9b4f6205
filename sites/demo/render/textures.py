"""Textures of buildings and objects: brick, tiles, plaster, painted steel, planks, windows, signs, and foliage.

Every texture is painted for one surface, `width_m` x `height_m`, with row 0 at the top, and varies at every scale from metres
(stains, repairs, weathering) to a texel, so that no two places look the same; only windows repeat.
"""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.types import Float32s

from .covers import blobs, lettering, stones
from .paint import Colour, Rng, Texture, cracks, encode, fractal_noise, mix, one_colour, palette, shape_of, smoothstep, weather

# Tones of the single bricks, tiles and stones of a wall: linear reflectances, red, green, blue.
BRICK_TONES = ((0.30, 0.12, 0.075), (0.36, 0.155, 0.09), (0.23, 0.09, 0.06), (0.40, 0.20, 0.12), (0.27, 0.14, 0.11))
TILE_TONES = ((0.30, 0.12, 0.07), (0.24, 0.10, 0.07), (0.35, 0.16, 0.10), (0.17, 0.09, 0.07))
ASHLAR_TONES = ((0.46, 0.41, 0.33), (0.52, 0.47, 0.38), (0.41, 0.37, 0.31), (0.49, 0.42, 0.32))
RUST: Colour = (0.19, 0.075, 0.03)


def brick_wall(
    rng: Rng, width_m: float, height_m: float, texel_m: float, tint: Colour = (1.0, 1.0, 1.0), *, sign: str = ""
) -> Texture:
    """Paint old brickwork: tone by brick, pale joints, repairs, streaks, damp and salt at the foot, a faded painted sign."""
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, relief = stones(rng, shape, texel_m, (0.25, 0.078), 0.013, bond=0.5, jitter=0.05, warp=0.004)
    repairs = blobs(rng, shape, texel_m, count=int(width_m * height_m / 18), radius_m=0.6)
    # 1. The bricks: repaired patches have brighter ones, in another order of tones.
    image = palette(BRICK_TONES, tone) * np.asarray(tint, np.float32)
    mix(image, palette(BRICK_TONES[::-1], -tone) * np.float32(1.25), (repairs > 0.55).astype(np.float32) * 0.8)
    image *= (1 + 0.16 * relief)[..., None]
    if sign:
        # letters about as high as wide, which together take up at most nine tenths of the wall
        size = min(0.12 * height_m, 0.9 * width_m / max(len(sign), 1))
        faded = lettering(shape, texel_m, sign, 0.06 * width_m, 0.445 * height_m, size, bold=0.2)
        mix(image, (0.62, 0.60, 0.52), faded * (0.55 + 0.3 * fractal_noise(rng, shape, texel_m, 0.6)))
    # 2. The joints cover the sign, too: its paint has come off the mortar.
    mortar = np.float32(0.42) + np.float32(0.06) * fractal_noise(rng, shape, texel_m, 1.2, octaves=5)
    mix(image, mortar[..., None] * np.asarray((1.0, 0.94, 0.84), np.float32), 1 - cover)

    # 3. Weather, damp in the lowest metre, salt above it.
    weather(rng, image, texel_m, strength=0.16, streaks=0.22)
    height = np.linspace(0, height_m, shape[0], dtype=np.float32)[:, None]
    damp = smoothstep(0.9, 0.0, height_m - height + 0.35 * fractal_noise(rng, shape, texel_m, 1.5))
    image *= (1 - 0.45 * damp)[..., None]
    salt = blobs(rng, shape, texel_m, count=int(width_m), radius_m=0.35)
    salt *= smoothstep(-0.3, 1.2, fractal_noise(rng, shape, texel_m, 0.3))
    mix(image, (0.60, 0.57, 0.52), 0.55 * salt * smoothstep(2.5, 0.6, height_m - height))
    return encode(image, texel_m)


def roof_tiles(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint pantiles in rows, dark under each row's lip, with moss and replaced tiles."""
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, relief = stones(rng, shape, texel_m, (0.24, 0.33), 0.02, bond=0.0, jitter=0.03, warp=0.008)
    image = palette(TILE_TONES, tone) * (1 + 0.35 * relief)[..., None]
    mix(image, (0.03, 0.025, 0.02), 1 - cover)
    weather(rng, image, texel_m, strength=0.2, streaks=0.12)
    mix(image, (0.10, 0.12, 0.05), 0.7 * smoothstep(0.9, 1.9, fractal_noise(rng, shape, texel_m, 1.2)))
    return encode(image, texel_m)


def plaster(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour = (0.62, 0.58, 0.48)) -> Texture:
    """Paint nearly even plaster that is intentionally hard to match: a few cracks, faint stains, flaked spots at the foot."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, colour)
    tone = 1 + 0.025 * fractal_noise(rng, shape, texel_m, 3.0) + 0.012 * fractal_noise(rng, shape, texel_m, 0.05, octaves=2)
    image *= tone[..., None]
    mix(image, (0.25, 0.22, 0.19), 0.5 * cracks(rng, shape, texel_m, count=int(width_m / 3), length_m=2.0))
    flakes = blobs(rng, shape, texel_m, count=int(width_m / 2), radius_m=0.3)
    # only where splashes of rain reach
    flakes[: int(0.8 * shape[0])] = 0
    mix(image, (0.33, 0.18, 0.12), (flakes > 0.5).astype(np.float32))
    return encode(image, texel_m)


def container_side(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour, name: str, serial: str) -> Texture:
    """Paint a container's steel wall: company name, disc, sometimes a stripe, serial number, stains, and rust from the edges."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, colour)
    # letters stand out: dark ones on bright paint
    pale: Colour = (0.72, 0.70, 0.66) if sum(colour) < 1.2 else (0.10, 0.16, 0.32)
    if name:
        size = min(0.33 * height_m, 0.95 * width_m / len(name))
        mix(image, pale, 0.92 * lettering(shape, texel_m, name, 0.08 * width_m, 0.28 * height_m, size, bold=0.2))
        band = np.zeros(shape, np.float32)
        # a stripe on every second container, by chance
        band[int(0.72 * shape[0]) : int(0.78 * shape[0])] = float(rng.integers(0, 2))
        centre = (int((0.90 - 0.05 * rng.random()) * shape[1]), int(0.45 * shape[0]))
        cv2.circle(band, centre, int(0.11 * shape[0]), 1.0, -1, cv2.LINE_AA)
        mix(image, pale, 0.85 * band)
    mix(image, pale, 0.9 * lettering(shape, texel_m, serial, 0.62 * width_m, 0.06 * height_m, 0.13))
    mix(image, pale, 0.8 * lettering(shape, texel_m, "22G1 MAX 30480 KG", 0.62 * width_m, 0.14 * height_m, 0.08))
    weather(rng, image, texel_m, strength=0.10, streaks=0.16)
    _rust(rng, image, texel_m, amount=float(rng.uniform(0.2, 0.7)))
    return encode(image, texel_m)


def container_roof(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour) -> Texture:
    """Paint a container's ribbed roof: dirt, dried puddles, rust, and the faded number for the crane driver."""
    shape = shape_of(width_m, height_m, texel_m)
    # ribs every 0.28 m, painted only, without relief
    rib = np.asarray(np.sin(np.arange(shape[1], dtype=np.float32) * np.float32(texel_m * 2 * np.pi / 0.28)), dtype=np.float32)
    image = one_colour(shape, colour) * (1 + 0.10 * rib)[None, :, None]
    number = lettering(shape, texel_m, str(rng.integers(1000, 9999)), 0.2 * width_m, 0.25 * height_m, 0.5 * height_m, bold=0.18)
    mix(image, (0.70, 0.68, 0.62), 0.75 * number * smoothstep(-0.6, 0.4, fractal_noise(rng, shape, texel_m, 0.4)))
    dirt = smoothstep(-0.2, 1.6, fractal_noise(rng, shape, texel_m, 1.1, octaves=7, gain=0.75))
    mix(image, (0.17, 0.145, 0.115), 0.75 * dirt)
    puddles = blobs(rng, shape, texel_m, count=int(2 * width_m), radius_m=0.16)
    image *= (1 - 0.45 * puddles)[..., None]
    weather(rng, image, texel_m, strength=0.12)
    _rust(rng, image, texel_m, amount=0.6)
    return encode(image, texel_m)


def _rust(rng: Rng, image: Float32s, texel_m: float, *, amount: float) -> None:
    """Add rust in streaks where the sum of noise and closeness to the top and bottom edges is large."""
    shape = image.shape[:2]
    y = np.linspace(-1, 1, shape[0], dtype=np.float32)[:, None] ** 4
    field = fractal_noise(rng, shape, texel_m, 1.5) + 0.7 * fractal_noise(rng, shape, texel_m, 0.25, stretch=6.0) + 1.2 * y
    # a larger amount lowers the threshold that the field has to pass
    cover = smoothstep(2.9 - 1.6 * amount, 4.0 - 1.6 * amount, field)
    tone = 1 + 0.35 * fractal_noise(rng, shape, texel_m, 0.1, octaves=3)
    mix(image, tone[..., None] * np.asarray(RUST, np.float32), 0.9 * cover)


def painted_steel(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour, *, stripes: bool = False) -> Texture:
    """Paint the steel of cranes, posts and vehicles, with or without warning stripes."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, colour)
    if stripes:
        diagonal = np.indices(shape, dtype=np.float32).sum(axis=0) * texel_m
        mix(image, (0.03, 0.03, 0.03), (diagonal % 0.5 < 0.25).astype(np.float32))
    weather(rng, image, texel_m, strength=0.12, streaks=0.12)
    _rust(rng, image, texel_m, amount=0.35)
    return encode(image, texel_m)


def planks(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour = (0.36, 0.24, 0.13)) -> Texture:
    """Paint vertical boards with grain: gates, crates, pallets."""
    shape = shape_of(width_m, height_m, texel_m)
    # boards are stones that are higher than the surface
    cover, tone, _ = stones(rng, shape, texel_m, (0.16, height_m + 1.0), 0.014, bond=0.0, jitter=0.06, warp=0.003)
    image = (1 + 0.22 * tone)[..., None] * np.asarray(colour, np.float32)
    image *= (1 + 0.16 * fractal_noise(rng, shape, texel_m, 0.06, octaves=3, stretch=14.0))[..., None]
    mix(image, (0.03, 0.025, 0.02), 1 - cover)
    weather(rng, image, texel_m, strength=0.15, streaks=0.1)
    return encode(image, texel_m)


def roller_door(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour, number: str) -> Texture:
    """Paint a slatted steel door with a large number."""
    shape = shape_of(width_m, height_m, texel_m)
    # slats of 0.12 m, each bright in the middle, as if rounded
    y = (np.arange(shape[0], dtype=np.float32) * texel_m % 0.12) / 0.12
    light = np.asarray(0.75 + 0.4 * np.sin(np.pi * y), dtype=np.float32)
    image = one_colour(shape, colour) * light[:, None, None]
    digits = lettering(shape, texel_m, number, 0.3 * width_m, 0.22 * height_m, 0.3 * height_m, bold=0.2)
    mix(image, (0.75, 0.73, 0.66), 0.9 * digits)
    weather(rng, image, texel_m, strength=0.10, streaks=0.16)
    _rust(rng, image, texel_m, amount=0.4)
    return encode(image, texel_m)


def window(width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint the window that all façades repeat: white bars, dark panes that reflect a pale sky, a half-drawn blind."""
    shape = shape_of(width_m, height_m, texel_m)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32) * np.float32(texel_m)
    sheen = smoothstep(0.0, 1.0, 0.9 - 0.5 * y / height_m - 0.35 * x / width_m)
    image = np.asarray((0.03, 0.035, 0.04), np.float32) + sheen[..., None] * np.asarray((0.10, 0.13, 0.16), np.float32)
    blind = ((y < 0.38 * height_m) & (x > 0.5 * width_m)).astype(np.float32)
    mix(image, (0.48, 0.44, 0.34), blind * (0.8 + 0.2 * (y % 0.06 > 0.015)))
    # distance from the nearest bar: 3 upright and 4 level ones, 7 cm wide
    off = [np.abs(x - bar) for bar in np.linspace(0, width_m, 3)] + [np.abs(y - bar) for bar in np.linspace(0, height_m, 4)]
    mix(image, (0.66, 0.65, 0.60), (0.035 - np.min(off, axis=0)) / texel_m + 0.5)
    return encode(image, texel_m)


def sign_board(
    rng: Rng, width_m: float, height_m: float, texel_m: float, lines: tuple[str, ...], colour: Colour, ink: Colour
) -> Texture:
    """Paint a sign board with a frame and lines of text."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, colour)
    pitch = height_m / len(lines)
    for k, line in enumerate(lines):
        size = min(0.55 * pitch, 1.25 * width_m / max(len(line), 1) * 0.8)
        mix(image, ink, lettering(shape, texel_m, line, 0.07 * width_m, (k + 0.25) * pitch, size, bold=0.17))
    border = max(int(0.03 / texel_m), 1)
    for edge in (image[:border], image[-border:], image[:, :border], image[:, -border:]):
        edge[:] = np.asarray(ink, np.float32)
    weather(rng, image, texel_m, strength=0.06, streaks=0.12)
    return encode(image, texel_m)


def cloth(rng: Rng, texel_m: float, colour: Colour) -> Texture:
    """Paint clothes, skin, rubber or glass: one colour with slight folds and grain."""
    shape = shape_of(1.0, 1.0, texel_m)
    factor = 1 + 0.18 * fractal_noise(rng, shape, texel_m, 0.3)
    return encode(factor[..., None] * np.asarray(colour, np.float32), texel_m)


def ashlar(rng: Rng, width_m: float, height_m: float, texel_m: float, tint: Colour = (1.0, 1.0, 1.0)) -> Texture:
    """Paint dressed stone in courses, with stains and streaks."""
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, relief = stones(rng, shape, texel_m, (0.95, 0.42), 0.014, bond=0.5, jitter=0.10, warp=0.003)
    image = palette(ASHLAR_TONES, tone) * np.asarray(tint, np.float32) * (1 + 0.05 * relief)[..., None]
    image *= (1 + 0.06 * fractal_noise(rng, shape, texel_m, 0.08, octaves=3))[..., None]
    mix(image, (0.22, 0.20, 0.17), 0.85 * (1 - cover))
    weather(rng, image, texel_m, strength=0.12, streaks=0.2)
    return encode(image, texel_m)


def leaves(rng: Rng, texel_m: float, colour: Colour = (0.06, 0.095, 0.03)) -> Texture:
    """Paint the outside of foliage: clumps of light and shadow at all scales down to a leaf."""
    shape = shape_of(3.0, 3.0, texel_m)
    # a high gain keeps the fine octaves strong: leaves, not clouds
    clumps = fractal_noise(rng, shape, texel_m, 0.7, octaves=6, gain=0.85)
    image = np.clip(1 + 0.55 * clumps, 0.12, 3)[..., None] * np.asarray(colour, np.float32)
    mix(image, (0.32, 0.22, 0.06), 0.5 * smoothstep(1.2, 2.2, fractal_noise(rng, shape, texel_m, 0.25, octaves=3)))
    return encode(image, texel_m)
