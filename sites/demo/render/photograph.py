"""Photographs a scene: fixed cameras, several captures of each with traffic at other places, and the exact ground truth.

Captures are as a camera would write them (distorted, noisy, with a burned-in clock).  The ground truth describes the empty scene:
lenses, poses, depth, and a reference cloud.  The same arguments give the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from wbflow_stages.capture.wide import views_of_lens
from wbflow_stages.core.cameras import project
from wbflow_stages.core.lenses import lens_pixels
from wbflow_stages.types import Bools, Camera, Cloud, Float32s, Float64s, Lens, Uint8s

from .cameras import Viewpoint, camera_at, distort, pixel_rays, with_lenses
from .light import Light
from .paint import Rng
from .reference import TrueView, reference_cloud
from .renderer import Hits, PreparedScene, SkyGrid, build_atlas, shade, trace
from .scene import WATER, Scene, joined
from .sensor import Sensor, add_rain, burn_clock, clock_mask, develop, sensor_of

Daytime = Literal["day", "dusk", "night", "dark"]


@dataclass(frozen=True)
class Shots:
    """Number, size and conditions of the pictures taken of a scene."""

    cameras: int
    """Number of the scene's cameras that are used."""
    captures: int
    """Captures per camera."""
    size: tuple[int, int] = (960, 540)
    """Width and height, pixels."""
    seed: int = 0
    """Seed of textures, movers, exposures and noise."""
    light: Daytime = "day"
    """Time of day."""
    threads: int = 2
    """Threads for rendering; the result does not depend on their number."""
    lenses: str = "standard"
    """A name in `cameras.VARIANTS`."""
    surfaces: str = "standard"
    """A name in `weak.SURFACES`."""

    def check(self, available: int) -> None:
        """Raise ValueError unless there is a capture, it has 16 x 16 pixels, and there are 1 to `available` cameras."""
        if not 1 <= self.cameras <= available:
            raise ValueError(f"this scene has 1 to {available} cameras, not {self.cameras}")
        if self.captures < 1 or min(self.size) < 16:
            wide, high = self.size
            raise ValueError(f"a camera needs at least 1 capture of 16 x 16 pixels, not {self.captures} of {wide} x {high}")

    def texel_m(self, width_m: float, finest_m: float, coarsest_m: float) -> float:
        """Return the side of a texel, metres: that of a pixel if an image shows `width_m` of the scene, clipped to the limits."""
        return float(np.clip(width_m / self.size[0], finest_m, coarsest_m))

    def voxel_m(self, width_m: float, coarsest_m: float = 0.1) -> float:
        """Return the side of a cell of the reference cloud likewise, in whole centimetres, from 0.02 to `coarsest_m` metres."""
        return float(np.clip(round(width_m / self.size[0], 2), 0.02, coarsest_m))

    def random(self, part: int) -> Rng:
        """Return the random generator for one part of the scene."""
        return np.random.default_rng([self.seed, part])


FIRST_CAPTURE = {
    "day": datetime(2026, 11, 19, 14, 2, 11),
    "dusk": datetime(2026, 11, 19, 16, 41, 5),
    "night": datetime(2026, 11, 19, 22, 14, 37),
    "dark": datetime(2026, 11, 19, 23, 47, 52),
}

SAMPLES = 2
"""Samples along each side of a pixel."""

ROW, COLUMN = np.divmod(np.arange(SAMPLES * SAMPLES), SAMPLES)
"""Row and column of each sample within its pixel."""

BATCH = 65536
"""Number of pixels that are rendered at a time."""
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class DemoCamera:
    """One fixed camera, its captures and its ground truth."""

    name: str
    captures: tuple[Uint8s, ...]
    """(h, w, 3) uint8 RGB each, as captured (distorted)."""
    times: tuple[datetime, ...]
    """When each was taken."""
    mask: Bools
    """(h, w) bool, False under the clock."""
    depth: Float32s
    """(h, w) float32, depth of the empty scene in metres along the optical axis, in the undistorted view with the lens's own K;
    0 for sky and water.  For a fisheye: metres along the ray of each pixel of a capture."""
    camera: Camera
    """The undistorted view of `depth`."""
    lens: Lens


@dataclass(frozen=True)
class DemoSite:
    """A photographed scene."""

    cameras: tuple[DemoCamera, ...]
    reference: Cloud
    """Surfaces that at least two cameras see: their mean point in each cell of `voxel_m` metres."""
    voxel_m: float

    def __getitem__(self, name: str) -> DemoCamera:
        return next(c for c in self.cameras if c.name == name)


