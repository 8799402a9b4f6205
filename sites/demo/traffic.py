"""People without helmets and cars, elsewhere at every capture: the traffic of squares, streets and car parks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .movers import person
from .paint import Colour
from .random_fields import Rng
from .scene import MOVING, Scene, SceneBuilder
from .street import car, car_textures
from .textures import cloth

Way = tuple[tuple[float, float], tuple[float, float]]
"""From and to, metres east and north."""

COATS: tuple[Colour, ...] = (
    (0.06, 0.07, 0.09), (0.34, 0.30, 0.24), (0.40, 0.06, 0.05), (0.10, 0.17, 0.33),
    (0.16, 0.22, 0.12), (0.55, 0.53, 0.48), (0.50, 0.30, 0.05),
)  # fmt: skip
HAIR: tuple[Colour, ...] = ((0.05, 0.035, 0.025), (0.16, 0.10, 0.05), (0.30, 0.28, 0.26))


def traffic(
    rng: Rng, texel_m: float, captures: int, *, people: int, walks: Sequence[Way], cars: int = 0, roads: Sequence[Way] = ()
) -> tuple[Scene, ...]:
    """The same people and cars at other places of their ways for each capture; all scenes have the same textures.

    Parameters
    ----------
    rng : Generator
        Of places, headings and looks.
    texel_m : float
        Metres per texel.
    captures : int
        How many scenes.
    people, cars : int
        How many of each.
    walks, roads : sequence of (from, to)
        Where people and cars may be, metres east and north; each keeps to one.
    """
    build = SceneBuilder()
    build.kind = MOVING
    skin = build.add_texture(cloth(rng, texel_m, (0.45, 0.27, 0.19)))
    coats = [build.add_texture(cloth(rng, texel_m, c)) for c in COATS]
    hair = [build.add_texture(cloth(rng, texel_m, c)) for c in HAIR]
    worn = rng.integers(len(coats), size=(people, 2))
    vehicles = [car(build, car_textures(build, rng, texel_m), k) for k in range(cars)]
    scenes = []
    for _ in range(captures):
        build = build.with_same_textures()
        for k, (coat, trousers) in enumerate(worn):
            place, yaw = _on_way(rng, walks[k % len(walks)], 0.9)
            person(build, rng, place, yaw, (coats[coat], coats[trousers], skin, hair[k % len(hair)]))
        for k, vehicle in enumerate(vehicles):
            place, yaw = _on_way(rng, roads[k % len(roads)], 0.15)
            build.stamp(vehicle, place, yaw=yaw)
        scenes.append(build.build())
    return tuple(scenes)


def _on_way(rng: Rng, way: Way, stray_m: float) -> tuple[tuple[float, float, float], float]:
    """A random place on a way, and a heading along it, to or fro."""
    start, end = (np.array(p) for p in way)
    x, y = start + rng.uniform(0, 1) * (end - start) + rng.normal(0, stray_m, 2)
    yaw = float(np.arctan2(*(end - start)[::-1])) + float(rng.normal(0, 0.1)) + np.pi * float(rng.integers(2))
    return (float(x), float(y), 0.0), yaw
