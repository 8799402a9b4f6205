"""The room of the machine shop: sealed floor with painted lines, white walls with windows, roof with beams, skylights, lamps."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.structures import Opening, facade
from wbflow_demo.render import Place
from wbflow_demo.render import textures as paint
from wbflow_demo.render.covers import blobs, lettering, stones
from wbflow_demo.render.paint import Rng, Texture, cracks, draw, encode, fractal_noise, mix, one_colour, shape_of, smoothstep
from wbflow_demo.render.scene import GLOWING, STATIC, SceneBuilder

from .shapes import rod

WIDE, DEEP, HIGH = 24.0, 16.0, 7.0
LAMPS: tuple[Place, ...] = tuple((x, y, 6.05) for x in (-9.0, -3.0, 3.0, 9.0) for y in (-5.7, 0.0, 5.7))
WAYS = (
    ((0.8, 6.6), (23.2, 6.6)), ((0.8, 8.9), (23.2, 8.9)), ((9.2, 0.8), (9.2, 6.6)), ((11.0, 0.8), (11.0, 6.6)),
    ((15.6, 8.9), (15.6, 15.2)), ((17.2, 8.9), (17.2, 15.2)), ((3.0, 10.2), (6.6, 10.2)), ((3.0, 13.0), (6.6, 13.0)),
    ((3.0, 10.2), (3.0, 13.0)), ((6.6, 10.2), (6.6, 13.0)),
)  # fmt: skip
"""Ends of the painted lines, in metres from the north-western corner."""
WORDS = (("3", 10.0, 2.2, 0.8), ("LAGER", 3.5, 11.2, 0.5), ("<<", 12.6, 7.4, 0.7), ("7", 16.2, 12.0, 0.8))


def sealed_floor(rng: Rng, texel_m: float) -> Texture:
    """Paint smooth sealed concrete: its tone varies by a few per cent; joints, worn lines, a hatched field, scuffs, oil drops."""
    shape = shape_of(WIDE, DEEP, texel_m)
    tone = 1 + 0.03 * fractal_noise(rng, shape, texel_m, 2.5) + 0.012 * fractal_noise(rng, shape, texel_m, 0.06, octaves=2)
    image = tone[..., None] * np.asarray((0.30, 0.305, 0.30), np.float32)
    joint, _, _ = stones(rng, shape, texel_m, (6.0, 5.4), 0.02, bond=0.0, jitter=0.0, warp=0.0)
    mix(image, (0.13, 0.13, 0.13), 0.7 * (1 - joint))
    mix(image, (0.14, 0.135, 0.13), 0.5 * cracks(rng, shape, texel_m, count=9, length_m=1.8))
    y, x = np.indices(shape, dtype=np.float32) * np.float32(texel_m)
    worn = smoothstep(-1.3, 0.3, fractal_noise(rng, shape, texel_m, 0.5))
    hatched = ((x > 18.6) & (x < 22.6) & (y > 10.2) & (y < 11.4) & ((x + y) % 0.6 < 0.3)).astype(np.float32)
    mix(image, (0.50, 0.36, 0.04), 0.8 * worn * hatched)
    for text, left, top, size in WORDS:
        mix(image, (0.60, 0.58, 0.50), 0.8 * worn * lettering(shape, texel_m, text, left, top, size, bold=0.18))
    scuffs = np.zeros(shape, np.uint8)
    for _ in range(46):
        start, heading = rng.uniform((1.0, 5.5), (23.0, 10.0)), rng.normal(0, 0.25)
        turn = heading + np.cumsum(rng.normal(0, 0.04, 20))
        path = start + np.cumsum(np.column_stack([np.cos(turn), np.sin(turn)]) * 0.16 * rng.choice([-1, 1]), axis=0)
        draw(scuffs, path / texel_m, 0.06 / texel_m, int(rng.integers(40, 150)))
    mix(image, (0.10, 0.10, 0.10), 0.6 * scuffs.astype(np.float32) / np.float32(255))
    for count, radius, dark in ((60, 0.10, 0.5), (160, 0.03, 0.7), (14, 0.22, 0.15)):
        mix(image, (0.09, 0.08, 0.065), dark * blobs(rng, shape, texel_m, count=count, radius_m=radius))
    plain = encode(image, texel_m, gloss=0.35)
    lines = ground.with_lines(plain, np.array(WAYS, np.float32), 0.1, rng, (0.56, 0.42, 0.05))
    return Texture(lines.pixels, texel_m, plain.gloss)


def white_wall(rng: Rng, width_m: float, texel_m: float) -> Texture:
    """Paint a white wall, grey-green up to 1.3 m, with scuffs, drips, spots and cracks."""
    shape = shape_of(width_m, HIGH, texel_m)
    tone = 1 + 0.014 * fractal_noise(rng, shape, texel_m, 2.5) + 0.008 * fractal_noise(rng, shape, texel_m, 0.06, octaves=2)
    image = one_colour(shape, (0.66, 0.66, 0.63)) * tone[..., None]
    up = HIGH - (np.arange(shape[0], dtype=np.float32)[:, None] + 0.5) * np.float32(texel_m)
    mix(image, (0.25, 0.31, 0.29), np.broadcast_to((up < 1.3).astype(np.float32), shape))
    runs = smoothstep(1.3, 2.6, fractal_noise(rng, shape, texel_m, 0.5, octaves=4, stretch=8.0))
    mix(image, (0.42, 0.38, 0.31), 0.5 * runs * smoothstep(0.0, 6.5, up))
    low = smoothstep(1.9, 0.2, up + 0.3 * fractal_noise(rng, shape, texel_m, 0.8))
    mix(image, (0.17, 0.16, 0.15), 0.45 * low * blobs(rng, shape, texel_m, count=int(10 * width_m), radius_m=0.12))
    mix(image, (0.48, 0.47, 0.44), 0.5 * blobs(rng, shape, texel_m, count=int(2 * width_m), radius_m=0.08))
    mix(image, (0.30, 0.29, 0.27), 0.45 * cracks(rng, shape, texel_m, count=int(width_m / 2), length_m=1.6))
    return encode(image, texel_m)


def _outside(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint a window of small panes seen from inside: a bright sky and roofs outside."""
    shape = shape_of(width_m, height_m, texel_m)
    y, x = np.indices(shape, dtype=np.float32) * np.float32(texel_m)
    image = one_colour(shape, (0.62, 0.66, 0.70)) * (1 + 0.05 * fractal_noise(rng, shape, texel_m, 0.8))[..., None]
    roofs = 0.62 * height_m - 0.25 * (np.floor(1.3 * x + 0.4 * np.sin(x)) % 3)
    mix(image, (0.34, 0.32, 0.31), (y > roofs).astype(np.float32))
    bars = np.minimum((x + 0.03) % 0.6, (y + 0.03) % 0.6)
    mix(image, (0.13, 0.15, 0.14), (bars < 0.06).astype(np.float32))
    return encode(image, texel_m)


