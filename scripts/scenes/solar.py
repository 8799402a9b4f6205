"""A solar farm on a sloping meadow: rows of identical glossy panels, a gravel way, a cabin, sheep; cameras on masts."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import van
from wbflow_demo.parts.street import furniture_textures, tree
from wbflow_demo.parts.structures import crates, heap
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng, Texture, draw, encode, fractal_noise, mix, one_colour, shape_of
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

from .meadow import EAST, ROWS, fence, flock, lay, on_meadow

WIDE, DEEP = 64.0, 60.0
"""Size of the meadow, metres."""
TABLE, TILT = 7.0, 0.44
"""Length of a table of 2 x 7 panels, in metres, and its tilt towards the south, in radians."""
LAMPS = ((-4.0, 13.0, 7.0), (3.0, -14.0, 7.0))
MASTS = (
    (-21.0, -11.0, 10.5), (-14.0, -20.5, 9.5), (3.4, -24.0, 10.0), (15.0, -19.0, 11.0),
    (23.0, -8.0, 9.8), (22.0, 9.0, 10.6), (-23.5, 3.0, 10.0), (-15.5, 18.0, 11.2),
)  # fmt: skip


def solar(shots: Shots) -> DemoSite:
    """Render the solar farm; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MASTS))
    texel_m = shots.texel_m(18.0, 0.0145, 0.06)
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_solar(shots.random(1), texel_m),
        traffic=flock(shots.random(2), max(texel_m, 0.02), shots.captures),
        lighting=light_of(shots.light, tuple(on_meadow(*lamp) for lamp in LAMPS)),
    )
    return photograph(night, shots, shots.voxel_m(44.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the middle of the rows."""
    return [
        viewpoint_on_post(k, "mast", on_meadow(*mast), on_meadow(0.1 * mast[0], 0.0, 0.8), 68.0, -0.15)
        for k, mast in enumerate(MASTS)
    ]


def static_solar(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    look = furniture_textures(build, rng, texel_m)
    grass = build.add_texture(ground.lawn(rng, WIDE, DEEP, texel_m))
    gravel = build.add_texture(ground.gravel(rng, 30.0, 4.0, texel_m))
    lay(build, (-WIDE / 2, DEEP / 2), (WIDE, DEEP), 0.0, grass)
    lay(build, (-1.8, 14.5), (3.6, 44.0), 0.03, gravel)
    lay(build, (-18.0, 17.0), (36.0, 3.0), 0.04, gravel)
    steel = build.add_texture(paint.painted_steel(rng, 8.0, 1.0, texel_m, (0.40, 0.41, 0.42)))
    panel, back = build.add_texture(_panels(rng, texel_m)), build.add_texture(paint.plaster(rng, 8.0, 4.0, texel_m, (0.5,) * 3))
    for y in ROWS:
        for x in (-17.0, -9.7, 2.6, 9.9):
            _table(build, (x, y), (panel, back, steel))
    _cabin(build, rng, texel_m, steel)
    fence(build, look.wood, steel)
    for _ in range(26):
        x, y = float(rng.uniform(3, 20) * rng.choice([-1, 1])), float(rng.choice([-15.8, -15.0, 18.8, 20.0]))
        size = float(rng.uniform(0.4, 0.9))
        build.ball(on_meadow(x, y, 0.5 * size), (1.2 * size, size, 0.9 * size), look.crown, steps=7)
    for x, y in ((-19.0, 24.0), (-9.0, 26.0), (4.0, 25.0), (14.0, 24.0), (28.0, 4.0), (-29.0, -3.0)):
        build.stamp(tree(build, rng, look, height=float(rng.uniform(4.5, 7.0))), on_meadow(x, y))
    for x, y, z in MASTS:
        build.tube(on_meadow(1.02 * x, 1.02 * y), 0.12, z + 0.3, steel, sides=8)
    return build.build()


def _panels(rng: Rng, texel_m: float) -> Texture:
    """Paint a table: two rows of seven glossy dark blue panels with pale frames and thin lines between their cells."""
    shape = shape_of(TABLE, 3.4, texel_m)
    image = one_colour(shape, (0.018, 0.030, 0.075)) * (1 + 0.05 * fractal_noise(rng, shape, texel_m, 0.8))[..., None]
    for pitch, wide, tone in ((1 / 6, 0.008, 0.35), (1.0, 0.04, 1.0)):
        lines = np.zeros(shape, np.uint8)
        for at in np.arange(0.0, TABLE + 0.01, pitch) / texel_m:
            draw(lines, np.array([(at, 0.0), (at, shape[0])]), wide / texel_m)
        for at in np.arange(0.0, 3.41, 1.7 * pitch) / texel_m:
            draw(lines, np.array([(0.0, at), (shape[1], at)]), wide / texel_m)
        mix(image, (0.55, 0.57, 0.60), tone * min(wide / texel_m, 1.0) * lines.astype(np.float32) / np.float32(255))
    return encode(image, texel_m, gloss=0.8)


def _table(build: SceneBuilder, at: tuple[float, float], look: tuple[int, int, int]) -> None:
    """A table of panels on posts that extends eastwards from its lower western corner `at`."""
    panel, back, steel = look
    right, down = np.array([TABLE, 0, TABLE * EAST]), -3.4 * np.array([0, np.cos(TILT), np.sin(TILT)])
    corner = np.array(on_meadow(*at, 0.75)) - down
    build.quad(corner, right, down, panel)
    build.quad(corner + right - (0, 0, 0.06), -right, down, back)
    for share in (0.22, 0.78):
        build.beam(corner + share * down - (0, 0, 0.12), corner + share * down + right - (0, 0, 0.12), 0.1, steel)
        for along in (0.08, 0.36, 0.64, 0.92):
            top = corner + share * down + along * right - (0, 0, 0.12)
            build.beam(on_meadow(top[0], top[1]), top, 0.1, steel)


def _cabin(build: SceneBuilder, rng: Rng, texel_m: float, steel: int) -> None:
    """The inverters' cabin, and the fitters' material: crates, cable drums, sand, a van."""
    wall = build.add_texture(paint.plaster(rng, 6.0, 3.0, texel_m, (0.42, 0.46, 0.38)))
    door = paint.sign_board(rng, 4.2, 2.5, texel_m, ("WECHSELRICHTER 2", "HOCHSPANNUNG"), (0.45, 0.47, 0.42), (0.35, 0.08, 0.04))
    build.box(on_meadow(5.0, 17.0), (4.2, 2.4, 2.6), wall, front=build.add_texture(door))
    build.box(on_meadow(5.0, 17.0, 2.6), (4.6, 2.8, 0.15), steel)
    wood = [build.add_texture(paint.planks(rng, 4.0, 1.5, texel_m, c)) for c in ((0.42, 0.31, 0.18), (0.30, 0.22, 0.14))]
    pile = build.with_same_textures()
    crates(pile, rng, (0.0, 0.0), wood, rows=3, levels=2)
    for x, y in ((-5.0, -14.0), (9.0, 15.0), (-9.0, 15.5)):
        build.stamp(pile, on_meadow(x, y), yaw=0.3 * x)
    sand = build.with_same_textures()
    heap(sand, rng, (0.0, 0.0), 1.7, 1.0, build.add_texture(ground.gravel(rng, 4.0, 4.0, texel_m)))
    build.stamp(sand, on_meadow(4.2, -14.5))
    for x, y in ((7.6, -14.2), (8.9, -13.6), (-7.8, -13.4)):
        build.tube(on_meadow(x, y), 0.75, 0.9, wood[0], sides=16)
    white = build.add_texture(paint.painted_steel(rng, 4.0, 3.0, texel_m, (0.58, 0.57, 0.54)))
    board = build.add_texture(paint.sign_board(rng, 3.4, 1.9, texel_m, ("SONNEN", "WERK"), (0.6, 0.6, 0.57), (0.55, 0.3, 0.02)))
    dark, glass = (build.add_texture(paint.cloth(rng, texel_m, c)) for c in ((0.03, 0.03, 0.035), (0.05, 0.06, 0.07)))
    van(build, on_meadow(-0.4, -12.0), 1.4, (white, board, dark, glass))
