"""Parts of an old town: ground of setts between pale bands, half-timbered walls, houses with gables and shutters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbflow_demo.parts.structures import Opening, facade
from wbflow_demo.render import textures as paint
from wbflow_demo.render.covers import blobs, stones
from wbflow_demo.render.paint import (
    Colour,
    Rng,
    Texture,
    draw,
    encode,
    fractal_noise,
    mix,
    one_colour,
    palette,
    shape_of,
    smoothstep,
    weather,
)
from wbflow_demo.render.scene import SceneBuilder

SETTS = ((0.20, 0.19, 0.185), (0.26, 0.245, 0.23), (0.165, 0.165, 0.17), (0.23, 0.20, 0.175), (0.30, 0.285, 0.265))
PITCH = 2.3
"""Approximate distance between neighbouring windows of a house, in metres."""


def setts(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint fields of small granite setts in two directions between bands of pale flags, with stains, moss and litter."""
    shape = shape_of(width_m, height_m, texel_m)
    cover, tone, relief = stones(rng, shape, texel_m, (0.15, 0.12), 0.018, bond=0.5, jitter=0.2, warp=0.03)
    other = [each.T for each in stones(rng, shape[::-1], texel_m, (0.15, 0.12), 0.018, bond=0.5, jitter=0.2, warp=0.03)]
    y, x = (np.indices(shape, dtype=np.float32) + 0.5) * np.float32(texel_m)
    turned = (np.floor(x / 4.6) + np.floor(y / 4.6)) % 2 > 0
    cover, tone, relief = (np.where(turned, b, a) for a, b in zip((cover, tone, relief), other, strict=True))
    image = palette(SETTS, tone) * (1 + 0.25 * relief + 0.05 * turned)[..., None]
    mix(image, (0.095, 0.085, 0.065), 1 - cover)
    flags = stones(rng, shape, texel_m, (0.8, 0.46), 0.02, bond=0.5, jitter=0.15, warp=0.01)
    band = np.maximum(x % 4.6 < 0.46, y % 4.6 < 0.46).astype(np.float32)
    pale = palette(((0.36, 0.33, 0.28), (0.42, 0.39, 0.34), (0.31, 0.29, 0.26)), flags[1]) * (0.4 + 0.6 * flags[0])[..., None]
    mix(image, pale, 0.85 * band)
    weather(rng, image, texel_m, strength=0.22)
    moss = smoothstep(0.7, 1.9, fractal_noise(rng, shape, texel_m, 2.5)) * (1 - cover)
    mix(image, (0.07, 0.10, 0.035), moss)
    image *= (1 - 0.45 * blobs(rng, shape, texel_m, count=int(width_m * height_m / 9), radius_m=0.25))[..., None]
    for tone_of, count in (
        ((0.42, 0.27, 0.06), 1.2),
        ((0.55, 0.53, 0.48), 0.5),
        ((0.10, 0.16, 0.04), 0.6),
        ((0.05, 0.04, 0.03), 0.8),
    ):
        mix(image, tone_of, 1.2 * blobs(rng, shape, texel_m, count=int(count * width_m * height_m), radius_m=0.04))
    return encode(image, texel_m)


def timber_frame(rng: Rng, width_m: float, height_m: float, texel_m: float, colour: Colour) -> Texture:
    """Paint a half-timbered wall: dark beams with room for a window about every `PITCH`, braces, infills of uneven render."""
    shape = shape_of(width_m, height_m, texel_m)
    image = one_colour(shape, colour) * (1 + 0.06 * fractal_noise(rng, shape, texel_m, 1.4))[..., None]
    beams = np.zeros(shape, np.uint8)
    columns, storeys = max(round(width_m / PITCH), 1), max(round(height_m / 2.8), 1)
    step, rise = width_m / columns / 2, height_m / storeys

    def beam(x0: float, y0: float, x1: float, y1: float, wide: float = 0.17) -> None:
        draw(beams, np.array([(x0, y0), (x1, y1)]) / texel_m, wide / texel_m)

    for k in range(2 * columns + 1):
        beam(k * step, 0.0, k * step, height_m)
    for level in range(storeys + 1):
        beam(0.0, level * rise, width_m, level * rise, 0.26)
        beam(0.0, (level + 0.68) * rise, width_m, (level + 0.68) * rise, 0.14)
        for k in {0, 2 * columns - 1, int(rng.integers(2 * columns))}:
            lean = step if k % 2 else 0.0
            beam(k * step + lean, level * rise, (k + 1) * step - lean, (level + 1) * rise, 0.14)
    tone = 1 + 0.35 * fractal_noise(rng, shape, texel_m, 0.3)
    brown = tone[..., None] * np.asarray((0.085, 0.055, 0.038), np.float32)
    mix(image, brown, beams.astype(np.float32) / np.float32(255))
    weather(rng, image, texel_m, strength=0.10, streaks=0.18)
    return encode(image, texel_m)


