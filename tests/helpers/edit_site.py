"""A site of three posed cameras and one without a pose, with comments in its file, for tests of `wbflow edit`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import cv2
import numpy as np

from wbflow.api import load_site
from wbflow.edit.server import EditServer
from wbflow.edit.session import Session
from wbflow.site.calibration.calibrated import look_at

WIDTH, HEIGHT, FOCAL = 320, 180, 300.0
PLACES = {"gate": [-6.0, -12.0, 5.0], "roof": [0.0, -14.0, 7.0], "mast": [6.0, -12.0, 4.0]}
BOLT = [0.5, 1.0, 0.0]

SITE = """\
# The harbour; Anna knows the passwords.
site: harbour
captures: {root: captures, pattern: "{camera}.png"}

cameras:
  - id: gate      # at the entrance
    intrinsics:   &lens
      {fx: 300, fy: 300, cx: 159.5, cy: 89.5,   width: 320, height: 180}
    pose: {position: [-6, -12, 5], look_at: [0, 0, 0]}
    mask: masks/gate.png
    privacy: [[[0.0, 0.7], [0.3, 0.65], [0.3, 1.0], [0.0, 1.0]]]   # the neighbour's garden
  - {id: roof, intrinsics: *lens, pose: {position: [0, -14, 7], look_at: [0, 0, 0]}}
  - {id: mast, intrinsics: *lens,
     pose: {position: [6, -12, 4], look_at: [0, 0, 0]}}   # sways in the wind
  - shed          # nobody knows where it is

zones:
  - {name: quay,   polygon: [[-3, -3], [3, -3], [3, 3], [-3, 3]], least_m: 0.5}   # where ships moor

# What Ben measured in May:
control_points:
  - id: bolt                       # the big one
    position: [0.5, 1.0, 0.0]
    pixels: {gate: [176.4, 78.4], roof: [159.9, 88.9]}

# Long side that stages work at.
resolution: 1600
"""


def write(folder: Path, text: str = SITE) -> Path:
    """Write the site into a folder; return its site file."""
    noise = np.random.default_rng(0)
    (folder / "captures").mkdir(parents=True)
    (folder / "masks").mkdir()
    for camera in (*PLACES, "shed"):
        small = noise.integers(30, 220, (18, 32, 3), dtype=np.uint8)
        cv2.imwrite(str(folder / "captures" / f"{camera}.png"), cv2.resize(small, (WIDTH, HEIGHT)))
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:20, :60] = 0
    cv2.imwrite(str(folder / "masks" / "gate.png"), mask)
    file = folder / "site.yaml"
    file.write_text(text)
    return file


def seen(camera: str, X: list[float]) -> list[float]:
    """The pixel at which a camera sees a point."""
    R = np.array(look_at(PLACES[camera], [0, 0, 0]))
    x = R @ (np.array(X) - PLACES[camera])
    return [float(FOCAL * x[0] / x[2] + 159.5), float(FOCAL * x[1] / x[2] + 89.5)]


@contextmanager
def served(file: Path) -> Iterator[EditServer]:
    """Run the server of `wbflow edit` for a site file."""
    with EditServer(Session(load_site(file))) as server:
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join(10)
