"""Make a site of two nights, with its true surface, from photographs with true cameras.

Captures are small and seen through a distorting lens, so that every calibration fault has an effect; those of the second night
are darker and noisier.  The true surface is the cloud of a run on all photographs with their true cameras, replaced by the
laser's points (fountain only) wherever the laser has data.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import yaml
from pairs_with_truth import read_rgb
from scores import voxel_means

from wbflow.cache.ply import ply_bytes, read_ply
from wbflow_stages.core.cameras import backproject, project, scaled_intrinsics
from wbflow_stages.types import Bools, Camera, Float32s, Float64s, Uint8s

DATA = Path(os.environ.get("WBFLOW_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
LENS = np.array([-0.12, 0.02, 0.0003, -0.0002, 0.0])
WIDTH, WIDTH_OF_TRUTH = 480, 768
FROM_CORNER = {"pavilion"}
"""Data sets whose principal points are counted from the corner of the first pixel: dense matches show it by 25 sigmas."""


def write_photographs(folder: Path, photographs: str, cameras: Sequence[str], nights: Sequence[str]) -> None:
    """Write captures, site.yaml, cameras.json and truth/ for a data set of `WBFLOW_DATA` into a folder.

    cameras: names of photographs.  nights: two dates.
    """
    source, calibration, rng = DATA / photographs, {}, np.random.default_rng(1)
    every = true_cameras(source)
    for name in cameras:
        picture = read_rgb(picture_file(source, name))
        camera = resized(every[name], WIDTH)
        seen = through_lens(picture, every[name], camera)
        darker = np.clip(0.95 * seen + rng.normal(0, 2, seen.shape), 0, 255).astype(np.uint8)
        for night, capture in zip(nights, (seen, darker), strict=True):
            file = folder / "captures" / name / f"{night}_1.jpg"
            file.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(file), capture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
        calibration[name] = entry(camera) | {"distortion": LENS.tolist()}
    (folder / "cameras.json").write_text(json.dumps(calibration))
    captures = {"root": "captures", "pattern": "{camera}/{date:%Y-%m-%d}_*.jpg"}
    site = {
        "site": photographs,
        "captures": captures,
        "cameras": [{"id": name} for name in cameras],
        "calibration": "cameras.json",
        "resolution": None,
    }
    (folder / "site.yaml").write_text(yaml.safe_dump(site, sort_keys=False))
    write_truth(folder / "truth", source, every, {name: resized(every[name], WIDTH) for name in cameras})


def true_cameras(source: Path) -> dict[str, Camera]:
    """All cameras of a data set by name, for its photographs at full size."""
    cameras = {}
    for name, of in json.loads((source / "cameras.json").read_text()).items():
        K, R, C = (np.array(of[key], np.float64) for key in "KRC")
        K[:2, 2] -= 0.5 * (source.name in FROM_CORNER)
        cameras[Path(name).stem] = Camera(K, R, C, of["width"], of["height"])
    return cameras


def picture_file(source: Path, name: str) -> Path:
    """The photograph of a camera; the first of several nights."""
    photograph = source / "images" / f"{name}.jpg"
    return photograph if photograph.exists() else min((source / "captures" / name).iterdir())


def resized(camera: Camera, width: int) -> Camera:
    """The same camera with images of this width."""
    height = round(camera.height * width / camera.width)
    K = scaled_intrinsics(camera.K, width / camera.width, height / camera.height)
    return Camera(K, camera.R, camera.C, width, height)


def through_lens(picture: Uint8s, whole: Camera, camera: Camera) -> Uint8s:
    """The image of a smaller camera at the same place through `LENS`: resampled at twice its size, then averaged."""
    large = resized(camera, 2 * camera.width)
    v, u = np.mgrid[0 : large.height, 0 : large.width].reshape(2, -1).astype(np.float64)
    rays = cv2.undistortPoints(np.column_stack([u, v])[:, None], large.K, LENS)[:, 0]
    fine = resized(whole, min(whole.width, 5 * camera.width // 2))
    shrunk = cv2.resize(picture, (fine.width, fine.height), interpolation=cv2.INTER_AREA)
    at = (np.column_stack([rays, np.ones(len(rays))]) @ fine.K.T)[:, :2].reshape(large.height, large.width, 2).astype(np.float32)
    seen = cv2.remap(shrunk, at[..., 0], at[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(seen, (camera.width, camera.height), interpolation=cv2.INTER_AREA), np.uint8)


def entry(camera: Camera) -> dict[str, object]:
    """The entry of a camera in cameras.json."""
    matrices = {key: getattr(camera, key).tolist() for key in "KRC"}
    return {"width": camera.width, "height": camera.height, **matrices}


def write_truth(truth: Path, source: Path, every: dict[str, Camera], cameras: dict[str, Camera]) -> None:
    """Write cameras.json, depth/ of these cameras if the laser has it, and reference.ply, in the demo's formats."""
    (truth / "depth").mkdir(parents=True)
    (truth / "cameras.json").write_text(json.dumps({name: entry(camera) for name, camera in cameras.items()}))
    X, lit = photographed_surface(source, every), []
    for name in every if (source / "depth").exists() else ():
        with np.load(source / "depth" / f"{name}.npz") as file:
            depth: Float32s = file["depth"]
        if name in cameras:
            np.savez_compressed(truth / "depth" / f"{name}.npz", depth=sampled(depth, every[name], cameras[name]))
        v, u = np.nonzero(depth[::2, ::2])
        pixels = np.column_stack([2 * u, 2 * v]).astype(np.float64)
        lit.append(backproject(every[name], pixels, depth[2 * v, 2 * u].astype(np.float64)))
        X = X[~has_depth(depth, every[name], X)]
    points = np.concatenate([X, voxel_means(np.concatenate(lit), 0.01)] if lit else [X]).astype(np.float32)
    (truth / "reference.ply").write_bytes(ply_bytes(dict(zip("xyz", points.T, strict=True))))


