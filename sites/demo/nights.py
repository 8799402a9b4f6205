"""The demo yard photographed night after night: other light, other people and vehicles, and what the script says has happened.

What each ray meets is worked out once for each camera and state of the yard, and lit anew for every night.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime

import cv2
import numpy as np
import open3d as o3d

from wbflow_stages.types import Camera, Cloud, Float32s, Float64s, Lens, Placement, Uint8s

from .depot import containers
from .parts.movers import PAINTS, movers, van
from .parts.structures import Box, container
from .render.cameras import MOUNTS, Viewpoint, camera_at, choose_mounts
from .render.paint import Rng
from .render.photograph import (
    DemoCamera,
    Shots,
    captures,
    shade_pixels,
    trace_pixels,
    true_depth,
    undistorted_colours,
)
from .render.reference import reference_cloud
from .render.renderer import Hits, PreparedScene, build_atlas
from .render.scene import STATIC, Scene, SceneBuilder, joined
from .render.sensor import burn_clock, clock_mask, develop, jpeg, sensor_of
from .render.textures import cloth, painted_steel, planks, sign_board
from .script import Hour, Stay, event_of, frame_time, hour_of, stays, turned_axes, weather_of
from .yard import static_yard

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
        """Return the things of a night as a scene; `there`: at least one."""
        build = self._all.with_same_textures()
        for name, stay in there.items():
            build.stamp(self._parts[name], (*stay.at, 0.0), yaw=stay.yaw)
        return build.build()

    def extent(self, name: str) -> Extent:
        """Return the size of a thing, and its volume by rays from above, one for each cell of RASTER_M."""
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


PEOPLE, VEHICLES = 6, 2
"""That move in each frame."""


@dataclass(frozen=True)
class NightOfCamera:
    """The frames of a camera in a night."""

    frames: tuple[tuple[datetime, bytes], ...]
    """JPEG files, and the times that they are named after."""
    turn: Float64s
    """(3, 3) camera axes as the site file says to camera axes as they are."""


@dataclass(frozen=True)
class CameraNights:
    """A camera and all its nights."""

    camera: DemoCamera
    """As the site file says; its captures are those of the first night."""
    normals: Float32s
    """(h, w, 3), of its depth map."""
    nights: tuple[NightOfCamera, ...]
    depths: dict[int, Float32s]
    """(h, w) float32 by the first night from which it holds; the first is the camera's own."""


@dataclass(frozen=True)
class NightsSite:
    """A yard photographed for some nights."""

    cameras: tuple[CameraNights, ...]
    reference: Cloud
    """Of the first night: see `DemoSite`."""
    voxel_m: float
    extents: dict[str, Extent]
    """How large the things of the script are."""


@dataclass(frozen=True)
class _NightScene:
    """The yard in one night, in its light."""

    number: int
    epoch: int
    """The first night with the same things at the same places."""
    hour: Hour
    still: PreparedScene
    busy: tuple[PreparedScene, ...]
    moving: tuple[Scene, ...]


@dataclass(frozen=True)
class _Shoot:
    nights: tuple[_NightScene, ...]
    shots: Shots


def yard_nights(nights: int, shots: Shots) -> NightsSite:
    """Render the yard of several nights: `shots` says what is taken in each, `script` the light and what happens.

    Raises ValueError for impossible shots.
    """
    shots.check(len(MOUNTS))
    if nights < 1:
        raise ValueError(f"at least one night can be rendered, not {nights}")
    things = Things(shots.random(4), _texel_m(shots))
    shoot = _Shoot(tuple(_scenes(things, nights, shots)), shots)
    with ThreadPoolExecutor(shots.threads) as pool:
        done = list(pool.map(lambda mount: _camera_nights(shoot, mount), choose_mounts(shots.cameras)))
    rows = [each.camera for each in done]
    pinholes, depths, colors = [c.camera for c in rows], [c.depth for c in rows], [undistorted_colours(c) for c in rows]
    voxel_m = shots.voxel_m(51.2)
    reference = reference_cloud(pinholes, depths, [each.normals for each in done], colors, voxel_m)
    names = dict.fromkeys(name for night in range(1, nights + 1) for name in stays(night))
    return NightsSite(tuple(done), reference, voxel_m, {name: things.extent(name) for name in names})


def moving(nights: int, shots: Shots) -> list[Scene]:
    """Return the people and vehicles of each frame, night after night."""
    return movers(shots.random(2), max(_texel_m(shots), 0.02), nights * shots.captures, people=PEOPLE, vehicles=VEHICLES)


def _texel_m(shots: Shots) -> float:
    return shots.texel_m(0.0098 * 1280, 0.0098, 0.1)


