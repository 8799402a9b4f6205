"""How right `sigma_mm` of a cloud is: errors on exact truth over sigma, in every tenth of the points by sigma.

    scripts/bench_certainty.py CLOUD.ply TRUTH

TRUTH holds `cameras.json` and `depth/<camera>.npz`, as `wbflow demo` writes them.  A point's error is along the ray of the
nearest camera that sees it in truth, where that surface is smooth.  The robust spread (1.4826 MAD) is 1 where sigma is right.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from wbflow.store.ply import read_ply
from wbflow_stages.core.cameras import project
from wbflow_stages.types import Camera, Float64s

SMOOTH, SAME = 0.03, 0.02
"""Of the depth: how much four neighbouring pixels of the truth may differ, and how far a point may be off."""


def errors_along_rays(X: Float64s, truth: Path) -> Float64s:
    """(n,) signed errors, metres; nan where no camera sees the point in truth."""
    nearest, error = np.full(len(X), np.inf), np.full(len(X), np.nan)
    for name, entry in json.loads((truth / "cameras.json").read_text()).items():
        file = truth / "depth" / f"{name}.npz"
        if not file.exists():
            continue
        depth = np.load(file)["depth"].astype(np.float64)
        h, w = depth.shape
        K, R, C = (np.array(entry[key], dtype=np.float64) for key in ("K", "R", "C"))
        camera = Camera(K, R, C, w, h)
        x, z = project(camera, X)
        inside = np.flatnonzero((z > 0) & (x > 0).all(axis=1) & (x < (w - 2, h - 2)).all(axis=1))
        column, row = x[inside].astype(int).T
        fx, fy = (x[inside] - x[inside].astype(int)).T
        around = np.stack([depth[row + j, column + i] for j in (0, 1) for i in (0, 1)])
        with np.errstate(divide="ignore"):
            a, b, c, d = 1.0 / around
        there = 1.0 / ((1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d))
        off, reach = z[inside] - there, np.linalg.norm(X[inside] - camera.C, axis=1)
        good = (
            (around.min(axis=0) > 0) & (np.ptp(around, axis=0) < SMOOTH * around.min(axis=0)) & (np.abs(off) < SAME * z[inside])
        )
        good &= reach < nearest[inside]
        nearest[inside[good]] = reach[good]
        error[inside[good]] = (off * reach / z[inside])[good]
    return error


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("truth", type=Path)
    options = parser.parse_args()
    table = read_ply(options.cloud)
    error = errors_along_rays(np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64), options.truth)
    sigma = table["sigma_mm"].astype(np.float64) / 1000.0
    known = np.isfinite(error)
    error, sigma = error[known], sigma[known]
    order = np.argsort(sigma, kind="stable")
    print(f"{len(error):,} of {len(known):,} points;  sigma, median error, robust spread of error over sigma")
    for rows in np.array_split(order, 10):
        off, ratio = 1000 * np.median(np.abs(error[rows])), error[rows] / sigma[rows]
        spread = 1.4826 * np.median(np.abs(ratio - np.median(ratio)))
        print(f"{1000 * np.median(sigma[rows]):8.2f} mm {off:8.2f} mm {spread:6.2f}")


if __name__ == "__main__":
    main()
