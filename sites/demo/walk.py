"""A walk through the demo yard: recordings of a lamp that is carried through it at night and by day, with the truth.

The still yard is rendered once for each camera.  In each frame the lamp is drawn with its glare, its light on what is around it
(without shadows), its reflection on wet ground, and the person who carries it; what stands in front of them hides them.  There is
more that shines or moves: fixed lamps of which one flickers, a vehicle with headlights, and somebody in a bright vest.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal, NamedTuple

import av
import cv2
import numpy as np

from wbflow_stages.core.lenses import lens_pixels
from wbflow_stages.types import Camera, Float32s, Float64s, Lens, Uint8s

from .render.cameras import Viewpoint, camera_at
from .render.light import light_of
from .render.photograph import SAMPLES, Shots, shade_pixels, trace_pixels
from .render.renderer import PreparedScene, build_atlas
from .render.sensor import develop, sensor_of
from .yard import LAMPS, static_yard

WalkLight = Literal["night", "day"]
WALKS: tuple[WalkLight, ...] = ("night", "day")
"""The recordings of each camera."""
SIZE = (640, 360)
"""Width and height of recordings, pixels."""
FPS = 5
"""Frames of a second."""
SECONDS = 40
"""Length of a walk."""
MOST_CLOCK_S = 0.5
"""Clocks of cameras differ from that of the walk by no more than this."""

WAY = (
    (18.0, 3.5), (33.0, 4.5), (26.4, 9.0), (25.4, 16.0), (26.0, 24.0), (31.0, 26.6), (20.0, 26.4), (9.0, 26.0),
    (13.0, 23.0), (14.2, 14.0), (19.0, 12.6), (25.0, 13.5), (28.5, 11.0),
)  # fmt: skip
"""Points of the way, metres east and north: ways on which nothing stands."""
_HEIGHT_M = 2.4
_LIFT_M = 0.8
_LIFT_S = 7.0
"""Mean height of the lamp, and how far and how often it is lifted and lowered; at one height, all points lie in a plane."""
_LAMP_RADIUS_M = 0.05
_BEHIND_M = 0.45
"""Distance of the person behind the lamp."""
_TALL_M = 1.75
_BROAD_M = 0.45
"""Height and breadth of a person."""
_SHARPEST_PX = 0.6
"""Standard deviation of the image of a point, pixels."""
_PEAK = 40.0
"""Radiance of the lamp in the middle of its image; 1 is white in daylight."""
_GLARE = ((0.012, 5.0), (0.002, 18.0))
"""Light scattered in the lens: share of the peak, and standard deviation in pixels."""
_POWER = 3.0
"""Light of the lamp at one metre, as those of the yard."""
_WET = 0.06
"""Share of the mirrored light that wet asphalt, which is rough, sends towards a camera at grazing angles."""
_STREAK_PX = (1.8, 8.0)
"""Breadth and length of reflections, standard deviations in pixels."""
_FLICKERING = 1
"""Number of the lamp of the yard that flickers."""
_DRIVE_S = (14.0, 20.0)
_DRIVE = ((10.0, 3.2), (38.0, 3.2))
"""When a vehicle passes with its headlights on, and from where to where, metres."""
_DARK_TONE = {True: 0.05, False: 0.18}
"""Radiance of the person who carries the lamp at night (True) and by day."""
_VEST_TONE = 0.75
"""Radiance of a bright vest in daylight."""
_VEST_S = 30.0
"""Time in which the vest goes to and fro."""
_VEST_WAY = ((8.0, 26.0), (32.0, 26.5))
"""Way of somebody in a bright vest, metres."""


@dataclass(frozen=True)
class WalkRecording:
    """A recording of one camera."""

    camera: str
    light: WalkLight
    video: bytes
    """MP4."""
    clock_s: float
    """What is added to its times to get those of the walk."""


def lamp_places(times: Float64s, light: WalkLight) -> Float64s:
    """Return (n, 3) places of the lamp, metres, at (n,) seconds of a walk; by day the way is walked in the other direction."""
    at = _along(np.array(WAY), times / SECONDS, is_back=light == "day")
    # a step is .55 s long
    lift = _LIFT_M * np.sin(2 * np.pi * times / _LIFT_S) + 0.04 * np.sin(2 * np.pi * times / 0.55)
    return np.column_stack([at, _HEIGHT_M + lift])


def _along(corners: Float64s, share: Float64s, is_back: bool = False) -> Float64s:
    """Return (n, 2) points at shares (n,) of a way's length, with round corners."""
    if is_back:
        share = 1 - share
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    # corners are rounded by the mean over some points along the way
    near = np.linspace(-0.02, 0.02, 9)
    at = np.clip(share[:, None] + near, 0, 1) * lengths[-1]
    x = np.interp(at, lengths, corners[:, 0]).mean(axis=1)
    y = np.interp(at, lengths, corners[:, 1]).mean(axis=1)
    return np.column_stack([x, y])


