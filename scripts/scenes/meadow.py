"""The meadow of the solar farm: its slope, its fence, and the sheep and fitters that move on it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from wbflow_demo.parts.movers import CLOTHES, SKIN, person
from wbflow_demo.render import Place
from wbflow_demo.render import textures as paint
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.scene import MOVING, Scene, SceneBuilder

EAST, NORTH = 0.012, 0.04
"""Slope of the meadow towards the east and the north, in metres per metre."""
ROWS = (-11.0, -5.5, 0.0, 5.5, 11.0)
"""y of the rows of panels, in metres north."""
WOOL, FACE = (0.50, 0.47, 0.41), (0.05, 0.045, 0.04)


def on_meadow(x: float, y: float, above: float = 0.0) -> Place:
    """Return the place at (x, y) and `above` metres over the slope."""
    return (x, y, 1.3 + EAST * x + NORTH * y + above)


def lay(build: SceneBuilder, corner: tuple[float, float], size: tuple[float, float], above: float, texture: int) -> None:
    """Add a rectangle parallel to the slope, `above` metres over it, given its north-western corner."""
    right, down = np.array([size[0], 0, size[0] * EAST]), np.array([0, -size[1], -size[1] * NORTH])
    build.quad(on_meadow(*corner, above), right, down, texture)


def fence(build: SceneBuilder, wood: int, steel: int) -> None:
    """Add posts and three wires around the rows, with a gap where the gravel way enters."""
    corners = ((3.0, -17.0), (22.0, -17.0), (22.0, 21.5), (-22.0, 21.5), (-22.0, -17.0), (-3.0, -17.0))
    for start, end in pairwise(np.array(corners)):
        for x, y in start + np.linspace(0, 1, 15)[:, None] * (end - start):
            build.beam(on_meadow(x, y), on_meadow(x, y, 1.5), 0.1, wood)
        for z in (0.5, 1.0, 1.4):
            build.beam(on_meadow(start[0], start[1], z), on_meadow(end[0], end[1], z), 0.03, steel)


def flock(rng: Rng, texel_m: float, captures: int) -> tuple[Scene, ...]:
    """Sheep between the rows and two fitters on the way, at other places in each capture."""
    build = SceneBuilder()
    build.kind = MOVING
    look = [
        build.add_texture(paint.cloth(rng, texel_m, c)) for c in (*CLOTHES[:3], SKIN, (0.50, 0.47, 0.41), (0.05, 0.045, 0.04))
    ]
    sheep = build.with_same_textures()
    sheep.ball((0.0, 0.0, 0.55), (0.55, 0.30, 0.30), look[4], steps=6)
    sheep.ball((0.60, 0.0, 0.68), (0.20, 0.12, 0.14), look[5], steps=5)
    for a in (-0.3, 0.3):
        for s in (-0.14, 0.14):
            sheep.beam((a, s, 0.0), (a, s, 0.4), 0.08, look[5])
    scenes = []
    for _ in range(captures):
        build = build.with_same_textures()
        for k in range(11):
            x, y = float(rng.uniform(-18, 18)), (*ROWS, 16.0)[k % 6] - 1.2 + float(rng.normal(0, 0.3))
            build.stamp(sheep, on_meadow(x, y), yaw=float(rng.uniform(0, 6)))
        for k in range(2):
            fitter = build.with_same_textures()
            person(fitter, rng, (0.0, 0.0, 0.0), 1.5, (look[k], look[1 + k], look[3], look[0]))
            build.stamp(fitter, on_meadow(float(rng.normal(0, 0.8)), float(rng.uniform(-9, 12))), yaw=float(rng.normal(0, 0.5)))
        scenes.append(build.build())
    return tuple(scenes)
