"""A small stadium: mown stripes, lines that look the same after half a turn, stands of identical seats, boards around."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from wbflow_demo.parts.ground import lawn, with_lines
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.street import furniture_textures
from wbflow_demo.parts.structures import lamp_post
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, principal_shift
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Colour, Rng, Texture, encode, shape_of
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

WIDE, DEEP = 60.0, 40.0
CAMERAS = 10
ROWS, ROW_M, SEATS_M = 9, 0.85, 5.0
"""Number of rows of a stand, depth of a row, and width of the texture of its seats (metres)."""
LAMPS = tuple((x, y, 16.0) for x in (-34.0, 34.0) for y in (-24.0, 24.0))


def stadium(shots: Shots) -> DemoSite:
    """Render the stadium; it has 10 cameras.  Raises ValueError for impossible shots."""
    shots.check(CAMERAS)
    texel_m = shots.texel_m(22.0, 0.02, 0.07)
    ways = (((-25.0, -12.0), (25.0, 12.0)), ((-25.0, 12.0), (25.0, -12.0)), ((0.0, -18.0), (0.0, 18.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_stadium(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=16, walks=ways),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(60.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras above the stands, all around the field."""
    found = []
    for k in range(CAMERAS):
        turn = 2 * np.pi * (k + 0.3 * np.sin(2.1 * k)) / CAMERAS
        centre = (36.0 * float(np.cos(turn)), 27.0 * float(np.sin(turn)), 10.5 + 0.8 * float(np.sin(3 * k)))
        shift = principal_shift(k)
        bend = (-0.15 - 0.01 * (k % 3), 0.03, 0.0002, 0.0003, 0.0)
        target = (-0.1 * centre[0], -0.1 * centre[1], 0.5)
        found.append(Viewpoint(f"stand-{k + 1}", centre, target, 70.0, bend, 0.8 * shift[0], shift))
    return found


def static_stadium(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    _pitch(build, rng, texel_m)
    grey = build.add_texture(paint.plaster(rng, 70.0, 1.0, texel_m, (0.36, 0.36, 0.35)))
    seats = [build.add_texture(_seats(texel_m, c)) for c in ((0.35, 0.04, 0.05), (0.05, 0.10, 0.35))]
    for side in range(4):
        long, away = (WIDE, DEEP / 2) if side % 2 == 0 else (DEEP, WIDE / 2)
        build.stamp(_stand(build, long + 4.0, away + 4.0, grey, seats[side % 2]), quarters=side)
    _boards(build, rng, texel_m)
    look = furniture_textures(build, rng, texel_m)
    for x, y, z in LAMPS:
        lamp_post(build, (x * 1.2, y * 1.25), z, look.steel)
    return build.build()


def _stand(build: SceneBuilder, long: float, away: float, grey: int, seats: int) -> SceneBuilder:
    """The southern stand, as a part to stamp: rows of one repeated texture."""
    part = build.with_same_textures()
    for row in range(ROWS):
        high, near = 0.82 + 0.42 * row, away + ROW_M * row
        for k in range(int(long / SEATS_M)):
            x = -long / 2 + SEATS_M * k
            part.quad((x, -near, high), (SEATS_M, 0, 0), (0, 0, -0.42), grey, (x + long / 2, 0))
            part.quad((x, -near - ROW_M, high), (SEATS_M, 0, 0), (0, ROW_M, 0), seats)
    part.quad((-long / 2, -away - ROWS * ROW_M, 9.0), (long, 0, 0), (0, 0, -5.0), grey)
    return part


def _seats(texel_m: float, colour: Colour) -> Texture:
    """A texture of ten seats and the step behind them."""
    shape = shape_of(SEATS_M, ROW_M, texel_m)
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32) * np.float32(texel_m)
    seat = ((x % 0.5 > 0.05) & (y < 0.5)).astype(np.float32)
    image = np.full((*shape, 3), 0.3, np.float32)
    image += seat[..., None] * (np.asarray(colour, np.float32) * (1.1 - 0.5 * y[..., None]) - 0.3)
    return encode(np.clip(image, 0.01, 1), texel_m)


def _pitch(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Lawn in mown stripes, with the lines of a field, inside a red track."""
    grass = lawn(rng, WIDE, DEEP, texel_m)
    x = np.arange(grass.pixels.shape[1]) * grass.texel_m
    stripe = np.where(((x / 5.0).astype(int) % 2)[None, :, None] == 0, 1.0, 0.86).astype(np.float32)
    image = np.square(grass.pixels.astype(np.float32) / 255) * stripe
    marked = with_lines(encode(image, grass.texel_m), np.array(_lines(), np.float32), 0.12, rng)
    build.quad((-WIDE / 2, DEEP / 2, 0.0), (WIDE, 0, 0), (0, -DEEP, 0), build.add_texture(marked))
    track = build.add_texture(paint.plaster(rng, 80.0, 60.0, 2 * texel_m, (0.30, 0.10, 0.07)))
    build.quad((-40.0, 30.0, -0.02), (80.0, 0, 0), (0, -60.0, 0), track)
    build.quad((-100.0, 100.0, -0.3), (200.0, 0, 0), (0, -200.0, 0), track)


def _lines() -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Lines of the field, in metres from its top left corner; they are the same after half a turn."""
    x, y = WIDE / 2, DEEP / 2
    corners = [(2.0, 2.0), (WIDE - 2.0, 2.0), (WIDE - 2.0, DEEP - 2.0), (2.0, DEEP - 2.0)]
    lines = [*zip(corners, corners[1:] + corners[:1], strict=True), ((x, 2.0), (x, DEEP - 2.0))]
    for goal, box in ((2.0, 12.0), (WIDE - 2.0, WIDE - 12.0)):
        lines += [((goal, y - 10), (box, y - 10)), ((goal, y + 10), (box, y + 10)), ((box, y - 10), (box, y + 10))]
    circle = [(x + 5 * float(np.cos(a)), y + 5 * float(np.sin(a))) for a in np.linspace(0, 2 * np.pi, 41)]
    return [*lines, *pairwise(circle)]


def _boards(build: SceneBuilder, rng: Rng, texel_m: float) -> None:
    """Repeated advertisements around the field, and one score board."""
    names = ("KAFFEE", "SPARKASSE", "REIFEN", "BRAUEREI", "ZEITUNG", "MOEBEL", "OPTIK", "STROM")
    tones = ((0.5, 0.05, 0.05), (0.05, 0.1, 0.4), (0.6, 0.55, 0.1), (0.05, 0.3, 0.1))
    faces = [
        build.add_texture(paint.sign_board(rng, 6.0, 0.9, texel_m, (n,), tones[k % 4], (0.75, 0.74, 0.7)))
        for k, n in enumerate(names)
    ]
    for k in range(9):
        for s in (-1, 1):
            build.box((-27.0 + 6.5 * k, s * (DEEP / 2 + 1.5), 0.0), (6.0, 0.15, 0.9), faces[(k + 3 * s) % 8])
    for k in range(5):
        for s in (-1, 1):
            build.box((s * (WIDE / 2 + 1.5), -14.0 + 6.5 * k, 0.0), (0.15, 6.0, 0.9), faces[(2 * k + s) % 8])
    score = build.add_texture(paint.sign_board(rng, 8.0, 4.0, texel_m, ("HEIM 2", "GAST 1"), (0.02, 0.02, 0.02), (0.7, 0.6, 0.1)))
    build.box((0.0, DEEP / 2 + 13.0, 6.0), (8.0, 0.4, 4.0), score)
