"""Textures of the ground: cobbles, concrete, gravel, water, repeating tiles, asphalt, lawn.

`width_m` and `height_m` are the size of the painted surface, `texel_m` the side of a texel, all in metres.
"""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.types import Float32s

from ..render.covers import blobs, lettering, stones
from ..render.paint import Colour, Rng, Texture, cracks, draw, encode, fractal_noise, mix, palette, shape_of, smoothstep, weather

# Colours are linear reflectances: stone and soil reflect a tenth to a third of the light, paint two thirds.
COBBLE_TONES = ((0.21, 0.20, 0.19), (0.28, 0.26, 0.24), (0.15, 0.15, 0.155), (0.24, 0.21, 0.18), (0.33, 0.31, 0.29))
LITTER_TONES = ((0.5, 0.36, 0.12), (0.62, 0.6, 0.55), (0.08, 0.07, 0.06), (0.33, 0.2, 0.1))


def cobbles(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint setts with worn tracks, moss and soil in the joints, oil, relaid patches, covers, painted lines and litter."""
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, relief = stones(rng, shape, texel_m, (0.17, 0.125), 0.018, bond=0.5, jitter=0.16, warp=0.02)
    # 1. The stones; patches that were relaid have other ones.
    image = palette(COBBLE_TONES, tone)
    relaid = blobs(rng, shape, texel_m, count=int(width_m * height_m / 40), radius_m=0.9)
    mix(image, palette(COBBLE_TONES[::-1], -tone) * np.float32(1.35), (relaid > 0.6).astype(np.float32))
    image *= (1 + 0.28 * relief)[..., None]
    # 2. The joints, brown with soil or green with moss.
    moss = smoothstep(0.3, 1.5, fractal_noise(rng, shape, texel_m, 4.0))
    soil = np.asarray((0.13, 0.105, 0.075), np.float32) + moss[..., None] * np.asarray((-0.05, 0.015, -0.045), np.float32)
    mix(image, soil, 1 - cover)

    # 3. Use: dirt, wheel tracks, oil; and what lies on top, which is the most distinct for matching.
    weather(rng, image, texel_m, strength=0.2)
    tracks = _tracks(rng, shape, texel_m, count=7)
    image *= (1 - 0.22 * tracks)[..., None]
    image *= (1 - 0.6 * blobs(rng, shape, texel_m, count=int(width_m * height_m / 22), radius_m=0.22))[..., None]
    _markings(rng, image, texel_m)
    _covers(rng, image, texel_m, count=int(width_m * height_m / 130) + 1)
    _litter(rng, image, texel_m, count=int(width_m * height_m * 1.6))
    return encode(image, texel_m)


def concrete(rng: Rng, width_m: float, height_m: float, texel_m: float, *, slab_m: float = 5.0, text: str = "") -> Texture:
    """Paint cast slabs: joints, cracks, aggregate, oil and tyre marks, worn paint."""
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, _ = stones(rng, shape, texel_m, (slab_m, slab_m * 0.8), 0.03, bond=0.0, jitter=0.0, warp=0.003)
    # 1. Slabs with aggregate.
    base = np.float32(0.27) * (1 + 0.1 * tone + 0.07 * fractal_noise(rng, shape, texel_m, 0.06, octaves=3))
    image = base[..., None] * np.asarray((1.0, 0.965, 0.90), np.float32)

    # 2. Painted letters, and a warning stripe of 0.45 m along the edge, both worn off in places.
    worn = smoothstep(-0.7, 0.5, fractal_noise(rng, shape, texel_m, 0.5))
    if text:
        letters = lettering(shape, texel_m, text, 0.1 * width_m, 0.3 * height_m, min(1.2, 0.4 * height_m))
        mix(image, (0.75, 0.72, 0.6), 0.85 * worn * letters)
        stripe = (np.indices(shape, dtype=np.float32).sum(axis=0) * texel_m % 0.8 < 0.4).astype(np.float32)
        stripe[int(0.45 / texel_m) :] = 0
        mix(image, (0.62, 0.42, 0.03), 0.8 * worn * stripe)

    # 3. Age: stains, cracks, joints full of dirt, oil, tracks, litter.
    weather(rng, image, texel_m, strength=0.2)
    mix(image, (0.08, 0.075, 0.07), 0.8 * cracks(rng, shape, texel_m, count=int(width_m * height_m / 9), length_m=2.5))
    mix(image, (0.10, 0.09, 0.08), 1 - cover)
    mix(image, (0.07, 0.065, 0.06), 0.75 * blobs(rng, shape, texel_m, count=int(width_m * height_m / 14), radius_m=0.25))
    image *= (1 - 0.3 * _tracks(rng, shape, texel_m, count=5))[..., None]
    _litter(rng, image, texel_m, count=int(width_m * height_m * 0.8))
    return encode(image, texel_m)


def gravel(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint crushed stone."""
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, relief = stones(rng, shape, texel_m, (0.085, 0.07), 0.012, bond=0.5, jitter=0.3, warp=0.03)
    image = palette(COBBLE_TONES, tone) * (1.15 + 0.4 * relief)[..., None]
    mix(image, (0.07, 0.065, 0.06), 1 - cover)
    weather(rng, image, texel_m, strength=0.2)
    return encode(image, texel_m)


def water(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint rippled harbour water."""
    shape = shape_of(width_m, height_m, texel_m)
    ripples = fractal_noise(rng, shape, texel_m, 3.0, octaves=5, stretch=0.4)
    return encode((1 + 0.35 * ripples)[..., None] * np.asarray((0.055, 0.075, 0.075), np.float32), texel_m)


def _tracks(rng: Rng, shape: tuple[int, int], texel_m: float, *, count: int) -> Float32s:
    """Return coverage of pairs of curved wheel tracks across the surface."""
    cover = np.zeros(shape, np.uint8)
    h, w = shape
    t = np.linspace(0, 1, 40)[:, None]
    for _ in range(count):
        # a quadratic Bezier curve from outside the surface to outside it
        ends = rng.uniform((-0.1 * w, -0.1 * h), (1.1 * w, 1.1 * h), (3, 2))
        path = (1 - t) ** 2 * ends[0] + 2 * t * (1 - t) * ends[1] + t**2 * ends[2]
        along = np.gradient(path, axis=0)
        side = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
        # two wheels, 1.7 m apart
        for offset in (-0.85, 0.85):
            draw(cover, path + side * offset / texel_m, int(0.24 / texel_m), int(rng.integers(90, 220)))
    return cover.astype(np.float32) / np.float32(255) * smoothstep(-1.2, 0.8, fractal_noise(rng, shape, texel_m, 0.5))


def _markings(rng: Rng, image: Float32s, texel_m: float) -> None:
    """Add worn paint: bays with numbers, a driveway's broken line, arrows."""
    shape = (image.shape[0], image.shape[1])
    paint = np.zeros(shape, np.uint8)
    width_m = shape[1] * texel_m
    height_m = shape[0] * texel_m

    def line(*points_m: tuple[float, float]) -> None:
        draw(paint, np.array(points_m) / texel_m, 0.12 / texel_m)

    # bays of 3.2 m along one edge, a broken line along the other, arrows between
    for k in range(int(width_m / 3.2)):
        line((3.2 * k + 0.8, 0.3), (3.2 * k + 0.8, 0.17 * height_m))
    for k in range(int(width_m / 2.5)):
        line((2.5 * k, 0.9 * height_m), (2.5 * k + 1.3, 0.9 * height_m))
    for x, y in ((0.33, 0.5), (0.64, 0.66), (0.52, 0.84), (0.17, 0.78)):
        line((x * width_m, y * height_m + 1.1), (x * width_m, y * height_m - 1.1))
        line((x * width_m - 0.5, y * height_m - 0.4), (x * width_m, y * height_m - 1.1), (x * width_m + 0.5, y * height_m - 0.4))
    cover = paint.astype(np.float32) / np.float32(255)
    for k in range(int(width_m / 3.2)):
        cover = np.maximum(cover, lettering(shape, texel_m, str(k + 11), 3.2 * k + 1.7, 0.12 * height_m, 0.8))
    worn = smoothstep(-0.4, 0.6, fractal_noise(rng, shape, texel_m, 0.4))
    mix(image, (0.60, 0.58, 0.50), 0.8 * cover * worn)


def _covers(rng: Rng, image: Float32s, texel_m: float, *, count: int) -> None:
    """Add round iron covers with a raised pattern."""
    h, w = image.shape[:2]
    radius = int(0.36 / texel_m)
    if radius < 3:
        return
    # one face for all covers: they are alike on purpose
    yy, xx = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float32)
    disc = np.clip(radius - np.hypot(xx, yy), 0, 1)
    studs = (np.sin(xx * texel_m * 55) * np.sin(yy * texel_m * 55) > 0.1).astype(np.float32)
    ring = (np.abs(np.hypot(xx, yy) - 0.86 * radius) < 0.06 * radius).astype(np.float32)
    face = np.asarray((0.10, 0.085, 0.075), np.float32) * (1 + 0.9 * np.maximum(studs, ring))[..., None]
    for _ in range(count):
        y = int(rng.integers(radius, h - radius - 1))
        x = int(rng.integers(radius, w - radius - 1))
        mix(image[y - radius : y + radius + 1, x - radius : x + radius + 1], face, disc)


def _litter(rng: Rng, image: Float32s, texel_m: float, *, count: int) -> None:
    """Add leaves, scraps and pebbles of 3 to 10 cm in random tones."""
    h, w = image.shape[:2]
    for _ in range(count):
        centre = rng.uniform((0, 0), (w, h))
        size = rng.uniform(0.03, 0.10) / texel_m
        corners = centre + rng.normal(0, 0.6, (5, 2)) * size
        hull = cv2.convexHull(np.round(corners * 16).astype(np.int32))
        tone = rng.choice(np.array(LITTER_TONES)) * rng.uniform(0.6, 1.2)
        # in sixteenths of a texel
        cv2.fillConvexPoly(image, hull, tone.tolist(), cv2.LINE_AA, 4)


SLAB_TONES = ((0.36, 0.34, 0.31), (0.30, 0.285, 0.27), (0.42, 0.39, 0.35), (0.25, 0.24, 0.235), (0.38, 0.31, 0.26))


def repeating_tiles(rng: Rng, tile_m: float, tiles: int, texel_m: float) -> Texture:
    """Paint `tiles` x `tiles` bit-identical copies of one tile, a patterned slab of `tile_m` metres with a joint around it.

    `tile_m` is rounded to whole texels; copies of the texture laid edge to edge continue the repetition."""
    n = max(round(tile_m / texel_m), 4)
    shape = (n, n)
    y, x = (np.indices(shape, dtype=np.float32) + 0.5) / n
    # four slabs around a small dark one, as cut stone is often laid, each with its own tone
    inset = np.float32(0.24)
    is_upper = (y < inset) & (x >= inset)
    is_right = (x >= inset) & (y >= inset) & (x > y)
    is_lower = y >= inset
    arms = np.where(is_upper, 0, np.where(is_right, 1, np.where(is_lower, 2, 3)))
    arms = np.where((np.abs(x - 0.60) < 0.10) & (np.abs(y - 0.55) < 0.10), 4, arms)
    tones = rng.permutation(np.array(SLAB_TONES, np.float32))
    image = np.asarray(tones[arms], np.float32)
    image[arms == 4] *= np.float32(0.45)
    grain = fractal_noise(rng, shape, tile_m / n, 0.12, octaves=4, gain=0.8)
    image *= (1 + 0.14 * grain)[..., None]
    image *= (1 - 0.35 * blobs(rng, shape, tile_m / n, count=5, radius_m=0.04 * tile_m))[..., None]
    # joints where the number of the slab changes, and along two edges of the tile, which meet the other two of its copies
    edge = np.abs(np.diff(arms, axis=0, prepend=arms[:1])) + np.abs(np.diff(arms, axis=1, prepend=arms[:, :1])) > 0
    wide = max(round(0.012 / (tile_m / n)), 1)
    joints = cv2.dilate(edge.astype(np.uint8), np.ones((wide, wide), np.uint8)).astype(np.float32)
    joints[:wide] = 1.0
    joints[:, :wide] = 1.0
    mix(image, (0.10, 0.09, 0.075), 0.9 * joints)
    one = encode(image, tile_m / n)
    return Texture(np.ascontiguousarray(np.tile(one.pixels, (tiles, tiles, 1))), one.texel_m)


def asphalt(rng: Rng, width_m: float, height_m: float, texel_m: float, *, tone: float = 0.085) -> Texture:
    """Paint rolled asphalt: grain, patches, sealed cracks, oil."""
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
    """Return a copy with worn lines painted on it; lines_m: (n, 2, 2), start and end points, metres from the top left corner."""
    shape = (texture.pixels.shape[0], texture.pixels.shape[1])
    paint = np.zeros(shape, np.uint8)
    for line in lines_m:
        draw(paint, line / texture.texel_m, width_m / texture.texel_m)
    worn = smoothstep(-1.1, 0.4, fractal_noise(rng, shape, texture.texel_m, 0.4))
    # textures hold square roots of reflectances: paint is mixed in linear light
    image = np.asarray(np.square(texture.pixels.astype(np.float32) / np.float32(255)), np.float32)
    mix(image, colour, 0.85 * worn * paint.astype(np.float32) / np.float32(255))
    return encode(image, texture.texel_m)


def lawn(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint grass with bare and yellow spots."""
    shape = shape_of(width_m, height_m, texel_m)
    blades = 1 + 0.35 * fractal_noise(rng, shape, texel_m, 0.12, octaves=3, gain=0.9)
    image = blades[..., None] * np.asarray((0.075, 0.115, 0.035), np.float32)
    dry = smoothstep(0.5, 1.8, fractal_noise(rng, shape, texel_m, 1.6))
    mix(image, (0.20, 0.165, 0.09), 0.7 * dry)
    weather(rng, image, texel_m, strength=0.14)
    return encode(image, texel_m)
