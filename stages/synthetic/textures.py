"""Procedural textures of the yard: brick, cobbles, concrete, tiles, paint, windows, signs.

Every texture is painted for one surface, `width_m` x `height_m`, row 0 at the top, and carries variation at every scale from
metres (stains, repairs, weathering) to a texel, so that no two places look the same; only windows repeat.  Colours are linear
reflectances, stored as square roots in 8 bits (about what sRGB does), so that filtering can be done in linear light.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..kernels import kernel
from ..types import Float32s, Uint8s
from .noise import Rng, blobs, cracks, fractal_noise, lettering, smoothstep

Colour = tuple[float, float, float]

BRICK_TONES: tuple[Colour, ...] = (
    (0.30, 0.12, 0.075),
    (0.36, 0.155, 0.09),
    (0.23, 0.09, 0.06),
    (0.40, 0.20, 0.12),
    (0.27, 0.14, 0.11),
)
COBBLE_TONES: tuple[Colour, ...] = (
    (0.21, 0.20, 0.19),
    (0.28, 0.26, 0.24),
    (0.15, 0.15, 0.155),
    (0.24, 0.21, 0.18),
    (0.33, 0.31, 0.29),
)
TILE_TONES: tuple[Colour, ...] = ((0.30, 0.12, 0.07), (0.24, 0.10, 0.07), (0.35, 0.16, 0.10), (0.17, 0.09, 0.07))
RUST: Colour = (0.19, 0.075, 0.03)


@dataclass(frozen=True)
class Texture:
    """pixels: (h, w, 3) uint8, square root of the linear reflectance; texel_m: metres per texel."""

    pixels: Uint8s
    texel_m: float


def encode(reflectance: Float32s, texel_m: float) -> Texture:
    """A texture of a (h, w, 3) linear reflectance."""
    return Texture((np.sqrt(np.clip(reflectance, 0.004, 0.97)) * 255 + 0.5).astype(np.uint8), texel_m)


def _shape(width_m: float, height_m: float, texel_m: float) -> tuple[int, int]:
    return max(round(height_m / texel_m), 2), max(round(width_m / texel_m), 2)


def _mix(image: Float32s, colour: Colour | Float32s, cover: Float32s) -> None:
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


def _stones(
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
    """Coverage, tone (unit variance, one number a stone) and relief of rows of stones `unit` = (width, height) metres."""
    rows, cols = int(shape[0] * texel_m / unit[1]) + 2, int(shape[1] * texel_m / unit[0]) + 4
    table = rng.standard_normal((rows, cols), dtype=np.float32)
    edges = (unit[0] * jitter * rng.uniform(-1, 1, (rows, cols))).astype(np.float32)
    shift = (unit[0] * (1 + bond * (np.arange(rows) % 2) + 0.5 * jitter * rng.uniform(-1, 1, rows))).astype(np.float32)
    bend = np.float32(warp) * fractal_noise(rng, shape, texel_m, 2.0, octaves=4)
    cover, tone, relief = (np.empty(shape, np.float32) for _ in range(3))
    _lay_stones(cover, tone, relief, table, edges, shift, bend, texel_m, unit, joint)
    return cover, tone, relief


def _palette(tones: tuple[Colour, ...], tone: Float32s) -> Float32s:
    """A colour for each number of unit variance: the numbers' order is cut into as many classes as there are tones."""
    index = np.minimum((smoothstep(-2.2, 2.2, tone) * len(tones)).astype(np.intp), len(tones) - 1)
    variation = 1 + 0.13 * np.sin(37.0 * tone)
    return np.asarray(np.asarray(tones, np.float32)[index] * variation[..., None], dtype=np.float32)


def _weather(rng: Rng, image: Float32s, texel_m: float, *, strength: float, streaks: float = 0.0) -> None:
    """Large stains, fine grain, and rain streaks down the wall, as factors on `image` in place."""
    shape = image.shape[:2]
    factor = 1 + strength * (
        0.55 * fractal_noise(rng, shape, texel_m, 5.0, octaves=5) + 0.45 * fractal_noise(rng, shape, texel_m, 0.4, octaves=5)
    )
    if streaks:
        runs = fractal_noise(rng, shape, texel_m, 0.5, octaves=4, stretch=9.0)
        factor -= streaks * smoothstep(0.2, 2.0, runs)
    image *= np.clip(factor, 0.25, 1.8)[..., None]


