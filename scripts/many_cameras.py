"""The demo yard with any number of cameras: on masts along a half ring, at various heights, looking in various directions."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from wbflow_demo.files import calibration_of
from wbflow_demo.parts.movers import movers
from wbflow_demo.render.cameras import CENTRE, Viewpoint
from wbflow_demo.render.light import light_of
from wbflow_demo.render.photograph import DemoSite, Night, Shots, photograph
from wbflow_demo.render.sensor import jpeg, png
from wbflow_demo.yard import LAMPS, static_yard


def viewpoints(count: int, every: int = 1) -> tuple[Viewpoint, ...]:
    """Every `every`-th of `count` cameras, in the order of their places on the ring."""
    random = np.random.default_rng(count)
    found = []
    for k, bearing in enumerate(np.radians(np.linspace(-74.0, 74.0, count))):
        distance, height = random.uniform(17.0, 20.5), random.uniform(5.5, 9.5)
        centre = CENTRE[0] + distance * np.sin(bearing), CENTRE[1] - distance * np.cos(bearing), height
        target = *(np.array([20.0, 21.0]) + random.uniform(-7.0, 7.0, 2)), random.uniform(0.5, 2.0)
        lens = tuple(random.uniform(-1, 1, 5) * (0.03, 0.01, 0.0004, 0.0004, 0.003) - (0.18, -0.04, 0, 0, 0))
        found.append(
            Viewpoint(
                f"c{k:03d}",
                (float(centre[0]), float(centre[1]), float(centre[2])),
                (float(target[0]), float(target[1]), float(target[2])),
                float(random.uniform(60.0, 72.0)),
                lens,
                roll_deg=float(random.uniform(-1.5, 1.5)),
                shift=(float(random.uniform(-1, 1)), float(random.uniform(-1, 1))),
            )
        )
    return tuple(found[::every])


def render(count: int, size: tuple[int, int], every: int = 1) -> DemoSite:
    """Photograph the yard with every `every`-th of `count` cameras, one image each."""
    shots = Shots(len(viewpoints(count, every)), 1, size)
    texel_m = shots.texel_m(0.0098 * 1280, 0.0098, 0.1)
    night = Night(
        viewpoints=viewpoints(count, every),
        still=static_yard(shots.random(1), texel_m),
        traffic=tuple(movers(shots.random(2), max(texel_m, 0.02), shots.captures)),
        lighting=light_of(shots.light, LAMPS),
    )
    return photograph(night, shots, shots.voxel_m(51.2))


def write_site(site: DemoSite, folder: Path, degree: int = 6, cameras: int | None = None, every: int = 1) -> tuple[Path, Path]:
    """Write a site without poses and one with them; returns both site files.

    Parameters
    ----------
    site : DemoSite
        What was photographed.
    folder : Path
        Where captures, masks, calibrations and both site files are written.
    degree : int
        Number of pairs per camera.
    cameras, every : int, optional
        Use every `every`-th camera, and of these only the first `cameras`.
    """
    chosen = site.cameras[::every][:cameras]
    for camera in chosen:
        for part, data in (("captures", jpeg(camera.captures[0])), ("masks", png(camera.mask))):
            file = folder / part / f"{camera.name}.{'jpg' if part == 'captures' else 'png'}"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
    files = []
    for name, dropped in (("withheld", {"R", "C"}), ("posed", set[str]())):
        known = {c.name: {key: value for key, value in calibration_of(c).items() if key not in dropped} for c in chosen}
        (folder / f"{name}.json").write_text(json.dumps(known))
        described = {
            "site": name,
            "captures": {"root": "captures", "pattern": "{camera}.jpg"},
            "cameras": [{"id": camera.name, "mask": f"masks/{camera.name}.png"} for camera in chosen],
            "calibration": f"{name}.json",
            "resolution": None,
            "pairs": {"degree": degree, "min_angle": 8, "max_angle": 50},
        }
        files.append(folder / f"{name}.yaml")
        files[-1].write_text(json.dumps(described))  # JSON is YAML
    return files[0], files[1]
