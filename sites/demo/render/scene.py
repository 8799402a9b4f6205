"""Scenes of flat textured facets: quads, boxes, posts and balls, gathered by a builder into arrays for the renderer.

World axes are metres, z up.  A facet's texture runs along two world vectors from its first corner, so a hit point gives its
texture position by two dot products and facets may share one texture (walls between windows, ribs of a container).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wbflow_stages.types import Float32s, Float64s, Int32s, Uint8s

from .paint import Texture

Vector = tuple[float, float, float] | Float64s

STATIC, MOVING, WATER, GLOWING = 0, 1, 2, 3
"""Kinds of facets: what stands still, what moves between captures, water (drawn, but no truth for a reconstruction), lamps."""


@dataclass(frozen=True)
class Scene:
    """Triangles and what is painted on them."""

    vertices: Float32s
    """(3 t, 3) float32, three for each of t triangles."""
    normals: Float32s
    """(t, 3) float32, outward."""
    origins: Float32s
    along_u: Float32s
    along_v: Float32s
    """(t, 3) float32: a point X lies ((X - origin) . u + offset_u, (X - origin) . v + offset_v) metres into its texture."""
    offsets: Float32s
    """(t, 2) float32."""
    texture_of: Int32s
    """(t,) int32, into `textures`."""
    kinds: Uint8s
    """(t,) uint8."""
    textures: tuple[Texture, ...]


class SceneBuilder:
    """Collects facets; `build` freezes them.  Textures are referred to by the number `add_texture` returns."""

    def __init__(self) -> None:
        self._textures: list[Texture] = []
        self._corners: list[Float64s] = []
        self._axes: list[tuple[Float64s, Float64s, Float64s, tuple[float, float]]] = []
        self._paint: list[tuple[int, int]] = []
        self.kind = STATIC

    def with_same_textures(self) -> SceneBuilder:
        """Return a builder without facets that shares this one's textures, and their numbers."""
        other = SceneBuilder()
        other._textures, other.kind = self._textures, self.kind
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
        at: tuple[float, float] = (0.0, 0.0),
        run: Vector | None = None,
    ) -> None:
        """Add a parallelogram seen from its front: top-left `corner`, edges `right` and `down`."""
        c, r, d = (np.asarray(v, np.float64) for v in (corner, right, down))
        u = np.asarray(run, np.float64) if run is not None else r / np.linalg.norm(r)
        v = d / np.linalg.norm(d)
        v = v - (v @ u) * u if run is None else v
        for triangle in ((c, c + d, c + r), (c + r, c + d, c + r + d)):
            self._corners.append(np.array(triangle))
            self._axes.append((c, u, v, at))
            self._paint.append((texture, self.kind))

    def triangle(self, corners: Float64s, u: Float64s, v: Float64s, texture: int, at: tuple[float, float] = (0.0, 0.0)) -> None:
        """Add one triangle, corners (3, 3) counter-clockwise from its front; texture axes u, v from its first corner."""
        self._corners.append(np.asarray(corners, np.float64))
        self._axes.append((np.asarray(corners[0], np.float64), np.asarray(u, np.float64), np.asarray(v, np.float64), at))
        self._paint.append((texture, self.kind))

    def box(
        self,
        base: Vector,
        size: Vector,
        texture: int,
        *,
        yaw: float = 0.0,
        sides: int | None = None,
        front: int | None = None,
        at: float = 0.0,
    ) -> None:
        """Add a box, given the centre of its foot; `sides` replaces `texture` on upright faces, `front` on the one facing -y."""
        x, y, z = (float(s) for s in size)
        ex, ey, ez = np.array([np.cos(yaw), np.sin(yaw), 0]), np.array([-np.sin(yaw), np.cos(yaw), 0]), np.array([0, 0, 1.0])
        foot = np.asarray(base, np.float64)

        def corner(a: float, b: float, c: float) -> Float64s:
            return np.asarray(foot + a * x / 2 * ex + b * y / 2 * ey + c * z * ez, np.float64)

        wall = texture if sides is None else sides
        self.quad(corner(-1, -1, 1), ex * x, -ez * z, wall if front is None else front, (at, 0.0))
        self.quad(corner(1, -1, 1), ey * y, -ez * z, wall, (at + x, 0.0))
        self.quad(corner(1, 1, 1), -ex * x, -ez * z, wall, (at, 0.0))
        self.quad(corner(-1, 1, 1), -ey * y, -ez * z, wall, (at + x, 0.0))
        self.quad(corner(-1, 1, 1), ex * x, -ey * y, texture, (at, z))
        self.quad(corner(-1, -1, 0), ex * x, ey * y, texture, (at, z))

    def beam(self, start: Vector, end: Vector, thick: float, texture: int, *, at: float = 0.0) -> None:
        """Add a square bar between two points."""
        a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
        along = b - a
        length = float(np.linalg.norm(along))
        axis = along / length
        side = np.cross(axis, (0, 0, 1.0) if abs(axis[2]) < 0.95 else (0, 1.0, 0))
        side /= np.linalg.norm(side)
        other = np.cross(axis, side)
        half = thick / 2
        for p, q in ((other, side), (-side, other), (-other, -side), (side, -other)):
            # seen from outside along -p, with the beam's axis pointing down the picture
            self.quad(a + half * p - half * q, thick * q, along, texture, (at, at))

    def tube(self, base: Vector, radius: float, height: float, texture: int, *, sides: int = 14, top: bool = True) -> None:
        """Add an upright cylinder; the texture runs around it."""
        foot = np.asarray(base, np.float64)
        turn = np.linspace(0, 2 * np.pi, sides + 1)
        ring = foot + np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(sides + 1)])
        lift = np.array([0, 0, height])
        for k in range(sides):
            step = ring[k + 1] - ring[k]
            self.quad(ring[k] + lift, step, -lift, texture, (float(k * np.linalg.norm(step)), 0.0))
            if top:
                cap = np.array([foot + lift, ring[k] + lift, ring[k + 1] + lift])
                self.triangle(cap, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), texture, (radius, radius))

    def ball(self, centre: Vector, radii: Vector, texture: int, *, steps: int = 8) -> None:
        """Add an ellipsoid of `steps` x 2 `steps` facets: heads, shoulders, wheels seen from afar."""
        c, r = np.asarray(centre, np.float64), np.asarray(radii, np.float64)
        theta = np.linspace(0, np.pi, steps + 1)
        phi = np.linspace(0, 2 * np.pi, 2 * steps + 1)

        def point(i: int, j: int) -> Float64s:
            direction = np.array([np.sin(theta[i]) * np.cos(phi[j]), np.sin(theta[i]) * np.sin(phi[j]), np.cos(theta[i])])
            return np.asarray(c + r * direction, np.float64)

        for i in range(steps):
            for j in range(2 * steps):
                a, b, d, e = point(i, j), point(i + 1, j), point(i, j + 1), point(i + 1, j + 1)
                u = np.array([-np.sin(phi[j]), np.cos(phi[j]), 0])
                v = np.array([0, 0, -1.0])
                if i < steps - 1:
                    self.triangle(np.array([a, b, e]), u, v, texture, (0.3 * j, 0.3 * i))
                if i > 0:
                    self.triangle(np.array([a, e, d]), u, v, texture, (0.3 * j, 0.3 * i))

    def stamp(self, part: SceneBuilder, at: Vector = (0.0, 0.0, 0.0), *, yaw: float = 0.0, quarters: int = 0) -> None:
        """Add a copy of a part that shares this builder's textures.

        It is turned by `yaw` radians and by exactly `quarters` right angles about its origin, then moved to `at`, metres."""
        c, s = np.cos(yaw), np.sin(yaw)
        quarter = np.linalg.matrix_power(np.array([[0, -1.0, 0], [1.0, 0, 0], [0, 0, 1.0]]), quarters % 4)
        turn = quarter @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        move = np.asarray(at, np.float64)
        self._corners.extend(np.array(part._corners) @ turn.T + move)
        origins, u, v = (np.array([axis[k] for axis in part._axes]) for k in range(3))
        moved = zip(origins @ turn.T + move, u @ turn.T, v @ turn.T, part._axes, strict=True)
        self._axes.extend((o, a, b, axis[3]) for o, a, b, axis in moved)
        self._paint.extend(part._paint)

    def build(self) -> Scene:
        """Return the scene as arrays."""
        corners = np.array(self._corners)
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        columns = [np.array([axis[k] for axis in self._axes], np.float32) for k in range(4)]
        paint: npt.NDArray[np.int64] = np.array(self._paint, np.int64)
        return Scene(
            vertices=corners.reshape(-1, 3).astype(np.float32),
            normals=normals.astype(np.float32),
            origins=columns[0],
            along_u=columns[1],
            along_v=columns[2],
            offsets=columns[3],
            texture_of=paint[:, 0].astype(np.int32),
            kinds=paint[:, 1].astype(np.uint8),
            textures=tuple(self._textures),
        )


def joined(scene: Scene, movers: Scene) -> Scene:
    """Return both scenes as one; facets of `scene` come first."""
    pairs = {
        name: np.concatenate([getattr(scene, name), getattr(movers, name)])
        for name in ("vertices", "normals", "origins", "along_u", "along_v", "offsets", "kinds")
    }
    texture_of = np.concatenate([scene.texture_of, movers.texture_of + len(scene.textures)]).astype(np.int32)
    return Scene(**pairs, texture_of=texture_of, textures=scene.textures + movers.textures)