@dataclass(frozen=True)
class Night:
    """A scene with its cameras, traffic and light."""

    viewpoints: tuple[Viewpoint, ...]
    still: Scene
    """The empty scene."""
    traffic: tuple[Scene, ...]
    """The moving objects at each capture; all scenes share their textures."""
    lighting: Light
    sky: SkyGrid | None = None
    """Sky visibility of the empty scene; None: it is computed."""


class Frame(NamedTuple):
    """The scene at one capture."""

    scene: PreparedScene
    moving: Scene
    """The part of the scene that differs between captures."""


def frames_of(empty: PreparedScene, traffic: Sequence[Scene]) -> tuple[Frame, ...]:
    """Return a prepared scene with its traffic at each capture, in the same light."""
    frames = []
    for moving in traffic:
        scene = PreparedScene(joined(empty.scene, moving), empty.light, empty.atlas, empty.sky)
        frames.append(Frame(scene, moving))
    return tuple(frames)


def photograph(night: Night, shots: Shots, voxel_m: float) -> DemoSite:
    """Take the captures of all cameras, several cameras at a time; `voxel_m`: cell of the reference cloud, metres."""
    atlas = build_atlas(night.still.textures + night.traffic[0].textures)
    empty = PreparedScene(night.still, night.lighting, atlas, night.sky)
    frames = frames_of(empty, night.traffic)
    viewpoints = [with_lenses(viewpoint, k, shots.lenses) for k, viewpoint in enumerate(night.viewpoints)]
    with ThreadPoolExecutor(shots.threads) as pool:
        done = list(pool.map(lambda viewpoint: _photograph(empty, frames, viewpoint, shots), viewpoints))
    reference = reference_cloud([view for _, seen in done for view in seen], voxel_m)
    return DemoSite(tuple(camera for camera, _ in done), reference, voxel_m)


def _photograph(
    empty: PreparedScene, frames: Sequence[Frame], viewpoint: Viewpoint, shots: Shots
) -> tuple[DemoCamera, list[TrueView]]:
    """Return one camera with its captures and ground truth, and its pinhole view (for a fisheye: several)."""
    # 1. The camera and the truth of the empty scene.
    name = viewpoint.name
    size = viewpoint.size(shots.size)
    camera, lens = camera_at(viewpoint, size)
    wide = lens if lens.model == "fisheye" else None
    depth, normals = true_depth(empty, camera, wide)

    # 2. Its captures.  Seeds depend on the camera's name, not on how many cameras there are.
    seed = [shots.seed, 3, sum(name.encode())]
    sensor = sensor_of(np.random.default_rng(seed), shots.light)
    rngs = [np.random.default_rng([*seed, k]) for k in range(len(frames))]
    images = captures(render_view(empty, camera, lens), frames, rngs, camera, lens, sensor)
    first_time = FIRST_CAPTURE[shots.light] + timedelta(seconds=seed[2] % 11)
    times = [first_time + timedelta(seconds=97 * k) for k in range(len(frames))]
    dated = tuple(burn_clock(image, name, time) for image, time in zip(images, times, strict=True))
    demo = DemoCamera(name, dated, tuple(times), clock_mask(size), depth, camera, lens)

    # 3. What it contributes to the reference cloud.
    if wide is None:
        return demo, [TrueView(camera, depth, normals, undistorted_colours(demo))]
    pinholes = pinholes_of(camera, wide, name)
    return demo, [TrueView(each, *true_depth(empty, each), undistorted_colours(demo, each)) for each in pinholes]


def captures(
    still: Float32s, frames: Sequence[Frame], rngs: Sequence[Rng], camera: Camera, lens: Lens, sensor: Sensor, rain: bool = False
) -> Iterator[Uint8s]:
    """Yield a camera's capture of each frame; `rngs`: a random generator per frame.

    still: radiance (h, w, 3) of the empty scene; only pixels that movers may change are rendered again.
    """
    for (scene, moving), rng in zip(frames, rngs, strict=True):
        # most pixels are as in the empty scene
        radiance = still.copy()
        pixels = np.flatnonzero(changed_pixels(moving, scene.light, camera, lens))
        radiance.reshape(-1, 3)[pixels] = render_pixels(scene, camera, lens, pixels)
        if rain:
            radiance = add_rain(radiance, scene.light, rng)
        # automatic exposure differs by an eighth of a stop
        exposure = float(2 ** rng.uniform(-0.12, 0.12))
        yield develop(radiance, sensor, exposure, rng)


