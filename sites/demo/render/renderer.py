"""Renders a scene: open3d finds the hits of rays, compiled kernels filter the textures and add up the light.

Surfaces are matt or wet.  Shadows of sun and lamps come from one ray per sample towards a point of the source (the sun has a
disc); light of sky and surroundings comes from a coarse grid of directional visibilities, computed once per scene.  Every sample
depends only on its own ray, so the same scene gives the same image on any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import open3d as o3d

from wbflow_stages.core.jit import kernel
from wbflow_stages.types import Float32s, Float64s, Int32s, Uint8s

from .light import Lamp, Light
from .paint import Texture
from .scene import GLOWING, STATIC, Scene


class Atlas(NamedTuple):
    """All textures with their image pyramids, in one array."""

    texels: Uint8s
    """(n, 3) uint8."""
    starts: Int32s
    heights: Int32s
    widths: Int32s
    """(textures, LEVELS) int32 each: first texel, height and width of each level."""
    texel_m: Float32s
    """(textures,) float32, side of a texel at level 0, metres."""


LEVELS = 9
"""Levels of each texture's pyramid: the coarsest texel is 256 times as wide as the finest."""


def build_atlas(textures: tuple[Texture, ...]) -> Atlas:
    """Return an atlas of textures with their pyramids."""
    levels: list[Uint8s] = []
    for texture in textures:
        levels.append(texture.pixels)
        for _ in range(LEVELS - 1):
            levels.append(_halved(levels[-1]))
    shapes = np.array([level.shape[:2] for level in levels], np.int32).reshape(-1, LEVELS, 2)
    heights = shapes[..., 0].copy()
    widths = shapes[..., 1].copy()
    areas = heights.ravel() * widths.ravel()
    starts = (np.cumsum(areas) - areas).astype(np.int32).reshape(-1, LEVELS)
    texels = np.concatenate([level.reshape(-1, 3) for level in levels])
    texel_m = np.array([texture.texel_m for texture in textures], np.float32)
    return Atlas(texels, starts, heights, widths, texel_m)


def _halved(fine: Uint8s) -> Uint8s:
    """Return the means of 2 x 2 texels in linear light (texels hold square roots); an odd last row or column is duplicated."""
    height, width = fine.shape[:2]
    even = cv2.copyMakeBorder(fine, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    linear = np.square(even, dtype=np.float32)
    size = ((width + 1) // 2, (height + 1) // 2)
    mean = cv2.resize(linear, size, interpolation=cv2.INTER_AREA)
    return np.asarray(np.sqrt(mean) + np.float32(0.5), np.float32).astype(np.uint8)


AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float32)
"""Directions +x -x +y -y +z -z, as in `SkyGrid.open`."""


class SkyGrid(NamedTuple):
    """Visibility of the sky from the points of a grid."""

    open: Float32s
    """(nz, ny, nx, 6) float32, visible share in the half spaces along +x -x +y -y +z -z."""
    corner: Float32s
    """(3,) float32: the first point, metres."""
    cell_m: float
    """Distance between neighbouring points, metres."""


OPEN_SKY = SkyGrid(np.ones((2, 2, 2, 6), np.float32), np.zeros(3, np.float32), 1e4)
"""The whole sky is visible from everywhere: for landscapes."""


def tensor(array: Any) -> Any:
    """Return an array as an open3d tensor."""
    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(array))