def _scenes(things: Things, nights: int, shots: Shots) -> Iterator[_NightScene]:
    """Yield the yard of each night, empty and at each frame; all share textures and sky."""
    frames = shots.captures
    yard = static_yard(shots.random(1), _texel_m(shots))
    traffic = moving(nights, shots)
    whole = joined(joined(yard, things.scene(stays(1))), traffic[0])
    atlas = build_atlas(whole.textures)
    sky = PreparedScene(yard, hour_of("noon").light, atlas).sky
    there: dict[str, Stay] = {}
    epoch = 1
    for night in range(1, nights + 1):
        if stays(night) != there:
            there, epoch = stays(night), night
        hour = hour_of(weather_of(night))
        empty = joined(yard, things.scene(there))
        tonight = tuple(traffic[(night - 1) * frames : night * frames])
        busy = tuple(PreparedScene(joined(empty, each), hour.light, atlas, sky) for each in tonight)
        yield _NightScene(night, epoch, hour, PreparedScene(empty, hour.light, atlas, sky), busy, tonight)


def _camera_nights(shoot: _Shoot, viewpoint: Viewpoint) -> CameraNights:
    """Return all nights of one camera, and its truth."""
    camera, lens = camera_at(viewpoint, shoot.shots.size)
    done: list[NightOfCamera] = []
    depths: dict[int, Float32s] = {}
    first: tuple[Uint8s, ...] = ()
    normals = np.zeros(0, np.float32)
    seen: Hits | None = None
    for night in shoot.nights:
        if night.epoch not in depths:
            depths[night.epoch], its_normals = true_depth(night.still, camera)
            normals = its_normals if night.number == 1 else normals
            seen = None
        event = event_of(night.number, viewpoint.name)
        turn = turned_axes(event, float(camera.K[0, 0])) if event.what in ("turned", "nudged") else np.eye(3)
        times = [frame_time(night.number, k, sum(viewpoint.name.encode()) % 11) for k in range(len(night.busy))]
        if event.what == "frozen" and done:
            stuck = done[-1].frames[-1][1]
            done.append(NightOfCamera(tuple((time, stuck) for time in times), turn))
            continue
        if event.what in ("turned", "nudged"):
            images = list(_photographed(shoot, night, replace(camera, R=turn @ camera.R), lens, viewpoint.name, None))
        elif event.what == "foreign":
            images = list(containers(replace(shoot.shots, cameras=1, threads=1)).cameras[0].captures)
        elif event.what == "covered":
            images = [_covered(shoot, night, viewpoint.name, k) for k in range(len(times))]
        else:
            seen = seen or trace_pixels(night.still, camera, lens, np.arange(camera.width * camera.height))
            images = list(_photographed(shoot, night, camera, lens, viewpoint.name, seen))
        clocks = [f"{viewpoint.name.upper()}  {time:%Y-%m-%d  %H:%M:%S}" for time in times]
        pictures = [burn_clock(image, clock) for image, clock in zip(images, clocks, strict=True)]
        first = first or tuple(pictures)
        done.append(NightOfCamera(tuple((time, jpeg(p)) for time, p in zip(times, pictures, strict=True)), turn))
    placement = Placement(R=camera.R, C=camera.C)
    taken = tuple(time for time, _ in done[0].frames)
    demo = DemoCamera(viewpoint.name, first, taken, clock_mask(shoot.shots.size), depths[1], camera, lens, placement)
    return CameraNights(demo, normals, tuple(done), depths)


def _photographed(
    shoot: _Shoot, night: _NightScene, camera: Camera, lens: Lens, name: str, seen: Hits | None
) -> Iterator[Uint8s]:
    """Return the frames of a camera that sees the yard; `seen`: what its rays hit in the empty yard, where known."""
    if seen is None:
        seen = trace_pixels(night.still, camera, lens, np.arange(camera.width * camera.height))
    sensor = sensor_of(np.random.default_rng([shoot.shots.seed, 3, sum(name.encode())]), night.hour.sensor)
    if night.hour.rain:
        sensor = replace(sensor, gain=1.4 * sensor.gain, full_well=sensor.full_well / 4)
    still = shade_pixels(night.still, seen).reshape(camera.height, camera.width, 3)
    rngs = [_rng(shoot, night, name, k) for k in range(len(night.busy))]
    return captures(still, list(zip(night.busy, night.moving, rngs, strict=True)), camera, lens, sensor, night.hour.rain)


def _covered(shoot: _Shoot, night: _NightScene, name: str, frame: int) -> Uint8s:
    """Return a frame of a tarpaulin before the lens: light from one side, no detail; it flaps a little."""
    width, height = shoot.shots.size
    folds = np.random.default_rng([shoot.shots.seed, 5, night.number]).uniform(0.035, 0.14, (4, 6, 1))
    rng = _rng(shoot, night, name, frame)
    folds = (folds + rng.normal(0, 0.004, folds.shape)) * np.array([0.8, 0.95, 1.0])
    radiance = np.asarray(cv2.resize(folds.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC))
    return develop(radiance, sensor_of(rng, "day"), 1.0, rng)


def _rng(shoot: _Shoot, night: _NightScene, name: str, frame: int) -> np.random.Generator:
    return np.random.default_rng([shoot.shots.seed, 3, sum(name.encode()), night.number, frame])
