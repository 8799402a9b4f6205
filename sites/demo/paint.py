"""What all textures are made with: a texture's form, colours laid over each other, rows of stones, weather.

Colours are linear reflectances, stored as square roots in 8 bits (about what sRGB does), so that filtering can be done in linear
light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbflow_stages.core.jit import kernel
from wbflow_stages.types import Float32s, Uint8s

from .random_fields import Rng, fractal_noise, smoothstep

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Texture:
    """A picture of a surface."""

    pixels: Uint8s
    """(h, w, 3) uint8, square root of the linear reflectance."""
    texel_m: float
    """Metres per texel."""
    gloss: float = 0.0
    """How much of it is as smooth as water, 0 to 1: it mirrors the sky."""


def encode(reflectance: Float32s, texel_m: float, gloss: float = 0.0) -> Texture:
    """A texture of a (h, w, 3) linear reflectance."""
    return Texture((np.sqrt(np.clip(reflectance, 0.004, 0.97)) * 255 + 0.5).astype(np.uint8), texel_m, gloss)


def shape_of(width_m: float, height_m: float, texel_m: float) -> tuple[int, int]:
    return max(round(height_m / texel_m), 2), max(round(width_m / texel_m), 2)


def mix(image: Float32s, colour: Colour | Float32s, cover: Float32s) -> None:
    """Paint `colour` over `image` in place where `cover` (h, w) says so."""
    image += (np.asarray(colour, np.float32) - image) * np.clip(cover, 0, 1)[..., None]


@kernel
def _lay_stones(
    cover: Float32s,
    tone: Float32s,
    relief: Float32s,
    table: Float32s,
    edges: Float32s,
    shift: Float32s,
    warp: Float32s,
    texel: float,
    unit: tuple[float, float],
    joint: float,
) -> None:
    """Rows of stones with jittered joints: coverage (0 in a joint), a stone's own number, and dome shading lit from top left."""
    rows, cols = table.shape
    unit_w, unit_h = unit
    for i in range(cover.shape[0]):
        for j in range(cover.shape[1]):
            y = (i + 0.5) * texel + warp[i, j]
            row = min(max(int(y / unit_h), 0), rows - 1)
            x = (j + 0.5) * texel + warp[i, j] + shift[row]
            col = min(max(int(x / unit_w), 1), cols - 2)
            if x < col * unit_w + edges[row, col]:
                col -= 1
            elif x > (col + 1) * unit_w + edges[row, col + 1]:
                col += 1
            left = col * unit_w + edges[row, col]
            right = (col + 1) * unit_w + edges[row, min(col + 1, cols - 1)]
            top = row * unit_h
            inside = min(min(x - left, right - x), min(y - top, top + unit_h - y))
            cover[i, j] = min(max((inside - 0.5 * joint) / texel + 0.5, 0.0), 1.0)
            tone[i, j] = table[row, col]
            fx = 2 * (x - left) / (right - left) - 1
            fy = 2 * (y - top) / unit_h - 1
            relief[i, j] = -(0.45 * fx * fx * fx + 0.9 * fy * fy * fy)


def stones(
    rng: Rng,
    shape: tuple[int, int],
    texel_m: float,
    unit: tuple[float, float],
    joint: float,
    *,
    bond: float,
    jitter: float,
    warp: float,
) -> tuple[Float32s, Float32s, Float32s]:
    """Coverage, tone (unit variance, one number a stone) and relief of rows of stones `unit` = (width, height) metres.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    shape : tuple of int
        Height and width, texels.
    texel_m : float
        Side of a texel, metres.
    unit : tuple of float
        Width and height of a stone with its joint, metres.
    joint : float
        Metres.
    bond : float
        Shift of every other row, in stones.
    jitter : float
        How unequal stones are.
    warp : float
        How crooked rows are, metres.
    """
    rows, cols = int(shape[0] * texel_m / unit[1]) + 2, int(shape[1] * texel_m / unit[0]) + 4
    table = rng.standard_normal((rows, cols), dtype=np.float32)
    edges = (unit[0] * jitter * rng.uniform(-1, 1, (rows, cols))).astype(np.float32)
    shift = (unit[0] * (1 + bond * (np.arange(rows) % 2) + 0.5 * jitter * rng.uniform(-1, 1, rows))).astype(np.float32)
    bend = np.float32(warp) * fractal_noise(rng, shape, texel_m, 2.0, octaves=4)
    cover, tone, relief = (np.empty(shape, np.float32) for _ in range(3))
    _lay_stones(cover, tone, relief, table, edges, shift, bend, texel_m, unit, joint)
    return cover, tone, relief


def palette(tones: tuple[Colour, ...], tone: Float32s) -> Float32s:
    """A colour for each number of unit variance: the numbers' order is cut into as many classes as there are tones."""
    index = np.minimum((smoothstep(-2.2, 2.2, tone) * len(tones)).astype(np.intp), len(tones) - 1)
    variation = 1 + 0.13 * np.sin(37.0 * tone)
    return np.asarray(np.asarray(tones, np.float32)[index] * variation[..., None], dtype=np.float32)


def weather(rng: Rng, image: Float32s, texel_m: float, *, strength: float, streaks: float = 0.0) -> None:
    """Large stains, fine grain, and rain streaks down the wall, as factors on `image` in place.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    image : ndarray
        (h, w, 3), changed in place.
    texel_m : float
        Side of a texel, metres.
    strength : float
        Of stains and grain.
    streaks : float
        Of rain down the wall.
    """
    shape = image.shape[:2]
    factor = 1 + strength * (
        0.55 * fractal_noise(rng, shape, texel_m, 5.0, octaves=5) + 0.45 * fractal_noise(rng, shape, texel_m, 0.4, octaves=5)
    )
    if streaks:
        runs = fractal_noise(rng, shape, texel_m, 0.5, octaves=4, stretch=9.0)
        factor -= streaks * smoothstep(0.2, 2.0, runs)
    image *= np.clip(factor, 0.25, 1.8)[..., None]
