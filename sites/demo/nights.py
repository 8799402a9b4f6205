"""The demo yard photographed night after night: other light, other people and vehicles, and what the script says has happened.

What each ray meets is worked out once for each camera and state of the yard, and lit anew for every night.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime

import cv2
import numpy as np

from wbflow_stages.types import Camera, Cloud, Float32s, Float64s, Lens, Placement, Uint8s

from .atlas import build_atlas
from .cameras import MOUNTS, Viewpoint, camera_at, choose_mounts, viewpoint_of
from .depot import containers
from .encode import jpeg
from .layout import static_yard
from .movers import movers
from .prepared import PreparedScene, Seen
from .reference import reference_cloud
from .scene import Scene, joined
from .script import Hour, Stay, event_of, frame_time, hour_of, stays, turn_of, weather_of
from .sensor import burn_clock, clock_mask, develop, sensor_of
from .shooting import DemoCamera, light_up, look_at_pixels, render_pixels, touched, true_depth, upright
from .shots import Shots
from .things import Extent, Things
from .weather import rain_over

PEOPLE, VEHICLES = 6, 2
"""That move in each frame."""


@dataclass(frozen=True)
class NightOfCamera:
    """What a camera did in a night."""

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
    """Render the yard of several nights; `shots` says what is taken in each of them, `script` the light and what happens.

    Raises ValueError for impossible shots.
    """
    shots.check(len(MOUNTS))
    if nights < 1:
        raise ValueError(f"at least one night can be rendered, not {nights}")
    mounts = choose_mounts(shots.cameras)
    things = Things(shots.random(4), _texel_m(shots))
    shoot = _Shoot(tuple(_scenes(things, nights, shots)), shots)
    with ThreadPoolExecutor(shots.threads) as pool:
        done = list(pool.map(lambda mount: _camera_nights(shoot, viewpoint_of(mount)), mounts))
    rows = [each.camera for each in done]
    pinholes, depths, colors = [c.camera for c in rows], [c.depth for c in rows], [upright(c) for c in rows]
    voxel_m = shots.voxel_m(51.2)
    reference = reference_cloud(pinholes, depths, [each.normals for each in done], colors, voxel_m)
    names = dict.fromkeys(name for night in range(1, nights + 1) for name in stays(night))
    return NightsSite(tuple(done), reference, voxel_m, {name: things.extent(name) for name in names})


def moving(nights: int, shots: Shots) -> list[Scene]:
    """The people and vehicles of each frame, night after night."""
    return movers(shots.random(2), max(_texel_m(shots), 0.02), nights * shots.captures, people=PEOPLE, vehicles=VEHICLES)


def _texel_m(shots: Shots) -> float:
    return shots.texel_m(0.0098 * 1280, 0.0098, 0.1)


def _scenes(things: Things, nights: int, shots: Shots) -> Iterator[_NightScene]:
    """The yard of each night, empty and at each frame; all share textures and sky."""
    frames = shots.captures
    yard = static_yard(shots.random(1), _texel_m(shots), choose_mounts(len(MOUNTS)))
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
    """All nights of one camera, and its truth."""
    camera, lens = camera_at(viewpoint, shoot.shots.size)
    done: list[NightOfCamera] = []
    depths: dict[int, Float32s] = {}
    first: tuple[Uint8s, ...] = ()
    normals = np.zeros(0, np.float32)
    seen: Seen | None = None
    for night in shoot.nights:
        if night.epoch not in depths:
            depths[night.epoch], its_normals = true_depth(night.still, camera)
            normals = its_normals if night.number == 1 else normals
            seen = None
        event = event_of(night.number, viewpoint.name)
        turn = turn_of(event, float(camera.K[0, 0])) if event.what in ("turned", "nudged") else np.eye(3)
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
            seen = seen or look_at_pixels(night.still, camera, lens, np.arange(camera.width * camera.height))
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
    shoot: _Shoot, night: _NightScene, camera: Camera, lens: Lens, name: str, seen: Seen | None
) -> Iterator[Uint8s]:
    """The frames of a camera that sees the yard.

    Parameters
    ----------
    shoot, night : _Shoot, _NightScene
        What is asked for, and what stands there.
    camera, lens : Camera, Lens
        As they are in this night.
    name : str
        Of the camera.
    seen : Seen, optional
        What its rays meet in the empty yard, where that is known.
    """
    if seen is None:
        seen = look_at_pixels(night.still, camera, lens, np.arange(camera.width * camera.height))
    sensor = sensor_of(np.random.default_rng([shoot.shots.seed, 3, sum(name.encode())]), night.hour.sensor)
    if night.hour.rain:
        sensor = replace(sensor, gain=1.4 * sensor.gain, full_well=sensor.full_well / 4)
    still = light_up(night.still, seen).reshape(camera.height, camera.width, 3)
    for k, (prepared, moving) in enumerate(zip(night.busy, night.moving, strict=True)):
        rng = _rng(shoot, night, name, k)
        radiance = still.copy()
        pixels = np.flatnonzero(touched(moving, night.hour.light, camera, lens))
        radiance.reshape(-1, 3)[pixels] = render_pixels(prepared, camera, lens, pixels)
        if night.hour.rain:
            radiance = rain_over(radiance, night.hour.light, rng)
        yield develop(radiance, sensor, float(2 ** rng.uniform(-0.12, 0.12)), rng)


def _covered(shoot: _Shoot, night: _NightScene, name: str, frame: int) -> Uint8s:
    """A tarpaulin before the lens: light from one side, no detail; it flaps a little."""
    width, height = shoot.shots.size
    folds = np.random.default_rng([shoot.shots.seed, 5, night.number]).uniform(0.035, 0.14, (4, 6, 1))
    rng = _rng(shoot, night, name, frame)
    folds = (folds + rng.normal(0, 0.004, folds.shape)) * np.array([0.8, 0.95, 1.0])
    radiance = np.asarray(cv2.resize(folds.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC))
    return develop(radiance, sensor_of(rng, "day"), 1.0, rng)


def _rng(shoot: _Shoot, night: _NightScene, name: str, frame: int) -> np.random.Generator:
    return np.random.default_rng([shoot.shots.seed, 3, sum(name.encode()), night.number, frame])
