"""The light of a scene: sun, sky, haze, ground and lamps, by day, at dusk, at night, in the dark, and under an overcast sky."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from . import Place


@dataclass(frozen=True)
class Lamp:
    """A lamp: position in metres, and colour times strength, with inverse-square falloff."""

    position: tuple[float, float, float]
    power: tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """All light sources of a scene."""

    sun_direction: tuple[float, float, float]
    """Unit vector towards the sun."""
    sun: tuple[float, float, float]
    """Linear colour of the sun."""
    sky: tuple[float, float, float]
    """Linear colour of the sky overhead."""
    ground: tuple[float, float, float]
    """Linear colour of the light reflected by the ground."""
    haze: tuple[float, float, float]
    """Linear colour of the sky at the horizon."""
    lamps: tuple[Lamp, ...] = ()
    clouds: float = 0.25
    """Contrast of the bands of cloud."""


SUN = (-0.547, -0.526, 0.652)
"""Unit vector towards the afternoon sun: in the south-west, 40 degrees above the horizon."""


def light_of(light: str, lamps: Sequence[Place]) -> Light:
    """Return the light at a time of day.

    day: afternoon sun; dusk: low sun with the lamps on; night: lamps; dark: night without lamps, with only the glow of the sky.
    lamps: their positions, metres.  Raises ValueError for another `light`.
    """
    # strengths are relative: 1 from everywhere makes white paint white at the exposure of day
    if light == "day":
        return Light(
            sun_direction=SUN,
            sun=(1.55, 1.45, 1.27),
            sky=(0.52, 0.60, 0.76),  # bluer than the sun: shadows are blue
            ground=(0.30, 0.28, 0.25),
            haze=(0.86, 0.90, 0.95),
        )
    if light == "dusk":
        return Light(
            sun_direction=(-0.909, -0.354, 0.222),  # 13 degrees above the horizon
            sun=(0.22, 0.13, 0.07),
            sky=(0.17, 0.20, 0.29),
            ground=(0.10, 0.09, 0.085),
            haze=(0.45, 0.33, 0.27),
            lamps=_lit(lamps, 0.35),
        )
    if light in ("night", "dark"):
        # no sun; its direction is that of day, which nothing uses
        return Light(
            sun_direction=SUN,
            sun=(0.0, 0.0, 0.0),
            sky=(0.030, 0.034, 0.045),
            ground=(0.030, 0.026, 0.020),  # warmer than the sky: the glow of a town
            haze=(0.02, 0.018, 0.016),
            lamps=_lit(lamps, 0.5) if light == "night" else (),
        )
    raise ValueError(f"light is day, dusk, night or dark, not {light!r}")


def overcast_of(light: str, lamps: Sequence[Place]) -> Light:
    """Return the light at a time of day under an even sky without sun; all lamps have the same colour and strength."""
    lit = light_of(light, lamps)
    if light == "day":
        # the clouds spread the sun's light over the sky
        lit = replace(lit, sky=(1.25, 1.27, 1.32), ground=(0.55, 0.54, 0.52), haze=(0.9, 0.92, 0.95))
    equal_lamps = tuple(replace(lamp, power=lit.lamps[0].power) for lamp in lit.lamps)
    return replace(lit, sun=(0.0, 0.0, 0.0), clouds=0.0, lamps=equal_lamps)


def _lit(places: Sequence[Place], strength: float) -> tuple[Lamp, ...]:
    """Return lamps that are on: every third is white, the others warm."""
    # light falls with the square of the distance: 34 at one metre is about 1 at six, the height of the lamps
    warm = (34.0 * strength, 27.0 * strength, 17.0 * strength)
    white = (30.0 * strength, 29.0 * strength, 26.0 * strength)
    lamps = []
    for k, place in enumerate(places):
        lamps.append(Lamp(place, white if k % 3 == 0 else warm))
    return tuple(lamps)
