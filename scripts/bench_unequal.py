#!/usr/bin/env python3
"""Photographed sites with unequal cameras and withheld poses: which cameras are placed, and how accurately?

    scripts/bench_unequal.py [--scenes fountain entry] [--kinds long-3 small-4 ...] [--resolution 1024]

Every third camera of a site is changed: a longer lens (its image cropped to a half or a third), fewer pixels, rotated by 90
degrees, grey, infrared in the dark, or interlaced lines.  Other kinds compress all images strongly, or give them wrong colours.
`mixed` combines most of these in one site.  Whole runs until `poses`; errors after a similarity alignment of the centres.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from pairs_with_truth import DATA, read_rgb
from scores import pose_errors

import wbflow
from wbflow_stages.core.cameras import scaled_intrinsics
from wbflow_stages.types import Camera, Uint8s

WIDTH = 1536


@dataclass(frozen=True)
class Shot:
    """An image (h, w, 3) uint8 RGB, its camera, and the JPEG quality of its file."""

    image: Uint8s
    camera: Camera
    jpeg: int = 95


def smaller(shot: Shot, times: int) -> Shot:
    """The same view by a camera with fewer pixels: `times` fewer along each side."""
    c = shot.camera
    width, height = c.width // times, c.height // times
    camera = Camera(scaled_intrinsics(c.K, width / c.width, height / c.height), c.R, c.C, width, height)
    return replace(shot, image=_resized(shot.image, width, height), camera=camera)


def longer(shot: Shot, times: int) -> Shot:
    """The same view through a lens `times` longer: the middle of the image, cropped."""
    c = shot.camera
    width, height = c.width // times, c.height // times
    x, y = (c.width - width) // 2, (c.height - height) // 2
    camera = Camera(c.K - [[0, 0, x], [0, 0, y], [0, 0, 0]], c.R, c.C, width, height)
    return replace(shot, image=shot.image[y : y + height, x : x + width], camera=camera)


def upright(shot: Shot) -> Shot:
    """The image rotated by 90 degrees clockwise, and the camera that takes it."""
    c = shot.camera
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    moved = np.array([[0.0, -1, c.height - 1], [1, 0, 0], [0, 0, 1]])
    camera = Camera(moved @ c.K @ quarter.T, quarter @ c.R, c.C, c.height, c.width)
    return replace(shot, image=np.ascontiguousarray(np.rot90(shot.image, -1)), camera=camera)


def grey(shot: Shot) -> Shot:
    return replace(shot, image=_three(np.asarray(cv2.cvtColor(shot.image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)))


def infrared(shot: Shot) -> Shot:
    """Imitation of infrared: bright red and green, dark blue, lifted shadows, and the noise of a sensor in the dark."""
    r, g, b = np.moveaxis(shot.image.astype(np.float64), 2, 0)
    seen = 255 * (np.clip(0.8 * r + 0.5 * g - 0.3 * b, 0, 255) / 255) ** 0.6
    noisy = seen + np.random.default_rng(1).normal(0, 6, seen.shape)
    return replace(shot, image=_three(np.clip(noisy, 0, 255).astype(np.uint8)))


def combed(shot: Shot) -> Shot:
    """Interlacing: every other line is shifted by four pixels."""
    image = shot.image.copy()
    image[1::2] = np.roll(image[1::2], 4, axis=1)
    return replace(shot, image=image)


def tinted(shot: Shot, which: int) -> Shot:
    """Brightness and colour balance of another make of camera."""
    gains = np.array([(0.7, 1, 1.3), (1.4, 1, 0.7), (0.8, 1.25, 1)][which % 3]) * (0.6 + 0.3 * (which % 3))
    return replace(shot, image=np.clip(shot.image * gains, 0, 255).astype(np.uint8))


def every_third(change: Callable[[Shot], Shot]) -> Callable[[Shot, int], Shot]:
    return lambda shot, number: change(shot) if number % 3 == 1 else shot


def mixed(shot: Shot, number: int) -> Shot:
    changes: list[Callable[[Shot], Shot]] = [
        grey, lambda s: tinted(smaller(s, 2), 0), infrared, lambda s: longer(s, 2), lambda s: s,
    ]  # fmt: skip
    return replace(changes[number % 5](shot), jpeg=30 + 10 * (number % 4))


KINDS: dict[str, Callable[[Shot, int], Shot]] = {
    "equal": lambda shot, _: shot,
    "small-4": every_third(lambda shot: smaller(shot, 4)),
    "long-2": every_third(lambda shot: longer(shot, 2)),
    "long-3": every_third(lambda shot: longer(shot, 3)),
    "upright": every_third(upright),
    "grey": every_third(grey),
    "infrared": every_third(infrared),
    "combed": every_third(combed),
    "tinted": tinted,
    "jpeg": lambda shot, number: replace(shot, jpeg=12 if number % 3 == 1 else 40),
    "mixed": mixed,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["fountain", "entry"], choices=["fountain", "entry"])
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS), metavar="KIND")
    parser.add_argument("--resolution", type=int, default=1024, help="long side of the pictures that stages work on, pixels")
    options = parser.parse_args()
    print(f"{'scene':10}{'kind':10}{'exit':>5}{'placed':>8}{'pairs':>6}   cm: median  most   degrees: median  most   CPU s")
    for scene in options.scenes:
        shots = photographed(scene)
        for kind in options.kinds:
            show(scene, kind, {name: KINDS[kind](shot, k) for k, (name, shot) in enumerate(shots.items())}, options.resolution)


def photographed(scene: str) -> dict[str, Shot]:
    """The photographs of a scene at about `WIDTH`, by camera."""
    shots = {}
    for name, row in json.loads((DATA / scene / "cameras.json").read_text()).items():
        camera = Camera(np.array(row["K"]), np.array(row["R"]), np.array(row["C"]), row["width"], row["height"])
        whole = Shot(read_rgb(DATA / scene / "images" / name), camera)
        shots[Path(name).stem] = smaller(whole, camera.width // WIDTH)
    return shots


def show(scene: str, kind: str, shots: dict[str, Shot], resolution: int) -> None:
    """Run a site with these cameras, without their poses, and print its row."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for camera, shot in shots.items():
            cv2.imwrite(str(folder / f"{camera}.jpg"), shot.image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, shot.jpeg])
        lenses = {c: {"K": s.camera.K.tolist(), "width": s.camera.width, "height": s.camera.height} for c, s in shots.items()}
        (folder / "cameras.json").write_text(json.dumps(lenses))
        captures = {"root": ".", "pattern": "{camera}.jpg"}
        site = {"site": scene, "captures": captures, "calibration": "cameras.json", "cameras": list(shots)}
        (folder / "site.yaml").write_text(json.dumps(site | {"resolution": resolution}))
        night = wbflow.run(folder / "site.yaml", jobs=1, until="poses")
        record, solved = night.record, night.calibration
    found = {
        camera: Camera(np.array(row["K"]), np.array(row["R"]), np.array(row["C"]), row["width"], row["height"])
        for camera, row in solved.items()
    }
    errors = pose_errors(found, {camera: shot.camera for camera, shot in shots.items()}, aligned=True)
    used = sum((pair.figures.probability or 0.0) > 0.5 for pair in record.pairs)
    print(
        f"{scene:10}{kind:10}{record.exit_code:5}{f'{len(found)}/{len(shots)}':>8}{used:6}   "
        f"{100 * np.median(errors.position):10.2f}{100 * errors.position.max():6.2f}   "
        f"{np.median(errors.rotation_deg):15.3f}{errors.rotation_deg.max():7.3f}   "
        f"{record.seconds.cpu:5.0f}",
        flush=True,
    )


def _resized(image: Uint8s, width: int, height: int) -> Uint8s:
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _three(image: Uint8s) -> Uint8s:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)


if __name__ == "__main__":
    main()
