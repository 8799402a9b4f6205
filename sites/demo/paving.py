"""Textures of squares and streets: paving that repeats exactly, asphalt, lawn, leaves, ashlar."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.types import Float32s

from .paint import Colour, Texture, encode, mix, palette, shape_of, stones, weather
from .random_fields import Rng, blobs, cracks, fractal_noise, smoothstep

SLAB_TONES: tuple[Colour, ...] = (
    (0.36, 0.34, 0.31),
    (0.30, 0.285, 0.27),
    (0.42, 0.39, 0.35),
    (0.25, 0.24, 0.235),
    (0.38, 0.31, 0.26),
)
ASHLAR_TONES: tuple[Colour, ...] = ((0.46, 0.41, 0.33), (0.52, 0.47, 0.38), (0.41, 0.37, 0.31), (0.49, 0.42, 0.32))


def repeating_tiles(rng: Rng, tile_m: float, tiles: int, texel_m: float) -> Texture:
    """`tiles` x `tiles` copies of one tile, equal to the bit: a patterned slab of `tile_m` metres with a joint around it.

    `tile_m` is rounded to whole texels; lay the texture edge to edge and the ground repeats everywhere.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    tile_m : float
        Metres; rounded to whole texels.
    tiles : int
        Along either side.
    texel_m : float
        Side of a texel, metres.
    """
    n = max(round(tile_m / texel_m), 4)
    shape = (n, n)
    y, x = (np.indices(shape, dtype=np.float32) + 0.5) / n
    # four slabs around a small dark one, as cut stone is often laid; each with its own tone and grain
    inset = np.float32(0.24)
    arms = np.where((y < inset) & (x >= inset), 0, np.where((x >= inset) & (y >= inset) & (x > y), 1, np.where(y >= inset, 2, 3)))
    arms = np.where((np.abs(x - 0.60) < 0.10) & (np.abs(y - 0.55) < 0.10), 4, arms)
    tones = rng.permutation(np.array(SLAB_TONES, np.float32))
    image = np.asarray(tones[arms], np.float32)
    image[arms == 4] *= np.float32(0.45)
    grain = fractal_noise(rng, shape, tile_m / n, 0.12, octaves=4, gain=0.8)
    image *= (1 + 0.14 * grain)[..., None]
    image *= (1 - 0.35 * blobs(rng, shape, tile_m / n, count=5, radius_m=0.04 * tile_m))[..., None]
    edge = np.abs(np.diff(arms, axis=0, prepend=arms[:1])) + np.abs(np.diff(arms, axis=1, prepend=arms[:, :1])) > 0
    wide = max(round(0.012 / (tile_m / n)), 1)
    joints = cv2.dilate(edge.astype(np.uint8), np.ones((wide, wide), np.uint8)).astype(np.float32)
    joints[:wide], joints[:, :wide] = 1.0, 1.0
    mix(image, (0.10, 0.09, 0.075), 0.9 * joints)
    one = encode(image, tile_m / n)
    return Texture(np.ascontiguousarray(np.tile(one.pixels, (tiles, tiles, 1))), one.texel_m)


def asphalt(rng: Rng, width_m: float, height_m: float, texel_m: float, *, tone: float = 0.085) -> Texture:
    """Rolled asphalt: grain, patches, sealed cracks, oil.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    width_m : float
        Metres.
    height_m : float
        Metres.
    texel_m : float
        Side of a texel, metres.
    tone : float
        Mean reflectance.
    """
    shape = shape_of(width_m, height_m, texel_m)
    grain = 1 + 0.22 * fractal_noise(rng, shape, texel_m, 0.05, octaves=3) + 0.10 * fractal_noise(rng, shape, texel_m, 2.5)
    image = grain[..., None] * np.asarray((tone, tone * 0.98, tone * 0.95), np.float32)
    area = width_m * height_m
    patches = blobs(rng, shape, texel_m, count=int(area / 60), radius_m=0.7)
    image *= (1 - 0.4 * (patches > 0.5))[..., None].astype(np.float32)
    weather(rng, image, texel_m, strength=0.16)
    mix(image, (0.02, 0.02, 0.02), 0.9 * cracks(rng, shape, texel_m, count=int(area / 18), length_m=3.0))
    mix(image, (0.03, 0.03, 0.03), 0.7 * blobs(rng, shape, texel_m, count=int(area / 25), radius_m=0.16))
    return encode(image, texel_m)


def with_lines(texture: Texture, lines_m: Float32s, width_m: float, rng: Rng, colour: Colour = (0.62, 0.60, 0.55)) -> Texture:
    """A copy with worn lines painted on it; lines_m: (n, 2, 2), from and to, metres from the top left corner.

    Parameters
    ----------
    texture : Texture
        Stays as it is.
    lines_m : ndarray
        (n, 2, 2) from and to, metres from the top left corner.
    width_m : float
        Of a line, metres.
    rng : Generator
        The source of all that is random in it.
    colour : Colour
        Linear red, green, blue.
    """
    shape = (texture.pixels.shape[0], texture.pixels.shape[1])
    paint = np.zeros(shape, np.uint8)
    wide = max(round(width_m / texture.texel_m), 1)
    for line in lines_m:
        cv2.polylines(paint, [np.round(line / texture.texel_m * 16).astype(np.int32)], False, 255, wide, cv2.LINE_AA, 4)
    worn = smoothstep(-1.1, 0.4, fractal_noise(rng, shape, texture.texel_m, 0.4))
    image = np.asarray(np.square(texture.pixels.astype(np.float32) / np.float32(255)), np.float32)
    mix(image, colour, 0.85 * worn * paint.astype(np.float32) / np.float32(255))
    return encode(image, texture.texel_m)


def lawn(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Grass with bare and yellow spots.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    width_m : float
        Metres.
    height_m : float
        Metres.
    texel_m : float
        Side of a texel, metres.
    """
    shape = shape_of(width_m, height_m, texel_m)
    blades = 1 + 0.35 * fractal_noise(rng, shape, texel_m, 0.12, octaves=3, gain=0.9)
    image = blades[..., None] * np.asarray((0.075, 0.115, 0.035), np.float32)
    dry = smoothstep(0.5, 1.8, fractal_noise(rng, shape, texel_m, 1.6))
    mix(image, (0.20, 0.165, 0.09), 0.7 * dry)
    weather(rng, image, texel_m, strength=0.14)
    return encode(image, texel_m)


