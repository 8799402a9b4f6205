#!/usr/bin/env python3
"""Is the cloud right whenever a night is called good?  Changes one thing at a time on small sites with known truth.

    bench_site_faults.py FOLDER [--scenes yard carpark ...] [--everywhere] [--only WORD ...] [--quick] [--json FILE]

Renders the scenes into FOLDER, or writes photographs there, and runs two nights of each.  Then, for each variation of
`VARIATIONS`, it makes a copy of the scene, changes the copy and runs it.  Results stay in FOLDER/results: a second call resumes
where the first stopped, and prints all results.  A result is that of the last run of its copy.  With --quick, a copy with a fault
is run only up to its poses if these are already found to be wrong; its cloud is not measured.

- **Fault**: exit code 0 is a lie if less than 90 % of the points lie within the tolerance of the true surface.
- **Harmless**: any exit code other than 0 is a false alarm.
- **Invisible**: no evidence in the images can show it; `why` has the proof.

The exit code is 1 if there is a lie or a false alarm.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import scenes  # noqa: F401  # adds its scenes to the table
import yaml
from bench_certainty import errors_along_rays
from obstructions import barred, dirty, flared, hidden, netted, overgrown, scratched, webbed, with_drops
from photograph_site import write_photographs
from scipy.spatial import cKDTree

from wbflow.cache.ply import read_ply
from wbflow.commands.demo import write_demo
from wbflow.pipeline.summaries import PosesSummary
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.types import Float64s, Uint8s

RIGHT = 0.9
REFUTABLE = {"camera-unverified", "poses-contradicted"}
"""Findings that dense matching may refute, like a contradiction without a named cause.  With --quick, a copy that has no others
after its poses is run to the end."""
NIGHTS = ("2026-11-19", "2026-11-20")


@dataclass(frozen=True)
class Scene:
    """A small demo site, or photographs; fitted: the limits of the checks were fitted on this scene."""

    render: dict[str, Any]
    tolerance_m: float
    fitted: bool


PAVILION = [f"c{k:03}" for k in (76, 81, 86, 91, 96, 1, 6)]
"""Seven neighbours of the twenty cameras around the hall."""

SCENES = {
    "yard": Scene({"scene": "yard"}, 0.2, fitted=True),
    "carpark": Scene({"scene": "carpark"}, 0.2, fitted=True),
    "apron": Scene({"scene": "apron", "cameras": 5}, 0.5, fitted=False),
    "stadium": Scene({"scene": "stadium", "cameras": 5}, 0.5, fitted=False),
    "yard-5": Scene({"scene": "yard", "seed": 5, "cameras": 5}, 0.2, fitted=False),
    "yard-5-lamps": Scene({"scene": "yard", "seed": 5, "cameras": 5, "light": "night"}, 0.2, fitted=False),
    "yard-5-dusk": Scene({"scene": "yard", "seed": 5, "cameras": 5, "light": "dusk"}, 0.2, fitted=False),
    "yard-5-wet": Scene({"scene": "yard", "seed": 5, "cameras": 5, "surfaces": "weak"}, 0.2, fitted=False),
    "quarry": Scene({"scene": "quarry", "cameras": 5}, 0.3, fitted=False),
    "platform": Scene({"scene": "platform", "cameras": 8}, 0.2, fitted=False),
    "warehouse": Scene({"scene": "warehouse", "cameras": 5}, 0.2, fitted=False),
    "building": Scene({"scene": "building", "cameras": 5}, 0.3, fitted=False),
    "harbour": Scene({"scene": "harbour", "cameras": 5}, 0.3, fitted=False),
    "solar": Scene({"scene": "solar", "cameras": 5}, 0.3, fitted=False),
    "tankfarm": Scene({"scene": "tankfarm", "cameras": 5}, 0.2, fitted=False),
    "park": Scene({"scene": "park", "cameras": 5}, 0.2, fitted=False),
    "market": Scene({"scene": "market", "cameras": 5}, 0.2, fitted=False),
    "railyard": Scene({"scene": "railyard", "cameras": 5}, 0.2, fitted=False),
    "workshop": Scene({"scene": "workshop", "cameras": 5}, 0.15, fitted=False),
    "tankfarm-few": Scene({"scene": "tankfarm", "cameras": 3}, 0.2, fitted=False),
    "harbour-few": Scene({"scene": "harbour", "cameras": 3}, 0.3, fitted=False),
    "building-few": Scene({"scene": "building", "cameras": 3}, 0.3, fitted=False),
    "study": Scene({"scene": "study"}, 0.1, fitted=False),
    "containers": Scene({"scene": "containers"}, 0.2, fitted=False),
    "houses": Scene({"scene": "houses"}, 0.3, fitted=False),
    "hall": Scene({"scene": "hall", "cameras": 6}, 0.2, fitted=False),
    "construction": Scene({"scene": "construction", "cameras": 5}, 0.3, fitted=False),
    "substation": Scene({"scene": "substation", "cameras": 5}, 0.3, fitted=False),
    "fountain": Scene({"photographs": "fountain", "cameras": [f"{k:04}" for k in range(0, 11, 2)]}, 0.1, fitted=False),
    "pavilion": Scene({"photographs": "pavilion", "cameras": PAVILION}, 0.08, fitted=False),
    "entry": Scene({"photographs": "entry", "cameras": [f"{k:04}" for k in range(0, 9, 2)]}, 0.2, fitted=False),
}


class TooFewCameras(Exception):
    """A variation concerns a camera that a scene does not have."""


class Site:
    """A copy of a site, which variations may change."""

    def __init__(self, folder: Path, night: str) -> None:
        self.folder, self.night = folder, night
        self.calibration: dict[str, Any] = json.loads((folder / "cameras.json").read_text())
        self.file: dict[str, Any] = yaml.safe_load((folder / "site.yaml").read_text())
        self.names = list(self.calibration)
        self.run_options: list[str] = []

    def write(self) -> None:
        """Write calibration and site file."""
        (self.folder / "cameras.json").write_text(json.dumps(self.calibration))
        (self.folder / "site.yaml").write_text(yaml.safe_dump(self.file, sort_keys=False))

    def files(self, camera: str) -> list[Path]:
        """Tonight's captures of a camera."""
        return sorted((self.folder / "captures" / camera).glob(f"{self.night}_*.jpg"))

    def cameras(self, which: Sequence[int] | None = None) -> list[dict[str, Any]]:
        """Entries of the calibration: all, or by number."""
        return [self.calibration[name] for name in self.chosen(which)]

    def chosen(self, which: Sequence[int] | None) -> list[str]:
        """Names of cameras: all, or by number."""
        if which and max(which) >= len(self.names):
            raise TooFewCameras
        return self.names if which is None else [self.names[k] for k in which]

    def pictures(self, change: Callable[[Uint8s], Uint8s], which: Sequence[int] | None = None, quality: int = 95) -> None:
        """Change tonight's pictures."""
        for name in self.chosen(which):
            for file in self.files(name):
                image = cv2.imread(str(file))
                assert image is not None
                cv2.imwrite(str(file), change(image.astype(np.uint8)), [cv2.IMWRITE_JPEG_QUALITY, quality])


Change = Callable[[Site], None]


@dataclass(frozen=True)
class Variation:
    """One thing that differs from the site as it was rendered."""

    name: str
    kind: Literal["fault", "harmless", "invisible"]
    change: Change
    causes: tuple[str, ...] = ()
    """Right explanations: each a `cause` of the calibration check or a kind of finding."""
    on: tuple[str, ...] = ("yard",)
    night: int = 1
    """The night that is run, 1 or 2; the second night has the first as reference."""
    why: str = ""