def brick_wall(
    rng: Rng, width_m: float, height_m: float, texel_m: float, *, sign: str = "", tint: Colour = (1.0, 1.0, 1.0)
) -> Texture:
    """Old brickwork: tone by brick, pale joints, repairs, soot from the eaves, damp at the foot, a faded painted sign."""
    shape = _shape(width_m, height_m, texel_m)
    cover, tone, relief = _stones(rng, shape, texel_m, (0.25, 0.078), 0.013, bond=0.5, jitter=0.05, warp=0.004)
    repairs = blobs(rng, shape, texel_m, count=int(width_m * height_m / 18), radius_m=0.6)
    image = _palette(BRICK_TONES, tone) * np.asarray(tint, np.float32)
    _mix(image, _palette(BRICK_TONES[::-1], -tone) * np.float32(1.25), (repairs > 0.55).astype(np.float32) * 0.8)
    image *= (1 + 0.16 * relief)[..., None]
    if sign:
        size = min(0.12 * height_m, 0.9 * width_m / max(len(sign), 1))
        faded = lettering(shape, texel_m, sign, 0.06 * width_m, 0.445 * height_m, size, bold=0.2)
        _mix(image, (0.62, 0.60, 0.52), faded * (0.55 + 0.3 * fractal_noise(rng, shape, texel_m, 0.6)))
    mortar = np.float32(0.42) + np.float32(0.06) * fractal_noise(rng, shape, texel_m, 1.2, octaves=5)
    _mix(image, mortar[..., None] * np.asarray((1.0, 0.94, 0.84), np.float32), 1 - cover)
    _weather(rng, image, texel_m, strength=0.16, streaks=0.22)
    height = np.linspace(0, height_m, shape[0], dtype=np.float32)[:, None]
    damp = smoothstep(0.9, 0.0, height_m - height + 0.35 * fractal_noise(rng, shape, texel_m, 1.5))
    image *= (1 - 0.45 * damp)[..., None]
    salt = blobs(rng, shape, texel_m, count=int(width_m), radius_m=0.35) * smoothstep(
        -0.3, 1.2, fractal_noise(rng, shape, texel_m, 0.3)
    )
    _mix(image, (0.60, 0.57, 0.52), 0.55 * salt * smoothstep(2.5, 0.6, height_m - height))
    return encode(image, texel_m)