def render_view(prepared: PreparedScene, camera: Camera, lens: Lens | None) -> Float32s:
    """Return linear radiance (h, w, 3) float32 of a whole view; `lens` None: without distortion."""
    every = np.arange(camera.width * camera.height)
    return render_pixels(prepared, camera, lens, every).reshape(camera.height, camera.width, 3)


def render_pixels(prepared: PreparedScene, camera: Camera, lens: Lens | None, pixels: Indices) -> Float32s:
    """Return linear radiance (n, 3) float32 of pixels, given by index: the means of their SAMPLES x SAMPLES samples."""
    out = np.empty((len(pixels), 3), np.float32)
    for start in range(0, len(pixels), BATCH):
        batch = slice(start, start + BATCH)
        out[batch] = shade_pixels(prepared, trace_pixels(prepared, camera, lens, pixels[batch]))
    return out


def trace_pixels(prepared: PreparedScene, camera: Camera, lens: Lens | None, pixels: Indices) -> Hits:
    """Return the hits of SAMPLES x SAMPLES rays through each pixel; pixels are given by their index in the image."""
    y, x = np.divmod(pixels[:, None], camera.width)
    column = (SAMPLES * x + COLUMN).ravel().astype(np.float64)
    row = (SAMPLES * y + ROW).ravel().astype(np.float64)
    # samples are the centres of the parts of a pixel, whose own centre has whole coordinates
    rays = pixel_rays(camera, lens, (column + 0.5) / SAMPLES - 0.5, (row + 0.5) / SAMPLES - 0.5)
    return trace(prepared, camera.C, rays, 1.0 / (SAMPLES * camera.K[0, 0]))


def shade_pixels(prepared: PreparedScene, seen: Hits) -> Float32s:
    """Return linear radiance (n, 3) float32 of n pixels from the hits of `trace_pixels`, in the light of `prepared`."""
    pixels = len(seen.directions) // (SAMPLES * SAMPLES)
    # the samples of a pixel use different points of the sun's disc, equal for all pixels: soft shadow edges without noise
    points_of_disc = np.column_stack([COLUMN + 0.4 * ROW, ROW - 0.4 * COLUMN]) * 1.4 - (0.98, 0.42)
    radiance = shade(prepared, seen, np.tile(points_of_disc, (pixels, 1)).astype(np.float32))
    return np.asarray(radiance.reshape(pixels, SAMPLES * SAMPLES, 3).mean(axis=1))


def true_depth(prepared: PreparedScene, camera: Camera, wide: Lens | None = None) -> tuple[Float32s, Float32s]:
    """Return depth (h, w) float32 of the undistorted view, 0 where there is none, and normals (h, w, 3) towards the camera.

    wide: a fisheye lens; then pixels are those of its captures, and depth is in metres along their rays instead of the axis.
    """
    y, x = np.divmod(np.arange(camera.width * camera.height), camera.width)
    rays = pixel_rays(camera, wide, x.astype(np.float64), y.astype(np.float64))
    distance, facet = prepared.cast(np.broadcast_to(camera.C.astype(np.float32), rays.shape), rays)
    # index -1, for nothing, is replaced by 0 and masked
    known = (facet >= 0) & (prepared.scene.kinds[np.maximum(facet, 0)] != WATER)
    normals = prepared.scene.normals[np.maximum(facet, 0)]
    is_back = np.einsum("ni,ni->n", normals, rays) > 0
    normals = np.where(is_back[:, None], -normals, normals)
    depth = np.where(known, distance, np.float32(0))
    if wide is None:
        # from metres along the ray to metres along the optical axis
        depth = (depth * (rays @ camera.R[2].astype(np.float32))).astype(np.float32)
    return depth.reshape(camera.height, camera.width), normals.reshape(camera.height, camera.width, 3)


def pinholes_of(camera: Camera, lens: Lens, name: str) -> list[Camera]:
    """Return the pinhole views that together cover a wide lens."""
    assert lens.K is not None
    found = []
    views = views_of_lens(lens.K.tolist(), lens.distortion.tolist(), lens.width, lens.height, lens.model)
    for turn, (left, right, up, down) in views:
        f = lens.K[0, 0]
        # left, right, up and down are tangents of the view's edges
        K = np.array([[f, 0.0, -f * left - 0.5], [0.0, f, -f * up - 0.5], [0.0, 0.0, 1.0]])
        size = (round(f * (right - left)), round(f * (down - up)))
        turned = replace(lens, camera=name, turn=np.array(turn))
        found.append(Camera(K, np.array(turn) @ camera.R, camera.C, *size, lens=turned))
    return found