@dataclass
class Result:
    """The outcome of a variation."""

    scene: str
    name: str
    kind: str
    exit: int
    right: float | None
    """Share of all points within the tolerance of the true surface."""
    points: int
    sigma_mm: float | None
    """Median of the cloud's `sigma_mm`."""
    within_3_sigma: float | None
    findings: list[str] = field(default_factory=list)
    cause: str = ""
    cause_right: bool | None = None
    text: str = ""
    cpu: float = 0.0


# --- what may be wrong -------------------------------------------------------------------------------------------------------


def focal(factor: float, which: Sequence[int] | None = None, axes: Sequence[int] = (0, 1)) -> Change:
    def change(site: Site) -> None:
        for camera in site.cameras(which):
            for k in axes:
                camera["K"][k][k] *= factor

    return change


def distortion(factor: float, which: Sequence[int] | None = None, only: Sequence[int] = (0, 1, 2, 3, 4)) -> Change:
    def change(site: Site) -> None:
        for camera in site.cameras(which):
            camera["distortion"] = [d * factor if k in only else d for k, d in enumerate(camera["distortion"])]

    return change


def principal(dx: float, dy: float, which: Sequence[int] | None = None) -> Change:
    def change(site: Site) -> None:
        for camera in site.cameras(which):
            camera["K"][0][2] += dx
            camera["K"][1][2] += dy

    return change


def turn(degrees: tuple[float, float, float], which: Sequence[int] | None = None) -> Change:
    def change(site: Site) -> None:
        for camera in site.cameras(which):
            camera["R"] = (rotation_matrix(np.radians(degrees)) @ np.array(camera["R"])).tolist()

    return change


def turn_at_random(degrees: float, which: Sequence[int] | None = None) -> Change:
    def change(site: Site) -> None:
        rng = np.random.default_rng(1)
        for camera in site.cameras(which):
            w = rng.normal(size=3)
            w *= np.radians(degrees) / np.linalg.norm(w)
            camera["R"] = (rotation_matrix(w) @ np.array(camera["R"])).tolist()

    return change


def move(metres: tuple[float, float, float], which: Sequence[int]) -> Change:
    def change(site: Site) -> None:
        for camera in site.cameras(which):
            camera["C"] = (np.array(camera["C"]) + metres).tolist()

    return change


def centres(change_of: Callable[[Float64s], Float64s], which: Sequence[int] | None = None) -> Change:
    """Change positions; change_of: maps a (3,) position to the stated one."""

    def change(site: Site) -> None:
        for camera in site.cameras(which):
            camera["C"] = np.asarray(change_of(np.array(camera["C"]))).tolist()

    return change


def rotations(change_of: Callable[[Float64s], Float64s], which: Sequence[int] | None = None) -> Change:
    def change(site: Site) -> None:
        for camera in site.cameras(which):
            camera["R"] = np.asarray(change_of(np.array(camera["R"]))).tolist()

    return change


def half_surveyed_otherwise(metres: tuple[float, float, float], degrees: float = 0.0) -> Change:
    """Every second camera was surveyed in another frame; degrees: by which that is turned about the vertical."""

    def change(site: Site) -> None:
        which = range(0, len(site.names), 2)
        centres(lambda C: C + metres, which)(site)
        turned_by_compass(degrees, which)(site)

    return change


def turned_by_compass(degrees: float, which: Sequence[int] | None = None) -> Change:
    """Rotations about the world's vertical: headings from a compass, without the declination."""
    Q = rotation_matrix(np.radians([0.0, 0.0, degrees]))
    return rotations(lambda R: R @ Q.T, which)


def at_random(metres: float = 0.0, focal_share: float = 0.0) -> Change:
    """Random errors of all positions and of all focal lengths, with these standard deviations (of positions, along each axis)."""

    def change(site: Site) -> None:
        rng = np.random.default_rng(5)
        for k, camera in enumerate(site.cameras()):
            camera["C"] = (np.array(camera["C"]) + rng.normal(0, metres, 3)).tolist()
            focal(1 + rng.normal(0, focal_share), (k,))(site)

    return change


def decentred(p: float, which: Sequence[int] | None = None) -> Change:
    """Tangential distortion that is off by p."""

    def change(site: Site) -> None:
        for camera in site.cameras(which):
            k1, k2, p1, p2, k3 = camera["distortion"]
            camera["distortion"] = [k1, k2, p1 + p, p2 - p, k3]

    return change


def copied(keys: Sequence[str], which: Sequence[int] | None = None) -> Change:
    """Parts of the first camera's calibration were copied to others."""

    def change(site: Site) -> None:
        first = site.cameras((0,))[0]
        for camera in site.cameras(which):
            camera.update(deepcopy({key: first[key] for key in keys}))

    return change


def together(*changes: Change) -> Change:
    def change(site: Site) -> None:
        for one in changes:
            one(site)

    return change


def exchange(keys: Sequence[str], one: int = 0, other: int = 1) -> Change:
    def change(site: Site) -> None:
        a, b = site.cameras((one, other))
        for key in keys:
            a[key], b[key] = b[key], a[key]

    return change


def without_poses(which: Sequence[int], wrong: Change | None = None) -> Change:
    def change(site: Site) -> None:
        if wrong:
            wrong(site)
        for camera in site.cameras(which):
            del camera["R"], camera["C"]

    return change


def all_poses_but_two_withheld(site: Site) -> None:
    without_poses(range(2, len(site.names)))(site)


def as_t(site: Site) -> None:
    """State the t of x = R X + t instead of the position."""
    for camera in site.cameras():
        camera["C"] = (-np.array(camera["R"]) @ np.array(camera["C"])).tolist()


def distances(*factors: float) -> Change:
    """State true distances between cameras, each times a factor."""

    def change(site: Site) -> None:
        pairs = [(0, 1), (1, 2), (0, 2)]
        rows = []
        for (i, j), factor in zip(pairs, factors, strict=False):
            a, b = site.cameras((i, j))
            length = float(np.linalg.norm(np.array(a["C"]) - np.array(b["C"])))
            rows.append([site.names[i], site.names[j], length * factor])
        site.file["distances"] = rows

    return change


def pictures(change_of: Callable[[Uint8s], Uint8s], which: Sequence[int] | None = None, quality: int = 95) -> Change:
    return lambda site: site.pictures(change_of, which, quality)


def blurred(sigma: float) -> Callable[[Uint8s], Uint8s]:
    return lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), np.uint8)


def smeared(pixels: int) -> Callable[[Uint8s], Uint8s]:
    return lambda image: np.asarray(cv2.blur(image, (pixels, 1)), np.uint8)


def noisy(sigma: float) -> Callable[[Uint8s], Uint8s]:
    def change(image: Uint8s) -> Uint8s:
        noise = np.random.default_rng(int(image.astype(np.int64).sum()) % 2**31).normal(0, sigma, image.shape)
        return np.asarray(np.clip(image + noise, 0, 255), np.uint8)

    return change