def cobbles(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Setts with worn tracks, moss and sand in the joints, oil, relaid patches, covers, painted lines and litter."""
    shape = _shape(width_m, height_m, texel_m)
    cover, tone, relief = _stones(rng, shape, texel_m, (0.17, 0.125), 0.018, bond=0.5, jitter=0.16, warp=0.02)
    image = _palette(COBBLE_TONES, tone)
    relaid = blobs(rng, shape, texel_m, count=int(width_m * height_m / 40), radius_m=0.9)
    _mix(image, _palette(COBBLE_TONES[::-1], -tone) * np.float32(1.35), (relaid > 0.6).astype(np.float32))
    image *= (1 + 0.28 * relief)[..., None]
    moss = smoothstep(0.3, 1.5, fractal_noise(rng, shape, texel_m, 4.0))
    soil = np.asarray((0.13, 0.105, 0.075), np.float32) + moss[..., None] * np.asarray((-0.05, 0.015, -0.045), np.float32)
    _mix(image, soil, 1 - cover)
    _weather(rng, image, texel_m, strength=0.2)
    tracks = _tracks(rng, shape, texel_m, count=7)
    image *= (1 - 0.22 * tracks)[..., None]
    image *= (1 - 0.6 * blobs(rng, shape, texel_m, count=int(width_m * height_m / 22), radius_m=0.22))[..., None]
    _markings(rng, image, texel_m)
    _covers(rng, image, texel_m, count=int(width_m * height_m / 130) + 1)
    _litter(rng, image, texel_m, count=int(width_m * height_m * 1.6))
    return encode(image, texel_m)


def concrete(rng: Rng, width_m: float, height_m: float, texel_m: float, *, slab_m: float = 5.0, text: str = "") -> Texture:
    """Cast slabs: joints, cracks, aggregate, oil and tyre marks, worn paint."""
    shape = _shape(width_m, height_m, texel_m)
    cover, tone, _ = _stones(rng, shape, texel_m, (slab_m, slab_m * 0.8), 0.03, bond=0.0, jitter=0.0, warp=0.003)
    base = np.float32(0.27) * (1 + 0.1 * tone + 0.07 * fractal_noise(rng, shape, texel_m, 0.06, octaves=3))
    image = base[..., None] * np.asarray((1.0, 0.965, 0.90), np.float32)
    worn = smoothstep(-0.7, 0.5, fractal_noise(rng, shape, texel_m, 0.5))
    if text:
        _mix(
            image,
            (0.75, 0.72, 0.6),
            0.85 * worn * lettering(shape, texel_m, text, 0.1 * width_m, 0.3 * height_m, min(1.2, 0.4 * height_m)),
        )
        stripe = (np.indices(shape, dtype=np.float32).sum(axis=0) * texel_m % 0.8 < 0.4).astype(np.float32)
        stripe[int(0.45 / texel_m) :] = 0
        _mix(image, (0.62, 0.42, 0.03), 0.8 * worn * stripe)
    _weather(rng, image, texel_m, strength=0.2)
    _mix(image, (0.08, 0.075, 0.07), 0.8 * cracks(rng, shape, texel_m, count=int(width_m * height_m / 9), length_m=2.5))
    _mix(image, (0.10, 0.09, 0.08), 1 - cover)
    _mix(image, (0.07, 0.065, 0.06), 0.75 * blobs(rng, shape, texel_m, count=int(width_m * height_m / 14), radius_m=0.25))
    image *= (1 - 0.3 * _tracks(rng, shape, texel_m, count=5))[..., None]
    _litter(rng, image, texel_m, count=int(width_m * height_m * 0.8))
    return encode(image, texel_m)


def _tracks(rng: Rng, shape: tuple[int, int], texel_m: float, *, count: int) -> Float32s:
    """Coverage of pairs of curved wheel tracks across the surface."""
    cover = np.zeros(shape, np.uint8)
    h, w = shape
    t = np.linspace(0, 1, 40)[:, None]
    for _ in range(count):
        ends = rng.uniform((-0.1 * w, -0.1 * h), (1.1 * w, 1.1 * h), (3, 2))
        path = (1 - t) ** 2 * ends[0] + 2 * t * (1 - t) * ends[1] + t**2 * ends[2]
        along = np.gradient(path, axis=0)
        side = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
        for offset in (-0.85, 0.85):
            line = path + side * offset / texel_m
            cv2.polylines(
                cover,
                [np.round(line * 16).astype(np.int32)],
                False,
                int(rng.integers(90, 220)),
                max(int(0.24 / texel_m), 1),
                cv2.LINE_AA,
                4,
            )
    return cover.astype(np.float32) / np.float32(255) * smoothstep(-1.2, 0.8, fractal_noise(rng, shape, texel_m, 0.5))


def _markings(rng: Rng, image: Float32s, texel_m: float) -> None:
    """Worn paint: bays with numbers, a driveway's broken line, arrows."""
    shape = (image.shape[0], image.shape[1])
    paint = np.zeros(shape, np.uint8)
    wide = max(round(0.12 / texel_m), 1)
    width_m, height_m = shape[1] * texel_m, shape[0] * texel_m

    def line(*points_m: tuple[float, float]) -> None:
        path = np.round(np.array(points_m) / texel_m * 16).astype(np.int32)
        cv2.polylines(paint, [path], False, 255, wide, cv2.LINE_AA, 4)

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
    _mix(image, (0.60, 0.58, 0.50), 0.8 * cover * worn)


def _covers(rng: Rng, image: Float32s, texel_m: float, *, count: int) -> None:
    """Round iron covers with a raised pattern."""
    h, w = image.shape[:2]
    radius = int(0.36 / texel_m)
    if radius < 3:
        return
    yy, xx = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float32)
    disc = np.clip(radius - np.hypot(xx, yy), 0, 1)
    studs = (np.sin(xx * texel_m * 55) * np.sin(yy * texel_m * 55) > 0.1).astype(np.float32)
    ring = (np.abs(np.hypot(xx, yy) - 0.86 * radius) < 0.06 * radius).astype(np.float32)
    face = np.asarray((0.10, 0.085, 0.075), np.float32) * (1 + 0.9 * np.maximum(studs, ring))[..., None]
    for _ in range(count):
        y, x = (int(rng.integers(radius, n - radius - 1)) for n in (h, w))
        _mix(image[y - radius : y + radius + 1, x - radius : x + radius + 1], face, disc)


