"""Events in the demo yard on each night: the light, faults of cameras, and things that appear, vanish or move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from typing import Literal

import numpy as np

from wbflow_stages.types import Float64s

from .render.light import Light, light_of, overcast_of
from .yard import LAMPS

FIRST_NIGHT = date(2026, 11, 10)
"""Date of the first night."""
FRAME_INTERVAL = timedelta(seconds=97)
"""Time between two captures of a camera: not a whole minute, as with real ones."""
Weather = Literal["afternoon", "noon", "overcast", "rain", "dusk", "lamps"]
"""Names of the conditions of a night."""
NIGHTS: tuple[Weather, ...] = (
    "afternoon", "noon", "overcast", "dusk", "noon", "rain", "afternoon", "lamps", "overcast", "dusk",
)  # fmt: skip
"""Weather and light of the nights, from the first one; the list repeats."""

Event = Literal["none", "turned", "nudged", "covered", "frozen", "foreign"]


@dataclass(frozen=True)
class CameraEvent:
    """A fault of a camera on one night; by the next night it is repaired."""

    night: int
    """From 1."""
    camera: str
    what: Event
    turn: tuple[float, float] = (0.0, 0.0)
    """Pan (to the right) and tilt (upward): for `turned` in degrees, for `nudged` in pixels at the principal point."""


EVENTS = (
    CameraEvent(3, "crane-2", "turned", (0.4, 0.3)),
    CameraEvent(3, "gate", "covered"),
    CameraEvent(3, "mast-3", "frozen"),
    CameraEvent(3, "quay", "foreign"),
    CameraEvent(5, "mast-2", "nudged", (-2.4, 1.8)),
)


@dataclass(frozen=True)
class Stay:
    """The place of a thing for a range of nights."""

    first: int
    """First night, counted from 1; `last`: last night."""
    last: int
    at: tuple[float, float]
    """Metres east and north."""
    yaw: float
    """Radians."""


FOREVER = 1_000_000
"""The last night of a thing that stays: later than any that is rendered."""
THINGS: Mapping[str, tuple[Stay, ...]] = {
    "container": (Stay(7, FOREVER, (9.2, 15.3), 0.12),),
    "vehicle": (Stay(7, FOREVER, (28.3, 16.4), 1.5),),
    "stack": (Stay(1, 6, (22.0, 10.8), 0.2),),
    "crate": (Stay(1, 11, (16.6, 9.6), 0.3), Stay(12, FOREVER, (16.2, 7.4), 0.5)),
}
"""Things that are not at the same place in the yard every night; traffic, which differs in every frame, is not included."""


@dataclass(frozen=True)
class Conditions:
    """The light of a night."""

    sensor: str
    """Sensor settings: day, dusk or night."""
    begins: time
    light: Light
    rain: bool = False


_DAY = light_of("day", LAMPS)
"""A clear afternoon."""
_GREY = overcast_of("day", LAMPS)
"""The same under clouds."""
CONDITIONS: Mapping[Weather, Conditions] = {
    "afternoon": Conditions("day", time(14, 2, 11), _DAY),
    "noon": Conditions("day", time(12, 7, 40), replace(_DAY, sun_direction=(0.105, -0.640, 0.761), sun=(1.62, 1.56, 1.44))),
    "overcast": Conditions("day", time(11, 15, 2), _GREY),
    "rain": Conditions("day", time(10, 31, 55), replace(_GREY, sky=(0.75, 0.77, 0.80), ground=(0.33, 0.32, 0.31)), rain=True),
    "dusk": Conditions("dusk", time(16, 41, 5), light_of("dusk", LAMPS)),
    "lamps": Conditions("night", time(22, 14, 37), light_of("night", LAMPS)),
}


def weather_of(night: int) -> Weather:
    """Return the weather of a night, counted from 1."""
    return NIGHTS[(night - 1) % len(NIGHTS)]


def date_of(night: int) -> date:
    """Return the date of a night, counted from 1."""
    return FIRST_NIGHT + timedelta(days=night - 1)


def frame_time(night: int, frame: int, late_s: int) -> datetime:
    """Return the time of a frame (from 0) of a camera that is `late_s` seconds behind the schedule of the night."""
    begins = datetime.combine(date_of(night), CONDITIONS[weather_of(night)].begins)
    return begins + frame * FRAME_INTERVAL + timedelta(seconds=late_s)


def event_of(night: int, camera: str) -> CameraEvent:
    """Return the event of a camera on a night; "none" if it has none."""
    for event in EVENTS:
        if event.night == night and event.camera == camera:
            return event
    return CameraEvent(night, camera, "none")


def stays(night: int) -> dict[str, Stay]:
    """Return the things in the yard on a night, with their places."""
    present = {}
    for name, places in THINGS.items():
        for stay in places:
            if stay.first <= night <= stay.last:
                present[name] = stay
    return present


def turned_axes(event: CameraEvent, focal_px: float) -> Float64s:
    """Return the rotation (3, 3) from a camera's nominal axes to its axes after the event."""
    if event.what == "turned":
        pan, tilt = event.turn
    else:
        # pixels at the principal point to degrees
        pan, tilt = np.degrees(np.arctan(np.array(event.turn) / focal_px)).tolist()
    # x right, y down, z ahead: a pan to the right turns z towards x, a tilt upward turns it towards -y
    a = np.radians(pan)
    b = np.radians(tilt)
    panned = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    tilted = np.array([[1, 0, 0], [0, np.cos(b), np.sin(b)], [0, -np.sin(b), np.cos(b)]])
    return np.asarray(tilted @ panned, np.float64)
