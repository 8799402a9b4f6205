"""Parts of a park: trees, hedges and flower beds made of many slanting cards with gaps between them; a fountain, a pavilion."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.render import textures as paint
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.scene import STATIC, WATER, SceneBuilder
from wbflow_stages.types import Float64s

from .quarry import rock
from .shapes import cone, rod


def cards(build: SceneBuilder, rng: Rng, places: Float64s, size_m: tuple[float, float], textures: tuple[int, ...]) -> None:
    """Add a leaf-like card at each of places (n, 3), in metres, with random size, tilt, texture and part of the texture."""
    for place in places:
        u, v = np.linalg.qr(rng.standard_normal((3, 2)))[0].T
        long, wide = rng.uniform(*size_m), rng.uniform(*size_m)
        right, down = long * u, 0.8 * wide * v + 0.35 * long * u
        at = (float(rng.uniform(0, 2)), float(rng.uniform(0, 2)))
        build.quad(place - 0.5 * (right + down), right, down, textures[int(rng.integers(len(textures)))], at)


def tree(
    build: SceneBuilder, rng: Rng, at: tuple[float, float, float], bark: int, leaves: tuple[int, int], count: int, size_m: float
) -> None:
    """Add a leaning trunk that forks into five boughs, each with `count` / 5 cards of about `size_m` around its end.

    at: east, north and height of the tree, in metres.  The sky is visible between the cards.
    """
    x, y, high = at
    fork = np.array([x, y, 0.38 * high]) + 0.03 * high * np.append(rng.standard_normal(2), 0.0)
    rod(build, (x, y, 0.0), fork, 0.024 * high, bark)
    first = float(rng.uniform(0, 6))
    for k in range(5):
        turn, out = first + 1.26 * k + float(rng.normal(0, 0.2)), float(rng.uniform(0.15, 0.27)) * high * (k > 0)
        end = np.array([x + out * np.cos(turn), y + out * np.sin(turn), float(rng.uniform(0.6, 0.8)) * high])
        rod(build, fork, end, 0.013 * high, bark, sides=6)
        around = rng.standard_normal((count // 5, 3))
        around *= rng.uniform(0.6, 1.0, (len(around), 1)) / np.linalg.norm(around, axis=1, keepdims=True)
        cards(build, rng, end + around * (0.19 * high, 0.19 * high, 0.16 * high), (0.5 * size_m, 1.3 * size_m), leaves)


def hedge(
    build: SceneBuilder, rng: Rng, at: tuple[float, float, float], size: tuple[float, float, float], leaves: tuple[int, ...]
) -> None:
    """Add a clipped hedge: a core covered with 45 cards per square metre; at: east, north and yaw; size in metres."""
    (x, y, yaw), (long, wide, high) = at, size
    build.box((x, y, 0.0), (long - 0.1, wide - 0.1, high - 0.06), leaves[0], yaw=yaw, offset=float(rng.uniform(0, 2)))
    count = int(45 * (long * wide + 2 * (long + wide) * high))
    unit = rng.uniform(-0.5, 0.5, (count, 3))
    face = rng.choice(
        3, count, p=np.array([wide * high, long * high, 0.5 * long * wide]) / (wide * high + long * high + 0.5 * long * wide)
    )
    unit[np.arange(count), face] = np.where(face == 2, 0.5, np.sign(unit[np.arange(count), face]) * 0.5)
    local = unit * (long, wide, high) + (0.0, 0.0, 0.5 * high)
    c, s = np.cos(yaw), np.sin(yaw)
    places = np.column_stack([x + c * local[:, 0] - s * local[:, 1], y + s * local[:, 0] + c * local[:, 1], local[:, 2]])
    cards(build, rng, places + rng.normal(0, 0.03, places.shape), (0.08, 0.26), leaves)


def flower_bed(
    build: SceneBuilder, rng: Rng, at: tuple[float, float, float], size: tuple[float, float], soil: int, looks: tuple[int, ...]
) -> None:
    """Add a bed of soil with rows of plants, 30 cards per square metre; at: east, north and yaw; size in metres."""
    (x, y, yaw), (long, wide) = at, size
    build.box((x, y, 0.0), (long, wide, 0.12), soil, yaw=yaw)
    a, b = rng.uniform(-0.47, 0.47, (2, int(30 * long * wide)))
    b = np.round(b * wide / 0.3) * 0.3 + rng.normal(0, 0.05, len(b))
    a, c, s = a * long, np.cos(yaw), np.sin(yaw)
    high = 0.16 + 0.28 * rng.random(len(a)) ** 2
    cards(build, rng, np.column_stack([x + c * a - s * b, y + s * a + c * b, high]), (0.08, 0.22), looks)


def fountain(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Add a round basin with water, and in it a pedestal with a stone ball and four bronze spouts."""
    stone = build.add_texture(paint.ashlar(rng, 19.0, 1.5, texel_m, tint=(0.9, 0.86, 0.78)))
    granite = build.add_texture(rock(rng, 5.0, 4.0, 0.5 * texel_m))
    bronze = build.add_texture(paint.painted_steel(rng, 2.0, 3.0, texel_m, (0.09, 0.15, 0.12)))
    build.tube((0.0, 0.0, 0.0), 3.1, 0.16, stone, sides=32)
    build.tube((0.0, 0.0, 0.16), 2.7, 0.5, stone, sides=32, top=False)
    build.kind = WATER
    build.tube((0.0, 0.0, 0.4), 2.68, 0.05, build.add_texture(ground.water(rng, 5.4, 5.4, texel_m)), sides=32)
    build.kind = STATIC
    for a in np.linspace(0.0, 2 * np.pi, 32, endpoint=False):
        b = a + 2 * np.pi / 32
        build.beam((2.75 * np.cos(a), 2.75 * np.sin(a), 0.7), (2.75 * np.cos(b), 2.75 * np.sin(b), 0.7), 0.28, stone)
    build.box((0.0, 0.0, 0.2), (1.2, 1.2, 1.5), stone, yaw=0.3)
    build.box((0.0, 0.0, 1.7), (1.5, 1.5, 0.16), stone, yaw=0.3)
    build.tube((0.0, 0.0, 1.86), 0.35, 0.3, bronze)
    build.ball((0.0, 0.0, 2.85), (0.75, 0.75, 0.75), granite, steps=14)
    for k in range(4):
        turn = 0.3 + k * np.pi / 2
        out = (1.15 * float(np.cos(turn)), 1.15 * float(np.sin(turn)))
        rod(build, (0.5 * out[0], 0.5 * out[1], 0.9), (*out, 1.15), 0.07, bronze)
        build.ball((*out, 1.2), (0.16, 0.16, 0.2), bronze, steps=6)


def pavilion(build: SceneBuilder, rng: Rng, texel_m: float, stone: int) -> None:
    """Add a pavilion next to the northern path: a roof on eight posts, with a railing."""
    roof = build.add_texture(paint.roof_tiles(rng, 5.2, 5.2, texel_m))
    wood = build.add_texture(paint.planks(rng, 3.0, 3.0, texel_m, (0.5, 0.48, 0.42)))
    x, y = -6.8, 8.4
    build.tube((x, y, 0.0), 2.1, 0.3, stone, sides=8)
    ring = [(x + 1.9 * float(np.cos(t)), y + 1.9 * float(np.sin(t))) for t in np.linspace(0.0, 2 * np.pi, 9)]
    for k in range(8):
        rod(build, (*ring[k], 0.3), (*ring[k], 2.6), 0.08, wood)
        for up in (0.7, 1.1) if k % 4 else ():
            build.beam((*ring[k], up), (*ring[k + 1], up), 0.07, wood)
    build.tube((x, y, 2.6), 2.35, 0.12, wood, sides=8)
    cone(build, (x, y, 2.72), 2.5, 1.1, roof, sides=8)
