"""A city park: mown lawn, gravel paths, hedges and trees of separate leaves, a fountain; cameras on lamp posts around it."""

from __future__ import annotations

import numpy as np

from wbflow_demo.parts import ground
from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.street import bench, furniture_textures, street_lamp
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.covers import blobs
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng, Texture, encode, fractal_noise, mix, smoothstep
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

from .garden import flower_bed, fountain, hedge, pavilion, tree

WIDE = 44.0
POSTS = (
    (-5.4, 15.0, 6.2), (-14.6, 7.6, 5.8), (-15.6, -5.4, 6.6), (-8.2, -13.6, 6.0),
    (4.6, -15.8, 6.4), (14.2, -7.8, 5.9), (15.4, 5.4, 6.7), (8.0, 14.2, 6.1),
)  # fmt: skip
"""Camera positions in metres, neighbours 40 to 49 degrees apart as seen from the fountain."""
LAMPS = (*((1.03 * x, 1.03 * y, z + 0.35) for x, y, z in POSTS), (-6.6, 0.0, 4.2), (6.6, 0.0, 4.2))
TREES = ((-11.2, 11.2, 6.2), (-11.2, -9.1, 5.6), (10.6, -11.0, 6.4), (11.6, 10.8, 5.8), (-10.8, 1.9, 4.6), (0.8, -10.6, 4.4),
         (10.4, -1.8, 4.8))  # fmt: skip
"""East, north and height, in metres, of the trees inside the ring of cameras; more trees form a ring outside it."""
FLOWERS = ((0.45, 0.05, 0.06), (0.62, 0.45, 0.04), (0.55, 0.55, 0.58), (0.30, 0.08, 0.36))


def park(shots: Shots) -> DemoSite:
    """Render the park; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(POSTS))
    texel_m = shots.texel_m(14.0, 0.0145, 0.05)
    walks = (((-13.0, 0.0), (-5.0, 0.5)), ((5.0, 0.0), (13.0, -0.5)), ((0.0, 5.0), (0.4, 13.0)), ((-4.5, -3.5), (4.0, -4.0)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_park(shots.random(1), texel_m),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=9, walks=walks),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(36.0))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the fountain."""
    return [viewpoint_on_post(k, "lamp", (x, y, z), (0.05 * x, 0.05 * y, 0.6), 70.0, -0.15) for k, (x, y, z) in enumerate(POSTS)]


