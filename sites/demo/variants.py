"""Cameras as they are bought over ten years: a scene's viewpoints with other lenses, sizes and sensors."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Literal

from .cameras import Viewpoint
from .light import Lamp, Light
from .prepared import PreparedScene

VARIANTS = {
    "standard": "as the scene has them",
    "fisheye": "every second camera sees 180 degrees, with twice the pixels along each side",
    "brown": "all see 100 degrees with half as many pixels again along each side, and bend lines strongly",
    "mixed": "every second camera has four times the pixels of its neighbours along each side",
    "infrared": "colour, infrared, grey, infrared; at night the infrared ones see by their own lamp",
}
"""What each is."""

_FISHEYE = (-0.012, 0.004, -0.0011, 0.0001)
"""k1..k4 of a lens that is nearly equidistant."""
_BARREL = (-0.15, 0.02, 0.0004, -0.0003, 0.0)
_SIGHTS: tuple[Literal["colour", "grey", "infrared"], ...] = ("colour", "infrared", "grey", "infrared")
_LAMP = 120.0
"""Of an infrared camera: it lights a yard as well as the lamps on its walls do."""


def check_lenses(lenses: str) -> None:
    """Raises ValueError for what is no row of `VARIANTS`."""
    if lenses not in VARIANTS:
        raise ValueError(f"lenses are {', '.join(VARIANTS)}, not {lenses!r}")


def fitted(viewpoints: Sequence[Viewpoint], lenses: str) -> tuple[Viewpoint, ...]:
    """The viewpoints with the lenses of a row of `VARIANTS`."""
    return tuple(_fitted(viewpoint, k, lenses) for k, viewpoint in enumerate(viewpoints))


def _fitted(viewpoint: Viewpoint, k: int, lenses: str) -> Viewpoint:
    every_second = k % 2 == 1
    if lenses == "fisheye" and every_second:
        return replace(viewpoint, model="fisheye", distortion=_FISHEYE, hfov_deg=180.0, scale=2.0)
    if lenses == "brown":
        return replace(viewpoint, distortion=_BARREL, hfov_deg=100.0, whole_picture=True, scale=1.5)
    if lenses == "mixed":
        return replace(viewpoint, scale=2.0 if every_second else 0.5)
    if lenses == "infrared":
        return replace(viewpoint, sight=_SIGHTS[k % len(_SIGHTS)])
    return viewpoint


def own_lamp(light: Light, viewpoint: Viewpoint, hour: str) -> Light:
    """The light that a camera sees by: an infrared one lights what it sees itself where it is night.

    Parameters
    ----------
    light : Light
        What the scene is lit by.
    viewpoint : Viewpoint
        The camera.
    hour : str
        "day", "dusk", "night" or "dark".
    """
    if viewpoint.sight != "infrared" or hour not in {"night", "dark"}:
        return light
    return replace(light, lamps=(*light.lamps, Lamp(viewpoint.centre, (_LAMP, _LAMP, _LAMP))))


def lit(prepared: PreparedScene, light: Light) -> PreparedScene:
    """The same scene in another light."""
    other = copy(prepared)
    other.light = light
    return other
