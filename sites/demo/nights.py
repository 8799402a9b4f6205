"""The demo yard photographed on several nights, with other light, people and vehicles each time, and the events of the script.

Rays are traced once for each camera and state of the yard; their hits are shaded again for the light of every night.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime

import cv2
import numpy as np

from wbflow_stages.types import Camera, Cloud, Float32s, Float64s, Lens, Uint8s

from .depot import containers
from .parts.movers import PAINTS, movers, van
from .parts.structures import Box, container
from .render import textures as paint
from .render.cameras import MOUNTS, Viewpoint, camera_at, choose_mounts
from .render.paint import Rng
from .render.photograph import (
    DemoCamera,
    Frame,
    Shots,
    captures,
    frames_of,
    shade_pixels,
    trace_pixels,
    true_depth,
    undistorted_colours,
)
from .render.reference import TrueView, reference_cloud
from .render.renderer import Hits, PreparedScene, build_atlas, ray_scene, tensor
from .render.scene import STATIC, Scene, SceneBuilder, joined
from .render.sensor import burn_clock, clock_mask, develop, jpeg, sensor_of
from .script import CONDITIONS, CameraEvent, Conditions, Stay, event_of, frame_time, stays, turned_axes, weather_of
from .yard import static_yard, yard_texel_m

RASTER_M = 0.01
"""Side of the cells in which a thing's volume is measured, metres."""

PEOPLE = 6
"""Number of people that move in each frame."""

VEHICLES = 2
"""Number of vehicles that move in each frame."""


@dataclass(frozen=True)
class Extent:
    """Size of a thing, measured along its own axes."""

    size: tuple[float, float, float]
    """Length, width and height, metres."""
    volume_m3: float
    """Volume between the ground and its surface as seen from above."""


class Things:
    """Builds scenes with the things of a night; all these scenes share their textures."""

    def __init__(self, rng: Rng, texel_m: float) -> None:
        self._all = SceneBuilder()
        self._all.kind = STATIC
        self._parts = {name: self._all.with_same_textures() for name in ("container", "vehicle", "stack", "crate")}
        add = self._all.add_texture
        container(self._parts["container"], rng, texel_m, Box(0.0, 0.0, 0, 0.0, 6.06, (0.44, 0.20, 0.04), "WESER"))
        blue = add(paint.painted_steel(rng, 2.5, 2.5, texel_m, PAINTS[2]))
        board = add(paint.sign_board(rng, 3.0, 1.5, texel_m, ("ELEKTRO", "KRUSE"), (0.50, 0.48, 0.42), (0.3, 0.05, 0.04)))
        dark = add(paint.cloth(rng, texel_m, (0.035, 0.035, 0.04)))
        glass = add(paint.cloth(rng, texel_m, (0.05, 0.07, 0.08)))
        van(self._parts["vehicle"], (0.0, 0.0, 0.0), 0.0, (blue, board, dark, glass))
        for level, tone in enumerate(((0.36, 0.25, 0.14), (0.42, 0.33, 0.2), (0.30, 0.22, 0.15))):
            wood = add(paint.planks(rng, 5.0, 1.5, texel_m, tone))
            self._parts["stack"].box((0.0, 0.0, 0.65 * level), (2.4, 1.6, 0.65), wood)
        words = ("PUMPE 3", "OBEN  450 KG")
        sides = add(paint.sign_board(rng, 4.0, 1.3, texel_m, words, (0.38, 0.28, 0.16), (0.05, 0.04, 0.04)))
        lid = add(paint.planks(rng, 5.0, 1.5, texel_m))
        self._parts["crate"].box((0.0, 0.0, 0.0), (1.6, 1.2, 1.3), lid, sides=sides)

    def scene(self, places: Mapping[str, Stay]) -> Scene:
        """Return the things of a night as a scene; `places` must contain at least one."""
        build = self._all.with_same_textures()
        for name, stay in places.items():
            build.stamp(self._parts[name], (*stay.at, 0.0), yaw=stay.yaw)
        return build.build()

    def extent(self, name: str) -> Extent:
        """Return the size of a thing, and its volume from vertical rays, one per cell of a grid of `RASTER_M` metres."""
        corners = self._parts[name].build().vertices
        low = corners.min(axis=0)
        high = corners.max(axis=0)
        columns = np.arange(low[0] + RASTER_M / 2, high[0], RASTER_M)
        rows = np.arange(low[1] + RASTER_M / 2, high[1], RASTER_M)
        # rays from a metre above its top, straight down
        x, y = np.meshgrid(columns, rows)
        origins = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, high[2] + 1)])
        down = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
        rays = tensor(np.hstack([origins, down]).astype(np.float32))
        distance = ray_scene(corners).cast_rays(rays)["t_hit"].numpy()
        height = np.where(np.isfinite(distance), high[2] + 1 - distance, 0).astype(np.float64)
        size = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2]))
        return Extent(size, float(height.sum() * RASTER_M**2))