def _litter(rng: Rng, image: Float32s, texel_m: float, *, count: int) -> None:
    """Leaves, scraps and pebbles of 3 to 10 cm in random tones."""
    h, w = image.shape[:2]
    for _ in range(count):
        centre = rng.uniform((0, 0), (w, h))
        size = rng.uniform(0.03, 0.10) / texel_m
        corners = centre + rng.normal(0, 0.6, (5, 2)) * size
        hull = cv2.convexHull(np.round(corners * 16).astype(np.int32))
        tone = rng.choice(np.array([[0.5, 0.36, 0.12], [0.62, 0.6, 0.55], [0.08, 0.07, 0.06], [0.33, 0.2, 0.1]])) * rng.uniform(
            0.6, 1.2
        )
        cv2.fillConvexPoly(image, hull, tone.tolist(), cv2.LINE_AA, 4)


def roof_tiles(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Pantiles in rows, dark under each row's lip, with moss and replaced tiles."""
    shape = _shape(width_m, height_m, texel_m)
    cover, tone, relief = _stones(rng, shape, texel_m, (0.24, 0.33), 0.02, bond=0.0, jitter=0.03, warp=0.008)
    image = _palette(TILE_TONES, tone) * (1 + 0.35 * relief)[..., None]
    _mix(image, (0.03, 0.025, 0.02), 1 - cover)
    _weather(rng, image, texel_m, strength=0.2, streaks=0.12)
    _mix(image, (0.10, 0.12, 0.05), 0.7 * smoothstep(0.9, 1.9, fractal_noise(rng, shape, texel_m, 1.2)))
    return encode(image, texel_m)


def plaster(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour = (0.62, 0.58, 0.48)) -> Texture:
    """Nearly even render: a hard surface for matching on purpose; a few cracks, faint stains, flakes at the foot."""
    shape = _shape(width_m, height_m, texel_m)
    image = np.ones((*shape, 3), np.float32) * np.asarray(colour, np.float32)
    image *= (1 + 0.025 * fractal_noise(rng, shape, texel_m, 3.0) + 0.012 * fractal_noise(rng, shape, texel_m, 0.05, octaves=2))[
        ..., None
    ]
    _mix(image, (0.25, 0.22, 0.19), 0.5 * cracks(rng, shape, texel_m, count=int(width_m / 3), length_m=2.0))
    flakes = blobs(rng, shape, texel_m, count=int(width_m / 2), radius_m=0.3)
    flakes[: int(0.8 * shape[0])] = 0
    _mix(image, (0.33, 0.18, 0.12), (flakes > 0.5).astype(np.float32))
    return encode(image, texel_m)


def container_side(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour, name: str, serial: str) -> Texture:
    """Painted steel with a company's name, a stripe or disc, a serial number, dents of tone, rust from edges and seams."""
    shape = _shape(width_m, height_m, texel_m)
    image = np.ones((*shape, 3), np.float32) * np.asarray(colour, np.float32)
    pale: Colour = (0.72, 0.70, 0.66) if sum(colour) < 1.2 else (0.10, 0.16, 0.32)
    if name:
        size = min(0.33 * height_m, 0.95 * width_m / len(name))
        _mix(image, pale, 0.92 * lettering(shape, texel_m, name, 0.08 * width_m, 0.28 * height_m, size, bold=0.2))
        band = np.zeros(shape, np.float32)
        band[int(0.72 * shape[0]) : int(0.78 * shape[0])] = float(rng.integers(0, 2))
        centre = (int((0.90 - 0.05 * rng.random()) * shape[1]), int(0.45 * shape[0]))
        cv2.circle(band, centre, int(0.11 * shape[0]), 1.0, -1, cv2.LINE_AA)
        _mix(image, pale, 0.85 * band)
    _mix(image, pale, 0.9 * lettering(shape, texel_m, serial, 0.62 * width_m, 0.06 * height_m, 0.13))
    _mix(image, pale, 0.8 * lettering(shape, texel_m, "22G1 MAX 30480 KG", 0.62 * width_m, 0.14 * height_m, 0.08))
    _weather(rng, image, texel_m, strength=0.10, streaks=0.16)
    _rust(rng, image, texel_m, amount=float(rng.uniform(0.2, 0.7)))
    return encode(image, texel_m)


def container_roof(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour) -> Texture:
    """Faded paint under dirt, dried puddles and rust between the ribs, and the number for the crane driver."""
    shape = _shape(width_m, height_m, texel_m)
    rib = np.sin(np.arange(shape[1], dtype=np.float32) * np.float32(texel_m * 2 * np.pi / 0.28))
    image = np.ones((*shape, 3), np.float32) * np.asarray(colour, np.float32) * (1 + 0.10 * rib)[None, :, None]
    number = lettering(shape, texel_m, str(rng.integers(1000, 9999)), 0.2 * width_m, 0.25 * height_m, 0.5 * height_m, bold=0.18)
    _mix(image, (0.70, 0.68, 0.62), 0.75 * number * smoothstep(-0.6, 0.4, fractal_noise(rng, shape, texel_m, 0.4)))
    dirt = smoothstep(-0.2, 1.6, fractal_noise(rng, shape, texel_m, 1.1, octaves=7, gain=0.75))
    _mix(image, (0.17, 0.145, 0.115), 0.75 * dirt)
    puddles = blobs(rng, shape, texel_m, count=int(2 * width_m), radius_m=0.16)
    image *= (1 - 0.45 * puddles)[..., None]
    _weather(rng, image, texel_m, strength=0.12)
    _rust(rng, image, texel_m, amount=0.6)
    return encode(image, texel_m)


def _rust(rng: Rng, image: Float32s, texel_m: float, *, amount: float) -> None:
    """Rust where noise and nearness to the top and bottom edges agree, running down in streaks."""
    shape = image.shape[:2]
    y = np.linspace(-1, 1, shape[0], dtype=np.float32)[:, None] ** 4
    field = (
        fractal_noise(rng, shape, texel_m, 1.5, octaves=6) + 0.7 * fractal_noise(rng, shape, texel_m, 0.25, stretch=6.0) + 1.2 * y
    )
    cover = smoothstep(2.9 - 1.6 * amount, 4.0 - 1.6 * amount, field)
    tone = 1 + 0.35 * fractal_noise(rng, shape, texel_m, 0.1, octaves=3)
    _mix(image, tone[..., None] * np.asarray(RUST, np.float32), 0.9 * cover)


def painted_steel(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour, *, stripes: bool = False) -> Texture:
    """Painted steel of cranes, posts and vehicles, with or without warning stripes."""
    shape = _shape(width_m, height_m, texel_m)
    image = np.ones((*shape, 3), np.float32) * np.asarray(colour, np.float32)
    if stripes:
        diagonal = np.indices(shape, dtype=np.float32).sum(axis=0) * texel_m
        _mix(image, (0.03, 0.03, 0.03), (diagonal % 0.5 < 0.25).astype(np.float32))
    _weather(rng, image, texel_m, strength=0.12, streaks=0.12)
    _rust(rng, image, texel_m, amount=0.35)
    return encode(image, texel_m)


def planks(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour = (0.36, 0.24, 0.13)) -> Texture:
    """Vertical boards with grain: gates, crates, pallets."""
    shape = _shape(width_m, height_m, texel_m)
    cover, tone, _ = _stones(rng, shape, texel_m, (0.16, height_m + 1.0), 0.014, bond=0.0, jitter=0.06, warp=0.003)
    image = (1 + 0.22 * tone)[..., None] * np.asarray(colour, np.float32)
    image *= (1 + 0.16 * fractal_noise(rng, shape, texel_m, 0.06, octaves=3, stretch=14.0))[..., None]
    _mix(image, (0.03, 0.025, 0.02), 1 - cover)
    _weather(rng, image, texel_m, strength=0.15, streaks=0.1)
    return encode(image, texel_m)


def roller_door(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour, number: str) -> Texture:
    """A slatted steel door with a large number."""
    shape = _shape(width_m, height_m, texel_m)
    y = (np.arange(shape[0], dtype=np.float32) * texel_m % 0.12) / 0.12
    image = np.ones((*shape, 3), np.float32) * np.asarray(colour, np.float32) * (0.75 + 0.4 * np.sin(np.pi * y))[:, None, None]
    _mix(
        image,
        (0.75, 0.73, 0.66),
        0.9 * lettering(shape, texel_m, number, 0.3 * width_m, 0.22 * height_m, 0.3 * height_m, bold=0.2),
    )
    _weather(rng, image, texel_m, strength=0.10, streaks=0.16)
    _rust(rng, image, texel_m, amount=0.4)
    return encode(image, texel_m)


def window(width_m: float, height_m: float, texel_m: float) -> Texture:
    """The one window that all façades repeat: white bars, dark panes that mirror a pale sky, half-drawn blind."""
    shape = _shape(width_m, height_m, texel_m)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32) * np.float32(texel_m)
    sheen = smoothstep(0.0, 1.0, 0.9 - 0.5 * y / height_m - 0.35 * x / width_m)
    image = np.asarray((0.03, 0.035, 0.04), np.float32) + sheen[..., None] * np.asarray((0.10, 0.13, 0.16), np.float32)
    blind = ((y < 0.38 * height_m) & (x > 0.5 * width_m)).astype(np.float32)
    _mix(image, (0.48, 0.44, 0.34), blind * (0.8 + 0.2 * (y % 0.06 > 0.015)))
    bar = np.zeros(shape, np.float32)
    for position in np.linspace(0, width_m, 3):
        bar = np.maximum(bar, np.clip((0.035 - np.abs(x - position)) / texel_m + 0.5, 0, 1))
    for position in np.linspace(0, height_m, 4):
        bar = np.maximum(bar, np.clip((0.035 - np.abs(y - position)) / texel_m + 0.5, 0, 1))
    _mix(image, (0.66, 0.65, 0.60), bar)
    return encode(image, texel_m)