def walls(build: SceneBuilder, rng: Rng, texel_m: float, steel: int, *, daylight: bool) -> None:
    """Four walls with piers, windows in the north and west that glow by daylight, a door in the east, and the crane's rails."""
    glass = build.add_texture(_outside(rng, 3.0, 1.9, texel_m))
    door = build.add_texture(paint.roller_door(rng, 4.0, 4.2, texel_m, (0.20, 0.26, 0.33), "2"))
    rows = {
        0: [Opening(1.5 + 6.0 * k, 1.9, 3.0, 1.9, glass, depth=0.18) for k in range(4)],
        1: [Opening(1.8 + 4.9 * k, 1.9, 3.0, 1.9, glass, depth=0.18) for k in range(3)],
        2: [],
        3: [Opening(1.4, HIGH - 4.2, 4.0, 4.2, door, depth=0.25)],
    }
    for side, openings in rows.items():
        half, away = ((WIDE, DEEP), (DEEP, WIDE))[side % 2]
        wall, part = build.add_texture(white_wall(rng, half, texel_m)), build.with_same_textures()
        facade(part, np.array([-half / 2, away / 2, HIGH]), np.array([1.0, 0, 0]), (half, HIGH), wall, openings, steel)
        part.kind = GLOWING if daylight else STATIC
        for o in openings:
            if o.texture == glass:
                part.quad((o.left - half / 2, away / 2 + 0.17, HIGH - o.top), (o.width, 0, 0), (0, 0, -o.height), glass)
        part.kind = STATIC
        for x in np.arange(-half / 2 + 0.3, half / 2, (half - 0.6) / round(half / 6.0)):
            part.box((float(x), away / 2 - 0.16, 0.0), (0.3, 0.3, HIGH - 0.5), steel)
        rod(part, (-half / 2, away / 2 - 0.12, 4.6), (half / 2, away / 2 - 0.12, 4.6), 0.06, steel)
        build.stamp(part, quarters=side)
    for y in (-DEEP / 2 + 0.4, DEEP / 2 - 0.4):
        build.box((0.0, y, 5.35), (WIDE, 0.22, 0.4), steel)


def roof(build: SceneBuilder, rng: Rng, texel_m: float, steel: int) -> None:
    """Roof panels with two skylights along the room, lattice beams across it, and hanging lamps."""
    panel = build.add_texture(paint.plaster(rng, WIDE, 6.0, 2 * texel_m, (0.60, 0.60, 0.58)))
    tube = build.add_texture(paint.cloth(rng, 0.05, (0.80, 0.80, 0.78)))
    for low, high in ((-8.0, -4.4), (-2.4, 2.4), (4.4, 8.0)):
        build.quad((-WIDE / 2, high, HIGH), (WIDE, 0, 0), (0, low - high, 0), panel)
    for x in (-12.0, -6.0, 0.0, 6.0, 12.0):
        build.box((x, 0.0, 6.75), (0.24, DEEP, 0.2), steel)
        build.box((x, 0.0, 6.15), (0.2, DEEP, 0.12), steel)
        for k, (y, end) in enumerate(pairwise(np.linspace(-8.0, 8.0, 17))):
            build.beam((x, float(y), 6.2 + 0.55 * (k % 2)), (x, float(end), 6.75 - 0.55 * (k % 2)), 0.08, steel)
    for x, y in product((-9.0, -3.0, 3.0, 9.0), (-5.7, 0.0, 5.7)):
        build.box((x, y, 6.3), (1.7, 0.34, 0.08), steel)
        for end in (-0.7, 0.7):
            build.beam((x + end, y, 6.3), (x + end, y, 7.0), 0.03, steel)
        build.kind = GLOWING
        build.box((x, y, 6.22), (1.6, 0.24, 0.07), tube)
        build.kind = STATIC
