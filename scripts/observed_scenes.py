"""Synthetic scenes of fixed cameras around a moving thing, with exact truth, for `bench_observations.py` and the tests."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from wbflow_stages.core.lenses import lens_pixels
from wbflow_stages.types import Bools, Float64s, Lens, Observations, Placement


@dataclass(frozen=True)
class Recording:
    """How cameras and trackers record a scene."""

    rate: float = 25.0
    """Pictures a second."""
    noise_px: float = 1.0
    wrong_share: float = 0.0
    """Share of observations that are wrong: half of them in stretches of a second or two, the others anywhere."""
    offset_s: float = 0.0
    """Largest offset of a camera's clock."""
    bias_px: float = 0.0
    """Standard deviation of an error of the tracker that lasts for about a second."""
    seconds: float = 120.0


@dataclass(frozen=True)
class ObservedScene:
    """What cameras saw, and the truth."""

    observations: Observations
    lenses: dict[str, Lens]
    truth: dict[str, Placement]
    offsets: dict[str, float]
    """What is added to each camera's times to get those of the first camera."""
    path: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    """(n, 3) places of the thing at the times of the true clock, 25 a second."""
    path_times: Float64s = field(default_factory=lambda: np.zeros(0))


def looking_at(C: Float64s, target: Float64s, roll_deg: float = 0.0) -> Float64s:
    """(3, 3) rotation from world to camera axes of a camera at C that looks at a target; z is up in the world."""
    z = (target - C) / np.linalg.norm(target - C)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.array([x, np.cross(z, x), z])
    angle = np.deg2rad(roll_deg)
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return np.asarray(turn @ R)


def camera_ring(
    count: int, radius: float, spread_deg: float, rng: np.random.Generator, rolls: tuple[float, ...] = (0.0,)
) -> dict[str, Placement]:
    """Cameras on an arc around the origin, 3 to 8 m high."""
    angles = np.deg2rad(np.linspace(-spread_deg / 2, spread_deg / 2, count))
    cameras = {}
    for k, angle in enumerate(angles):
        distance = radius * rng.uniform(0.8, 1.3)
        C = np.array([distance * np.cos(angle), distance * np.sin(angle), rng.uniform(3, 8)])
        target = np.array([*rng.uniform(-0.15, 0.15, 2) * radius, 1.0])
        roll = rolls[k % len(rolls)] + rng.uniform(-3, 3)
        cameras[f"cam{k}"] = Placement(looking_at(C, target, roll), C)
    return cameras


def smooth_noise(times: Float64s, seconds: float, rng: np.random.Generator) -> Float64s:
    """(n,) smooth random function of time with a standard deviation of about 1 that changes within some seconds."""
    knots = np.arange(times[0] - 4 * seconds, times[-1] + 4 * seconds, seconds / 2)
    value = np.zeros(len(times))
    for knot, amplitude in zip(knots, rng.normal(size=len(knots)), strict=True):
        value += amplitude * np.exp(-0.5 * ((times - knot) / (seconds / 2)) ** 2)
    return value / 1.33


def walk(times: Float64s, radius: float, rng: np.random.Generator) -> Float64s:
    """(n, 3) a lamp that somebody carries at 1.5 m about an area of this radius at about 1.4 m/s."""
    # as fast as a person walks: a larger area takes longer to cross
    seconds = 0.9 * radius
    x = 0.6 * radius * smooth_noise(times, seconds, rng)
    y = 0.6 * radius * smooth_noise(times, seconds, rng)
    bob = 0.03 * np.sin(2 * np.pi * 1.8 * times)
    return np.column_stack([x, y, 1.5 + 0.05 * smooth_noise(times, 3.0, rng) + bob])


