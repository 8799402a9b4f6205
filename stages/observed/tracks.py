"""What each camera saw, as rays in order of time, and where it would have seen a thing between two pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..core.lenses import lens_pixels, lens_rays
from ..types import Bools, Float64s, Int32s, Int64s, Lens, Observations

MOST_GAP = 3.5
"""Tracks are interpolated over gaps of at most this many frame intervals."""
JUMP = 6.0
"""A step is a jump if it is this many times as fast as the steps around it: the track goes on with another thing."""
LEAST_JUMP_PX = 10.0
"""Steps of fewer pixels are no jumps: a thing that stands still moves by the noise alone."""
_NEIGHBOURS = 15
"""Number of steps over which the usual speed is taken."""
_SLOW = 0.25
"""Quantile of the speeds that is usual: of three observations one may be wrong, which spoils two steps of three."""
_OUTWARD = 2
"""Observations farther out, on each side, between which the velocity is taken."""
_ANGLE = 1e-5
"""Step of the differences that give pixels per radian."""


@dataclass(frozen=True)
class Track:
    """The observations of one camera, by thing and time.  Things that don't move have the time 0."""

    row: Int64s
    """(n,) rows of the `Observations`."""
    thing: Int32s
    """(n,)."""
    time: Float64s
    """(n,) by the camera's own clock."""
    ray: Float64s
    """(n, 3) unit rays in camera axes."""
    pixels_of: Float64s
    """(n, 2, 3) derivatives of the pixel by the unit ray, at right angles to it."""
    arm: Float64s
    """(n, 2) pixels from the principal point: how the pixel moves as the focal length grows."""
    sigma: Float64s
    """(n,) pixels, 1 where none is stated."""
    follows: Bools
    """(n,) bool: the track runs on smoothly from the row before to this one."""
    interval: float
    """Median time between two observations of a thing; 0 if nothing moves."""

    def __len__(self) -> int:
        return len(self.row)


@dataclass(frozen=True)
class Moments:
    """Things at times of the common clock, in order of thing and time."""

    thing: Int32s
    """(m,)."""
    time: Float64s
    """(m,) the common clock; 0 for things that don't move."""
    is_still: Bools
    """(m,) the thing does not move."""

    def __len__(self) -> int:
        return len(self.thing)

    def take(self, rows: Int64s | Bools) -> Moments:
        """Some of them."""
        return Moments(self.thing[rows], self.time[rows], self.is_still[rows])


@dataclass(frozen=True)
class Seen:
    """Where one camera saw the things at given moments."""

    valid: Bools
    """(m,) it saw the thing then; elsewhere the other arrays hold nothing of use."""
    ray: Float64s
    """(m, 3) unit rays in camera axes."""
    velocity: Float64s
    """(m, 3) change of the ray with time."""
    nearest: Int64s
    """(m,) index of the nearest observation in the `Track`."""
    sigma: Float64s
    """(m,) standard deviation of the interpolated pixel: stated one of the nearest observation, less where errors of several
    average out.  Without this, clocks would be drawn to halves of frames, where they do so most."""


def make_tracks(observations: Observations, lenses: Mapping[str, Lens]) -> dict[str, Track]:
    """The track of each camera that has a lens with intrinsics and observations that it can have seen."""
    tracks = {}
    for k, name in enumerate(observations.cameras):
        lens = lenses.get(name)
        if lens is None or lens.K is None:
            continue
        rows = np.flatnonzero(observations.camera == k)
        track = _track(observations, rows, lens)
        if len(track):
            tracks[name] = track
    return tracks


def _track(observations: Observations, rows: Int64s, lens: Lens) -> Track:
    # 1. Rays; pixels to which the lens maps none are left out.
    xy = observations.xy[rows]
    ray = np.asarray(lens_rays(lens, xy)).reshape(-1, 3)
    is_seen = np.isfinite(ray).all(axis=1)
    rows = rows[is_seen]
    ray = ray[is_seen]
    time = np.nan_to_num(observations.time[rows], nan=0.0)

    # 2. In order of thing and time.  Of several places of a thing at one time, the first stated one is kept.
    order = np.lexsort((rows, time, observations.thing[rows]))
    thing = observations.thing[rows][order]
    time = time[order]
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (np.diff(thing) != 0) | (np.diff(time) != 0)
    order = order[is_first]
    thing = thing[is_first]
    time = time[is_first]
    rows = rows[order]
    ray = ray[order]

    # 3. Which observations follow each other.
    pixels_of = _pixel_derivatives(lens, ray)
    steps = np.diff(time)
    same = np.diff(thing) == 0
    interval = 0.0
    if (same & (steps > 0)).any():
        interval = float(np.median(steps[same & (steps > 0)]))
    follows = np.zeros(len(rows), dtype=bool)
    follows[1:] = same & (steps <= MOST_GAP * interval) & ~_jumps(ray, pixels_of, steps, same)
    assert lens.K is not None
    sigma = np.nan_to_num(observations.sigma_px[rows], nan=1.0)
    return Track(
        row=rows,
        thing=thing,
        time=time,
        ray=ray,
        pixels_of=pixels_of,
        arm=observations.xy[rows] - lens.K[:2, 2],
        sigma=np.where(sigma > 0, sigma, 1.0),
        follows=follows,
        interval=interval,
    )