def leaves(rng: Rng, texel_m: float, colour: Colour = (0.06, 0.095, 0.03)) -> Texture:
    """Foliage from outside: clumps of light and shadow down to the leaf."""
    shape = shape_of(3.0, 3.0, texel_m)
    clumps = fractal_noise(rng, shape, texel_m, 0.7, octaves=6, gain=0.85)
    image = np.clip(1 + 0.55 * clumps, 0.12, 3)[..., None] * np.asarray(colour, np.float32)
    mix(image, (0.32, 0.22, 0.06), 0.5 * smoothstep(1.2, 2.2, fractal_noise(rng, shape, texel_m, 0.25, octaves=3)))
    return encode(image, texel_m)


def ashlar(rng: Rng, width_m: float, height_m: float, texel_m: float, *, tint: Colour = (1.0, 1.0, 1.0)) -> Texture:
    """Dressed stone in courses, sooty from the top, with streaks.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    width_m : float
        Metres.
    height_m : float
        Metres.
    texel_m : float
        Side of a texel, metres.
    tint : Colour
        Factors on red, green, blue.
    """
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, relief = stones(rng, shape, texel_m, (0.95, 0.42), 0.014, bond=0.5, jitter=0.10, warp=0.003)
    image = palette(ASHLAR_TONES, tone) * np.asarray(tint, np.float32) * (1 + 0.05 * relief)[..., None]
    image *= (1 + 0.06 * fractal_noise(rng, shape, texel_m, 0.08, octaves=3))[..., None]
    mix(image, (0.22, 0.20, 0.17), 0.85 * (1 - cover))
    weather(rng, image, texel_m, strength=0.12, streaks=0.2)
    return encode(image, texel_m)
