"""The ground of the yard: snow in which tracks, footprints, tyre tracks, grass and oil show faintly."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_demo.render.covers import blobs
from wbflow_demo.render.paint import Rng, Texture, draw, encode, fractal_noise, mix, shape_of, smoothstep
from wbflow_demo.render.textures import leaves
from wbflow_stages.types import Float32s, Float64s

WIDE, DEEP = 72.0, 56.0
"""Size of the painted ground, in metres."""
LINES = ((-8.0, -2.3, 0.0), (0.0, 2.2, 0.05), (4.0, -6.8, 0.02), (-6.0, 6.8, -0.03), (0.0, -11.6, 0.0), (2.0, 11.6, 0.02),
         (-3.0, 0.0, 1.4), (6.0, 0.0, 1.9), (-12.0, -14.0, 0.3), (8.0, 14.0, -0.5), (0.0, -16.0, 1.0))  # fmt: skip
"""Trails of footprints: x and y of their middle in metres, and heading in radians."""
ROADS = (((-36.0, -13.6), (-10.0, -12.8), (8.0, -14.4), (36.0, -13.4)), ((-36.0, 12.6), (-6.0, 12.2), (12.0, 13.4), (36.0, 12.4)),
         ((-2.0, -28.0), (-1.0, -20.0), (4.0, -15.5), (14.0, -14.0)))  # fmt: skip


def yard_under_snow(rng: Rng, texel_m: float, tracks: list[Float64s]) -> Texture:
    """Paint snow over tracks (centre lines (n, 2) in metres), with one or two per cent of contrast except where it is worn."""
    shape = shape_of(WIDE, DEEP, texel_m)
    waves = 0.022 * fractal_noise(rng, shape, texel_m, 3.0) + 0.016 * fractal_noise(rng, shape, texel_m, 0.25, octaves=4)
    image = (1 + waves)[..., None] * np.asarray((0.79, 0.81, 0.845), np.float32)
    bed, sleepers = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for track in tracks:
        path = _texels(track, texel_m)
        draw(bed, path, 2.7 / texel_m)
        for place, across in _along(path, 0.6 / texel_m):
            draw(sleepers, np.array([place - 1.25 / texel_m * across, place + 1.25 / texel_m * across]), 0.26 / texel_m)
    thin = fractal_noise(rng, shape, texel_m, 2.2, octaves=6)
    stones = (
        np.asarray((0.20, 0.18, 0.16), np.float32) * (1 + 0.4 * fractal_noise(rng, shape, texel_m, 0.12, octaves=3))[..., None]
    )
    soft = cv2.GaussianBlur(bed, (0, 0), 0.35 / texel_m).astype(np.float32) / np.float32(255)
    image *= (1 - 0.05 * soft)[..., None]
    mix(image, (0.30, 0.27, 0.24), 0.16 * sleepers.astype(np.float32) / np.float32(255) * smoothstep(-0.8, 1.2, thin))
    mix(image, stones, 0.75 * soft * smoothstep(0.7, 2.2, thin + 0.5 * fractal_noise(rng, shape, texel_m, 0.2, octaves=3)))
    _trodden(rng, image, texel_m)
    spots = (((0.34, 0.28, 0.14), 2600, 0.045), ((0.16, 0.13, 0.07), 900, 0.05), ((0.66, 0.66, 0.66), 260, 0.22))
    for tone, count, radius in spots:
        mix(image, tone, 0.9 * blobs(rng, shape, texel_m, count=count, radius_m=radius))
    mix(image, (0.22, 0.20, 0.18), 0.5 * soft * blobs(rng, shape, texel_m, count=700, radius_m=0.16))
    return encode(image, texel_m)


def needles(rng: Rng, texel_m: float) -> Texture:
    """Paint a spruce's branches: dark green with patches of snow."""
    green = leaves(rng, texel_m, (0.035, 0.055, 0.03))
    image = np.asarray(np.square(green.pixels.astype(np.float32) / np.float32(255)), np.float32)
    patches = smoothstep(0.1, 0.9, fractal_noise(rng, image.shape[:2], texel_m, 0.6, octaves=5))
    mix(image, (0.70, 0.72, 0.75), 0.85 * patches)
    return encode(image, texel_m)


def _texels(path_m: Float64s, texel_m: float) -> Float64s:
    """Convert world metres (n, 2) to texels from the north-western corner."""
    return np.asarray((path_m * (1, -1) + (WIDE / 2, DEEP / 2)) / texel_m, np.float64)


def _along(path: Float64s, step: float) -> list[tuple[Float64s, Float64s]]:
    """Places every `step` along a path (n, 2), each with the unit vector perpendicular to the path."""
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    at = np.arange(0.0, length[-1], step)
    x, y = (np.interp(at, length, column) for column in path.T)
    ahead = np.gradient(np.column_stack([x, y]), axis=0)
    across = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1, keepdims=True)
    return list(zip(np.column_stack([x, y]), across, strict=True))


def _trodden(rng: Rng, image: Float32s, texel_m: float) -> None:
    """Add trails of bluish footprints, and tyre tracks with slush along the roads."""
    shape = (image.shape[0], image.shape[1])
    prints, tyres = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for x, y, heading in LINES * 2:
        turns = heading + np.cumsum(rng.normal(0, 0.05, 50))
        steps = np.cumsum(np.column_stack([np.cos(turns), np.sin(turns)]) * 0.68, axis=0)
        path = _texels(steps - steps[25] + (x, y + float(rng.normal(0, 0.4))), texel_m)
        for k, (place, across) in enumerate(_along(path, 0.68 / texel_m)):
            ahead = np.array([across[1], -across[0]])
            foot = place + across * (0.13 if k % 2 else -0.13) / texel_m + rng.normal(0, 0.03 / texel_m, 2)
            ends = np.array([foot - 0.1 / texel_m * ahead, foot + 0.1 / texel_m * ahead])
            draw(prints, ends, 0.12 / texel_m, int(rng.integers(120, 250)))
    for road in ROADS:
        for _ in range(3):
            path = np.array(road) + rng.normal(0, 0.35, (len(road), 2))
            smooth = np.column_stack([np.interp(np.linspace(0, 3, 40), range(4), c) for c in path.T])
            for side in (-0.8, 0.8):
                draw(tyres, _texels(np.add(smooth, (0.3 * side, side)), texel_m), 0.24 / texel_m, int(rng.integers(90, 230)))
    worn = tyres.astype(np.float32) / np.float32(255)
    mix(image, (0.47, 0.48, 0.51), 0.8 * worn * smoothstep(-1.4, 0.6, fractal_noise(rng, shape, texel_m, 0.35)))
    mix(image, (0.36, 0.33, 0.29), worn * smoothstep(0.6, 1.6, fractal_noise(rng, shape, texel_m, 1.2)))
    mix(image, (0.42, 0.45, 0.51), 0.85 * prints.astype(np.float32) / np.float32(255))