@dataclass(frozen=True)
class CameraNights:
    """A camera and all its nights."""

    camera: DemoCamera
    """The camera as described in the site file, with the captures of the first night."""
    view: TrueView
    """Its true view on the first night."""
    frames: tuple[tuple[tuple[datetime, bytes], ...], ...]
    """For each night, its captures: the time that the file is named after, and the JPEG data."""
    depths: dict[int, Float32s]
    """True depth, (h, w) float32, by the first night on which it is valid; the first one is `camera.depth`."""


@dataclass(frozen=True)
class NightsSite:
    """The yard photographed on several nights."""

    cameras: tuple[CameraNights, ...]
    reference: Cloud
    """Reference cloud of the first night (see `DemoSite`)."""
    voxel_m: float
    extents: dict[str, Extent]
    """Size of each thing of the script."""


@dataclass(frozen=True)
class _NightScene:
    """The yard on one night, in its light."""

    number: int
    epoch: int
    """The first night since which the same things have been at the same places."""
    conditions: Conditions
    still: PreparedScene
    frames: tuple[Frame, ...]


def yard_nights(nights: int, shots: Shots) -> NightsSite:
    """Render the yard on several nights: `shots` sets the captures of each night, the module `script` its light and events.

    Raises ValueError for impossible shots.
    """
    shots.check(len(MOUNTS))
    if nights < 1:
        raise ValueError(f"at least one night can be rendered, not {nights}")
    things = Things(shots.random(4), yard_texel_m(shots))
    scenes = list(_scenes(things, nights, shots))
    with ThreadPoolExecutor(shots.threads) as pool:
        done = list(pool.map(lambda mount: _camera_nights(scenes, shots, mount), choose_mounts(shots.cameras)))
    extents: dict[str, Extent] = {}
    for night in range(1, nights + 1):
        for name in stays(night):
            if name not in extents:
                extents[name] = things.extent(name)
    voxel_m = shots.voxel_m(51.2)
    reference = reference_cloud([each.view for each in done], voxel_m)
    return NightsSite(tuple(done), reference, voxel_m, extents)


def traffic_scenes(nights: int, shots: Shots) -> list[Scene]:
    """Return the people and vehicles of each frame of the first night, then of the second, and so on."""
    return movers(shots.random(2), max(yard_texel_m(shots), 0.02), nights * shots.captures, people=PEOPLE, vehicles=VEHICLES)


def _scenes(things: Things, nights: int, shots: Shots) -> Iterator[_NightScene]:
    """Yield the yard on each night, without traffic and at each frame; all share textures and sky visibility."""
    yard = static_yard(shots.random(1), yard_texel_m(shots))
    traffic = traffic_scenes(nights, shots)
    # one atlas for all nights, which share their textures
    atlas = build_atlas(yard.textures + things.scene(stays(1)).textures + traffic[0].textures)
    sky = PreparedScene(yard, CONDITIONS["noon"].light, atlas).sky
    places: dict[str, Stay] = {}
    epoch = 1
    for night in range(1, nights + 1):
        if stays(night) != places:
            places = stays(night)
            epoch = night
        conditions = CONDITIONS[weather_of(night)]
        empty = PreparedScene(joined(yard, things.scene(places)), conditions.light, atlas, sky)
        tonight = traffic[(night - 1) * shots.captures : night * shots.captures]
        yield _NightScene(night, epoch, conditions, empty, frames_of(empty, tonight))