def ray_scene(vertices: Float32s) -> Any:
    """Return an open3d ray casting scene of t triangles, given by three vertices each, (3 t, 3)."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(vertices), tensor(np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)))
    return scene


class PreparedScene:
    """A scene ready for ray casting, with light, atlas of its textures, and sky visibility (computed if not given)."""

    def __init__(self, scene: Scene, light: Light, atlas: Atlas, sky: SkyGrid | None = None) -> None:
        self.scene = scene
        self.light = light
        self._rays = ray_scene(scene.vertices)
        self.atlas = atlas
        self.sky = self.sky_grid(spiral(48)) if sky is None else sky

    def cast(self, origins: Float32s, directions: Float32s) -> tuple[Float32s, Int32s]:
        """Return the distance (inf for nothing) and facet (-1 for nothing) of the first hit of each of n rays."""
        answer = self._rays.cast_rays(tensor(np.hstack([origins, directions])))
        facet = answer["primitive_ids"].numpy().astype(np.int64)
        return answer["t_hit"].numpy(), np.where(facet < len(self.scene.kinds), facet, -1).astype(np.int32)

    def reaches(self, origins: Float32s, directions: Float32s, far: float = np.inf) -> Float32s:
        """Return 1 for each ray of length `far` (in units of its direction) that is not occluded, else 0."""
        rays = tensor(np.hstack([origins, directions]))
        hit = self._rays.test_occlusions(rays, tnear=0.0, tfar=float(far)).numpy()
        return np.asarray(~hit, dtype=np.float32)

    def sky_grid(self, directions: Float32s, cell_m: float = 0.8) -> SkyGrid:
        """Return the share of the sky visible from points of a grid around the static scene, in the half space along each axis.

        The shares are estimated with rays along `directions` (n, 3)."""
        still = self.scene.vertices[np.repeat(self.scene.kinds == STATIC, 3)]
        low = still.min(axis=0) - cell_m
        shape = (np.ceil((still.max(axis=0) + cell_m - low) / cell_m).astype(int) + 1)[::-1]  # z, y, x
        points = low + cell_m * np.indices(shape, np.float32).reshape(3, -1)[::-1].T
        seen = np.zeros((len(points), 6), np.float32)
        total = np.zeros(6, np.float32)
        for d in directions:
            facing = np.maximum(AXES @ d, 0)
            # light is also reflected by the ground: rays below the horizon count half, and fully if they are not occluded
            clear = self.reaches(points, np.broadcast_to(d, points.shape).astype(np.float32), far=25.0)
            if d[2] <= 0:
                clear = 0.5 + 0.5 * clear
            seen += clear[:, None] * facing
            total += facing
        return SkyGrid((seen / total).reshape(*shape, 6), low.astype(np.float32), cell_m)


def spiral(n: int) -> Float32s:
    """Return n unit vectors spread evenly over the sphere (golden-angle spiral)."""
    k = np.arange(n) + 0.5
    z = 1 - 2 * k / n
    turn = np.pi * (1 + 5**0.5) * k
    return np.column_stack([np.cos(turn) * np.sqrt(1 - z * z), np.sin(turn) * np.sqrt(1 - z * z), z]).astype(np.float32)


@dataclass(frozen=True)
class Hits:
    """Hits of rays from one point, before shading: they do not depend on the light."""

    directions: Float32s
    """(n, 3) float32 unit vectors."""
    distance: Float32s
    """(n,) float32 metres, inf for sky."""
    facet: Int32s
    """(n,) int32, -1 for sky."""
    points: Float32s
    facing: Float32s
    albedo: Float32s
    """(m, 3) float32 each, for the m rays that hit a facet: hit point, normal towards the camera, and reflectance."""


_HEAD_ON = 0.02
"""Reflectance of water at normal incidence."""


def sky_radiance(light: Light, directions: Float32s) -> Float32s:
    """Return the radiance of the sky, (n, 3): haze at the horizon, `light.sky` higher up, and bands of cloud."""
    up = np.clip(directions[:, 2], 0, 1)[:, None]
    blend = np.sqrt(up)
    # position on a flat layer of cloud, kept finite at the horizon
    x = directions[:, 0] / (up[:, 0] + 0.12)
    y = directions[:, 1] / (up[:, 0] + 0.12)
    band = np.sin(1.7 * x + 0.6 * y) * np.sin(0.8 * x - 1.9 * y + 1.0)
    band = band + 0.5 * np.sin(4.1 * x + 2.3 * y) * np.sin(3.3 * y - 1.2 * x)
    cloud = light.clouds * np.clip(band, 0, 1)[:, None]
    haze = np.asarray(light.haze, np.float32)
    colour = haze * (1 - blend) + np.asarray(light.sky, np.float32) * blend
    return np.asarray(colour + cloud * (haze - colour * 0.5), dtype=np.float32)


def add_sheen(prepared: PreparedScene, seen: Hits, lifted: Float32s, radiance: Float32s) -> Float32s:
    """Return radiance (m, 3) of the hit surfaces, with reflections of the sky in glossy ones.

    Objects in front of the sky are reflected as one dark tone with the right outline; reflections move over the ground with the
    viewpoint, which misleads matchers.  Schlick's approximation of Fresnel's equations (Computer Graphics Forum 1994)."""
    gloss = np.array([texture.gloss for texture in prepared.scene.textures], np.float32)
    if not gloss.any():
        return radiance
    # 1. The wet facets that were hit, and how much of each is water.
    hit = seen.facet >= 0
    share = gloss[prepared.scene.texture_of[seen.facet[hit]]]
    wet = np.flatnonzero(share > 0)
    rays = seen.directions[hit][wet]
    facing = seen.facing[wet]

    # 2. What they mirror: the sky, where nothing stands in the way.
    cosine = np.clip(-np.sum(rays * facing, axis=1, keepdims=True), 0, 1)
    mirrored = (rays + 2 * cosine * facing).astype(np.float32)
    clear = prepared.reaches(lifted[wet], mirrored)[:, None]
    ground = np.asarray(prepared.light.ground, np.float32)
    there = clear * sky_radiance(prepared.light, mirrored) + (1 - clear) * ground * 0.5

    # 3. Mix it in, more at grazing angles.
    part = share[wet, None] * (_HEAD_ON + (1 - _HEAD_ON) * (1 - cosine) ** 5)
    radiance[wet] += part * (there - radiance[wet])
    return radiance


def trace(prepared: PreparedScene, centre: Float64s, directions: Float32s, spread: float) -> Hits:
    """Return the hits of n rays from `centre`; `spread`: footprint of a ray per metre of distance."""
    # 1. The first facet on each ray.
    origins = np.broadcast_to(np.asarray(centre, np.float32), directions.shape)
    distance, facet = prepared.cast(origins, directions)
    scene = prepared.scene
    hit = facet >= 0
    rays = directions[hit]
    far = distance[hit]
    on = facet[hit]
    points = np.asarray(centre, np.float32) + rays * far[:, None]
    normals = scene.normals[on]
    # facets are seen from both sides: the normal is turned towards the camera
    is_back = np.einsum("ni,ni->n", normals, rays) > 0
    facing = np.where(is_back[:, None], -normals, normals)

    # 2. Its colour, averaged over the ray's footprint.
    albedo = np.empty_like(points)
    painted = (scene.origins, scene.along_u, scene.along_v, scene.offsets, scene.texture_of)
    _filter(albedo, (points, rays, facing, far, on), spread, painted, prepared.atlas)
    return Hits(directions, distance, facet, points, facing, albedo)


def shade(prepared: PreparedScene, seen: Hits, jitter: Float32s) -> Float32s:
    """Return linear radiance (n, 3) float32 of hits, in the light of a scene.

    jitter: (n, 2) float32 in -1..1, the point of the sun's disc that each sample uses.
    """
    scene = prepared.scene
    light = prepared.light
    hit = seen.facet >= 0
    radiance = np.empty_like(seen.directions)
    radiance[~hit] = sky_radiance(light, seen.directions[~hit])
    if not hit.any():
        return radiance
    points = seen.points
    facing = seen.facing
    # light is added up source by source, then multiplied by the reflectance
    received = np.empty_like(points)
    _sky_light(received, points, facing, prepared.sky, np.array(light.sky, np.float32), np.array(light.ground, np.float32))
    # rays to the lights start a little off the surface, further away the more distant it is: single precision
    lifted = points + facing * np.float32(0.004) * np.maximum(seen.distance[hit] * np.float32(0.05), 1)[:, None]
    _add_sun(prepared, received, lifted, facing, jitter[hit])
    for lamp in light.lamps:
        _add_lamp(prepared, received, lifted, facing, lamp)
    if light.lamps:
        received[scene.kinds[seen.facet[hit]] == GLOWING] = 1.2  # lamps look lit, whatever falls on them
    radiance[hit] = add_sheen(prepared, seen, lifted, seen.albedo * received)
    return radiance


def _add_sun(prepared: PreparedScene, received: Float32s, points: Float32s, facing: Float32s, jitter: Float32s) -> None:
    """Add sunlight on lit facets, with the sun's disc widened to 1 degree for soft edges."""
    sun = np.asarray(prepared.light.sun_direction, np.float32)
    side = np.cross(sun, (0, 0, 1)).astype(np.float32)
    side /= np.linalg.norm(side)
    cosine = facing @ sun
    lit = np.flatnonzero(cosine > 0)
    if not len(lit) or max(prepared.light.sun) <= 0:
        return
    other_side = np.cross(side, sun).astype(np.float32)
    towards = sun + np.float32(0.009) * (jitter[lit, :1] * side + jitter[lit, 1:] * other_side)  # 0.009 rad: half a degree
    clear = prepared.reaches(points[lit], towards.astype(np.float32))
    received[lit] += (cosine[lit] * clear)[:, None] * np.asarray(prepared.light.sun, np.float32)