def flight(times: Float64s, radius: float, rng: np.random.Generator) -> Float64s:
    """(n, 3) a drone, 2 to 20 m high."""
    seconds = 0.3 * radius
    x = 0.5 * radius * smooth_noise(times, seconds, rng)
    y = 0.5 * radius * smooth_noise(times, seconds, rng)
    z = 0.15 * radius * (2.0 + smooth_noise(times, seconds, rng))
    return np.column_stack([x, y, np.maximum(z, 0.5)])


def plain_lens(focal: float = 1100.0, width: int = 1920, height: int = 1080) -> Lens:
    """A lens with a little distortion."""
    K = np.array([[focal, 0, width / 2 - 0.5], [0, focal, height / 2 - 0.5], [0, 0, 1]])
    return Lens(K=K, distortion=np.array([-0.1, 0.01, 0.0, 0.0, 0.0]), width=width, height=height)


def record(
    cameras: dict[str, Placement],
    lenses: dict[str, Lens],
    path: str,
    radius: float,
    recording: Recording,
    rng: np.random.Generator,
) -> ObservedScene:
    """What the cameras see of a thing on a "walk" or "flight"."""
    make_path = {"walk": walk, "flight": flight}[path]
    fine = np.arange(-10.0, recording.seconds + 10.0, 0.04)
    places = make_path(fine, radius, rng)
    # clocks: the true time of a frame is its camera's time plus `ahead`
    ahead = rng.uniform(-recording.offset_s, recording.offset_s, len(cameras))
    rows: list[Float64s] = []
    for k, (name, placement) in enumerate(cameras.items()):
        assert placement.R is not None and placement.C is not None
        own = np.arange(0.0, recording.seconds, 1 / recording.rate)
        true = own + ahead[k]
        X = np.column_stack([np.interp(true, fine, column) for column in places.T])
        xy = lens_pixels(lenses[name], (X - placement.C) @ placement.R.T)
        if recording.bias_px:
            bias = [recording.bias_px * smooth_noise(own, 1.0, rng) for _ in range(2)]
            xy = xy + np.column_stack(bias)
        lens = lenses[name]
        inside = (xy[:, 0] >= 0) & (xy[:, 1] >= 0) & (xy[:, 0] < lens.width) & (xy[:, 1] < lens.height)
        xy = xy + recording.noise_px * rng.normal(size=xy.shape)
        wrong = _wrong_rows(own, recording, rng)
        xy[wrong] = wrong_places(own, lens, rng)[wrong]
        keep = np.flatnonzero(inside)
        rows.append(np.column_stack([np.full(len(keep), k), own[keep], xy[keep]]))
    table = np.concatenate(rows)
    observations = Observations(
        cameras=tuple(cameras),
        things=("lamp",),
        camera=table[:, 0].astype(np.int32),
        thing=np.zeros(len(table), np.int32),
        time=table[:, 1],
        xy=table[:, 2:],
        sigma_px=np.full(len(table), np.nan),
    )
    offsets = {name: float(ahead[k] - ahead[0]) for k, name in enumerate(cameras)}
    return ObservedScene(observations, lenses, dict(cameras), offsets, places, fine - ahead[0])


def _wrong_rows(times: Float64s, recording: Recording, rng: np.random.Generator) -> Bools:
    """(n,) bool: where the tracker is on something else."""
    wrong: Bools = rng.random(len(times)) < recording.wrong_share / 2
    stretch = int(1.5 * recording.rate)
    stretches = round(recording.wrong_share / 2 * len(times) / stretch)
    for start in rng.integers(0, max(len(times) - stretch, 1), stretches):
        wrong[start : start + stretch] = True
    return wrong


def wrong_places(times: Float64s, lens: Lens, rng: np.random.Generator) -> Float64s:
    """(n, 2) pixels of other lamps: a few that stand still for a while."""
    lamps = rng.uniform(0, 1, (5, 2)) * [lens.width, lens.height]
    which = (times // 1.5).astype(int) * 7 % 5
    return np.asarray(lamps[which] + rng.normal(size=(len(times), 2)))