def zoomed(factor: float) -> Callable[[Uint8s], Uint8s]:
    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        warp = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), 0, factor)
        return np.asarray(cv2.warpAffine(image, warp, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)

    return change


def shifted(dx: float, dy: float) -> Callable[[Uint8s], Uint8s]:
    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        warp = np.array([[1, 0, dx], [0, 1, dy]], np.float64)
        return np.asarray(cv2.warpAffine(image, warp, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)

    return change


def sheared(pixels: float) -> Callable[[Uint8s], Uint8s]:
    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        warp = np.array([[1, pixels / h, -pixels / 2], [0, 1, 0]], np.float64)
        return np.asarray(cv2.warpAffine(image, warp, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)

    return change


def stretched(factor: float) -> Callable[[Uint8s], Uint8s]:
    """Images stretched in x and cropped to the same size: non-square pixels."""

    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        warp = np.array([[factor, 0, (1 - factor) * (w - 1) / 2], [0, 1, 0]], np.float64)
        return np.asarray(cv2.warpAffine(image, warp, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)

    return change


def smaller(factor: float) -> Callable[[Uint8s], Uint8s]:
    """Images reduced by a factor and enlarged again."""

    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        few = cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.resize(few, (w, h), interpolation=cv2.INTER_LINEAR), np.uint8)

    return change


def levels(gain: float, offset: float = 0.0, gamma: float = 1.0) -> Callable[[Uint8s], Uint8s]:
    return lambda image: np.asarray(np.clip(255 * (image / 255.0) ** gamma * gain + offset, 0, 255), np.uint8)


def snowy(image: Uint8s) -> Uint8s:
    """Bright ground, little contrast, bluish."""
    return np.asarray(np.clip((0.55 * image + 110) * np.array([1.04, 1.0, 0.97]), 0, 255), np.uint8)


def rainy(image: Uint8s) -> Uint8s:
    """Streaks at different places in each image, and haze."""
    h, w = image.shape[:2]
    rng = np.random.default_rng(int(image.astype(np.int64).sum()) % 2**31)
    streaks = np.zeros((h, w), np.uint8)
    for x, y in rng.uniform(0, [w, h], (h * w // 400, 2)).astype(int).tolist():
        cv2.line(streaks, (x, y), (x + 1, y + 7), 60, 1)
    return np.asarray(np.clip(0.8 * image + 30 + streaks[..., None], 0, 255), np.uint8)


def sensed(image: Uint8s) -> Uint8s:
    """Photon noise, whose variance grows with brightness, and read noise."""
    rng = np.random.default_rng(int(image.astype(np.int64).sum()) % 2**31)
    return np.asarray(np.clip(image + rng.normal(size=image.shape) * np.sqrt(2.0 + 0.06 * image), 0, 255), np.uint8)


def tinted(image: Uint8s) -> Uint8s:
    return np.asarray(np.clip(image * np.array([0.8, 1.0, 1.15]), 0, 255), np.uint8)


def grey(image: Uint8s) -> Uint8s:
    return np.asarray(cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR), np.uint8)


def cropped(share: float) -> Callable[[Uint8s], Uint8s]:
    """The middle of the image, in fewer pixels: a recorder that crops instead of scaling."""

    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        y, x = (round(side * (1 - share) / 2) for side in (h, w))
        return np.ascontiguousarray(image[y : h - y, x : w - x])

    return change


def torn(pixels: int) -> Callable[[Uint8s], Uint8s]:
    """The lower 45 % of the image is displaced in x: the camera shook during readout."""

    def change(image: Uint8s) -> Uint8s:
        at = image.shape[0] * 55 // 100
        return np.concatenate([image[:at], np.roll(image[at:], pixels, axis=1)])

    return change


def interlaced(pixels: int) -> Callable[[Uint8s], Uint8s]:
    def change(image: Uint8s) -> Uint8s:
        image[1::2] = np.roll(image[1::2], pixels, axis=1)
        return image

    return change


def vignetted(least: float) -> Callable[[Uint8s], Uint8s]:
    """Darker toward the corners."""

    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        y, x = np.mgrid[-1 : 1 : h * 1j, -1 : 1 : w * 1j]
        return np.asarray(image * (1 - (1 - least) * (x**2 + y**2)[..., None] / 2), np.uint8)

    return change


def drops(share: float, which: Sequence[int]) -> Change:
    """Water drops on the glass of cameras."""

    def change(site: Site) -> None:
        for k in which:
            site.pictures(with_drops(share, k), (k,))

    return change


def obstructed(obstruction: Callable[[Uint8s, np.random.Generator], Uint8s]) -> Change:
    """Something at the same places in all images of a camera, and at other places in those of each other camera."""

    def change(site: Site) -> None:
        for k in range(len(site.names)):
            site.pictures(lambda image, k=k: obstruction(image, np.random.default_rng(100 + k)), (k,))  # type: ignore[misc]

    return change


def unfinished(image: Uint8s) -> Uint8s:
    """The lower half of the image was not transmitted, and is grey."""
    image = image.copy()
    image[len(image) // 2 :] = 128
    return image


def infrared(image: Uint8s) -> Uint8s:
    """An infrared image lit by the camera's own lamps: grey, dark toward the corners, noisy."""
    return noisy(8)(vignetted(0.3)(grey(image)))


def boxed(image: Uint8s) -> Uint8s:
    """The image scaled to three quarters, with a black border."""
    h, w = image.shape[:2]
    small = cv2.resize(image, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
    y, x = (h - len(small)) // 2, (w - small.shape[1]) // 2
    black = np.zeros_like(image)
    black[y : y + len(small), x : x + small.shape[1]] = small
    return black


def rolled(degrees: float) -> Callable[[Uint8s], Uint8s]:
    """Images rotated about their centre by the recorder."""

    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        warp = cv2.getRotationMatrix2D(((w - 1) / 2, (h - 1) / 2), degrees, 1)
        return np.asarray(cv2.warpAffine(image, warp, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)

    return change


def doubled(image: Uint8s) -> Uint8s:
    """A double image: the mast shook during the exposure."""
    return np.asarray(0.5 * image + 0.5 * np.roll(image, (2, 4), (0, 1)), np.uint8)


def wavy(pixels: float) -> Callable[[Uint8s], Uint8s]:
    """Rows displaced by a sine wave: a rolling shutter on a mast that sways."""

    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        y, x = np.mgrid[:h, :w].astype(np.float32)
        x += np.float32(pixels) * np.sin(y * np.float32(4 * np.pi / h))
        return np.asarray(cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)

    return change


def half_soft(image: Uint8s) -> Uint8s:
    """The lens is tilted: the right half is out of focus."""
    middle = image.shape[1] // 2
    return np.concatenate([image[:, :middle], cv2.GaussianBlur(image, (0, 0), 4)[:, middle:]], axis=1).astype(np.uint8)


def higher(image: Uint8s) -> Uint8s:
    """The image resampled to a third more rows: non-square pixels."""
    return np.asarray(cv2.resize(image, (image.shape[1], image.shape[0] * 4 // 3), interpolation=cv2.INTER_AREA), np.uint8)


def shimmering(pixels: float) -> Callable[[Uint8s], Uint8s]:
    """Hot air: smooth random displacements, different in each image; pixels: their standard deviation."""

    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        rng = np.random.default_rng(int(image.astype(np.int64).sum()) % 2**31)
        off = cv2.GaussianBlur(rng.normal(size=(h, w, 2)), (0, 0), 8)
        off *= pixels / off.std()
        y, x = np.mgrid[:h, :w]
        x, y = (x + off[..., 0]).astype(np.float32), (y + off[..., 1]).astype(np.float32)
        return np.asarray(cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)

    return change


def shaken(pixels: float) -> Callable[[Uint8s], Uint8s]:
    """Each frame is displaced by a random motion of this standard deviation along x and y: a mast in the wind."""

    def change(image: Uint8s) -> Uint8s:
        dx, dy = np.random.default_rng(int(image.astype(np.int64).sum()) % 2**31).normal(0, pixels, 2)
        return shifted(dx, dy)(image)

    return change


def keystone(image: Uint8s) -> Uint8s:
    """The recorder corrects converging verticals."""
    h, w = image.shape[:2]
    corners = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32)
    warp = cv2.getPerspectiveTransform(corners, corners + np.array([[0.04 * w, 0], [-0.04 * w, 0], [0, 0], [0, 0]], np.float32))
    return np.asarray(cv2.warpPerspective(image, warp, (w, h), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), np.uint8)


def branded(image: Uint8s) -> Uint8s:
    """The same logo and text at the same place in the images of all cameras."""
    h, w = image.shape[:2]
    image = image.copy()
    cv2.rectangle(image, (w * 7 // 10, h * 6 // 7), (w - 4, h - 4), (250, 250, 250), -1)
    cv2.putText(image, "CAM SITE", (w * 7 // 10 + 4, h - 10), cv2.FONT_HERSHEY_SIMPLEX, h / 360, (30, 30, 160), 1)
    cv2.putText(image, "2026-11-19 02:00", (4, 12), cv2.FONT_HERSHEY_SIMPLEX, h / 450, (255, 255, 255), 1)
    return image


def soft_colours(image: Uint8s) -> Uint8s:
    """Colours at a ninth of the resolution of brightness."""
    ycc = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    ycc[..., 1:] = cv2.blur(ycc[..., 1:], (9, 9))
    return np.asarray(cv2.cvtColor(ycc, cv2.COLOR_YCrCb2BGR), np.uint8)


def reflections(share: float) -> Change:
    """Each camera's window reflects the view of another camera."""

    def change(site: Site) -> None:
        seen = [cv2.imread(str(site.files(name)[0])) for name in site.names]
        for k in range(len(seen)):
            other = seen[(k + 1) % len(seen)]
            assert other is not None
            site.pictures(_with_reflection(np.asarray(other[:, ::-1], np.uint8), share), (k,))

    return change


def _with_reflection(other: Uint8s, share: float) -> Callable[[Uint8s], Uint8s]:
    return lambda image: np.asarray((1 - share) * image + share * cv2.resize(other, image.shape[1::-1]), np.uint8)


def sharpened(image: Uint8s) -> Uint8s:
    return np.asarray(np.clip(1.5 * image - 0.5 * cv2.GaussianBlur(image, (0, 0), 1.5), 0, 255), np.uint8)


def equalized(image: Uint8s) -> Uint8s:
    """Local contrast raised (CLAHE), as recorders do."""
    lab = cv2.cvtColor(image, cv2.COLOR_BGR2LAB)
    lab[..., 0] = cv2.createCLAHE(3.0, (8, 8)).apply(lab[..., 0])
    return np.asarray(cv2.cvtColor(lab, cv2.COLOR_LAB2BGR), np.uint8)


def foggy(image: Uint8s) -> Uint8s:
    return np.asarray(np.clip(0.6 * image + 0.4 * 190, 0, 255), np.uint8)


def exchanged_captures(order: Callable[[list[str]], list[str]]) -> Change:
    """Cameras deliver the captures of other cameras; order: maps all names to those whose captures they get."""

    def change(site: Site) -> None:
        content = {name: [file.read_bytes() for file in site.files(name)] for name in site.names}
        for name, other in zip(site.names, order(site.names), strict=True):
            for file, data in zip(site.files(name), content[other], strict=True):
                file.write_bytes(data)

    return change


def two_exchanged(names: list[str]) -> list[str]:
    return [names[1], names[0], *names[2:]]


def same_picture_twice(poses: bool) -> Change:
    def change(site: Site) -> None:
        exchanged_captures(lambda names: [names[0], names[0], *names[2:]])(site)
        if not poses:
            without_poses(range(len(site.names)))(site)

    return change


def other_scene(site: Site) -> None:
    """Camera 0 delivers images of another scene: random blocks."""
    rng = np.random.default_rng(3)
    site.pictures(
        lambda image: np.asarray(cv2.resize(rng.integers(0, 255, (20, 36, 3), np.uint8), image.shape[1::-1]), np.uint8), (0,)
    )


def one_camera_less(site: Site) -> None:
    gone = site.names[-1]
    site.file["cameras"] = [camera for camera in site.file["cameras"] if camera["id"] != gone]


def one_frame(site: Site) -> None:
    for name in site.names:
        for file in site.files(name)[1:]:
            file.unlink()


def no_masks(site: Site) -> None:
    for camera in site.file["cameras"]:
        camera.pop("mask", None)


def resolution(pixels: int) -> Change:
    return lambda site: site.file.update(resolution=pixels)


def rounded(digits: int) -> Change:
    def change(site: Site) -> None:
        for camera in site.cameras():
            for key in ("R", "C", "K", "distortion"):
                camera[key] = np.round(camera[key], digits).tolist()

    return change


def farther(metres: tuple[float, float, float]) -> Change:
    return centres(lambda C: C + np.array(metres))


def turned_world(site: Site) -> None:
    Q = rotation_matrix(np.array([0, 0, 0.17]))
    centres(lambda C: Q @ C)(site)
    rotations(lambda R: R @ Q.T)(site)


def of_other_size(factor: float, which: Sequence[int]) -> Change:
    """K belongs to images of another size than the calibration states."""

    def change(site: Site) -> None:
        for camera in site.cameras(which):
            camera["K"] = [[k * factor for k in row] for row in camera["K"][:2]] + [camera["K"][2]]

    return change


def other_night(which: Sequence[int]) -> Change:
    """Cameras deliver their captures of the other night."""

    def change(site: Site) -> None:
        other = NIGHTS[site.night == NIGHTS[0]]
        for k in which:
            for file in site.files(site.names[k]):
                file.write_bytes((file.parent / file.name.replace(site.night, other)).read_bytes())

    return change


def nothing(site: Site) -> None:
    pass


ALL = ("yard", "carpark", "apron", "stadium", "yard-5")
LIT = ("yard-5-lamps", "yard-5-dusk", "yard-5-wet")
NEW = ("quarry", "platform", "warehouse", "building")
MADE = ("yard", "building")
TWO = ("yard", "building")
THREE = (*TWO, "stadium")
SURVEYED = ("building", "study", "containers", "houses", "hall")
MIXED = ("railyard", "substation", "carpark", "platform", "solar", "tankfarm", "workshop", "harbour")
YZ = np.diag([1.0, -1.0, -1.0])
FOCAL = ("focal-lengths", "focal-lengths-and-distortion")
BENT = ("distortion", "distortion-factor", "focal-lengths-and-distortion")
ONE = ("turned", "moved", "camera-moved", "camera-unverified")


def _fault(name: str, change: Change, *causes: str, on: tuple[str, ...] = TWO, night: int = 1) -> Variation:
    return Variation(name, "fault", change, causes, on, night)


def _harmless(name: str, change: Change, on: tuple[str, ...] = ("yard",), night: int = 1) -> Variation:
    return Variation(name, "harmless", change, (), on, night)


VARIATIONS = (
    # lenses
    _fault("focal +3 %", focal(1.03), *FOCAL, on=ALL + NEW),
    _fault("focal +10 %", focal(1.1), *FOCAL, on=ALL),
    _fault("focal -5 %", focal(0.95), *FOCAL, on=ALL),
    _fault("focal x 2", focal(2.0), *FOCAL),
    _fault("focal of one +10 %", focal(1.1, (1,)), "focal-length", on=ALL),
    _fault("focal of one -4 %", focal(0.96, (0,)), "focal-length"),
    _fault("fx alone +6 %", focal(1.06, axes=(0,)), "pixel-shape"),
    _fault("distortion's sign", distortion(-1), *BENT, on=ALL),
    _fault("distortion left out", distortion(0), *BENT, on=ALL),
    _fault("distortion ten times", distortion(10), *BENT),
    _fault("distortion twice", distortion(2), *BENT),
    _fault("distortion of one left out", distortion(0, (1,)), "distortion-of-one"),
    _fault("k1 alone", distortion(0, only=(1, 2, 3, 4)), *BENT),
    _fault("principal points from the corner", principal(0.5, 0.5), "principal-points-corner", "pairs-disagree"),
    _fault("principal points 6 px", principal(6, 0), "principal-points", on=ALL),
    _fault("principal points 4 px down", principal(0, 4), "principal-points"),
    _fault("principal point of one 6 px", principal(6, 2, (2,)), "principal-point", *ONE),
    _fault("lenses of two exchanged", exchange(("K", "distortion")), "lenses-exchanged", "focal-length"),
    _fault("principal points of two 10 px", principal(10, 0, (0, 1)), "principal-point", "principal-points", "no-cause", *ONE),
    _fault("focal of one +5 %", focal(1.05, (2,)), "focal-length"),
    _fault("k1 of one left out", distortion(0, (2,), only=(0,)), "distortion-of-one"),
    _fault("fy alone +4 %", focal(1.04, axes=(1,)), "pixel-height"),
    _fault("two calibrated at another size", of_other_size(1.5, (0, 1)), "focal-length", "focal-lengths", "no-cause"),
    # poses
    _fault("one turned by .5 degrees", turn((0, 0.5, 0), (1,)), *ONE, on=ALL + NEW),
    _fault("one tilted by .5 degrees", turn((0.5, 0, 0), (0,)), *ONE),
    _fault("one turned by 2 degrees", turn((1, 1.73, 0), (1,)), *ONE, on=ALL),
    _fault("one turned by 10 degrees", turn((2, 10, 0), (2,)), *ONE),
    _fault("one rolled by 1 degree", turn((0, 0, 1), (1,)), *ONE, on=ALL),
    _fault("one moved by .3 m", move((0.3, 0, 0), (1,)), *ONE),
    _fault("one moved by .5 m", move((0, 0.5, 0), (0,)), *ONE, on=ALL),
    _fault("one raised by 1 m", move((0, 0, 1), (2,)), *ONE, on=ALL),
    _fault("one moved by 5 m", move((4, 3, 0), (1,)), *ONE),
    _fault("all turned at random by .3 degrees", turn_at_random(0.3), "no-cause"),
    _fault("all turned at random by 1 degree", turn_at_random(1.0), "no-cause"),
    _fault("all positions rounded to metres", centres(np.round), "no-cause"),
    _fault("two turned by 1 degree", turn_at_random(1.0, (0, 1)), "no-cause"),
    _fault("poses of two exchanged", exchange(("R", "C")), "exchanged", on=ALL),
    _fault("positions of two exchanged", exchange(("C",)), "positions-exchanged"),
    _fault("positions mirrored in x", centres(lambda C: C * (-1, 1, 1)), "mirrored-x", on=ALL),
    _fault("positions mirrored in z", centres(lambda C: C * (1, 1, -1)), "mirrored-z"),
    _fault("east and north exchanged", centres(lambda C: C[[1, 0, 2]]), "axes-exchanged"),
    _fault("heights left out", centres(lambda C: C * (1, 1, 0)), "no-cause"),
    _fault("rotations from camera to world", rotations(lambda R: R.T), "rotations-transposed"),
    _fault("rotations in OpenGL's axes", rotations(lambda R: YZ @ R), "rotations-opengl"),
    _fault("t in place of positions", as_t, "t-for-positions"),
    _fault("two stated wrongly, others free", without_poses((2, 3), turn_at_random(2.0, (0, 1))), "no-cause"),
    _fault("two stated, one moved, others free", without_poses((2, 3), move((1.0, 1.0, 0), (0,))), "no-cause"),
    _fault("one stated wrongly, one free", without_poses((3,), turn((0, 2, 0), (0,))), *ONE),
    _fault("two rolled by 1 degree", turn((0, 0, 1), (0, 2)), "no-cause", *ONE),
    _fault("all rolled by 1 degree", turn((0, 0, 1)), "rolls"),
    _fault("all turned by 1 degree, each about itself", turn((0, 1, 0)), "no-cause", "principal-points"),
    _fault("poses of two others exchanged", exchange(("R", "C"), 1, 3), "exchanged"),
    _fault("positions stretched by 1.05 to the east", centres(lambda C: C * (1.05, 1, 1)), "no-cause", "stretched-x"),
    _fault("one raised by .4 m", move((0, 0, 0.4), (1,)), *ONE),
    _fault("one moved by 1 m", move((-0.8, 0.6, 0), (2,)), *ONE),
    # units
    _fault("one position in feet", centres(lambda C: C * 3.28, (1,)), *ONE),
    _fault("positions in millimetres", centres(lambda C: C * 1000), "units-implausible", on=ALL),
    _fault("positions in kilometres", centres(lambda C: C / 1000), "units-implausible"),
    _fault("one position in millimetres", centres(lambda C: C * 1000, (1,)), *ONE, "units-implausible"),
    _fault("a distance ten times too long", distances(10.0), "distances-contradicted"),
    _fault("two distances that contradict each other", distances(1.0, 2.7), "distances-contradicted"),
    _fault("three distances, one 30 % too long", distances(1.0, 1.3, 1.0), "distances-contradicted"),
    # pictures
    _fault("all blurred by 1.5 px", pictures(blurred(1.5)), "pictures-soft"),
    _fault("all blurred by 2 px", pictures(blurred(2.0)), "pictures-soft", on=ALL + NEW),
    _fault("all blurred by 4 px", pictures(blurred(4.0)), "pictures-soft"),
    _fault("one blurred by 4 px", pictures(blurred(4.0), (0,)), "pictures-soft"),
    _fault("all smeared by 9 px", pictures(smeared(9)), "pictures-soft"),
    _fault("JPEG quality 3", pictures(lambda p: p, quality=3), "pictures-soft", on=ALL),
    _fault("JPEG quality 8", pictures(lambda p: p, quality=8), "pictures-soft"),
    _fault("JPEG quality 15", pictures(lambda p: p, quality=15), "pictures-soft"),
    _fault("noise of 20 levels", pictures(noisy(20)), "pictures-soft"),
    _fault("noise of 50 levels", pictures(noisy(50)), "pictures-soft"),
    _fault("enlarged three times", pictures(smaller(3)), "pictures-soft"),
    _fault("overexposed", pictures(levels(3.0)), "pictures-soft"),
    _fault("vignetting", pictures(vignetted(0.15)), "pictures-soft"),
    _fault("drops on a third of one picture", drops(0.33, (1,)), "camera-obscured", "pictures-soft"),
    _fault("drops on a third of three pictures", drops(0.33, (0, 1, 2)), "camera-obscured", "pictures-soft", on=THREE),
    _fault("interlaced by 3 px", pictures(interlaced(3)), "pictures-soft"),
    _fault("half the size and back", pictures(smaller(2)), "pictures-soft"),
    _fault("noise of 12 levels", pictures(noisy(12)), "pictures-soft"),
    _fault("JPEG quality 20", pictures(lambda p: p, quality=20), "pictures-soft"),
    _fault("infrared with noise", pictures(infrared), "pictures-soft", on=MADE),
    _fault("a web on one picture", pictures(webbed, (1,)), "camera-obscured", on=MADE),
    _fault("webs on all pictures", pictures(webbed), "camera-obscured", "pictures-soft", on=MADE),
    _fault("a lorry before one camera", pictures(hidden, (2,)), "camera-obscured", on=MADE),
    _fault("lorries before all cameras", pictures(hidden), "camera-obscured", on=MADE),
    _fault("all doubled", pictures(doubled), "pictures-soft", on=MADE),
    _fault("one doubled", pictures(doubled, (1,)), "pictures-soft", on=MADE),
    _fault("right halves out of focus", pictures(half_soft), "pictures-soft", on=MADE),
    # captures
    _fault("lower half of one lost", pictures(unfinished, (0,)), "camera-lost", on=MADE),
    _fault("lower half of all lost", pictures(unfinished), "camera-lost", on=MADE),
    _fault("frames of all boxed", pictures(boxed), *FOCAL, on=MADE),
    _fault("frames of one boxed", pictures(boxed, (2,)), "focal-length", on=MADE),
    _fault("frames of one rolled by 5 degrees", pictures(rolled(5), (1,)), *ONE, on=MADE),
    _fault("frames of all rolled by 3 degrees", pictures(rolled(3)), "rolls", on=MADE),
    _fault("frames of all higher by a third", pictures(higher), "pixel-height", "pixel-shape", on=MADE),
    _fault("frames of all wavy by 3 px", pictures(wavy(3)), "pairs-disagree", on=MADE),
    _fault("frames of one wavy by 2 px", pictures(wavy(2), (1,)), "pairs-disagree", on=MADE),
    _fault("frames of all cropped to .8", pictures(cropped(0.8)), *FOCAL, "pixel-shape"),
    _fault("frames of one cropped to .8", pictures(cropped(0.8), (1,)), "focal-length"),
    _fault("frames of one torn by 12 px", pictures(torn(12), (0,)), *ONE, "no-cause", "pairs-disagree", on=THREE),
    _fault("frames of one sheared by 6 px", pictures(sheared(6), (1,)), *ONE, "no-cause"),
    _fault("frames of two mirrored", pictures(lambda p: p[:, ::-1], (0, 1)), "mirrored-frames"),
    _fault("frames of all zoomed by 1.2", pictures(zoomed(1.2)), *FOCAL, on=ALL),
    _fault("frames of all zoomed by .95", pictures(zoomed(0.95)), *FOCAL),
    _fault("frames of one zoomed by 1.1", pictures(zoomed(1.1), (1,)), "focal-length"),
    _fault("frames of all shifted by 6 px", pictures(shifted(6, 0)), "principal-points", on=ALL),
    _fault("frames of one shifted by 6 px", pictures(shifted(6, -3), (0,)), "turned", "principal-point"),
    _fault("frames of all sheared by 8 px", pictures(sheared(8)), "skew"),
    _fault("frames of all stretched by 1.06", pictures(stretched(1.06)), "pixel-shape"),
    _fault("frames of all mirrored", pictures(lambda p: p[:, ::-1]), "mirrored-frames"),
    _fault("frames of one mirrored", pictures(lambda p: p[:, ::-1], (1,)), "mirrored-frames"),
    _fault("frames of one upside down", pictures(lambda p: p[::-1, ::-1], (1,)), "upside-down", "turned", "camera-moved"),
    _fault("captures of two exchanged", exchanged_captures(two_exchanged), "captures-exchanged", on=ALL),
    _fault("captures of all rotated", exchanged_captures(lambda n: [*n[1:], n[0]]), "captures-exchanged"),
    _fault("the same picture twice", same_picture_twice(True), "cameras-alike"),
    _fault("the same picture twice, poses solved", same_picture_twice(False), "cameras-alike"),
    _fault("one shows another scene", other_scene, "camera-no-usable-pair", "camera-foreign"),
    # second nights
    _fault("second night: focal +10 %", focal(1.1), *FOCAL, night=2),
    _fault("second night: distortion left out", distortion(0), *BENT, night=2),
    _fault("second night: one turned by .5 degrees", turn((0, 0.5, 0), (1,)), *ONE, night=2),
    _fault("second night: one moved by .5 m", move((0, 0.5, 0), (0,)), *ONE, night=2),
    _fault("second night: millimetres", centres(lambda C: C * 1000), "units-implausible", night=2),
    _fault("second night: frames zoomed by 1.2", pictures(zoomed(1.2)), *FOCAL, night=2),
    _fault("second night: frames shifted by 6 px", pictures(shifted(6, 0)), "camera-shifted", night=2),
    _fault("second night: captures of two exchanged", exchanged_captures(two_exchanged), "captures-exchanged", night=2),
    _fault("second night: all blurred by 2 px", pictures(blurred(2.0)), "pictures-soft", night=2),
    _fault("second night: hot air, 1 px", pictures(shimmering(1.0)), "pictures-soft", night=2),
    _fault("second night: webs on all pictures", pictures(webbed), "camera-obscured", "pictures-soft", night=2),
    _fault("second night: nets before all cameras", obstructed(netted), "camera-obscured", "pictures-soft", night=2),
    # added last; limits for tilted cameras, focal lengths, distortion and fog were fitted on another yard and a quarry
    _fault("all tilted by .5 degrees", turn((0.5, 0, 0)), "no-cause", "principal-points"),
    _fault("focal +1.5 %", focal(1.015), *FOCAL),
    _fault("half the distortion", distortion(0.5), *BENT),
    _fault("heights times 1.2", centres(lambda C: C * (1, 1, 1.2)), "no-cause", "stretched-z"),
    _fault("thick fog", pictures(levels(0.15, 170)), "pictures-soft"),
    _fault("underexposed", pictures(levels(0.15)), "pictures-soft"),
    _fault("hot air, 1 px", pictures(shimmering(1.0)), "pictures-soft"),
    _fault("hot air, 2 px", pictures(shimmering(2.0)), "pictures-soft"),
    _fault("reflections on all windows", reflections(0.3), "camera-obscured", "pictures-soft"),
    _fault("railings before all cameras", pictures(barred), "camera-obscured", "pictures-soft"),
    *(
        _fault(f"{name} before all cameras", obstructed(obstruction), "camera-obscured", "pictures-soft")
        for name, obstruction in (
            ("nets", netted),
            ("dirt", dirty),
            ("scratches", scratched),
            ("branches", overgrown),
            ("flares", flared),
        )
    ),
    _harmless("sharpened", pictures(sharpened), TWO),
    _harmless("contrast raised by parts", pictures(equalized), TWO),
    # errors of whole surveys, and two faults at once
    _fault("half surveyed 1 m farther east", half_surveyed_otherwise((1, 0, 0)), "no-cause", on=SURVEYED),
    _fault("half surveyed .5 m higher", half_surveyed_otherwise((0, 0, 0.5)), "no-cause", on=SURVEYED),
    _fault("half surveyed with other headings", half_surveyed_otherwise((0, 0, 0), 0.7), "no-cause", on=SURVEYED),
    _fault("all headings off by 2 degrees", turned_by_compass(2.0), "headings", on=SURVEYED),
    _fault("all headings off by .6 degrees", turned_by_compass(0.6), "headings", on=SURVEYED),
    _fault("positions at random by .2 m", at_random(metres=0.2), "no-cause", on=SURVEYED),
    _fault("focal lengths at random by 2 %", at_random(focal_share=0.02), "no-cause", on=SURVEYED),
    _fault("tangential distortion of all off", decentred(0.01), "no-cause", on=SURVEYED),
    _fault("tangential distortion of one off", decentred(0.02, (1,)), *ONE, on=SURVEYED),
    _fault("lens of the first for all", copied(("K", "distortion")), "no-cause", "focal-length", on=SURVEYED),
    _fault("pose of the first for the second", copied(("R", "C"), (1,)), *ONE, on=SURVEYED),
    _fault("all shaken by 2 px", pictures(shaken(2.0)), "pictures-soft", on=SURVEYED),
    _fault("one shaken by 4 px", pictures(shaken(4.0), (1,)), "pictures-soft", *ONE, on=SURVEYED),
    _fault("keystone of one", pictures(keystone, (0,)), *ONE, on=SURVEYED),
    _fault("keystone of all", pictures(keystone), "no-cause", "pixel-shape", on=SURVEYED),
    _fault("focal +2 %, half the distortion", together(focal(1.02), distortion(0.5)), *FOCAL, *BENT, on=SURVEYED),
    _fault("focal +3 %, one turned by .5 degrees", together(focal(1.03), turn((0, 0.5, 0), (1,))), *FOCAL, *ONE, on=SURVEYED),
    _fault("one turned, another moved", together(turn((0.3, 0.4, 0), (0,)), move((0.3, 0.4, 0), (2,))), *ONE, on=SURVEYED),
    _fault("two turned apart", together(turn((0, 0.5, 0), (0,)), turn((0, -0.5, 0), (2,))), "no-cause", *ONE, on=SURVEYED),
    _fault("second night: half surveyed 1 m farther east", half_surveyed_otherwise((1, 0, 0)), "no-cause", on=SURVEYED, night=2),
    _harmless("a logo on all", pictures(branded), SURVEYED),
    _harmless("one with red for blue", pictures(lambda p: np.ascontiguousarray(p[..., ::-1]), (1,)), SURVEYED),
    _harmless("soft colours", pictures(soft_colours), SURVEYED),
    _harmless("all headings off by .02 degrees", turned_by_compass(0.02), SURVEYED),
    _harmless("focal lengths at random by .1 %", at_random(focal_share=0.001), SURVEYED),
    _harmless("positions at random by 6 mm", at_random(metres=0.006), SURVEYED),
    _harmless("one of gamma 1.5", pictures(levels(1, gamma=1.5), (1,)), SURVEYED),
    # invisible
    Variation("positions x 1.1", "invisible", centres(lambda C: C * 1.1), on=TWO,
              why="x ~ K R (sX - sC) = K R (X - C): every picture of a world times s is the same"),
    Variation("positions in feet", "invisible", centres(lambda C: C * 3.28), on=TWO,
              why="as before: a world in another unit shows in no picture; a stated distance tells (distances-contradicted)"),
    Variation("positions 100 m farther east", "invisible", farther((100.0, 0.0, 0.0)), on=TWO,
              why="x ~ K R ((X + d) - (C + d)): every picture of a moved world is the same"),
    Variation("world turned by 10 degrees", "invisible", turned_world, on=TWO,
              why="x ~ K (R Q') (Q X - Q C): every picture of a turned world is the same"),
    # harmless
    _harmless("as it is", nothing, (*ALL, *LIT, *NEW, *SURVEYED[1:])),
    _harmless("second night as it is", nothing, (*ALL, *SURVEYED), night=2),
    _harmless("grey", pictures(grey)),
    _harmless("one grey", pictures(grey, (1,))),
    _harmless("tinted", pictures(tinted)),
    _harmless("fog", pictures(foggy)),
    _harmless("darker", pictures(levels(0.6))),
    _harmless("brighter", pictures(levels(1.2, 10))),
    _harmless("gamma .7", pictures(levels(1, gamma=0.7))),
    _harmless("one darker", pictures(levels(0.7), (0,))),
    _harmless("noise of 4 levels", pictures(noisy(4))),
    _harmless("JPEG quality 70", pictures(lambda p: p, quality=70)),
    _harmless("JPEG quality 50", pictures(lambda p: p, quality=50)),
    _harmless("blurred by .5 px", pictures(blurred(0.5))),
    _harmless("one frame", one_frame),
    _harmless("one camera less", one_camera_less, TWO),
    _harmless("without masks", no_masks),
    _harmless("at 240 pixels", resolution(240)),
    _harmless("calibration of four digits", rounded(4)),
    _harmless("UTM coordinates", farther((389000.0, 5820000.0, 40.0))),
    _harmless("true distances", distances(1.0, 1.0), ("yard",)),
    _harmless("one pose withheld", without_poses((1,))),
    _harmless("snow light", pictures(snowy)),
    _harmless("rain", pictures(rainy)),
    _harmless("noise of a sensor", pictures(sensed)),
    _harmless("one overexposed by a half", pictures(levels(1.5), (2,))),
    _harmless("two of the other night", other_night((0, 1))),
    _harmless("at 400 pixels", resolution(400)),
    _harmless("some vignetting", pictures(vignetted(0.6))),
    _harmless("two cameras grey", pictures(grey, (0, 1))),
    _harmless("a drop on one picture", drops(0.04, (1,))),
    _harmless("lenses given, poses solved", without_poses((0, 1, 2, 3))),
    _harmless("second night: snow light", pictures(snowy), night=2),
    _harmless("second night: rain", pictures(rainy), night=2),
    _harmless("second night: one camera less", one_camera_less, night=2),
    _harmless("second night: noise of a sensor", pictures(sensed), night=2),
    _harmless("second night: grey", pictures(grey), night=2),
    _harmless("second night: darker", pictures(levels(0.6)), night=2),
    _harmless("second night: fog", pictures(foggy), night=2),
    _harmless("second night: noise of 4 levels", pictures(noisy(4)), night=2),
    _harmless("second night: JPEG quality 50", pictures(lambda p: p, quality=50), night=2),
    # sites where a pose is stated for some cameras only
    _harmless("first pose withheld", without_poses((0,)), MIXED),
    _harmless("second pose withheld", without_poses((1,)), MIXED),
    _harmless("third pose withheld", without_poses((2,)), MIXED),
    _harmless("fourth pose withheld", without_poses((3,)), MIXED),
    _harmless("first and third pose withheld", without_poses((0, 2)), MIXED),
    _harmless("all poses but two withheld", all_poses_but_two_withheld, MIXED),
    _fault("a pose withheld, another turned by 1 degree", without_poses((1,), turn((0, 1, 0), (0,))), *ONE, on=MIXED),
    _fault("a pose withheld, another turned by .5 degrees", without_poses((3,), turn((0.5, 0, 0), (1,))), *ONE, on=MIXED),
    _fault("a pose withheld, another moved by 1 m", without_poses((1,), move((0, 1, 0), (0,))), *ONE, on=MIXED),
    _fault("a pose withheld, another moved by .5 m", without_poses((0,), move((0.5, 0, 0), (2,))), *ONE, on=MIXED),
    _fault("a pose withheld, focal +3 %", without_poses((1,), focal(1.03)), *FOCAL, on=MIXED),
    _fault("a pose withheld, its focal +5 %", without_poses((1,), focal(1.05, (1,))), "focal-length", on=MIXED),
    _fault("a pose withheld, distortion left out", without_poses((1,), distortion(0)), *BENT, on=MIXED),
    _fault("a pose withheld, its frames mirrored", without_poses((1,), pictures(lambda p: p[:, ::-1], (1,))), on=MIXED),
)  # fmt: skip


# --- working through them ----------------------------------------------------------------------------------------------------


def prepare(folder: Path, scene: Scene) -> None:
    """Render a scene, split its captures into two nights and run both; keeps the cache of both, and the state after the first."""
    if (folder / "ready").exists():
        return
    shutil.rmtree(folder, ignore_errors=True)
    if "photographs" in scene.render:
        write_photographs(folder, nights=NIGHTS, **scene.render)
    else:
        write_demo(folder, small=True, captures=6, **scene.render)
        for camera in sorted((folder / "captures").iterdir()):
            for k, file in enumerate(sorted(camera.iterdir())):
                file.rename(camera / f"{NIGHTS[k // 3]}_{k % 3 + 1}.jpg")
    wbflow_run(folder, NIGHTS[0])
    work = next((folder / ".wbflow").iterdir())
    shutil.copytree(work, folder / "first", symlinks=True, ignore=shutil.ignore_patterns("cache"))
    wbflow_run(folder, NIGHTS[1])
    for kept in [*work.iterdir()]:
        if kept.name != "cache":
            shutil.rmtree(kept) if kept.is_dir() and not kept.is_symlink() else kept.unlink()
    (folder / "ready").touch()


def wbflow_run(folder: Path, night: str, *options: str) -> dict[str, Any]:
    """The run.json of a run, or its exit code and error output if there is none."""
    command = [sys.executable, "-m", "wbflow", "run", str(folder), "--date", night, "--jobs", "1", "--json", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return dict(json.loads(done.stdout)) if done.stdout.startswith("{") else {"exit_code": done.returncode, "said": done.stderr}


def work_through(variation: Variation, name: str, folder: Path, quick: bool) -> Result:
    """Apply a variation to a copy of a scene, and run the copy."""
    base, copy = folder / name, folder / f"{name}-copy"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(base, copy, symlinks=True, ignore=shutil.ignore_patterns("first"))
    work = next((copy / ".wbflow").iterdir())
    if variation.night == 2:
        shutil.copytree(base / "first", work, symlinks=True, dirs_exist_ok=True)
    site = Site(copy, NIGHTS[variation.night - 1])
    variation.change(site)
    site.write()
    record: dict[str, Any] = wbflow_run(copy, site.night, "--until", "poses") if quick and variation.kind == "fault" else {}
    if record.get("exit_code", 0) == 0 or _is_refutable(record):
        record = wbflow_run(copy, site.night)
    verdict = record.get("verdict", {})
    findings = _kinds(record)
    cause = _cause(record.get("poses") or {})
    text = " | ".join(finding["text"] for finding in verdict.get("findings", ())) or record.get("said", "")[-300:]
    result = Result(name, variation.name, variation.kind, record["exit_code"], None, 0, None, None, findings, cause, text=text)
    result.cpu = record.get("seconds", {}).get("cpu", 0.0)
    if variation.causes:
        result.cause_right = bool({cause, *findings} & {*variation.causes})
    cloud = work / "runs" / "latest" / "cloud.ply"
    if record.get("cloud") and cloud.exists():
        measure(result, cloud, base / "truth", SCENES[name].tolerance_m)
    shutil.rmtree(copy)
    return result


def _cause(poses: dict[str, Any]) -> str:
    """The cause that the finding names; "" without a contradiction."""
    check = PosesSummary.from_json(poses).contradiction
    return (check.cause or "no-cause") if check else ""


def _is_refutable(record: dict[str, Any]) -> bool:
    check = (record.get("poses") or {}).get("calibration") or {}
    return {*_kinds(record)} <= REFUTABLE | ({"calibration-contradicted"} if not check.get("cause") else set())


def _kinds(record: dict[str, Any]) -> list[str]:
    return [finding["kind"] for finding in record.get("verdict", {}).get("findings", ())]


def measure(result: Result, cloud: Path, truth: Path, tolerance_m: float) -> None:
    """Add the figures of a cloud compared with the truth."""
    table, reference = read_ply(cloud), read_ply(truth / "reference.ply")
    X, true = (np.stack([np.asarray(t[axis], np.float64) for axis in "xyz"], axis=1) for t in (table, reference))
    off, _ = cKDTree(true).query(X, distance_upper_bound=tolerance_m)
    sigma = np.asarray(table["sigma_mm"], np.float64)
    error = np.abs(errors_along_rays(X, truth)) * 1000
    known = np.isfinite(error) & np.isfinite(sigma)
    result.points, result.right, result.sigma_mm = len(X), float(np.isfinite(off).mean()), float(np.nanmedian(sigma))
    result.within_3_sigma = float((error[known] <= 3 * sigma[known]).mean()) if known.any() else None


def is_wrong(result: Result) -> str:
    """Return "LIE" for a wrong cloud called good, "FALSE ALARM" for a harmless change not called good, else an empty text."""
    if result.kind == "fault" and result.exit == 0 and result.right is not None and result.right < RIGHT:
        return "LIE"
    return "FALSE ALARM" if result.kind == "harmless" and result.exit != 0 else ""


def row(result: Result) -> dict[str, str | float | None]:
    """A result as a row of the table."""
    percent = {k: None if v is None else round(100 * v, 1) for k, v in (("r", result.right), ("s", result.within_3_sigma))}
    return {
        "scene": f"{result.scene}{' (fitted)' if SCENES[result.scene].fitted else ''}",
        "variation": result.name,
        "kind": result.kind,
        "exit": result.exit,
        "right %": percent["r"],
        "sigma mm": None if result.sigma_mm is None else round(result.sigma_mm, 1),
        "within 3 sigma %": percent["s"],
        "findings": ", ".join(result.findings),
        "cause": result.cause,
        "cause right": {None: None, True: "yes", False: "no"}[result.cause_right],
        "wrong": is_wrong(result),
    }


def scene_row(scene: str, results: Sequence[Result]) -> dict[str, str | float | None]:
    """What is kept of the results of one scene: counts, and the names of the variations that were judged wrongly."""
    own = [result for result in results if result.scene == scene]
    faults = [result for result in own if result.kind == "fault"]
    wrong = [result for result in own if is_wrong(result)]
    caused = [result for result in own if result.cause_right is not None and result.exit]
    return {
        "scene": f"{scene}{' (fitted)' if SCENES[scene].fitted else ''}",
        "faults": len(faults),
        "found": sum(result.exit != 0 for result in faults),
        "lies": sum(result.kind == "fault" for result in wrong),
        "harmless": sum(result.kind == "harmless" for result in own),
        "false alarms": sum(result.kind == "harmless" for result in wrong),
        "invisible": sum(result.kind == "invisible" for result in own),
        "causes named": sum(bool(result.cause_right) for result in caused),
        "of": len(caused),
        "judged wrongly": ", ".join(result.name for result in wrong),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenes", nargs="*", default=[*SCENES], choices=[*SCENES])
    parser.add_argument("--only", nargs="*", default=[], help="only variations whose names contain one of these words")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--everywhere", action="store_true", help="apply each variation to all scenes, not just to its own")
    parser.add_argument("--table", action="store_true", help="only print the results of earlier runs")
    parser.add_argument("--json", type=Path, help="write a row of counts for each scene; FOLDER/results has every variation's")
    given = parser.parse_args()
    kept = given.folder / "results"
    kept.mkdir(parents=True, exist_ok=True)
    results: list[Result] = []
    for name in given.scenes:
        for variation in (v for v in VARIATIONS if given.everywhere or name in v.on):
            if given.only and not any(word in variation.name for word in given.only):
                continue
            file = kept / f"{name}--{variation.name.replace(' ', '_').replace('/', '')}.json"
            if not file.exists() and not given.table:
                prepare(given.folder / name, SCENES[name])
                try:
                    result = work_through(variation, name, given.folder, given.quick)
                except TooFewCameras:
                    continue
                file.write_text(json.dumps(asdict(result)))
            if file.exists():
                results.append(Result(**json.loads(file.read_text())))
                print(" | ".join("" if cell is None else str(cell) for cell in row(results[-1]).values()), flush=True)
    wrong = [result for result in results if is_wrong(result)]
    named = [result.cause_right for result in results if result.cause_right is not None and result.exit]
    print(f"{len(results)} variations, {len(wrong)} judged wrongly; cause named in {sum(named)} of {len(named)} that were found")
    if given.json:
        given.json.write_text(json.dumps([scene_row(scene, results) for scene in given.scenes], indent=1))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