def _add_lamp(prepared: PreparedScene, received: Float32s, points: Float32s, facing: Float32s, lamp: Lamp) -> None:
    """Add the light of one lamp where it is bright enough to matter."""
    place = np.asarray(lamp.position, np.float32)
    power = np.asarray(lamp.power, np.float32)
    strength = np.empty(len(points), np.float32)
    _lamp_strength(strength, points, facing, place, float(0.012 / power.max()))
    lit = np.flatnonzero(strength)
    if len(lit):
        clear = prepared.reaches(points[lit], place - points[lit], far=0.97)
        received[lit] += (strength[lit] * clear)[:, None] * power


@kernel
def _lamp_strength(strength: Float32s, points: Float32s, normals: Float32s, place: Float32s, least: float) -> None:
    """Fill in a hooded lamp's strength (little light goes up): falloff times cosine, minus `least`, at least 0."""
    for k in range(points.shape[0]):
        x = place[0] - points[k, 0]
        y = place[1] - points[k, 1]
        z = place[2] - points[k, 2]
        square = x * x + y * y + z * z
        distance = np.sqrt(square)
        cosine = (normals[k, 0] * x + normals[k, 1] * y + normals[k, 2] * z) / distance
        # all its light downward, 15 % sideways, 3 % upward
        hood = min(max(0.15 + z / distance, 0.03), 1.0)
        # 0.3 m2 keeps a lamp's own holder from glaring; `least` lets the light end where it no longer matters
        strength[k] = max(max(cosine, 0.0) * hood / (square + 0.3) - least, 0.0)