def walk_recordings(shots: Shots, texel_m: float, viewpoints: Sequence[Viewpoint]) -> Iterator[WalkRecording]:
    """Yield the recordings of all cameras, first of the night, then of the day; `texel_m`: of the yard's textures."""
    yard = static_yard(shots.random(1), texel_m)
    atlas = build_atlas(yard.textures)
    night = light_of("night", LAMPS)
    some_lamps = tuple(lamp for k, lamp in enumerate(night.lamps) if k != _FLICKERING)
    scene = PreparedScene(yard, night, atlas)
    without = PreparedScene(yard, replace(night, lamps=some_lamps), atlas, scene.sky)
    day = PreparedScene(yard, light_of("day", LAMPS), atlas, scene.sky)
    scenes: dict[WalkLight, _Lit] = {"night": _Lit(scene, without), "day": _Lit(day, day)}
    with ThreadPoolExecutor(shots.threads) as pool:
        for light in WALKS:
            yield from pool.map(lambda each, light=light: _recording(scenes[light], shots, each, light), viewpoints)


class _Lit(NamedTuple):
    """The yard with all its lamps, and without the one that flickers."""

    scene: PreparedScene
    without: PreparedScene


class _View(NamedTuple):
    """What one camera sees of the still yard."""

    camera: Camera
    lens: Lens
    radiance: Float32s
    """(h, w, 3) without the lamp that flickers."""
    flicker: Float32s
    """(h, w, 3) the light of that lamp."""
    range_m: Float32s
    """(h, w) distance along each pixel's ray, inf for sky."""
    points: Float32s
    facing: Float32s
    albedo: Float32s
    """(h, w, 3) each: point that a pixel sees, its normal towards the camera, and its reflectance; 0 for sky."""


def _recording(lit: _Lit, shots: Shots, viewpoint: Viewpoint, light: WalkLight) -> WalkRecording:
    """Return the recording of a camera."""
    view = _still_view(lit, viewpoint)
    number = sum(viewpoint.name.encode())
    rng = np.random.default_rng([shots.seed, 6, number, WALKS.index(light)])
    sensor = sensor_of(np.random.default_rng([shots.seed, 3, number]), light)
    clock_s = round(float(rng.uniform(-MOST_CLOCK_S, MOST_CLOCK_S)), 3)
    times = np.arange(FPS * SECONDS) / FPS + clock_s
    lamp = lamp_places(times, light)
    behind = lamp_places(times - 0.2, light)
    images = []
    for time, place, earlier in zip(times.tolist(), lamp, behind, strict=True):
        radiance = _frame(view, lit.scene, time, place, earlier, light == "night")
        images.append(develop(radiance, sensor, 1.0, rng))
    return WalkRecording(viewpoint.name, light, _mp4(images), clock_s)


