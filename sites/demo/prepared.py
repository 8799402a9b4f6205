"""A scene made ready to be looked at, and what rays from one point meet in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d

from wbflow_stages.types import Float32s, Int32s

from .atlas import Atlas
from .light import Light
from .scene import STATIC, Scene

AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32)


@dataclass(frozen=True)
class SkyGrid:
    """How much of the sky points in space see."""

    open: Float32s
    """(nz, ny, nx, 6) float32, along +x -x +y -y +z -z."""
    corner: Float32s
    """(3,) float32: the first point, metres."""
    cell_m: float
    """From each point to the next."""


OPEN_SKY = SkyGrid(np.ones((2, 2, 2, 6), np.float32), np.zeros(3, np.float32), 1e4)
"""All points see all of the sky: for landscapes."""


def _tensor(array: Any) -> Any:
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array))


class PreparedScene:
    """A scene made ready to be looked at: rays, light, atlas of its textures, sky visibility (computed where not given)."""

    def __init__(self, scene: Scene, light: Light, atlas: Atlas, sky: SkyGrid | None = None) -> None:
        self.scene = scene
        self.light = light
        self._rays = o3d.t.geometry.RaycastingScene()
        index = np.arange(len(scene.vertices), dtype=np.uint32).reshape(-1, 3)
        self._rays.add_triangles(_tensor(scene.vertices), _tensor(index))
        self.atlas = atlas
        self.sky = self.sky_grid(spiral(48)) if sky is None else sky

    def cast(self, origins: Float32s, directions: Float32s) -> tuple[Float32s, Int32s]:
        """Distance (inf for nothing) and facet (-1 for nothing) of what each of n rays hits first."""
        answer = self._rays.cast_rays(_tensor(np.hstack([origins, directions])))
        facet = answer["primitive_ids"].numpy().astype(np.int64)
        return answer["t_hit"].numpy(), np.where(facet < len(self.scene.kinds), facet, -1).astype(np.int32)

    def reaches(self, origins: Float32s, directions: Float32s, far: float = np.inf) -> Float32s:
        """1 where a ray of length `far` (in units of its direction) meets nothing, else 0."""
        rays = _tensor(np.hstack([origins, directions]))
        hit = self._rays.test_occlusions(rays, tnear=0.0, tfar=float(far)).numpy()
        return np.asarray(~hit, dtype=np.float32)

    def sky_grid(self, directions: Float32s, cell_m: float = 0.8) -> SkyGrid:
        """Share of the sky seen from the cells of a grid around the static scene, for the half space along each axis; by rays
        along `directions` (n, 3)."""
        still = np.repeat(self.scene.kinds == STATIC, 3)
        low = self.scene.vertices[still].min(axis=0) - cell_m
        count = np.ceil((self.scene.vertices[still].max(axis=0) + cell_m - low) / cell_m).astype(int) + 1
        axes = [low[k] + cell_m * np.arange(count[k], dtype=np.float32) for k in range(3)]
        z, y, x = np.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
        points = np.column_stack([x.ravel(), y.ravel(), z.ravel()]).astype(np.float32)
        seen = np.zeros((len(points), 6), np.float32)
        total = np.zeros(6, np.float32)
        for d in directions:
            facing = np.maximum(AXES @ d, 0)
            # sideways and downward light also comes back from the ground: rays below the horizon count a little when free
            clear = self.reaches(points, np.broadcast_to(d, points.shape).astype(np.float32), far=25.0)
            seen += (clear if d[2] > 0 else 0.5 + 0.5 * clear)[:, None] * facing
            total += facing
        return SkyGrid((seen / total).reshape(*z.shape, 6), low.astype(np.float32), cell_m)


def spiral(n: int) -> Float32s:
    """n unit vectors spread evenly over the sphere (golden-angle spiral)."""
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    turn = np.pi * (1 + 5**0.5) * k
    return np.column_stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z]).astype(np.float32)


@dataclass(frozen=True)
class Seen:
    """What rays from one point meet, before light falls on it: the same under any light."""

    directions: Float32s
    """(n, 3) float32 unit vectors."""
    distance: Float32s
    """(n,) float32 metres, inf for sky."""
    facet: Int32s
    """(n,) int32, -1 for sky."""
    points: Float32s
    facing: Float32s
    albedo: Float32s
    """(m, 3) float32 each, of the m rays that meet something: where, its normal towards the camera, its colour."""
