"""Tools for painting textures: noise, cracks, weathering, and blending of colours.

All random numbers come from an explicit generator `rng`; `shape` is (height, width) in texels, `texel_m` the side of a texel in
metres.  Colours are linear reflectances, stored as square roots in 8 bits (similar to sRGB), so that filtering can be done in
linear light.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from wbflow_stages.types import Float32s, Float64s, Uint8s

Rng = np.random.Generator
Shape = tuple[int, int]
"""Height and width, texels."""


def smooth_noise(rng: Rng, shape: Shape, wave_px: tuple[float, float]) -> Float32s:
    """Return value noise: (h, w) float32 of about unit variance, correlated over `wave_px` = (along y, along x) pixels."""
    # 1. One independent value for each wavelength; two more than fit, so that the interpolation has neighbours at the far edge.
    rows = int(np.ceil(shape[0] / max(wave_px[0], 1.0))) + 2
    cols = int(np.ceil(shape[1] / max(wave_px[1], 1.0))) + 2
    coarse = rng.standard_normal((rows, cols), dtype=np.float32)
    if wave_px[0] <= 1.0 and wave_px[1] <= 1.0:
        return np.ascontiguousarray(coarse[: shape[0], : shape[1]])

    # 2. Interpolate; cubic for long waves, whose linear interpolation would show as creases.
    size = (int(np.ceil(cols * max(wave_px[1], 1.0))), int(np.ceil(rows * max(wave_px[0], 1.0))))
    interpolation = cv2.INTER_LINEAR if max(wave_px) < 3 else cv2.INTER_CUBIC
    fine = cv2.resize(coarse, size, interpolation=interpolation)
    # values between the nodes are means, which vary less: 1.35 restores about unit variance
    return np.ascontiguousarray(fine[: shape[0], : shape[1]], dtype=np.float32) * np.float32(1.35)


def fractal_noise(
    rng: Rng, shape: Shape, texel_m: float, longest_m: float, *, octaves: int = 6, gain: float = 0.6, stretch: float = 1.0
) -> Float32s:
    """Return a sum of octaves of `smooth_noise`, (h, w) float32 of about unit variance; `stretch` > 1 elongates it along y."""
    total = np.zeros(shape, np.float32)
    power = 0.0  # sum of the octaves' variances
    weight = 1.0
    wave = longest_m / texel_m
    for _ in range(octaves):
        # waves below a texel would only be noise; the first octave is always there
        if wave < 1.0 and power > 0:
            break
        total += np.float32(weight) * smooth_noise(rng, shape, (wave * stretch, wave))
        power += weight**2
        weight *= gain
        wave *= 0.5
    return total * np.float32(1.0 / np.sqrt(power))


def smoothstep(low: float, high: float, x: Float32s) -> Float32s:
    """Return 0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((x - np.float32(low)) / np.float32(high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), dtype=np.float32)


def draw(cover: Uint8s, path: Float64s, width: float, tone: int = 255) -> None:
    """Draw a line through points `path` (n, 2), x and y in texels, into `cover` (h, w); at least one texel wide."""
    # positions in sixteenths of a texel: the last argument is the number of their fractional bits
    cv2.polylines(cover, [np.round(path * 16).astype(np.int32)], False, tone, max(round(width), 1), cv2.LINE_AA, 4)


_CRACK_STEP_M = 0.12
"""Length of the straight pieces of a crack, metres."""


def cracks(rng: Rng, shape: Shape, texel_m: float, *, count: int, length_m: float) -> Float32s:
    """Return coverage (h, w) float32 of `count` wandering hairlines of about `length_m`."""
    cover = np.zeros(shape, np.uint8)
    step = _CRACK_STEP_M / texel_m
    for _ in range(count):
        steps = max(int(length_m * rng.uniform(0.4, 1.6) / _CRACK_STEP_M), 3)
        # a random walk of the heading, 20 degrees a step
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.35, steps))
        start = rng.uniform((0, 0), (shape[1], shape[0]))
        path = start + step * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
        draw(cover, path, 0.012 / texel_m)
    return cover.astype(np.float32) / np.float32(255)


Colour = tuple[float, float, float]
"""Linear reflectance of red, green, blue, 0 to 1."""


@dataclass(frozen=True)
class Texture:
    """An image of a surface."""

    pixels: Uint8s
    """(h, w, 3) uint8, square root of the linear reflectance."""
    texel_m: float
    """Metres per texel."""
    gloss: float = 0.0
    """Share of the surface that is as smooth as water and reflects the sky, 0 to 1."""


def encode(reflectance: Float32s, texel_m: float, gloss: float = 0.0) -> Texture:
    """Return the texture of a linear reflectance (h, w, 3)."""
    # nothing real is blacker than soot or whiter than fresh snow; the root spreads dark tones over more of the 256 steps
    root = np.sqrt(np.clip(reflectance, 0.004, 0.97))
    return Texture((root * 255 + 0.5).astype(np.uint8), texel_m, gloss)


def shape_of(width_m: float, height_m: float, texel_m: float) -> tuple[int, int]:
    """Return (height, width) in texels of a surface, at least 2 each."""
    return max(round(height_m / texel_m), 2), max(round(width_m / texel_m), 2)


def one_colour(shape: Shape, colour: Colour) -> Float32s:
    """Return (h, w, 3) float32 of one linear colour."""
    return np.ones((*shape, 3), np.float32) * np.asarray(colour, np.float32)


def mix(image: Float32s, colour: Colour | Float32s, cover: Float32s) -> None:
    """Blend `colour` over `image` in place, with opacity `cover` (h, w)."""
    image += (np.asarray(colour, np.float32) - image) * np.clip(cover, 0, 1)[..., None]


def palette(tones: tuple[Colour, ...], tone: Float32s) -> Float32s:
    """Return a colour for each value of `tone` (unit variance): its range is divided into as many classes as there are tones."""
    index = np.minimum((smoothstep(-2.2, 2.2, tone) * len(tones)).astype(np.intp), len(tones) - 1)
    # things of one class differ a little, too: a fast wave of the tone is as good as random
    variation = 1 + 0.13 * np.sin(37.0 * tone)
    return np.asarray(np.asarray(tones, np.float32)[index] * variation[..., None], dtype=np.float32)


def weather(rng: Rng, image: Float32s, texel_m: float, *, strength: float, streaks: float = 0.0) -> None:
    """Multiply `image` in place by large stains, fine grain, and rain streaks down the wall."""
    shape = image.shape[:2]
    stains = fractal_noise(rng, shape, texel_m, 5.0, octaves=5)
    grain = fractal_noise(rng, shape, texel_m, 0.4, octaves=5)
    factor = 1 + strength * (0.55 * stains + 0.45 * grain)
    if streaks:
        runs = fractal_noise(rng, shape, texel_m, 0.5, octaves=4, stretch=9.0)
        factor -= streaks * smoothstep(0.2, 2.0, runs)
    image *= np.clip(factor, 0.25, 1.8)[..., None]