def static_park(rng: Rng, texel_m: float) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel."""
    build = SceneBuilder()
    build.kind = STATIC
    build.quad((-WIDE / 2, WIDE / 2, 0.0), (WIDE, 0, 0), (0, -WIDE, 0), build.add_texture(lawn_with_paths(rng, texel_m)))
    grass = build.add_texture(ground.lawn(rng, 30.0, 30.0, 2 * texel_m))
    build.quad((-52.0, 52.0, -0.05), (104.0, 0, 0), (0, -104.0, 0), grass)
    look = furniture_textures(build, rng, texel_m)
    tones = ((0.055, 0.10, 0.025), (0.10, 0.13, 0.03), (0.20, 0.13, 0.03), (0.24, 0.09, 0.03))
    foliage = tuple(build.add_texture(paint.leaves(rng, texel_m, tone)) for tone in tones)
    for k, (x, y, high) in enumerate(TREES):
        tree(build, rng, (x, y, high), look.bark, (foliage[k % 4], foliage[(k + 1) % 4]), 600, 0.34)
    for k, bearing in enumerate(np.linspace(0.0, 2 * np.pi, 22, endpoint=False)):
        away = float(rng.uniform(25.0, 36.0))
        at = (away * float(np.cos(bearing)), away * float(np.sin(bearing)), float(rng.uniform(7.0, 11.0)))
        tree(build, rng, at, look.bark, (foliage[k % 4], foliage[(k + 2) % 4]), 260, 0.9)
    fountain(build, rng, texel_m)
    _hedges_and_beds(build, rng, texel_m, foliage)
    seat = bench(build, look)
    for k, bearing in enumerate((0.5, 1.1, 2.0, 2.6, 3.7, 4.3, 5.2, 5.8)):
        at = (7.0 * float(np.cos(bearing)), 7.0 * float(np.sin(bearing)), 0.0)
        build.stamp(seat, at, yaw=bearing - np.pi / 2 + 0.05 * (k % 3))
        build.tube(
            (1.02 * at[0] + 1.3 * np.sin(bearing), 1.02 * at[1] - 1.3 * np.cos(bearing), 0.0), 0.2, 0.75, look.steel, sides=10
        )
    for x, y, z in LAMPS:
        build.stamp(street_lamp(build, look, height=z), (x, y, 0.0))
    board = build.add_texture(
        paint.sign_board(rng, 1.6, 1.0, texel_m, ("STADTPARK", "HUNDE", "ANLEINEN"), (0.05, 0.2, 0.1), (0.6, 0.6, 0.55))
    )
    build.box((3.0, 8.8, 0.9), (1.6, 0.06, 1.0), board, yaw=0.3)
    pavilion(build, rng, texel_m, look.stone)
    return build.build()


def lawn_with_paths(rng: Rng, texel_m: float) -> Texture:
    """Paint the ground: grass in mown strips with fallen leaves, and gravel paths with worn edges around and to the fountain."""
    grass, stone = ground.lawn(rng, WIDE, WIDE, texel_m), ground.gravel(rng, WIDE, WIDE, texel_m)
    image, path = (np.asarray(np.square(t.pixels.astype(np.float32) / np.float32(255))) for t in (grass, stone))
    shape = (image.shape[0], image.shape[1])
    y, x = (np.indices(shape, dtype=np.float32) + 0.5) * np.float32(texel_m) - np.float32(WIDE / 2)
    strips = smoothstep(-0.3, 0.3, np.sin(np.float32(2 * np.pi / 1.9) * (0.94 * x + 0.34 * y)))
    image *= (0.75 + 0.6 * strips)[..., None]
    image *= (1 + 0.18 * fractal_noise(rng, shape, texel_m, 0.5, octaves=4))[..., None]
    away = np.hypot(x, y)
    inside = np.maximum(np.minimum(away - 3.6, 6.3 - away), 1.3 - np.abs(away - 15.4))
    inside = np.maximum(inside, np.where(away > 3.6, 1.1 - np.minimum(np.abs(x), np.abs(y)), -1.0))
    inside += 0.16 * fractal_noise(rng, shape, texel_m, 0.8, octaves=5)
    mix(image, (0.17, 0.13, 0.085), 0.8 * smoothstep(-0.5, 0.0, inside))
    mix(image, path * np.asarray((1.35, 1.22, 1.0), np.float32), smoothstep(-0.06, 0.06, inside))
    for tone, count in (((0.45, 0.27, 0.05), 2600), ((0.30, 0.11, 0.04), 1500), ((0.13, 0.08, 0.04), 1500)):
        mix(image, tone, 1.2 * blobs(rng, shape, texel_m, count=count, radius_m=0.055))
    return encode(image, texel_m)


def _hedges_and_beds(build: SceneBuilder, rng: Rng, texel_m: float, foliage: tuple[int, ...]) -> None:
    """Low hedges along two paths, flower beds, and a ring of tall hedges with gaps outside the cameras."""
    for x in (-1.75, 1.75):
        for y in (-10.6, 10.6):
            hedge(build, rng, (x, y, np.pi / 2), (4.6, 0.6, 0.75), foliage[:2])
    for k, bearing in enumerate(np.linspace(0.2, 2 * np.pi + 0.2, 9, endpoint=False)):
        at = (20.5 * float(np.cos(bearing)), 20.5 * float(np.sin(bearing)), float(bearing) + np.pi / 2)
        hedge(build, rng, at, (7.5, 0.9, 1.3 + 0.15 * (k % 3)), foliage[k % 2 : k % 2 + 2])
    soil = build.add_texture(ground.asphalt(rng, 4.0, 3.0, texel_m, tone=0.06))
    blooms = [build.add_texture(paint.cloth(rng, texel_m, colour)) for colour in FLOWERS]
    beds = ((-9.8, 3.0, 0.0), (-9.8, -3.0, 0.1), (9.8, 3.2, -0.1), (9.6, -4.4, 0.4), (5.2, 8.6, 0.7), (-5.4, -8.4, 0.8))
    for k, bed in enumerate(beds):
        flower_bed(build, rng, bed, (3.6, 1.5), soil, (foliage[0], blooms[k % 4], blooms[(k + 1) % 4]))
