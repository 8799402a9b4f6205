#!/usr/bin/env python3
"""Renders nights of a scene on which things come and go:  scripts/nights_of_scene.py square|carpark|market|harbour DIR [--small]

Like `wbflow demo --nights`, which renders the yard, but no camera has a fault: benches of changes judge on these scenes what was
fitted on the yard.  The same arguments give the same bytes.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scenes import harbour, market

from wbflow_demo import carpark, square
from wbflow_demo.files import json_bytes, scene_files
from wbflow_demo.nights import Extent, Things
from wbflow_demo.parts.movers import traffic
from wbflow_demo.render.cameras import Viewpoint
from wbflow_demo.render.light import light_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import Daytime, DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import Scene, joined
from wbflow_demo.render.sensor import jpeg
from wbflow_demo.script import FOREVER, Stay

FIRST_NIGHT = datetime.date(2026, 11, 10)
LIGHTS: tuple[Daytime, ...] = ("day", "day", "dusk", "day", "night", "day", "dusk", "day", "day", "night")
"""Light of the nights; the list repeats."""


@dataclass(frozen=True)
class Place:
    """A scene, and the things that stand in it on its nights."""

    static: Callable[[Rng, float], Scene]
    viewpoints: Callable[[], list[Viewpoint]]
    lamps: tuple[tuple[float, float, float], ...]
    walks: tuple[Any, ...]
    texels: tuple[float, float, float]
    """Arguments of `Shots.texel_m`."""
    voxel_m: float
    """Argument of `Shots.voxel_m`."""
    things: Mapping[str, tuple[Stay, ...]]


PLACES = {
    "square": Place(
        square.static_square,
        square.viewpoints,
        square.LAMPS,
        square.WALKS,
        (12.0, 0.0125, 0.05),
        38.4,
        {
            "crate": (Stay(1, 4, (-3.5, 9.0), 0.4),),
            "stack": (Stay(3, 6, (3.5, -8.5), 0.2), Stay(8, FOREVER, (3.5, -8.5), 0.2)),
            "container": (Stay(4, FOREVER, (8.5, 3.0), 1.3),),
            "vehicle": (Stay(5, FOREVER, (-8.5, -2.5), 0.7),),
        },
    ),
    "carpark": Place(
        carpark.static_carpark,
        carpark.viewpoints,
        carpark.LAMPS,
        (((-20.0, 16.6), (20.0, 16.6)),),
        (14.0, 0.0145, 0.06),
        48.0,
        {
            "crate": (Stay(1, 4, (12.0, 7.3), 0.4),),
            "stack": (Stay(3, 6, (-9.0, 7.3), 0.2), Stay(8, FOREVER, (-9.0, 7.3), 0.2)),
            "container": (Stay(4, FOREVER, (-6.0, -9.3), 0.05),),
            "vehicle": (Stay(5, FOREVER, (8.0, -9.5), 0.1),),
        },
    ),
    "market": Place(
        market.static_market,
        market.viewpoints,
        market.LAMPS,
        (((-9.0, 5.3), (9.0, 5.4)), ((-9.0, -5.6), (9.0, -5.7)), ((-12.0, -10.6), (12.0, -9.8)), ((-12.5, 10.8), (11.0, 11.2))),
        (14.0, 0.0145, 0.05),
        38.0,
        {
            "crate": (Stay(1, 4, (-5.5, 1.5), 0.4),),
            "stack": (Stay(3, 6, (5.0, -2.0), 0.2), Stay(8, FOREVER, (5.0, -2.0), 0.2)),
            "container": (Stay(4, FOREVER, (0.5, 3.6), 0.0),),
            "vehicle": (Stay(5, FOREVER, (1.5, -4.2), 0.1),),
        },
    ),
    "harbour": Place(
        harbour.static_harbour,
        harbour.viewpoints,
        harbour.LAMPS,
        (((-18.0, 5.5), (18.0, 5.4)), ((-9.0, -17.0), (10.0, -18.0))),
        (18.0, 0.0145, 0.06),
        44.0,
        {
            "crate": (Stay(1, 4, (-12.5, -1.5), 0.4),),
            "stack": (Stay(3, 6, (10.0, -0.5), 0.2), Stay(8, FOREVER, (10.0, -0.5), 0.2)),
            "container": (Stay(4, FOREVER, (-3.8, 2.0), 0.1),),
            "vehicle": (Stay(5, FOREVER, (11.0, 3.0), 0.05),),
        },
    ),
}


def main() -> None:
    """Render the requested nights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=[*PLACES])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--small", action="store_true", help="320x180 pixels")
    parser.add_argument("--cameras", type=int, default=6)
    parser.add_argument("--nights", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    size = (320, 180) if given.small else (640, 360)
    write_nights(given.folder, given.scene, given.nights, Shots(given.cameras, 3, size, given.seed))


def write_nights(folder: Path, name: str, nights: int, shots: Shots) -> None:
    """Write captures, site file and truth of some nights of a scene."""
    place = PLACES[name]
    texel_m = shots.texel_m(*place.texels)
    things = Things(shots.random(4), texel_m)
    still = place.static(shots.random(1), texel_m)
    extents = {thing: things.extent(thing) for thing in place.things}
    truth = []
    for number in range(1, nights + 1):
        tonight = _photographed(place, still, things, number, shots, texel_m)
        date = FIRST_NIGHT + datetime.timedelta(days=number - 1)
        if number == 1:
            for path, content in scene_files(tonight, name, "day", "standard"):
                if not path.startswith("captures/") and isinstance(content, bytes):
                    (folder / path).parent.mkdir(parents=True, exist_ok=True)
                    (folder / path).write_bytes(content)
        for camera in tonight.cameras:
            (folder / "captures" / camera.name).mkdir(parents=True, exist_ok=True)
            for k, image in enumerate(camera.captures, 1):
                (folder / "captures" / camera.name / f"{date}_{k}.jpg").write_bytes(jpeg(image))
        truth.append({"night": number, "date": date.isoformat(), "changes": _changes(place, number, extents)})
    (folder / "truth" / "nights.json").write_bytes(json_bytes({"unit": "m", "nights": truth}))
    print(json.dumps({"scene": name, "nights": nights, "cameras": shots.cameras}))


def _photographed(place: Place, still: Scene, things: Things, number: int, shots: Shots, texel_m: float) -> DemoSite:
    """One night's captures of all cameras; number: of the night, from 1."""
    light = LIGHTS[(number - 1) % len(LIGHTS)]
    own = replace(shots, seed=1000 * shots.seed + number, light=light)  # another night has other people and other noise
    scene = joined(still, things.scene(_stays(place, number)))
    people = traffic(own.random(2), max(texel_m, 0.02), own.captures, people=6, walks=place.walks)
    viewpoints = tuple(place.viewpoints()[: shots.cameras])
    return photograph(Night(viewpoints, scene, people, light_of(light, place.lamps)), own, shots.voxel_m(place.voxel_m))


def _stays(place: Place, number: int) -> dict[str, Stay]:
    """The things that stand there on a night."""
    present = {}
    for name, stays in place.things.items():
        for stay in stays:
            if stay.first <= number <= stay.last:
                present[name] = stay
    return present


def _changes(place: Place, number: int, extents: Mapping[str, Extent]) -> list[dict[str, Any]]:
    """The differences between a night and the first, as in truth/nights.json of the demo."""
    before = _stays(place, 1)
    now = _stays(place, number)
    changes = []
    for name, extent in extents.items():
        if (name in before) == (name in now):
            continue
        stay = now.get(name) or before[name]
        kind = "appeared" if name in now else "vanished"
        where = {"position": [*stay.at, round(extent.size[2] / 2, 3)], "nights": [stay.first, stay.last]}
        changes.append(
            {
                "name": name,
                "kind": kind,
                "size": [round(value, 3) for value in extent.size],
                "volume_m3": round(extent.volume_m3, 3),
                "to" if name in now else "from": where,
            }
        )
    return changes


if __name__ == "__main__":
    main()