@dataclass(frozen=True)
class House:
    """Dimensions and look of a house in a row, in metres."""

    width: float
    eaves: float
    """Height of the wall."""
    rise: float
    """Height of the roof above the wall."""
    wall: int
    tone: Colour
    """Colour of shutters and door."""
    gable: bool = True
    """Whether the gable faces the square."""


def house(build: SceneBuilder, rng: Rng, texel_m: float, it: House, looks: tuple[int, int, int], shop: str = "") -> SceneBuilder:
    """Return a house whose front lies on the x axis from the origin, facing south; looks: window, stone and roof tiles."""
    part, (pane, stone, tiles) = build.with_same_textures(), looks
    wood = build.add_texture(paint.planks(rng, 3.0, 2.5, texel_m, it.tone))
    columns, middle, deep = max(round(it.width / PITCH), 1), it.width / 2, 8.0
    step = it.width / columns
    tops = np.arange(it.eaves - 5.35, 0.4, -2.8)
    openings = [Opening((k + 0.5) * step - 0.45, float(top), 0.9, 1.45, pane) for top in tops for k in range(columns)]
    door = int(rng.integers(columns))
    openings.append(Opening((door + 0.5) * step - 0.6, it.eaves - 2.4, 1.2, 2.4, wood, depth=0.3))
    glass = build.add_texture(paint.window(1.5, 1.6, texel_m))
    openings += [
        Opening((k + 0.5) * step - 0.75, it.eaves - 2.4, 1.5, 1.6, glass, depth=0.22) for k in range(columns) if k != door
    ]
    facade(part, np.array([0.0, 0.0, it.eaves]), np.array([1.0, 0, 0]), (it.width, it.eaves), it.wall, openings, stone)
    for opening in openings[: len(tops) * columns]:
        for x in (opening.left - 0.24, opening.left + 1.14):
            part.box((x, -0.03, it.eaves - opening.top - 1.45), (0.44, 0.06, 1.45), wood)
    if shop:
        board = build.add_texture(paint.sign_board(rng, it.width - 1.2, 0.55, texel_m, (shop,), it.tone, (0.68, 0.64, 0.52)))
        part.box((middle, -0.06, 2.62), (it.width - 1.2, 0.1, 0.5), board)
    for x, end in ((0.0, (0.0, -deep, 0.0)), (it.width, (0.0, deep, 0.0))):
        part.quad((x, deep if x == 0.0 else 0.0, it.eaves), end, (0, 0, -it.eaves), it.wall)
    top, over = it.eaves + it.rise, 0.35
    if it.gable:
        corners = np.array([(middle, 0.0, top), (0.0, 0.0, it.eaves), (it.width, 0.0, it.eaves)])
        part.triangle(corners, (1, 0, 0), (0, 0, -1), it.wall, (middle, -it.rise))
        part.box((middle, 0.02, it.eaves + 0.25 * it.rise), (0.9, 0.1, 1.1), stone, front=pane)
        slope = np.array([middle, 0.0, -it.rise]) * (1 + over / middle)
        part.quad((middle, deep, top + 0.06), (0, -deep - over, 0), slope * (-1, 1, 1), tiles)
        part.quad((middle, -over, top + 0.06), (0, deep + over, 0), slope, tiles)
    else:
        part.quad((-0.1, 5.0, top), (it.width + 0.2, 0, 0), (0, -5.0 - over, -it.rise - 0.3), tiles)
        part.box((middle, -0.1, it.eaves - 0.3), (it.width, 0.35, 0.28), stone)
    part.box((0.3 * it.width, 4.0, top - 1.2), (0.8, 0.7, 2.2), stone)
    return part