def _camera_nights(nights: Sequence[_NightScene], shots: Shots, viewpoint: Viewpoint) -> CameraNights:
    """Return all nights of one camera with its ground truth."""
    name = viewpoint.name
    camera, lens = camera_at(viewpoint, shots.size)
    depth, normals = true_depth(nights[0].still, camera)
    depths = {1: depth}
    first: tuple[Uint8s, ...] = ()
    done: list[tuple[tuple[datetime, bytes], ...]] = []
    seen: dict[int, Hits] = {}
    for night in nights:
        # 1. Truth and hits of the camera's rays, once for each state of the yard; only the last state's hits are kept.
        if night.epoch not in depths:
            depths[night.epoch], _ = true_depth(night.still, camera)
        if night.epoch not in seen:
            seen = {night.epoch: trace_pixels(night.still, camera, lens, np.arange(camera.width * camera.height))}

        # 2. The captures of the night; a frozen camera delivers its last picture of the night before, again and again.
        event = event_of(night.number, name)
        turn = turned_axes(event, float(camera.K[0, 0]))
        times = [frame_time(night.number, k, sum(name.encode()) % 11) for k in range(shots.captures)]
        if event.what == "frozen" and done:
            files = [done[-1][-1][1]] * len(times)
        else:
            turned_camera = replace(camera, R=turn @ camera.R)
            images = _images(night, shots, event, turned_camera, lens, seen[night.epoch])
            pictures = tuple(burn_clock(image, name, time) for image, time in zip(images, times, strict=True))
            first = first or pictures
            files = [jpeg(picture) for picture in pictures]
        done.append(tuple(zip(times, files, strict=True)))
    taken = tuple(time for time, _ in done[0])
    demo = DemoCamera(name, first, taken, clock_mask(shots.size), depth, camera, lens)
    view = TrueView(camera, depth, normals, undistorted_colours(demo))
    return CameraNights(demo, view, tuple(done), depths)


def _images(night: _NightScene, shots: Shots, event: CameraEvent, camera: Camera, lens: Lens, seen: Hits) -> Iterable[Uint8s]:
    """Return the frames of a camera with its pose of a night; `seen`: hits of its rays in its nominal pose."""
    rngs = [np.random.default_rng([*_seed(shots, event.camera), night.number, k]) for k in range(shots.captures)]
    # a camera whose pictures come from another site
    if event.what == "foreign":
        return containers(replace(shots, cameras=1, threads=1)).cameras[0].captures
    if event.what == "covered":
        folds = np.random.default_rng([shots.seed, 5, night.number]).uniform(0.035, 0.14, (4, 6, 1))
        return [_tarpaulin(folds, shots.size, rng) for rng in rngs]
    # a turned camera sees along other rays
    if event.what != "none":
        seen = trace_pixels(night.still, camera, lens, np.arange(camera.width * camera.height))
    sensor = sensor_of(np.random.default_rng(_seed(shots, event.camera)), night.conditions.sensor)
    if night.conditions.rain:  # under dark clouds, a camera raises its gain
        sensor = replace(sensor, gain=1.4 * sensor.gain, full_well=sensor.full_well / 4)
    still = shade_pixels(night.still, seen).reshape(camera.height, camera.width, 3)
    return captures(still, night.frames, rngs, camera, lens, sensor, night.conditions.rain)


def _tarpaulin(folds: Float64s, size: tuple[int, int], rng: Rng) -> Uint8s:
    """Return a frame that shows a tarpaulin over the lens, without detail; its `folds`, (4, 6, 1) grey tones, vary a little."""
    tinted = (folds + rng.normal(0, 0.004, folds.shape)) * np.array([0.8, 0.95, 1.0])
    radiance = np.asarray(cv2.resize(tinted.astype(np.float32), size, interpolation=cv2.INTER_CUBIC))
    return develop(radiance, sensor_of(rng, "day"), 1.0, rng)


def _seed(shots: Shots, camera: str) -> list[int]:
    """Return the seed of a camera's sensor and noise, the same as in `photograph`."""
    return [shots.seed, 3, sum(camera.encode())]
