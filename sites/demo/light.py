"""What lights a scene: sun, sky, haze, what comes back from the ground, lamps."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Lamp:
    """A lamp: position (3,), colour times strength (3,), metres-squared falloff."""

    position: tuple[float, float, float]
    power: tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """What lights a scene."""

    sun_direction: tuple[float, float, float]
    """Unit vector towards the sun."""
    sun: tuple[float, float, float]
    """Its linear colour."""
    sky: tuple[float, float, float]
    """That of the sky overhead."""
    ground: tuple[float, float, float]
    """That of the light that comes back from the ground."""
    haze: tuple[float, float, float]
    """The sky at the horizon."""
    lamps: tuple[Lamp, ...] = ()
    clouds: float = 0.25
    """How clearly the sky is banded."""
