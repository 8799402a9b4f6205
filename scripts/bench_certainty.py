"""How right is `sigma_mm` of a cloud?  Prints the spread of error over sigma for each tenth of the points, sorted by sigma.

    scripts/bench_certainty.py CLOUD.ply TRUTH
    scripts/bench_certainty.py CLOUD.ply --then CLOUD.ply ... [--days D ...] --camera X Y Z

TRUTH holds `cameras.json` and `depth/<camera>.npz`, as `wbflow demo` writes them.  A point's error is measured along the ray of
the nearest camera that sees it, where the true surface is smooth.  The robust spread (1.4826 MAD) is 1 where sigma is right.

With --then, the error is the difference to the other date's nearest point along the normal, converted to the ray's direction,
minus the median of its block of 20 m, which may have moved as a whole; sigma combines those of both points.  Motion within a
block remains and grows with the days between; with --days, the spread of three or more dates is extrapolated to no days between.

The score is the mean negative log-likelihood of the errors in millimetres, with errors beyond three sigmas cut off there.  Of two
estimates of sigma for the same points, the one with the lower score describes the errors better.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from wbflow.cache.ply import read_ply
from wbflow_stages.core.cameras import project
from wbflow_stages.types import Camera, Float64s

Columns = dict[str, np.ndarray]

FAR = 3.0
"""The score cuts errors off at this many sigmas."""

SMOOTH, SAME = 0.03, 0.02
"""Limits as shares of the depth: range of four neighbouring true depths, and distance of a point from the true surface."""

NEAR_M, BLOCK_M, FEW, STEEPEST = 3.0, 20.0, 20, 0.2
"""For two dates: largest distance to the other date's nearest point, side of the blocks that may move as a whole, smallest number
of points in a block, and smallest cosine between ray and normal by which a difference is divided."""


def errors_along_rays(X: Float64s, truth: Path) -> Float64s:
    """(n,) signed errors along the ray, metres; nan where no camera sees the true surface near the point."""
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


def differences_of_dates(tables: Sequence[Columns], centre: Float64s) -> tuple[Float64s, Float64s]:
    """(n,) differences along the first date's rays, nan where the other has no point near, and (n,) their combined sigmas."""
    X, Y = (columns(table, "x", "y", "z") for table in tables)
    near, at = cKDTree(Y).query(X, distance_upper_bound=NEAR_M)
    at = np.minimum(at, len(Y) - 1)
    rays, normals = X - centre, columns(tables[0], "nx", "ny", "nz")
    cosine = np.abs(np.sum(rays * normals, axis=1)) / np.linalg.norm(rays, axis=1)
    difference = np.sum((Y[at] - X) * normals, axis=1) / np.maximum(cosine, STEEPEST)
    difference[~np.isfinite(near)] = np.nan
    _, block, count = np.unique(np.floor(X / BLOCK_M).astype(int), axis=0, return_inverse=True, return_counts=True)
    for k in range(len(count)):
        mine = np.flatnonzero((block.ravel() == k) & np.isfinite(difference))
        difference[mine] = difference[mine] - np.median(difference[mine]) if len(mine) >= FEW else np.nan
    one, two = (columns(table, "sigma_mm")[:, 0] / 1000.0 for table in tables)
    return difference, np.hypot(one, two[at])


def columns(table: Columns, *names: str) -> Float64s:
    return np.column_stack([table[name] for name in names]).astype(np.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("truth", type=Path, nargs="?")
    parser.add_argument("--then", type=Path, nargs="+", metavar="CLOUD")
    parser.add_argument("--days", type=float, nargs="+", metavar="D", help="days from the first date to each other")
    parser.add_argument("--camera", type=float, nargs=3, metavar=("X", "Y", "Z"), help="where all clouds were seen from")
    options = parser.parse_args()
    if (options.truth is None) == (options.then is None) or (options.then is not None and options.camera is None):
        parser.error("either TRUTH, or --then and --camera")
    if options.days is not None and (options.then is None or len(options.days) != len(options.then)):
        parser.error("--days: a number for each cloud of --then")
    if options.then is not None:
        of_dates([options.cloud, *options.then], options.days, np.array(options.camera))
        return
    table = read_ply(options.cloud)
    error, sigma = errors_along_rays(columns(table, "x", "y", "z"), options.truth), columns(table, "sigma_mm")[:, 0] / 1000.0
    known = np.isfinite(error)
    show(f"{known.sum():,} of {len(known):,} points", error[known], sigma[known], tenths(sigma[known]))


def of_dates(clouds: Sequence[Path], days: Sequence[float] | None, centre: Float64s) -> None:
    """Print the rows of each pair of dates and, given their days, the spread extrapolated to no days between them."""
    tables = [read_ply(cloud) for cloud in clouds]
    found = {}
    for i, j in combinations(range(len(clouds)), 2):
        difference, sigma = differences_of_dates([tables[i], tables[j]], centre)
        known = np.isfinite(difference)
        found[i, j] = difference[known], sigma[known]
    limits = tenths(np.concatenate([sigma for _, sigma in found.values()]))
    since = [0.0, *(days or [])]
    squares = []
    for (i, j), (difference, sigma) in found.items():
        title = f"{clouds[i].name} to {clouds[j].name}" + (f", {abs(since[j] - since[i]):g} days" if days else "")
        squares.append(show(title, difference, sigma, limits) ** 2)
    if days is not None and len(found) > 2 and np.isfinite(squares).all():
        apart = np.array([(since[j] - since[i]) ** 2 for i, j in found])
        at_once = np.linalg.lstsq(np.column_stack([np.ones(len(apart)), apart]), np.array(squares), rcond=None)[0][0]
        print("extrapolated to zero days, for steady motion:", *(f"{np.sqrt(max(square, 0.0)):.2f}" for square in at_once))


def tenths(sigma: Float64s) -> Float64s:
    """(11,) values of sigma that bound the tenths of the points."""
    return np.asarray(np.quantile(sigma, np.linspace(0.0, 1.0, 11)))


def show(title: str, error: Float64s, sigma: Float64s, limits: Float64s) -> Float64s:
    """Print a row for each tenth, and return the (10,) robust spreads of error over sigma."""
    score = np.mean(np.log(1000 * sigma) + 0.5 * np.minimum((error / sigma) ** 2, FAR**2))
    print(f"{title};  score {score:.3f};  sigma, median error, robust spread of error over sigma")
    row, spreads = np.searchsorted(limits[1:-1], sigma, side="right"), np.full(10, np.nan)
    for k in range(10):
        off, ratio = error[row == k], error[row == k] / sigma[row == k]
        if len(off):
            spreads[k] = 1.4826 * np.median(np.abs(ratio - np.median(ratio)))
            print(f"{1000 * np.median(sigma[row == k]):8.2f} mm {1000 * np.median(np.abs(off)):8.2f} mm {spreads[k]:6.2f}")
    return spreads


if __name__ == "__main__":
    main()
