"""Things that appear, vanish and move in the demo yard, and how large they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import open3d as o3d

from .movers import PAINTS, van
from .random_fields import Rng
from .scene import STATIC, Scene, SceneBuilder
from .script import Stay
from .structures import Box, container
from .textures import cloth, painted_steel, planks, sign_board

RASTER_M = 0.01


@dataclass(frozen=True)
class Extent:
    """How large a thing is, at its own heading."""

    size: tuple[float, float, float]
    """Length, width and height, metres."""
    volume_m3: float
    """Under what is seen of it from above, down to the ground."""


class Things:
    """Builds the things of a night; all scenes have the same textures."""

    def __init__(self, rng: Rng, texel_m: float) -> None:
        self._all = SceneBuilder()
        self._all.kind = STATIC
        self._parts = {
            "container": self._container(rng, texel_m),
            "vehicle": self._vehicle(rng, texel_m),
            "stack": self._stack(rng, texel_m),
            "crate": self._crate(rng, texel_m),
        }

    def scene(self, there: Mapping[str, Stay]) -> Scene:
        """What stands where; there: at least one thing."""
        build = self._all.with_same_textures()
        for name, stay in there.items():
            build.stamp(self._parts[name], (*stay.at, 0.0), yaw=stay.yaw)
        return build.build()

    def extent(self, name: str) -> Extent:
        """The size of a thing, and its volume by rays from above, one for each cell of RASTER_M."""
        corners = self._parts[name].build().vertices
        low, high = corners.min(axis=0), corners.max(axis=0)
        rays = o3d.t.geometry.RaycastingScene()
        index = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        rays.add_triangles(o3d.core.Tensor.from_numpy(corners), o3d.core.Tensor.from_numpy(index))
        x, y = (np.arange(low[k] + RASTER_M / 2, high[k], RASTER_M) for k in range(2))
        down = np.zeros((len(x) * len(y), 6), np.float32)
        down[:, :2] = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        down[:, 2], down[:, 5] = high[2] + 1, -1
        distance = rays.cast_rays(o3d.core.Tensor.from_numpy(down))["t_hit"].numpy()
        height = np.where(np.isfinite(distance), high[2] + 1 - distance, 0).astype(np.float64)
        length, width, top = (float(v) for v in (high[0] - low[0], high[1] - low[1], high[2]))
        return Extent((length, width, top), float(height.sum() * RASTER_M**2))

    def _container(self, rng: Rng, texel_m: float) -> SceneBuilder:
        part = self._all.with_same_textures()
        container(part, rng, texel_m, Box(0.0, 0.0, 0, 0.0, 6.06, (0.44, 0.20, 0.04), "WESER"))
        return part

    def _vehicle(self, rng: Rng, texel_m: float) -> SceneBuilder:
        part = self._all.with_same_textures()
        paint = part.add_texture(painted_steel(rng, 2.5, 2.5, texel_m, PAINTS[2]))
        board = part.add_texture(sign_board(rng, 3.0, 1.5, texel_m, ("ELEKTRO", "KRUSE"), (0.50, 0.48, 0.42), (0.3, 0.05, 0.04)))
        dark, glass = (part.add_texture(cloth(rng, texel_m, c)) for c in ((0.035, 0.035, 0.04), (0.05, 0.07, 0.08)))
        van(part, (0.0, 0.0, 0.0), 0.0, (paint, board, dark, glass))
        return part

    def _stack(self, rng: Rng, texel_m: float) -> SceneBuilder:
        part = self._all.with_same_textures()
        for level, tone in enumerate(((0.36, 0.25, 0.14), (0.42, 0.33, 0.2), (0.30, 0.22, 0.15))):
            part.box((0.0, 0.0, 0.65 * level), (2.4, 1.6, 0.65), part.add_texture(planks(rng, 5.0, 1.5, texel_m, tone)))
        return part

    def _crate(self, rng: Rng, texel_m: float) -> SceneBuilder:
        part = self._all.with_same_textures()
        sides = sign_board(rng, 4.0, 1.3, texel_m, ("PUMPE 3", "OBEN  450 KG"), (0.38, 0.28, 0.16), (0.05, 0.04, 0.04))
        part.box(
            (0.0, 0.0, 0.0), (1.6, 1.2, 1.3), part.add_texture(planks(rng, 5.0, 1.5, texel_m)), sides=part.add_texture(sides)
        )
        return part