def _still_view(lit: _Lit, viewpoint: Viewpoint) -> _View:
    """Return what a camera sees of the still yard."""
    camera, lens = camera_at(viewpoint, SIZE)
    width, height = SIZE
    shape = (height, width, 3)
    hits = trace_pixels(lit.scene, camera, lens, np.arange(width * height))
    without = shade_pixels(lit.without, hits).reshape(shape)
    flicker = np.zeros_like(without)
    if lit.without is not lit.scene:
        flicker = shade_pixels(lit.scene, hits).reshape(shape) - without

    # of the samples of a pixel, the first; arrays of surfaces hold only the rays that hit one
    first = np.arange(width * height) * SAMPLES * SAMPLES
    hit = hits.facet[first] >= 0
    rows = (np.cumsum(hits.facet >= 0) - 1)[first[hit]]
    surfaces = []
    for values in (hits.points, hits.facing, hits.albedo):
        surface = np.zeros((width * height, 3), np.float32)
        surface[hit] = values[rows]
        surfaces.append(surface.reshape(shape))
    points, facing, albedo = surfaces
    return _View(camera, lens, without, flicker, hits.distance[first].reshape(height, width), points, facing, albedo)


def _frame(view: _View, scene: PreparedScene, time: float, lamp: Float64s, behind: Float64s, is_night: bool) -> Float32s:
    """Return the radiance (h, w, 3) of a frame; `behind`: where the lamp was shortly before."""
    # 1. The still yard with its flickering lamp, and what the carried one lights.
    on = float(np.sin(9.0 * time) + np.sin(23.7 * time) > -0.6)
    radiance = view.radiance + np.float32(on) * view.flicker
    if is_night:
        _add_light(view, radiance, lamp)

    # 2. People: the one who carries the lamp, and by day another one in a bright vest.
    people = np.full(view.range_m.shape, np.inf, np.float32)
    heading = (lamp - behind)[:2] / max(float(np.linalg.norm((lamp - behind)[:2])), 1e-6)
    _add_person(view, radiance, people, lamp[:2] - _BEHIND_M * heading, _DARK_TONE[is_night])
    if not is_night:
        share = abs(2 * ((time / _VEST_S) % 1) - 1)
        _add_person(view, radiance, people, _along(np.array(_VEST_WAY), np.array([share]))[0], _VEST_TONE)

    # 3. Lights: the lamp and its mirror image, and headlights.
    _add_spot(view, scene, radiance, people, lamp)
    if is_night:
        _add_reflection(view, scene, radiance, lamp)
        share = (time - _DRIVE_S[0]) / (_DRIVE_S[1] - _DRIVE_S[0])
        if 0 <= share <= 1:
            front = _along(np.array(_DRIVE), np.array([share]))[0]
            for side in (-0.7, 0.7):
                _add_spot(view, scene, radiance, people, np.array([front[0], front[1] + side, 0.8]))
    return radiance


def _add_light(view: _View, radiance: Float32s, lamp: Float64s) -> None:
    """Add the light of the lamp on the surfaces around it."""
    # it changes slowly: every second pixel of every second row
    towards = lamp.astype(np.float32) - view.points[::2, ::2]
    square = np.einsum("hwk,hwk->hw", towards, towards)
    cosine = np.einsum("hwk,hwk->hw", towards, view.facing[::2, ::2]) / np.sqrt(square)
    strength = np.float32(_POWER) * np.maximum(cosine, 0) / (square + np.float32(0.3))
    radiance += cv2.resize(strength, SIZE, interpolation=cv2.INTER_LINEAR)[..., None] * view.albedo


def _add_person(view: _View, radiance: Float32s, people: Float32s, foot: Float64s, tone: float) -> None:
    """Draw a person, and write their distance into `people` (h, w); `foot`: metres east and north."""
    body = np.array([[foot[0], foot[1], _BROAD_M / 2], [foot[0], foot[1], _TALL_M - _BROAD_M / 2]])
    rays = (body - view.camera.C) @ view.camera.R.T
    if rays[:, 2].min() < 1:
        return
    pixels = lens_pixels(view.lens, rays)
    # nan, where the lens does not see it, is not near either
    if not (np.abs(pixels) < 4 * SIZE[0]).all():
        return
    ends = np.round(pixels).astype(int)
    far = float(np.linalg.norm(rays.mean(axis=0)))
    breadth = max(round(float(view.camera.K[0, 0]) * _BROAD_M / far), 1)
    outline = np.zeros(view.range_m.shape, np.uint8)
    cv2.line(outline, ends[0].tolist(), ends[1].tolist(), 1, breadth, cv2.LINE_8)
    seen = (outline > 0) & (view.range_m > far)
    radiance[seen] = np.float32(tone) * np.array([0.9, 0.95, 1.0], np.float32)
    people[seen] = np.minimum(people[seen], np.float32(far))