@kernel
def _mirror(i: int, n: int) -> int:
    """Return the index of the texel at position i of an endlessly mirrored row of n texels."""
    i = i % (2 * n)
    if i < n:
        return i
    return 2 * n - 1 - i


@kernel
def _filter(albedo: Float32s, seen: tuple[Any, ...], spread: float, painted: tuple[Any, ...], atlas: Atlas) -> None:
    """Fill in texture colours of each sample's footprint, by anisotropic filtering: several taps along its long axis.

    seen: points, rays, normals (n, 3), distance and facet (n,) of the samples.  painted: arrays of all facets, as in `Scene`."""
    points, rays, normals, distance, facet = seen
    origins, along_u, along_v, offsets, texture_of = painted
    texels, starts, heights, widths, texel_m = atlas
    for k in range(points.shape[0]):
        f = facet[k]
        t = texture_of[f]
        cosine = 0.0
        for c in range(3):
            cosine -= rays[k, c] * normals[k, c]
        cosine = max(cosine, 0.03)
        width = distance[k] * spread
        # 1. The footprint's shape in the facet.
        # long axis of the footprint: the ray's direction projected into the facet; short axis: across it
        lx = rays[k, 0] + cosine * normals[k, 0]
        ly = rays[k, 1] + cosine * normals[k, 1]
        lz = rays[k, 2] + cosine * normals[k, 2]
        norm = np.sqrt(lx * lx + ly * ly + lz * lz) + 1e-9
        lu = (lx * along_u[f, 0] + ly * along_u[f, 1] + lz * along_u[f, 2]) / norm
        lv = (lx * along_v[f, 0] + ly * along_v[f, 1] + lz * along_v[f, 2]) / norm
        long_m = width / cosine
        # 2. Where its centre is in the texture, metres.
        u = offsets[f, 0]
        v = offsets[f, 1]
        for c in range(3):
            u += (points[k, c] - origins[f, c]) * along_u[f, c]
            v += (points[k, c] - origins[f, c]) * along_v[f, c]
        # 3. Number of taps, and the level whose texels are about as wide as the part of the footprint that a tap covers.
        taps = min(int(1.0 / cosine) + 1, 8)
        footprint = max(width, long_m / taps) / texel_m[t]
        level = 0
        while footprint > 1.5 and level < 8:
            footprint *= 0.5
            level += 1
        scale = 1.0 / (texel_m[t] * (1 << level))
        h = heights[t, level]
        w = widths[t, level]
        start = starts[t, level]
        # 4. The mean of the taps, bilinear each, in linear light (texels hold square roots).
        red = 0.0
        green = 0.0
        blue = 0.0
        for tap in range(taps):
            along = ((tap + 0.5) / taps - 0.5) * long_m
            x = (u + along * lu) * scale - 0.5
            y = (v + along * lv) * scale - 0.5
            x0 = int(np.floor(x))
            y0 = int(np.floor(y))
            ax = x - x0
            ay = y - y0
            for dy in range(2):
                row = start + _mirror(y0 + dy, h) * w
                for dx in range(2):
                    weight = (ax if dx else 1 - ax) * (ay if dy else 1 - ay)
                    index = row + _mirror(x0 + dx, w)
                    red += weight * float(texels[index, 0]) ** 2
                    green += weight * float(texels[index, 1]) ** 2
                    blue += weight * float(texels[index, 2]) ** 2
        gain = 1.0 / (taps * 255.0 * 255.0)
        albedo[k, 0] = red * gain
        albedo[k, 1] = green * gain
        albedo[k, 2] = blue * gain


