"""Scenes of flat textured facets: quads, boxes, posts and balls, gathered by a builder into arrays for the renderer.

World axes are in metres, z up.  A facet's texture runs along two world vectors from its first corner, so two dot products give
the texture position of a hit point, and facets may share one texture (walls between windows, ribs of a container).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from wbflow_stages.types import Float32s, Float64s, Int32s, Uint8s

from .paint import Texture

Vector = tuple[float, float, float] | Float64s
UP = np.array([0.0, 0.0, 1.0])

STATIC = 0
"""Kind of facets that stay."""

MOVING = 1
"""Kind of facets that move between captures."""

WATER = 2
"""Kind of facets of water: rendered, but without ground truth."""

GLOWING = 3
"""Kind of facets of lamps."""


@dataclass(frozen=True)
class Scene:
    """Triangles and their textures."""

    vertices: Float32s
    """(3 t, 3) float32, three for each of t triangles."""
    normals: Float32s
    """(t, 3) float32, outward."""
    origins: Float32s
    along_u: Float32s
    along_v: Float32s
    """(t, 3) float32: a point X is ((X - origin) . u + offset_u, (X - origin) . v + offset_v) metres into its texture."""
    offsets: Float32s
    """(t, 2) float32."""
    texture_of: Int32s
    """(t,) int32, indices into `textures`."""
    kinds: Uint8s
    """(t,) uint8."""
    textures: tuple[Texture, ...]


_Facet = tuple[Float64s, Float64s, Float64s, Float64s, tuple[float, float], int, int]
"""A triangle in the builder: corners (3, 3), and origin, u, v, offsets, texture and kind as in `Scene`."""


VECTORS = ("vertices", "normals", "origins", "along_u", "along_v", "offsets")
"""The float32 arrays of a `Scene`."""


class SceneBuilder:
    """Collects facets; `build` returns them as arrays.  Textures are given by the number that `add_texture` returns."""

    def __init__(self) -> None:
        self._textures: list[Texture] = []
        self._facets: list[_Facet] = []
        self.kind = STATIC

    def with_same_textures(self) -> SceneBuilder:
        """Return a builder without facets that shares this one's textures and their numbers."""
        other = SceneBuilder()
        other._textures = self._textures
        other.kind = self.kind
        return other

    def add_texture(self, texture: Texture) -> int:
        """Add a texture and return its number."""
        self._textures.append(texture)
        return len(self._textures) - 1

    def quad(
        self,
        corner: Vector,
        right: Vector,
        down: Vector,
        texture: int,
        offset: tuple[float, float] = (0.0, 0.0),
        axis: Vector | None = None,
    ) -> None:
        """Add a parallelogram seen from its front: top-left `corner`, edges `right` and `down`.

        axis: direction of the texture's rows, if it is not `right`."""
        c, r, d = (np.asarray(v, np.float64) for v in (corner, right, down))
        # texture axes: unit vectors along the edges; v is made perpendicular to u, if the quad is not a rectangle
        v = d / np.linalg.norm(d)
        if axis is None:
            u = r / np.linalg.norm(r)
            v = v - (v @ u) * u
        else:
            u = np.asarray(axis, np.float64)
        for triangle in ((c, c + d, c + r), (c + r, c + d, c + r + d)):
            self._facets.append((np.array(triangle), c, u, v, offset, texture, self.kind))

    def triangle(self, corners: Float64s, u: Vector, v: Vector, texture: int, offset: tuple[float, float] = (0.0, 0.0)) -> None:
        """Add one triangle, corners (3, 3) counter-clockwise from its front; texture axes u, v from its first corner."""
        c, u, v = (np.asarray(a, np.float64) for a in (corners, u, v))
        self._facets.append((c, c[0], u, v, offset, texture, self.kind))

    def box(
        self,
        base: Vector,
        size: Vector,
        texture: int,
        *,
        yaw: float = 0.0,
        sides: int | None = None,
        front: int | None = None,
        offset: float = 0.0,
    ) -> None:
        """Add a box with its bottom centre at `base`; `sides` replaces `texture` on upright faces, `front` on the -y face."""
        width, depth, height = (float(s) for s in size)
        foot = np.asarray(base, np.float64)
        across, back = axes_of(yaw)
        # the box's edges
        x = across * width
        y = back * depth
        z = np.array([0, 0, height])

        def corner(a: float, b: float, c: float) -> Float64s:
            return np.asarray(foot + a * width / 2 * across + b * depth / 2 * back + c * z, np.float64)

        wall = texture if sides is None else sides
        front_wall = wall if front is None else front
        self.quad(corner(-1, -1, 1), x, -z, front_wall, (offset, 0.0))
        self.quad(corner(1, -1, 1), y, -z, wall, (offset + width, 0.0))
        self.quad(corner(1, 1, 1), -x, -z, wall, (offset, 0.0))
        self.quad(corner(-1, 1, 1), -y, -z, wall, (offset + width, 0.0))
        self.quad(corner(-1, 1, 1), x, -y, texture, (offset, height))
        self.quad(corner(-1, -1, 0), x, y, texture, (offset, height))

    def beam(self, start: Vector, end: Vector, thickness: float, texture: int, *, offset: float = 0.0) -> None:
        """Add a square bar between two points."""
        a = np.asarray(start, np.float64)
        along = np.asarray(end, np.float64) - a
        axis = along / float(np.linalg.norm(along))
        # any direction that is not along the bar will do: upward, unless the bar is upright itself
        not_along = (0, 0, 1.0) if abs(axis[2]) < 0.95 else (0, 1.0, 0)
        side = np.cross(axis, not_along)
        side /= np.linalg.norm(side)
        other = np.cross(axis, side)
        for p, q in ((other, side), (-side, other), (-other, -side), (side, -other)):
            # seen from outside along -p, with the beam's axis pointing down the picture
            self.quad(a + thickness / 2 * p - thickness / 2 * q, thickness * q, along, texture, (offset, offset))

    def tube(self, base: Vector, radius: float, height: float, texture: int, *, sides: int = 14, top: bool = True) -> None:
        """Add an upright cylinder; the texture runs around it."""
        turn = np.linspace(0, 2 * np.pi, sides + 1)
        circle = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(sides + 1)])
        foot = np.asarray(base, np.float64)
        lift = np.array([0, 0, height])
        rim = foot + circle + lift
        for k, (start, end) in enumerate(itertools.pairwise(foot + circle)):
            step = end - start
            self.quad(start + lift, step, -lift, texture, (float(k * np.linalg.norm(step)), 0.0))
            if top:
                self.triangle(np.array([foot + lift, *rim[k : k + 2]]), (1, 0, 0), (0, 1, 0), texture, (radius, radius))

    def ball(self, centre: Vector, radii: Vector, texture: int, *, steps: int = 8) -> None:
        """Add an ellipsoid of `steps` x 2 `steps` faces, for heads, shoulders and wheels seen from afar."""
        down = np.linspace(0, np.pi, steps + 1)[:, None]
        around = np.linspace(0, 2 * np.pi, 2 * steps + 1)
        height = np.broadcast_to(np.cos(down), (steps + 1, 2 * steps + 1))
        unit = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), height], axis=-1)
        surface = np.asarray(centre, np.float64) + np.asarray(radii, np.float64) * unit
        for i, j in np.ndindex(steps, 2 * steps):
            # corners of a face: a, d above, b, e below; u runs around the ball
            (a, d), (b, e) = surface[i : i + 2, j : j + 2]
            u = np.array([-np.sin(around[j]), np.cos(around[j]), 0.0])
            at = (0.3 * j, 0.3 * i)
            # at the poles, one of the two triangles has no area
            if i < steps - 1:
                self.triangle(np.array([a, b, e]), u, (0, 0, -1), texture, at)
            if i > 0:
                self.triangle(np.array([a, e, d]), u, (0, 0, -1), texture, at)

    def stamp(self, part: SceneBuilder, at: Vector = (0.0, 0.0, 0.0), *, yaw: float = 0.0, quarters: int = 0) -> None:
        """Add a copy of a part that shares this builder's textures.

        It is rotated about its origin by `yaw` radians and by exactly `quarters` right angles, then moved to `at`, metres."""
        # right angles are exact, so that what meets at a corner still does
        quarter = np.linalg.matrix_power(np.array([[0, -1.0, 0], [1.0, 0, 0], [0, 0, 1.0]]), quarters % 4)
        turn = quarter @ np.column_stack([*axes_of(yaw), UP])
        # the first four entries of a facet are vectors, turned all at once: (t, 3, 3), and (t, 3) each
        vectors = list(zip(*part._facets, strict=True))[:4]
        corners, origins, u, v = (np.array(column) @ turn.T for column in vectors)
        move = np.asarray(at, np.float64)
        for facet, *moved in zip(part._facets, corners + move, origins + move, u, v, strict=True):
            self._facets.append((*moved, *facet[4:]))

    def build(self) -> Scene:
        """Return the scene as arrays."""
        corners, origins, u, v, offsets, textures, kinds = (np.array(column) for column in zip(*self._facets, strict=True))
        # corners are counter-clockwise from the front: normals point outward
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return Scene(
            vertices=corners.reshape(-1, 3).astype(np.float32),
            normals=normals.astype(np.float32),
            origins=origins.astype(np.float32),
            along_u=u.astype(np.float32),
            along_v=v.astype(np.float32),
            offsets=offsets.astype(np.float32),
            texture_of=textures.astype(np.int32),
            kinds=kinds.astype(np.uint8),
            textures=tuple(self._textures),
        )


def axes_of(yaw: float) -> tuple[Float64s, Float64s]:
    """Return (3,) unit vectors ahead and to the left for a heading of `yaw` radians north of east."""
    c = np.cos(yaw)
    s = np.sin(yaw)
    return np.array([c, s, 0]), np.array([-s, c, 0])


def joined(scene: Scene, movers: Scene) -> Scene:
    """Return both scenes as one; facets of `scene` come first."""
    # textures of the second follow those of the first, so their numbers move up
    both = {name: np.concatenate([getattr(scene, name), getattr(movers, name)]) for name in (*VECTORS, "kinds")}
    texture_of = np.concatenate([scene.texture_of, movers.texture_of + len(scene.textures)]).astype(np.int32)
    return Scene(**both, texture_of=texture_of, textures=scene.textures + movers.textures)