def _pixel_derivatives(lens: Lens, ray: Float64s) -> Float64s:
    """(n, 2, 3) derivatives of the pixel by the ray at right angles to it."""
    first, second = tangents(ray)
    columns = []
    for tangent in (first, second):
        after = lens_pixels(lens, ray + _ANGLE * tangent)
        before = lens_pixels(lens, ray - _ANGLE * tangent)
        columns.append(np.nan_to_num((after - before) / (2 * _ANGLE)))
    return np.asarray(columns[0][:, :, None] * first[:, None, :] + columns[1][:, :, None] * second[:, None, :])


def tangents(ray: Float64s) -> tuple[Float64s, Float64s]:
    """Two unit vectors (n, 3) each, at right angles to unit rays (n, 3) and to each other."""
    # the axis that is farthest from the ray gives the first
    axis = np.eye(3)[np.argmin(np.abs(ray), axis=1)]
    first = np.cross(ray, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(ray, first)


def _jumps(ray: Float64s, pixels_of: Float64s, steps: Float64s, same: Bools) -> Bools:
    """(n - 1,) the steps that are much faster than those around them."""
    pixels = np.linalg.norm(np.einsum("nij,nj->ni", pixels_of[1:], np.diff(ray, axis=0)), axis=1)
    speed = np.where(same & (steps > 0), pixels / np.where(steps > 0, steps, 1.0), np.nan)
    half = _NEIGHBOURS // 2
    padded = np.pad(speed, half, constant_values=np.nan)
    if not len(speed):
        return np.zeros(0, dtype=bool)
    around = np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS)
    # windows without any speed have no usual one; their steps are no part of a track
    usual = np.full(len(speed), np.inf)
    has_speed = np.isfinite(around).any(axis=1)
    usual[has_speed] = np.nanquantile(around[has_speed], _SLOW, axis=1)
    # a thing that starts to move is faster than before, but not than elsewhere
    if has_speed.any():
        usual = np.maximum(usual, 0.5 * np.nanquantile(speed, _SLOW))
    return np.asarray((speed > JUMP * usual) & (pixels > LEAST_JUMP_PX))


def seen_at(track: Track, thing: Int32s, time: Float64s) -> Seen:
    """Where a camera saw things (m,) at times (m,) of its own clock: by cubic Hermite interpolation of the rays.

    Where a neighbour is missing, the slope is that of the step itself.

    References: Catmull & Rom, A class of local interpolating splines, 1974.
    """
    last = len(track) - 1
    # one axis for thing and time: each thing has a stretch of its own
    origin = track.time[0]
    farthest = max(np.abs(track.time - origin).max(), np.abs(time - origin).max(initial=0.0))
    span = 2 * farthest + 1
    keys = track.thing * span + (track.time - origin)
    after = np.searchsorted(keys, thing * span + (time - origin))
    after = np.clip(after, 1, max(last, 1))
    before = after - 1
    if last == 0:
        after = before

    # 1. Observed at this very time, or between two observations that follow each other?
    step = track.time[after] - track.time[before]
    share = np.where(step > 0, (time - track.time[before]) / np.where(step > 0, step, 1.0), 0.0)
    nearest = np.where((share > 0.5) & (track.thing[after] == thing) | (track.thing[before] != thing), after, before)
    is_exact = (track.thing[nearest] == thing) & (np.abs(track.time[nearest] - time) <= 1e-6 * max(track.interval, 1e-3))
    is_between = track.follows[after] & (track.thing[before] == thing) & (share >= 0) & (share <= 1)

    # 2. Slopes at both ends.
    slope_before = _slopes(track, before)
    slope_after = _slopes(track, after)
    ray = _hermite(track.ray[before], track.ray[after], slope_before * step[:, None], slope_after * step[:, None], share)
    on_one = is_exact & ~is_between
    ray[on_one] = track.ray[nearest[on_one]]
    velocity = _velocity(track, before, after)
    velocity[~is_between] = 0.0
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    sigma = track.sigma[nearest] * np.where(on_one, 1.0, _noise_factor(share))
    return Seen(is_exact | is_between, ray, velocity, nearest, sigma)


def _noise_factor(share: Float64s) -> Float64s:
    """(m,) standard deviation of an interpolated value over that of the observations, by Catmull and Rom's weights."""
    s = np.clip(share, 0, 1)
    squares = (0.5 * s * (1 - s) ** 2) ** 2 + (1 - 2.5 * s**2 + 1.5 * s**3) ** 2
    squares += (0.5 * s + 2 * s**2 - 1.5 * s**3) ** 2 + (0.5 * s**2 * (1 - s)) ** 2
    return np.sqrt(squares)


