"""Parts of the shunting yard: rails, switch levers, catenary masts with wires, spruces, a signal box, huts."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from wbflow_demo.parts.structures import Opening, facade
from wbflow_demo.render import textures as paint
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.scene import SceneBuilder
from wbflow_stages.types import Float64s

from .rolling import Look
from .shapes import cone


def rails(build: SceneBuilder, path: Float64s, steel: int) -> None:
    """Add two rails along a centre line (n, 2) in metres; they rise 0.1 m above the snow."""
    ahead = np.gradient(path, axis=0)
    across = np.column_stack([-ahead[:, 1], ahead[:, 0]]) / np.linalg.norm(ahead, axis=1, keepdims=True)
    for gauge in (-0.75, 0.75):
        line = np.column_stack([path + gauge * across, np.full(len(path), 0.05)])
        for start, end in pairwise(line):
            build.beam(start, end, 0.1, steel, offset=float(start[0] % 5))


def lever(build: SceneBuilder, at: tuple[float, float], look: Look) -> None:
    """Add the lever of a switch with its weight and its lantern."""
    x, y = at
    build.box((x, y, 0.0), (0.8, 0.5, 0.3), look.snow, sides=look.dark)
    build.beam((x - 0.2, y, 0.3), (x + 0.3, y, 1.0), 0.06, look.frame)
    build.ball((x + 0.3, y, 1.0), (0.16, 0.16, 0.16), look.dark, steps=6)
    build.tube((x + 0.7, y, 0.0), 0.04, 0.6, look.dark, sides=6)
    build.box((x + 0.7, y, 0.6), (0.34, 0.34, 0.34), look.dark, front=look.snow)


def catenary(build: SceneBuilder, masts: Sequence[tuple[float, float]], tracks: Sequence[float], look: tuple[int, int]) -> None:
    """Add masts (east, north) with arms, and over each track a contact wire under a sagging wire; look: steel and wire."""
    steel, wire = look
    for x, y in masts:
        build.box((x, y, 0.0), (0.6, 0.6, 0.3), steel)
        build.beam((x, y, 0.3), (x, y, 7.6), 0.2, steel)
        for side in (-1, 1):
            build.beam((x, y, 7.1), (x, y + 2.4 * side, 6.9), 0.07, steel)
            build.beam((x, y, 6.0), (x, y + 2.4 * side, 6.9), 0.07, steel)
            build.beam((x, y + 1.4 * side, 6.45), (x + 0.2, y + 2.25 * side, 5.5), 0.05, steel)
    stops = sorted({-36.0, *(x for x, _ in masts), 36.0})
    for y in tracks:
        for start, end in pairwise(stops):
            build.beam((start, y, 5.5), (end, y, 5.5), 0.02, wire)
            t = np.linspace(0, 1, 9)
            sag = np.column_stack([start + (end - start) * t, np.full(9, y), 6.9 - 3.6 * t * (1 - t)])
            for a, b in pairwise(sag):
                build.beam(a, b, 0.02, wire)
                build.beam(b, (b[0], b[1], 5.5), 0.01, wire)


def spruce(build: SceneBuilder, bark: int, needles: int) -> SceneBuilder:
    """Return a spruce of 7 m at the origin, as a part to `stamp`."""
    part = build.with_same_textures()
    part.tube((0.0, 0.0, 0.0), 0.14, 1.6, bark, sides=7)
    for k in range(5):
        cone(part, (0.06 * (-1) ** k, 0.05 * (-1) ** (k // 2), 1.0 + 1.1 * k), 1.75 - 0.3 * k, 1.7, needles, sides=11)
    return part


def four_walls(
    build: SceneBuilder, at: tuple[float, float], size: tuple[float, float, float], wall: int, openings: list[Opening], sill: int
) -> None:
    """Add four walls with the same openings, as far as these fit."""
    wide, deep, high = size
    for k in range(4):
        turn, half, out = k * np.pi / 2, (wide / 2, deep / 2)[k % 2], (deep / 2, wide / 2)[k % 2]
        right, away = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([np.sin(turn), -np.cos(turn), 0.0])
        fits = [o for o in openings if o.left + o.width < 2 * half]
        facade(build, np.array([*at, high]) - half * right + out * away, right, (2 * half, high), wall, fits, sill)


def _roof(build: SceneBuilder, at: tuple[float, float, float], size: tuple[float, float, float], white: int, board: int) -> None:
    """A snow-covered ridged roof along x."""
    (x, y, z), (wide, deep, rise) = at, size
    build.box((x, y, z), (wide, deep, 0.14), board)
    for side in (-1, 1):
        build.quad((x - side * wide / 2, y, z + rise), (side * wide, 0, 0), (0, -side * (deep / 2 + 0.05), -rise + 0.16), white)
        corners = np.array(
            [
                (x + side * wide / 2, y, z + rise),
                (x + side * wide / 2, y - deep / 2, z + 0.1),
                (x + side * wide / 2, y + deep / 2, z + 0.1),
            ]
        )
        build.triangle(corners, (0, 1, 0), (0, 0, -1), board)


def signal_box(build: SceneBuilder, rng: Rng, texel_m: float, at: tuple[float, float], white: int) -> None:
    """Add a signal box: brick base, a band of windows all around, a name board, a stair, snow on its roof."""
    x, y = at
    brick = build.add_texture(paint.brick_wall(rng, 9.0, 3.6, texel_m))
    board = build.add_texture(paint.planks(rng, 9.0, 1.2, texel_m, (0.15, 0.20, 0.16)))
    pane, low = build.add_texture(paint.window(1.4, 1.5, texel_m)), build.add_texture(paint.window(1.1, 1.3, texel_m))
    openings = [Opening(0.8 + 2.0 * k, 1.1, 1.1, 1.3, low) for k in range(4)]
    four_walls(build, at, (8.6, 4.4, 3.6), brick, openings, board)
    build.box((x, y, 3.6), (9.0, 4.9, 0.9), board)
    build.box((x, y, 4.5), (8.4, 4.2, 1.5), board, sides=pane)
    for k in range(7):
        for side in (-2.14, 2.14):
            build.beam((x - 4.2 + 1.4 * k, y + side, 4.5), (x - 4.2 + 1.4 * k, y + side, 6.0), 0.12, board)
    _roof(build, (x, y, 6.0), (9.8, 5.8, 1.2), white, board)
    name = build.add_texture(paint.sign_board(rng, 4.6, 0.7, texel_m, ("NEUSTADT Nf",), (0.60, 0.60, 0.56), (0.03, 0.03, 0.03)))
    build.box((x, y - 2.5, 3.7), (4.6, 0.06, 0.7), name)
    for k in range(12):
        build.box((x - 6.9 + 0.2 * k, y - 1.2, 0.28 * k), (0.26, 1.0, 0.06), white)
    build.box((x + 2.4, y + 0.6, 6.6), (0.6, 0.6, 1.3), brick)


def hut(build: SceneBuilder, rng: Rng, texel_m: float, at: tuple[float, float], white: int) -> None:
    """Add a hut of boards with doors, windows and a snowy roof."""
    board = build.add_texture(paint.planks(rng, 3.4, 2.3, texel_m, (0.24, 0.17, 0.11)))
    door = build.add_texture(paint.planks(rng, 1.0, 1.9, texel_m, (0.10, 0.17, 0.22)))
    pane = build.add_texture(paint.window(0.8, 0.8, texel_m))
    four_walls(build, at, (3.2, 2.4, 2.3), board, [Opening(0.3, 0.4, 0.9, 1.9, door), Opening(1.45, 0.6, 0.8, 0.8, pane)], board)
    _roof(build, (*at, 2.3), (3.8, 3.0, 0.75), white, board)
