"""Six cameras on one mast, 0.3 to 4 m apart, above a valley hundreds of metres away: no usable baseline."""

from __future__ import annotations

import itertools

import numpy as np

from wbflow_demo.parts.movers import traffic
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, principal_shift
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng, Texture, encode, fractal_noise, mix, shape_of, smoothstep, weather
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.renderer import OPEN_SKY
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder
from wbflow_stages.types import Float64s

CENTRES = ((0.0, 0.0, 32.0), (0.3, 0.05, 32.1), (-0.5, 0.1, 33.0), (0.4, -0.1, 34.2), (-0.3, 0.0, 35.1), (0.2, 0.1, 35.9))
"""Camera centres, in metres east, north and up."""
NEAR, FAR, ASIDE = 90.0, 1300.0, 800.0
LAMPS = tuple((x, y, 9.0) for x, y in ((-60.0, 300.0), (-20.0, 330.0), (40.0, 310.0), (90.0, 350.0)))


def mast(shots: Shots) -> DemoSite:
    """Render what the mast's 6 cameras see.  Raises ValueError for impossible shots."""
    shots.check(len(CENTRES))
    texel_m = shots.texel_m(400.0, 0.42, 1.6)
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_valley(shots.random(1), texel_m),
        traffic=traffic(
            shots.random(2),
            0.1,
            shots.captures,
            people=0,
            walks=(),
            cars=12,
            roads=(((-140.0, 285.0), (-10.0, 285.0)), ((-10.0, 285.0), (140.0, 285.0)), ((12.0, 200.0), (20.0, 280.0))),
        ),
        lighting=light_of(shots.light, LAMPS),
        sky=OPEN_SKY,
    )
    return photograph(night, shots, 1.0)


def viewpoints() -> list[Viewpoint]:
    """Cameras on one mast, with headings a few degrees apart."""
    found = []
    for k, centre in enumerate(CENTRES):
        shift = principal_shift(k)
        heading, bend = np.deg2rad(4.0 * float(np.sin(2.1 * k))), (-0.10 - 0.01 * (k % 3), 0.02, 0.0002, 0.0003, 0.0)
        target = (500.0 * float(np.sin(heading)), 500.0 * float(np.cos(heading)), 8.0)
        found.append(Viewpoint(f"arm-{k + 1}", centre, target, 42.0 + 2.0 * (k % 2), bend, 0.6 * shift[0], shift))
    return found


def height_of(x: Float64s | np.float64, y: Float64s | np.float64) -> Float64s:
    """The land's height, metres: a valley floor at 0 with hills behind it and at the sides."""
    rise = np.clip((y - 430.0) / 800.0, 0, 1)
    hills = 34 * np.sin(0.011 * x + 1.0) + 22 * np.sin(0.023 * x + 0.017 * y) + 12 * np.sin(0.041 * y - 0.03 * x)
    return np.asarray(rise**1.4 * (190 + hills) + np.clip((np.abs(x) - 230.0) / 400.0, 0, 1) ** 1.5 * 110)


