"""All demo scenes by name, for `wbflow demo`, benchmarks and tests.

site = render("square", cameras=3)
site["pole-1"].captures, site["pole-1"].camera, site["pole-1"].depth, site.reference
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import cast

from .parts.weak import check_surfaces
from .render.photograph import Daytime, DemoSite, Shots


@dataclass(frozen=True)
class SceneRow:
    """A row of the table of scenes."""

    function: str
    """module:function; takes `Shots` and returns a DemoSite."""
    about: str
    angles_deg: tuple[float, float]
    """Smallest and largest angle between views that are worth matching."""
    cameras: int = 6
    captures: int = 4
    size: tuple[int, int] = (960, 540)
    """Default number of cameras, captures per camera, and (width, height) in pixels of the large form."""
    small_cameras: int | None = None
    """Number of cameras of the small form; None: as many as the large form."""


SCENES = {
    "yard": SceneRow("wbflow_demo.yard:yard", "a harbour yard", (8, 50), 8, 3, (1280, 720), small_cameras=4),
    "square": SceneRow("wbflow_demo.square:square", "a public square whose tiles repeat exactly", (8, 100), captures=10),
    "carpark": SceneRow("wbflow_demo.carpark:carpark", "a car park with rows of the same car", (4, 70)),
}
"""Scenes by name; benchmarks add theirs."""


def render(
    name: str,
    *,
    small: bool = False,
    cameras: int | None = None,
    size: tuple[int, int] | None = None,
    captures: int | None = None,
    seed: int = 0,
    light: str = "day",
    lenses: str = "standard",
    surfaces: str = "standard",
) -> DemoSite:
    """Render a scene in memory; the same arguments give the same bytes.

    small: 320 x 180 pixels, rendered in seconds.  cameras, captures: number of cameras, and of captures of each; default: the
    scene's own.  size: width and height in pixels.  seed: of all random numbers.  light: "day", "dusk", "night", or "dark" (night
    without lamps).  lenses: a name in `cameras.VARIANTS`.  surfaces: a name in `weak.SURFACES`.

    Raises ValueError for an unknown scene, light, kind of lenses or surfaces, and for impossible numbers.
    """
    if name not in SCENES:
        raise ValueError(f"there is no scene {name!r}; there are {', '.join(SCENES)}")
    row = SCENES[name]
    check_surfaces(surfaces, name)
    if small:
        cameras = cameras or row.small_cameras
        size = size or (320, 180)
        captures = 3 if captures is None else captures
    # what is not stated is as the scene has it
    if cameras is None:
        cameras = row.cameras
    if captures is None:
        captures = row.captures
    module, _, function = row.function.partition(":")
    scene = getattr(import_module(module), function)
    shots = Shots(cameras, captures, size or row.size, seed, cast(Daytime, light), lenses=lenses, surfaces=surfaces)
    return cast(DemoSite, scene(shots))