def sign_board(
    rng: Rng, width_m: float, height_m: float, texel_m: float, lines: tuple[str, ...], colour: Colour, ink: Colour
) -> Texture:
    """A painted board with a frame and lines of text."""
    shape = _shape(width_m, height_m, texel_m)
    image = np.ones((*shape, 3), np.float32) * np.asarray(colour, np.float32)
    pitch = height_m / len(lines)
    for k, line in enumerate(lines):
        size = min(0.55 * pitch, 1.25 * width_m / max(len(line), 1) * 0.8)
        _mix(image, ink, lettering(shape, texel_m, line, 0.07 * width_m, (k + 0.25) * pitch, size, bold=0.17))
    border = max(int(0.03 / texel_m), 1)
    for edge in (image[:border], image[-border:], image[:, :border], image[:, -border:]):
        edge[:] = np.asarray(ink, np.float32)
    _weather(rng, image, texel_m, strength=0.06, streaks=0.12)
    return encode(image, texel_m)


def gravel(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Crushed stone."""
    shape = _shape(width_m, height_m, texel_m)
    cover, tone, relief = _stones(rng, shape, texel_m, (0.085, 0.07), 0.012, bond=0.5, jitter=0.3, warp=0.03)
    image = _palette(COBBLE_TONES, tone) * (1.15 + 0.4 * relief)[..., None]
    _mix(image, (0.07, 0.065, 0.06), 1 - cover)
    _weather(rng, image, texel_m, strength=0.2)
    return encode(image, texel_m)


def cloth(rng: Rng, texel_m: float, colour: Colour) -> Texture:
    """Clothes, skin, rubber, glass: one colour with a little fold and grain."""
    shape = _shape(1.0, 1.0, texel_m)
    factor = 1 + 0.18 * fractal_noise(rng, shape, texel_m, 0.3)
    return encode(factor[..., None] * np.asarray(colour, np.float32), texel_m)


def water(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Rippled harbour water."""
    shape = _shape(width_m, height_m, texel_m)
    ripples = fractal_noise(rng, shape, texel_m, 3.0, octaves=5, stretch=0.4)
    return encode((1 + 0.35 * ripples)[..., None] * np.asarray((0.055, 0.075, 0.075), np.float32), texel_m)
