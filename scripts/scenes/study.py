"""A study: a desk, shelves full of books, a carpet and plain white walls, seen by webcams 10 to 35 degrees apart."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.weak import white_plaster
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import overcast_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

WIDE, DEEP, HIGH = 5.2, 4.4, 2.6
MOUNTS = ((-1.5, -2.0, 1.9), (-0.8, -2.05, 2.1), (0.3, -2.0, 1.7), (1.7, -1.9, 2.0), (2.4, -1.2, 1.6), (-2.4, -1.3, 1.8))
LAMPS = ((-1.2, 0.4, 2.5), (1.2, 0.4, 2.5))


def study(shots: Shots) -> DemoSite:
    """Render the study; it has 6 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MOUNTS))
    texel_m = shots.texel_m(2.5, 0.002, 0.01)
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_study(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.01), shots.captures, people=1, walks=(((1.2, -1.5), (1.4, 0.8)),)),
        lighting=overcast_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(6.0))


def viewpoints() -> list[Viewpoint]:
    """Webcams along one wall, all looking at the desk."""
    return [viewpoint_on_post(k, "webcam", place, (-0.2, 1.3, 0.8), 62.0, -0.1) for k, place in enumerate(MOUNTS)]


def static_study(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    floor = build.add_texture(paint.planks(rng, WIDE, DEEP, texel_m, (0.3, 0.19, 0.1)))
    build.quad((-WIDE / 2, DEEP / 2, 0.0), (WIDE, 0, 0), (0, -DEEP, 0), floor)
    wall = build.add_texture(white_plaster(rng, WIDE, HIGH, texel_m))
    for corner, right in (
        ((-WIDE / 2, DEEP / 2, HIGH), (WIDE, 0.0, 0.0)),
        ((WIDE / 2, DEEP / 2, HIGH), (0.0, -DEEP, 0.0)),
        ((WIDE / 2, -DEEP / 2, HIGH), (-WIDE, 0.0, 0.0)),
        ((-WIDE / 2, -DEEP / 2, HIGH), (0.0, DEEP, 0.0)),
    ):
        build.quad(corner, right, (0, 0, -HIGH), wall)
    carpet = build.add_texture(paint.ashlar(rng, 2.4, 1.6, texel_m, tint=(0.8, 0.3, 0.25)))
    build.box((-0.2, 0.3, 0.0), (2.4, 1.6, 0.012), carpet, yaw=0.1)
    _shelves(build, rng, texel_m)
    _desk(build, rng, texel_m)
    posters = (
        (("WESER", "1911"), (0.1, 0.25, 0.35)),
        (("KUNST", "HALLE", "BREMEN"), (0.55, 0.45, 0.1)),
        (("ATLAS",), (0.4, 0.1, 0.1)),
    )
    for k, (words, tone) in enumerate(posters):
        poster = build.add_texture(paint.sign_board(rng, 0.6, 0.85, texel_m, words, tone, (0.8, 0.78, 0.7)))
        build.box((-0.75 + 0.95 * k, DEEP / 2 - 0.01, 1.25), (0.6, 0.02, 0.85), poster)
    pane = build.add_texture(paint.window(1.2, 1.3, texel_m))
    build.box((WIDE / 2 - 0.01, 0.6, 0.95), (0.02, 1.2, 1.3), pane)
    return build.build()


def _shelves(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Two bookcases, at the left wall and at the wall behind the desk: six boards, books of many widths and colours."""
    wood = build.add_texture(paint.planks(rng, 2.0, 0.4, texel_m, (0.42, 0.3, 0.18)))
    tones = rng.uniform(0.03, 0.5, (12, 3))
    spines = [
        build.add_texture(paint.sign_board(rng, 0.05, 0.26, texel_m, ("I", "=", "N"), tuple(tone), tuple(0.75 - tone)))
        for tone in tones
    ]
    for x, y, yaw in ((-WIDE / 2 + 0.2, 0.6, np.pi / 2), (1.75, DEEP / 2 - 0.2, 0.0)):
        ahead, across = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        for level in range(6):
            build.box((x, y, 0.36 * level + 0.05), (1.4, 0.3, 0.025), wood, yaw=yaw)
            along = -0.68
            while level < 5 and along < 0.6:
                wide, high = float(rng.uniform(0.02, 0.06)), float(rng.uniform(0.18, 0.31))
                if rng.uniform() < 0.93:
                    at = np.array([x, y, 0.36 * level + 0.075]) + (along + wide / 2) * ahead + rng.uniform(-0.01, 0.03) * across
                    build.box(at, (wide, 0.22, high), spines[int(rng.integers(len(spines)))], yaw=yaw)
                along += wide
        for end in (-0.71, 0.71):
            build.box(np.array([x, y, 0.0]) + end * ahead, (0.025, 0.3, 1.9), wood, yaw=yaw)


def _desk(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Desk and chair, with a screen, papers, boxes and a lamp."""
    wood = build.add_texture(paint.planks(rng, 1.6, 0.8, texel_m, (0.5, 0.36, 0.2)))
    dark = build.add_texture(paint.painted_steel(rng, 0.6, 0.5, texel_m, (0.05, 0.05, 0.055)))
    build.box((-0.2, 1.45, 0.71), (1.6, 0.8, 0.03), wood)
    for x, y in ((-0.95, 1.1), (0.55, 1.1), (-0.95, 1.8), (0.55, 1.8)):
        build.box((x, y, 0.0), (0.05, 0.05, 0.71), dark)
    screen = build.add_texture(
        paint.sign_board(rng, 0.56, 0.34, texel_m, ("E = MC2", "QED", "7 x 8"), (0.06, 0.1, 0.2), (0.6, 0.7, 0.7))
    )
    build.box((-0.3, 1.65, 0.84), (0.56, 0.04, 0.34), dark, front=screen)
    build.box((-0.3, 1.68, 0.74), (0.2, 0.15, 0.1), dark)
    paper = build.add_texture(
        paint.sign_board(rng, 0.21, 0.3, texel_m, ("LOREM", "IPSUM", "DOLOR", "SIT"), (0.7, 0.69, 0.65), (0.1, 0.1, 0.1))
    )
    for k in range(5):
        at = (float(rng.uniform(-0.8, 0.4)), float(rng.uniform(1.15, 1.4)), 0.74 + 0.004 * k)
        build.box(at, (0.21, 0.3, 0.004), paper, yaw=float(rng.normal(0, 0.5)))
    cloth = build.add_texture(paint.cloth(rng, texel_m, (0.12, 0.2, 0.32)))
    build.box((-0.1, 0.75, 0.42), (0.5, 0.5, 0.07), cloth, yaw=0.3)
    build.box((-0.02, 0.5, 0.49), (0.48, 0.06, 0.5), cloth, yaw=0.3)
    build.box((-0.1, 0.75, 0.0), (0.08, 0.08, 0.42), dark)
    card = build.add_texture(paint.sign_board(rng, 0.4, 0.3, texel_m, ("BUCH", "VERSAND"), (0.42, 0.3, 0.18), (0.08, 0.07, 0.06)))
    for x, y, size in ((0.9, 0.9, 0.42), (1.3, 1.2, 0.34), (0.95, 0.92, 0.3)):
        lift = 0.42 if (x, y) == (0.95, 0.92) else 0.0
        build.box((x, y, lift), (size, size, size), card, yaw=float(rng.normal(0, 0.4)))