def _add_spot(view: _View, scene: PreparedScene, radiance: Float32s, people: Float32s, place: Float64s) -> None:
    """Draw a lamp with its glare, as far as neither things nor people hide it."""
    ray = view.camera.R @ (place - view.camera.C)
    if ray[2] < 1:
        return
    x, y = lens_pixels(view.lens, ray[None])[0].tolist()
    if not (0 <= x <= SIZE[0] - 1 and 0 <= y <= SIZE[1] - 1):
        return
    if people[round(y), round(x)] < np.linalg.norm(ray):
        return
    # a part of its disc may be hidden
    offsets = _LAMP_RADIUS_M * np.array([[0, 0], [-0.7, 0], [0.7, 0], [0, -0.7], [0, 0.7]])
    discs = place + offsets @ view.camera.R[:2]
    starts = np.broadcast_to(view.camera.C.astype(np.float32), discs.shape)
    visible = float(scene.reaches(starts, (discs - view.camera.C).astype(np.float32), far=1.0).mean())
    core = max(_SHARPEST_PX, 0.6 * float(view.camera.K[0, 0]) * _LAMP_RADIUS_M / float(ray[2]))
    for share, sigma in ((1.0, core), *_GLARE):
        _add_gaussian(radiance, (x, y), (sigma, sigma), visible * share * _PEAK)


def _add_reflection(view: _View, scene: PreparedScene, radiance: Float32s, lamp: Float64s) -> None:
    """Draw the mirror image of the lamp in wet ground: long, and where the ground is seen."""
    mirrored = lamp * (1.0, 1.0, -1.0)
    way = mirrored - view.camera.C
    ray = view.camera.R @ way
    if ray[2] < 1:
        return
    x, y = lens_pixels(view.lens, ray[None])[0].tolist()
    if not np.isfinite([x, y]).all():
        return
    # the ray reaches the ground on its way, at height 0, and nothing is before it
    to_ground = way * (view.camera.C[2] / (view.camera.C[2] + lamp[2]))
    start = view.camera.C.astype(np.float32)[None]
    if not scene.reaches(start, (0.98 * to_ground).astype(np.float32)[None], far=1.0)[0]:
        return
    # Schlick's approximation of Fresnel's equations, as for other wet surfaces
    cosine = -way[2] / np.linalg.norm(way)
    share = 0.02 + 0.98 * (1 - cosine) ** 5
    _add_gaussian(radiance, (x, y), _STREAK_PX, _WET * share * _PEAK)


def _add_gaussian(radiance: Float32s, at: tuple[float, float], sigma: tuple[float, float], peak: float) -> None:
    """Add white light around a pixel; `sigma`: standard deviations along x and y, pixels."""
    height, width = radiance.shape[:2]
    left, right = _reach(at[0], 4 * sigma[0], width)
    top, bottom = _reach(at[1], 4 * sigma[1], height)
    across = np.exp(-(((np.arange(left, right) - at[0]) / sigma[0]) ** 2) / 2)
    down = np.exp(-(((np.arange(top, bottom) - at[1]) / sigma[1]) ** 2) / 2)
    radiance[top:bottom, left:right] += (peak * np.outer(down, across)).astype(np.float32)[..., None]


def _reach(at: float, far: float, size: int) -> tuple[int, int]:
    """Return the first pixel within `far` of a place, and that after the last one."""
    first = int(np.clip(np.floor(at - far), 0, size))
    return first, int(np.clip(np.ceil(at + far) + 1, first, size))


def _mp4(images: Sequence[Uint8s]) -> bytes:
    """Return an H.264 video of images (h, w, 3) uint8 RGB."""
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(FPS), options={"crf": "30", "preset": "veryfast"})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        stream.thread_count = 1
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return file.getvalue()