@kernel
def _sky_light(received: Float32s, points: Float32s, normals: Float32s, around: SkyGrid, sky: Float32s, ground: Float32s) -> None:
    """Fill in light of sky and surroundings: visibilities interpolated just off the surface, weighted by its normal."""
    grid, corner, cell = around
    nz, ny, nx = grid.shape[:3]
    for k in range(points.shape[0]):
        x = min(max((points[k, 0] + 0.6 * cell * normals[k, 0] - corner[0]) / cell, 0.0), nx - 1.001)
        y = min(max((points[k, 1] + 0.6 * cell * normals[k, 1] - corner[1]) / cell, 0.0), ny - 1.001)
        z = min(max((points[k, 2] + 0.6 * cell * normals[k, 2] - corner[2]) / cell, 0.0), nz - 1.001)
        ix = int(x)
        iy = int(y)
        iz = int(z)
        ax = x - ix
        ay = y - iy
        az = z - iz
        # trilinear, and over the three half spaces that the normal faces: the squares of its components add up to 1
        seen = 0.0
        for axis in range(3):
            n = normals[k, axis]
            side = 2 * axis + (0 if n > 0 else 1)
            for dz in range(2):
                for dy in range(2):
                    for dx in range(2):
                        weight = (ax if dx else 1 - ax) * (ay if dy else 1 - ay) * (az if dz else 1 - az)
                        seen += n * n * weight * grid[iz + dz, iy + dy, ix + dx, side]
        # share of the sky above the facet's horizon; facets that face down see the ground instead
        up = 0.5 + 0.5 * normals[k, 2]
        for c in range(3):
            received[k, c] = seen * (sky[c] * (0.35 + 0.65 * up) + ground[c] * (1 - up))
