#!/usr/bin/env python3
"""How right is a cloud near flat ground at z = 0 (the demo square)?

    scripts/bench_ground.py CLOUD.ply TRUTH [CAMERA...]

TRUTH holds `cameras.json` and `depth/<camera>.npz`, as `wbflow demo` writes them; CAMERA names the cameras that made the cloud
(default: all).  Of the points within a metre of the ground, prints the share within 5 cm of it, and the same share of a perfect
cloud, which is below 1 because benches, kerbs and the feet of walls are within the metre too; the number of points on no true
surface at all; and the share of the ground seen by two cameras that is covered, in cells of 10 cm.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from wbflow.cache.ply import read_ply
from wbflow_stages.core.cameras import backproject, project
from wbflow_stages.types import Bools, Camera, Float32s, Float64s

NEAR_M, ON_M, CELL_M = 1.0, 0.05, 0.1
SAME = 0.02
"""A point lies on the surface that a camera sees if their depths differ by less than this share."""


def views(truth: Path, names: list[str]) -> dict[str, tuple[Camera, Float32s]]:
    """True cameras with their depth maps, by name; no names: all cameras."""
    found = {}
    for name, entry in json.loads((truth / "cameras.json").read_text()).items():
        if names and name not in names:
            continue
        depth = np.load(truth / "depth" / f"{name}.npz")["depth"]
        K, R, C = (np.array(entry[key], dtype=np.float64) for key in ("K", "R", "C"))
        found[name] = Camera(K, R, C, depth.shape[1], depth.shape[0]), depth
    return found


def surface(camera: Camera, depth: Float32s) -> Float64s:
    """(n, 3) points of the true surface that a camera sees."""
    y, x = np.nonzero(depth > 0)
    return backproject(camera, np.column_stack([x, y]).astype(np.float64), depth[y, x].astype(np.float64))


def sees(camera: Camera, depth: Float32s, X: Float64s) -> Bools:
    """(n,) which points lie on the true surface that the camera sees."""
    x, z = project(camera, X)
    inside = (z > 0) & (x > -0.5).all(axis=1) & (x < np.array([camera.width, camera.height]) - 0.5).all(axis=1)
    column, row = np.where(inside[:, None], np.rint(x), 0).astype(int).T
    return np.asarray(inside & (np.abs(depth[row, column] - z) < SAME * z))


def cells(X: Float64s) -> set[tuple[int, int]]:
    """Cells of the ground that contain points."""
    return set(map(tuple, np.floor(X[:, :2] / CELL_M).astype(int).tolist()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("camera", nargs="*")
    arguments = parser.parse_args()
    seen = views(arguments.truth, arguments.camera)
    surfaces = {name: surface(*view) for name, view in seen.items()}
    twice = []
    for name, X in surfaces.items():
        low = X[np.abs(X[:, 2]) < NEAR_M]
        twice.append(low[np.any([sees(*seen[other], low) for other in seen if other != name], axis=0)])
    both = np.concatenate(twice)
    table = read_ply(arguments.cloud)
    points = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)
    near = points[np.abs(points[:, 2]) < NEAR_M]
    on = np.abs(near[:, 2]) < ON_M
    away = cKDTree(np.concatenate(list(surfaces.values()))).query(near[~on], distance_upper_bound=ON_M)[0]
    wrong = int(np.isinf(away).sum())
    ground = cells(both[np.abs(both[:, 2]) < ON_M])
    deeper, covered = int((points[:, 2] < -NEAR_M).sum()), len(ground & cells(near[on])) / len(ground)
    print(f"{len(near):,} of {len(points):,} points within {NEAR_M:g} m of the ground, {deeper:,} below it")
    print(f"share within {ON_M:g} m of it: {on.mean():.3f}; of a perfect cloud: {(np.abs(both[:, 2]) < ON_M).mean():.3f}")
    print(f"points on no true surface: {wrong:,}; on the ground, as a share of both: {on.sum() / max(on.sum() + wrong, 1):.3f}")
    print(f"ground that two cameras see: {len(ground) * CELL_M**2:.0f} m2, covered: {covered:.3f}")


if __name__ == "__main__":
    main()