def photographed_surface(source: Path, every: dict[str, Camera]) -> Float64s:
    """(n, 3) the cloud of a run on all photographs with their true cameras."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "cameras.json").write_text(json.dumps({name: entry(camera) for name, camera in every.items()}))
        cameras = [{"id": name, "images": [str(picture_file(source, name))]} for name in every]
        site = {
            "site": "truth",
            "captures": {"root": ".", "pattern": "{camera}"},
            "cameras": cameras,
            "calibration": "cameras.json",
        }
        (Path(folder) / "site.yaml").write_text(yaml.safe_dump(site | {"resolution": WIDTH_OF_TRUTH}))
        subprocess.run([sys.executable, "-m", "wbflow", "run", folder, "-q"], check=True)
        table = read_ply(next(Path(folder).glob(".wbflow/*/runs/latest/cloud.ply")))
    return np.stack([np.asarray(table[axis], np.float64) for axis in "xyz"], axis=1)


def sampled(depth: Float32s, whole: Camera, camera: Camera) -> Float32s:
    """(h, w) depth map of a smaller camera at the same place, from the nearest pixels."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1).astype(np.float64)
    rays = np.column_stack([u, v, np.ones(len(u))]) @ np.linalg.inv(camera.K).T
    x = np.rint((rays @ whole.K.T)[:, :2]).astype(np.int64)
    x = np.clip(x, 0, (whole.width - 1, whole.height - 1))
    return np.asarray(depth[x[:, 1], x[:, 0]].reshape(camera.height, camera.width), np.float32)


def has_depth(depth: Float32s, camera: Camera, X: Float64s) -> Bools:
    """(n,) bool: does the depth map have a value at each point's pixel?"""
    x, z = project(camera, X)
    with np.errstate(invalid="ignore"):
        inside = (z > 0) & (x >= 0).all(axis=1) & (x <= (camera.width - 1, camera.height - 1)).all(axis=1)
    found = np.zeros(len(X), np.bool_)
    column, row = np.rint(x[inside]).astype(np.int64).T
    found[inside] = depth[row, column] > 0
    return found