def _slopes(track: Track, k: Int64s) -> Float64s:
    """(m, 3) change of the ray with time at observations k: by a parabola through its neighbours, or along the only one."""
    previous = np.maximum(k - 1, 0)
    following = np.minimum(k + 1, len(track) - 1)
    has_previous = track.follows[k]
    has_following = (following > k) & track.follows[following]
    to_previous = np.where(has_previous, track.time[k] - track.time[previous], 1.0)
    to_following = np.where(has_following, track.time[following] - track.time[k], 1.0)
    slope_previous = (track.ray[k] - track.ray[previous]) / to_previous[:, None]
    slope_following = (track.ray[following] - track.ray[k]) / to_following[:, None]
    weight = to_following / (to_previous + to_following)
    weight = np.where(has_previous & has_following, weight, np.where(has_previous, 1.0, 0.0))
    slope = weight[:, None] * slope_previous + (1 - weight[:, None]) * slope_following
    slope[~has_previous & ~has_following] = 0.0
    return slope


def _hermite(a: Float64s, b: Float64s, slope_a: Float64s, slope_b: Float64s, share: Float64s) -> Float64s:
    """(m, 3) values of the cubic from a to b (m, 3), with slopes for each step, at shares (m,) of the steps."""
    s = np.clip(share, 0, 1)[:, None]
    value = (1 + 2 * s) * (1 - s) ** 2 * a + s * (1 - s) ** 2 * slope_a
    return np.asarray(value + s**2 * (3 - 2 * s) * b + s**2 * (s - 1) * slope_b)


def _velocity(track: Track, before: Int64s, after: Int64s) -> Float64s:
    """(m, 3) change of the ray with time between two observations, from observations that lie farther out where there are some.

    The slope between the two themselves has the same errors as the interpolated ray: a clock that follows it would be drawn to
    halves of frames.
    """
    for _ in range(_OUTWARD):
        is_long = (before > 0) & track.follows[before]
        before = np.where(is_long, before - 1, before)
        following = np.minimum(after + 1, len(track) - 1)
        is_long = (following > after) & track.follows[following]
        after = np.where(is_long, following, after)
    step = track.time[after] - track.time[before]
    change = track.ray[after] - track.ray[before]
    return np.asarray(change / np.where(step > 0, step, 1.0)[:, None])


@dataclass(frozen=True)
class Clock:
    """How a camera's clock relates to the common one: what is added to its times is `offset + drift * (time - middle)`."""

    offset: float = 0.0
    drift: float = 0.0
    middle: float = 0.0
    """The common time at which the offset holds."""

    def own(self, time: Float64s) -> Float64s:
        """(m,) times of the camera's clock at times (m,) of the common one."""
        return time - self.offset - self.drift * (time - self.middle)

    def common(self, time: Float64s) -> Float64s:
        """(m,) the inverse of `own`."""
        return (time + self.offset - self.drift * self.middle) / (1 - self.drift)


def seen_by(track: Track, clock: Clock, moments: Moments) -> Seen:
    """Where a camera saw the things at moments of the common clock."""
    time = np.where(moments.is_still, 0.0, clock.own(moments.time))
    return seen_at(track, moments.thing, time)


def choose_moments(
    tracks: Sequence[Track], clocks: Sequence[Clock], still_things: Bools, most: int, least_cameras: int = 2
) -> Moments:
    """Moments at which cameras saw things at once, about one a frame interval, at times of actual observations.

    Parameters
    ----------
    tracks, clocks : of the cameras.
    still_things : (things,) bool, the things that don't move.
    most : largest number of moments; of more, evenly spaced ones are taken.
    least_cameras : number of cameras that must see the thing.
    """
    # 1. All observed times, in bins about the first track's times; the first camera that has one in a bin gives its time.
    interval = min([track.interval for track in tracks if track.interval > 0], default=1.0)
    things = np.concatenate([track.thing for track in tracks])
    is_still = still_things[things]
    times = np.concatenate([clock.common(track.time) for track, clock in zip(tracks, clocks, strict=True)])
    times[is_still] = 0.0
    bins = np.round((times - times[0]) / interval)
    camera = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    order = np.lexsort((camera, bins, things))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (np.diff(things[order]) != 0) | (np.diff(bins[order]) != 0)
    chosen = order[is_first]
    moments = Moments(things[chosen], times[chosen], is_still[chosen])

    # 2. Those that enough cameras see.
    counts = np.zeros(len(moments), dtype=np.int64)
    for track, clock in zip(tracks, clocks, strict=True):
        counts += seen_by(track, clock, moments).valid
    rows = np.flatnonzero(counts >= least_cameras)
    if len(rows) > most:
        rows = rows[np.linspace(0, len(rows) - 1, most).round().astype(np.int64)]
    return moments.take(rows)