def changed_pixels(scene: Scene, light: Light, camera: Camera, lens: Lens, tile: int = 8) -> Bools:
    """Return the mask (h, w) of pixels that facets of `scene` or their shadows on the ground may change, in whole tiles."""
    rows = -(-camera.height // tile)  # rounded up
    cols = -(-camera.width // tile)
    mark = np.zeros((rows + 1, cols + 1), np.int32)
    facets = scene.vertices.astype(np.float64).reshape(-1, 3, 3)
    # a facet's shadow is not only its image on the ground: everything between them may be shaded
    swept = [np.concatenate([facets, shadow], axis=1) for shadow in _shadows(facets, light)]
    for group in [facets, *swept]:
        # 1. Project the corners of each facet.
        if lens.model == "fisheye":
            rays = (group.reshape(-1, 3) - camera.C) @ camera.R.T
            pixels = lens_pixels(lens, rays)
            ahead = np.linalg.norm(rays, axis=1)
        else:
            pinhole, ahead = project(camera, group.reshape(-1, 3))
            pixels = distort(lens, pinhole)
        at = pixels.reshape(len(group), -1, 2) / tile
        is_ahead = (ahead.reshape(len(group), -1) > 0.5).all(axis=1)
        is_near = (np.abs(at) < 1e4).all(axis=(1, 2))
        at = at[is_ahead & is_near]

        # 2. Mark the tiles of their bounding rectangles, with a margin for lens distortion between corners.
        low = np.clip(np.floor(at.min(axis=1) - 0.3), 0, (cols, rows)).astype(np.intp)
        high = np.clip(np.floor(at.max(axis=1) + 0.3) + 1, 0, (cols, rows)).astype(np.intp)
        # +1 and -1 at the corners of each rectangle: their cumulative sum counts the rectangles that cover a tile
        for y, x, sign in ((low, low, 1), (low, high, -1), (high, low, -1), (high, high, 1)):
            np.add.at(mark, (y[:, 1], x[:, 0]), sign)
    covered = mark.cumsum(axis=0).cumsum(axis=1)[:rows, :cols] > 0
    return np.repeat(np.repeat(covered, tile, axis=0), tile, axis=1)[: camera.height, : camera.width]


def _shadows(facets: Float64s, light: Light) -> list[Float64s]:
    """Return the shadows of facets (t, 3, 3) on the ground, for each light; for a lamp only near it, where they are visible."""
    found = []
    if max(light.sun) > 0:
        # 10 km away from the sun: beyond the ground, wherever it is
        found.append(_on_ground(facets, facets - 1e4 * np.asarray(light.sun_direction)))
    for lamp in light.lamps:
        away = facets - np.asarray(lamp.position)
        near = np.linalg.norm(away, axis=2).max(axis=1) < 9.0
        found.append(np.where(near[:, None, None], _on_ground(facets, facets + away), facets))
    return found


def _on_ground(start: Float64s, end: Float64s) -> Float64s:
    """Return the points where the segments from `start` down to `end` meet z = 0, clamped to the segments."""
    with np.errstate(divide="ignore", invalid="ignore"):  # level segments never meet it
        share = np.nan_to_num(start[..., 2] / (start[..., 2] - end[..., 2]), nan=1.0)
        share = np.clip(share, 0, 1)
    return np.asarray(start + share[..., None] * (end - start), np.float64)


def undistorted_colours(camera: DemoCamera, pinhole: Camera | None = None) -> Uint8s:
    """Return colours (h, w, 3) of the undistorted view or another pinhole: the median over captures at the nearest pixel."""
    view = pinhole or camera.camera
    y, x = np.divmod(np.arange(view.width * view.height), view.width)
    pixels = np.column_stack([x, y]).astype(np.float64)
    if view.lens is None:
        at = distort(camera.lens, pixels)
    else:
        assert view.lens.turn is not None
        rays = np.column_stack([pixels, np.ones(len(x))]) @ np.linalg.inv(view.K).T
        at = np.nan_to_num(lens_pixels(camera.lens, rays @ view.lens.turn))
    at = np.rint(at).astype(np.intp)
    u = np.clip(at[:, 0], 0, camera.lens.width - 1)
    v = np.clip(at[:, 1], 0, camera.lens.height - 1)
    middle = np.median(np.stack([image[v, u] for image in camera.captures]), axis=0).astype(np.uint8)
    return np.asarray(middle.reshape(view.height, view.width, 3), np.uint8)
