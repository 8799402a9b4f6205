"""Equipment of the switchyard: gantries with wires; insulators on stands and transformers, as parts to stamp."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np

from wbflow_demo.render import textures as paint
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.scene import SceneBuilder

from .shapes import rod

PHASES = (-10.2, -7.6, -5.0, 5.0, 7.6, 10.2)
"""x of the wires, in metres east."""


def gantries(build: SceneBuilder, look: tuple[int, int, int, int]) -> None:
    """Add two rows of lattice posts, each with a girder, and six wires on insulator strings between the rows."""
    zinc, brown, wire, raw = look
    rows = (0.4, 6.8)
    for y, x in product(rows, (-12.2, -4.1, 4.1, 12.2)):
        build.box((x, y, 0.0), (0.9, 0.9, 0.25), raw, offset=x + 12.0)
        for a, b in product((-1, 1), repeat=2):
            build.beam((x + 0.35 * a, y + 0.35 * b, 0.2), (x + 0.15 * a, y + 0.15 * b, 7.4), 0.09, zinc)
        for k in range(8):
            half, side = 0.34 - 0.025 * k, (-1) ** k
            for b in (-1, 1):
                build.beam(
                    (x - side * half, y + b * half, 0.3 + 0.88 * k), (x + side * half, y + b * half, 1.18 + 0.88 * k), 0.05, zinc
                )
                build.beam(
                    (x + b * half, y - side * half, 0.3 + 0.88 * k), (x + b * half, y + side * half, 1.18 + 0.88 * k), 0.05, zinc
                )
    for y in rows:
        for off, z in product((-0.25, 0.25), (7.0, 7.5)):
            build.beam((-12.3, y + off, z), (12.3, y + off, z), 0.08, zinc)
        for k, left in enumerate(np.arange(-12.0, 12.0, 0.8)):
            build.beam((left, y - 0.25, 7.0 + 0.5 * (k % 2)), (left + 0.8, y - 0.25, 7.5 - 0.5 * (k % 2)), 0.05, zinc)
            build.beam((left, y - 0.25, 7.0), (left + 0.8 * (k % 2), y + 0.25, 7.0), 0.05, zinc)
    for x, (south, north) in product(PHASES, pairwise(rows)):
        for y, side in ((south, 1), (north, -1)):
            rod(build, (x, y + 0.3 * side, 6.95), (x, y + 1.3 * side, 6.6), 0.1, brown, sides=8)
        t = np.linspace(0, 1, 7)
        sag = np.column_stack([np.full(7, x), south + 1.3 + (north - south - 2.6) * t, 6.6 - 2.0 * t * (1 - t)])
        for p, q in pairwise(sag):
            build.beam(p, q, 0.03, wire)


def _insulator(part: SceneBuilder, at: tuple[float, float, float], high: float, brown: int) -> None:
    """A porcelain insulator column with sheds every 16 cm."""
    x, y, z = at
    part.tube(at, 0.09, high, brown, sides=8)
    for up in np.arange(0.1, high - 0.05, 0.16):
        part.tube((x, y, z + up), 0.17, 0.05, brown, sides=9)


def apparatus(build: SceneBuilder, look: tuple[int, int, int, int], kind: int) -> SceneBuilder:
    """Return apparatus on a stand; kind: disconnector of two columns (0), breaker of two columns (1), current transformer (2)."""
    zinc, brown, raw, grey = look
    part = build.with_same_textures()
    part.box((0.0, 0.0, 0.0), (0.9, 1.5, 0.25), raw, offset=3.0 * kind)
    for y in (-0.5, 0.5):
        part.beam((0.0, y, 0.2), (0.0, y, 2.2), 0.18, zinc)
    part.box((0.0, 0.0, 2.2), (0.3, 1.5, 0.14), zinc)
    for y in (0.0,) if kind == 2 else (-0.55, 0.55):
        _insulator(part, (0.0, y, 2.34), 1.4, brown)
    if kind == 0:
        part.beam((0.0, -0.6, 3.8), (0.0, 0.6, 3.8), 0.08, zinc)
    elif kind == 1:
        part.box((0.0, -0.1, 0.9), (0.5, 0.7, 1.1), grey)
        rod(part, (0.0, -0.9, 3.85), (0.0, 0.9, 3.85), 0.14, grey)
    else:
        part.tube((0.0, 0.0, 3.74), 0.26, 0.6, grey, sides=12)
        part.beam((0.0, -0.6, 4.0), (0.0, 0.6, 4.0), 0.08, zinc)
    return part


def transformer(build: SceneBuilder, rng: Rng, texel_m: float, look: tuple[int, int, int], name: str) -> SceneBuilder:
    """Return a transformer on a concrete tub: a tank with its name, cooling ribs, an oil conservator, three bushings."""
    grey, brown, raw = look
    part = build.with_same_textures()
    skin = build.add_texture(paint.container_side(rng, 4.0, 2.5, texel_m, (0.23, 0.29, 0.27), name, "110/20 KV"))
    part.box((0.0, 0.0, 0.0), (6.0, 4.6, 0.35), raw)
    part.box((0.0, 0.0, 0.5), (4.0, 1.9, 2.5), grey, sides=skin)
    for x, side in product(np.linspace(-1.7, 1.7, 12), (-1, 1)):
        part.box((x, 1.35 * side, 0.8), (0.09, 0.7, 1.7), grey, offset=x + 2.0)
    rod(part, (-1.8, 0.9, 3.6), (1.4, 0.9, 3.6), 0.35, grey, sides=14)
    for x in (-1.2, 0.0, 1.2):
        part.beam((x, 0.9, 3.0), (x, 0.9, 3.4), 0.12, grey)
        _insulator(part, (x, -0.4, 3.0), 1.3, brown)
    return part