def static_valley(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel on the land, finer on houses."""
    build = SceneBuilder()
    build.kind = STATIC
    land = build.add_texture(_land(rng, texel_m))
    xs, ys = np.linspace(-ASIDE, ASIDE, 65), np.linspace(NEAR, FAR, 50)
    for x0, x1 in itertools.pairwise(xs):
        for y0, y1 in itertools.pairwise(ys):
            a, b, c, d = (np.array([x, y, float(height_of(x, y))]) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1)))
            # the texture is mapped from above: u runs east, v south
            for corners in (np.array([a, b, c]), np.array([a, c, d])):
                at = (float(corners[0, 0]) + ASIDE, FAR - float(corners[0, 1]))
                build.triangle(corners, np.array([1.0, 0, 0]), np.array([0, -1.0, 0]), land, at)
    _village(build, rng)
    return build.build()


def _village(build: SceneBuilder, rng: Rng) -> None:
    """Houses, a church and trees on the valley floor."""
    tones = ((0.60, 0.56, 0.47), (0.52, 0.42, 0.30), (0.62, 0.60, 0.57), (0.45, 0.30, 0.24))
    walls = [build.add_texture(paint.plaster(rng, 12.0, 6.0, 0.1, tone)) for tone in tones]
    fronts = [build.add_texture(paint.window(9.0, 5.5, 0.1)) for _ in range(1)]
    roof = build.add_texture(paint.roof_tiles(rng, 14.0, 7.0, 0.1))
    wood = build.add_texture(_land(rng, 0.5, size=(40.0, 40.0)))
    for k in range(70):
        x, y = float(rng.normal(0, 85)), float(rng.uniform(300, 560))
        z, yaw = float(height_of(np.array(x), np.array(y))) - 0.3, float(rng.choice([0.1, 1.67]) + rng.normal(0, 0.12))
        _house(build, (x, y, z), yaw, float(rng.uniform(9, 14)), walls[k % 4], fronts[0], roof)
    build.box((22.0, 395.0, 0.0), (7.0, 7.0, 24.0), walls[2])
    for a in range(4):
        turn = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * 3.9
        foot = np.array([[22.0 + turn[a, 0], 395.0 + turn[a, 1], 24.0], [22.0 + turn[a + 1, 0], 395.0 + turn[a + 1, 1], 24.0]])
        build.triangle(np.array([*foot, [22.0, 395.0, 40.0]]), np.array([1.0, 0, 0]), np.array([0, 0, -1.0]), roof)
    for _ in range(170):
        x, y = float(rng.uniform(-260, 260)), float(rng.uniform(230, 700))
        if 275 < y < 295:
            continue
        z, size = float(height_of(np.array(x), np.array(y))), float(rng.uniform(2.5, 5.0))
        build.ball((x, y, z + size), (size, size, 1.3 * size), wood, steps=5)


def _house(
    build: SceneBuilder, place: tuple[float, float, float], yaw: float, length: float, wall: int, front: int, roof: int
) -> None:
    """Walls, a front with windows, and a gable roof."""
    part = build.with_same_textures()
    part.box((0.0, 0.0, 0.0), (length, 8.0, 6.0), wall, front=front)
    for side in (0, 1):
        slope = part.with_same_textures()
        slope.quad((-length / 2 - 0.4, 0.0, 9.6), (length + 0.8, 0, 0), (0, -4.5, -4.0), roof)
        slope.triangle(
            np.array([[length / 2, -4.0, 6.0], [length / 2, 4.0, 6.0], [length / 2, 0.0, 9.6]]),
            np.array([0, 1.0, 0]),
            np.array([0, 0, -1.0]),
            wall,
        )
        part.stamp(slope, quarters=2 * side)
    build.stamp(part, place, yaw=yaw)


def _land(rng: Rng, texel_m: float, size: tuple[float, float] = (2 * ASIDE, FAR - NEAR)) -> Texture:
    """Woods, meadows, rock, and a road, with details for a view from a mile away; `size` in metres."""
    shape = shape_of(*size, texel_m)
    crowns = fractal_noise(rng, shape, texel_m, 9.0, octaves=5, gain=0.9)
    wood = np.clip(1 + 0.5 * crowns, 0.15, 3)[..., None] * np.asarray((0.055, 0.075, 0.035), np.float32)
    meadow = (1 + 0.12 * fractal_noise(rng, shape, texel_m, 6.0))[..., None] * np.asarray((0.16, 0.17, 0.065), np.float32)
    image = np.asarray(wood, np.float32)
    where = fractal_noise(rng, shape, texel_m, 160.0, octaves=4)
    if size[0] > 100:
        mix(image, np.asarray(meadow, np.float32), smoothstep(0.0, 0.12, where))
        rock = fractal_noise(rng, shape, texel_m, 60.0, octaves=6, gain=0.75)
        mix(image, (0.30, 0.28, 0.25), smoothstep(1.2, 1.5, rock))
        row = int((FAR - 285.0) / texel_m)
        image[row - max(int(4 / texel_m), 1) : row + max(int(4 / texel_m), 1)] = (0.12, 0.12, 0.115)
    weather(rng, image, texel_m, strength=0.15)
    return encode(image, texel_m)
