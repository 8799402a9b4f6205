"""People and vehicles, which are at other places in every capture."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from wbflow_stages.types import Float64s

from ..render import Place
from ..render.paint import Colour, Rng
from ..render.scene import MOVING, Scene, SceneBuilder, axes_of
from ..render.textures import cloth, painted_steel, sign_board
from .street import car, car_textures

Way = tuple[tuple[float, float], tuple[float, float]]
"""Start and end point, metres east and north."""

# Linear reflectances.  Each person wears two of the clothes.
CLOTHES = ((0.75, 0.32, 0.02), (0.10, 0.16, 0.35), (0.45, 0.05, 0.04), (0.55, 0.55, 0.08), (0.06, 0.06, 0.07), (0.25, 0.35, 0.22))

HELMETS = ((0.75, 0.65, 0.05), (0.7, 0.7, 0.68), (0.1, 0.25, 0.5))

SKIN: Colour = (0.45, 0.27, 0.19)
PAINTS = ((0.62, 0.62, 0.60), (0.60, 0.40, 0.03), (0.08, 0.18, 0.42))

ROUTES: tuple[Way, ...] = (
    ((6.0, 3.0), (34.0, 4.5)),
    ((13.5, 9.0), (14.5, 24.0)),
    ((26.0, 8.0), (25.0, 24.5)),
    ((8.0, 26.0), (32.0, 26.5)),
    ((15.0, 12.5), (25.0, 13.5)),
)
"""Ways of the yard, along which there are no static objects."""


def movers(rng: Rng, texel_m: float, captures: int, *, people: int = 9, vehicles: int = 2) -> list[Scene]:
    """Return a scene per capture with the same people and vehicles at other places on the routes; all share their textures."""
    build = SceneBuilder()
    build.kind = MOVING
    # textures use random numbers: their order matters
    skin = build.add_texture(cloth(rng, texel_m, SKIN))
    dark = build.add_texture(cloth(rng, texel_m, (0.035, 0.035, 0.04)))
    glass = build.add_texture(cloth(rng, texel_m, (0.05, 0.07, 0.08)))
    clothes = [build.add_texture(cloth(rng, texel_m, c)) for c in CLOTHES]
    helmets = [build.add_texture(cloth(rng, texel_m, c)) for c in HELMETS]
    worn = rng.integers(len(clothes), size=(people, 2))
    paints = []
    for k in range(vehicles):
        paints.append(build.add_texture(painted_steel(rng, 2.5, 2.5, texel_m, PAINTS[k % len(PAINTS)])))
    board = build.add_texture(sign_board(rng, 3.0, 1.5, texel_m, ("HAFEN", "DIENST"), PAINTS[0], (0.05, 0.1, 0.3)))
    scenes = []
    for _ in range(captures):
        build = build.with_same_textures()
        for k, (jacket, trousers) in enumerate(worn):
            place, yaw = _on_way(rng, ROUTES[k % len(ROUTES)], 0.4, 0.15)
            person(build, rng, place, yaw, (clothes[jacket], clothes[trousers], skin, helmets[k % len(helmets)]))
        for k, paint in enumerate(paints):
            place, yaw = _on_way(rng, ROUTES[3 * k % len(ROUTES)], 0.4, 0.15)
            if k % 2 == 0:
                van(build, place, yaw, (paint, board, dark, glass))
            else:
                _forklift(build, place, yaw, paint, dark)
        scenes.append(build.build())
    return scenes


def person(build: SceneBuilder, rng: Rng, place: Place, yaw: float, look: tuple[int, int, int, int]) -> None:
    """Add a walking person of about 1.75 m, one leg forward; `look`: textures of jacket, trousers, skin, helmet."""
    jacket, trousers, skin, helmet = look
    x, y, _ = place
    ahead, side = axes_of(yaw)
    step = 0.18 * float(rng.uniform(0.3, 1.2))
    for sign in (-1, 1):
        # arm and leg of one side swing against each other
        hip = np.array([x, y, 0.88]) + 0.09 * sign * side
        build.beam(hip, hip + sign * step * ahead - np.array([0, 0, 0.88]), 0.15, trousers)
        shoulder = np.array([x, y, 1.42]) + 0.22 * sign * side
        build.beam(shoulder, shoulder - sign * step * ahead - np.array([0, 0, 0.6]), 0.10, jacket)
    build.ball((x, y, 1.18), (0.21, 0.21, 0.36), jacket, steps=6)
    build.ball((x, y, 1.63), (0.10, 0.10, 0.13), skin, steps=5)
    build.ball((x, y, 1.70), (0.13, 0.13, 0.10), helmet, steps=5)


def van(build: SceneBuilder, place: Place, yaw: float, look: tuple[int, int, int, int]) -> None:
    """Add a delivery van of 4.8 m."""
    paint, board, dark, glass = look
    ahead, _ = axes_of(yaw)
    p = np.array(place)
    build.box(p - 0.6 * ahead + (0, 0, 0.45), (3.4, 1.95, 1.95), paint, yaw=yaw, sides=board)
    build.box(p + 1.75 * ahead + (0, 0, 0.45), (1.3, 1.9, 0.95), paint, yaw=yaw)
    build.box(p + 1.35 * ahead + (0, 0, 1.4), (0.5, 1.8, 0.8), glass, yaw=yaw)
    _wheels(build, p, yaw, 1.45, 0.85, 0.36, dark)


def _forklift(build: SceneBuilder, place: Place, yaw: float, paint: int, dark: int) -> None:
    """Add a forklift of 2.4 m with its mast."""
    ahead, side = axes_of(yaw)
    p = np.array(place)
    build.box(p - 0.2 * ahead + (0, 0, 0.3), (1.9, 1.15, 0.9), paint, yaw=yaw)
    # four posts under the roof, then the mast with its two forks
    for a, s in itertools.product((-0.7, 0.5), (-0.5, 0.5)):
        build.beam(p + a * ahead + s * side + (0, 0, 1.2), p + a * ahead + s * side + (0, 0, 2.1), 0.08, dark)
    build.box(p - 0.1 * ahead + (0, 0, 2.1), (1.5, 1.15, 0.08), paint, yaw=yaw)
    for s in (-0.35, 0.35):
        build.beam(p + 0.95 * ahead + s * side, p + 0.95 * ahead + s * side + (0, 0, 2.5), 0.12, dark)
        build.beam(p + 0.95 * ahead + s * side + (0, 0, 0.15), p + 2.0 * ahead + s * side + (0, 0, 0.15), 0.10, dark)
    _wheels(build, p, yaw, 0.6, 0.5, 0.3, dark)


def _wheels(build: SceneBuilder, p: Float64s, yaw: float, a: float, s: float, radius: float, dark: int) -> None:
    """Add four wheels."""
    ahead, side = axes_of(yaw)
    for i, j in itertools.product((-a, a), (-s, s)):
        build.ball(p + i * ahead + j * side + (0, 0, radius), (radius, radius, radius), dark, steps=5)


COATS: tuple[Colour, ...] = (
    (0.06, 0.07, 0.09), (0.34, 0.30, 0.24), (0.40, 0.06, 0.05), (0.10, 0.17, 0.33),
    (0.16, 0.22, 0.12), (0.55, 0.53, 0.48), (0.50, 0.30, 0.05),
)  # fmt: skip
HAIR: tuple[Colour, ...] = ((0.05, 0.035, 0.025), (0.16, 0.10, 0.05), (0.30, 0.28, 0.26))


def traffic(
    rng: Rng, texel_m: float, captures: int, *, people: int, walks: Sequence[Way], cars: int = 0, roads: Sequence[Way] = ()
) -> tuple[Scene, ...]:
    """Return a scene per capture with the same people and cars at other places on their ways; all share their textures."""
    build = SceneBuilder()
    build.kind = MOVING
    skin = build.add_texture(cloth(rng, texel_m, SKIN))
    coats = [build.add_texture(cloth(rng, texel_m, c)) for c in COATS]
    hair = [build.add_texture(cloth(rng, texel_m, c)) for c in HAIR]
    worn = rng.integers(len(coats), size=(people, 2))
    vehicles = [car(build, car_textures(build, rng, texel_m), k) for k in range(cars)]
    scenes = []
    for _ in range(captures):
        build = build.with_same_textures()
        for k, (coat, trousers) in enumerate(worn):
            place, yaw = _on_way(rng, walks[k % len(walks)], 0.9, 0.1)
            person(build, rng, place, yaw, (coats[coat], coats[trousers], skin, hair[k % len(hair)]))
        for k, vehicle in enumerate(vehicles):
            place, yaw = _on_way(rng, roads[k % len(roads)], 0.15, 0.1)
            build.stamp(vehicle, place, yaw=yaw)
        scenes.append(build.build())
    return tuple(scenes)


def _on_way(rng: Rng, way: Way, stray_m: float, veer: float) -> tuple[Place, float]:
    """Return a random place and heading along a way, in either direction; `stray_m`, `veer` (radians): standard deviations."""
    start = np.array(way[0])
    end = np.array(way[1])
    x, y = start + rng.uniform(0, 1) * (end - start) + rng.normal(0, stray_m, 2)
    yaw = float(np.arctan2(*(end - start)[::-1]))
    yaw = yaw + float(rng.normal(0, veer)) + np.pi * float(rng.integers(2))  # half of them walk back
    return (float(x), float(y), 0.0), yaw
