#!/usr/bin/env python3
"""How much of each weak surface does a cloud contain: white plaster, wet asphalt and snow of `wbflow demo --surfaces weak`?

    scripts/bench_surfaces.py TRUTH CLOUD.ply [CLOUD.ply ...]

TRUTH is the demo's folder that holds `reference.ply`.  Completeness is the share of the surface's true points that have a cloud
point within 5 (10) cm.  Precision is the share of the cloud points nearest to the surface that lie within 5 (10) cm of its plane.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from wbflow.cache.ply import read_ply
from wbflow_stages.types import Float64s

TAUS = (0.05, 0.10)
ON_PLANE_M = 0.02
"""True points closer to a plane than this belong to it (metres)."""
PLANES = (
    # name, axis normal to the plane, its coordinate on that axis, and the limits along the other two axes (metres)
    ("white plaster", 1, 30.0, ((0.0, 40.0), (0.1, 9.2))),
    ("white plaster", 0, 40.0, ((12.5, 30.5), (0.1, 9.2))),
    ("white plaster", 0, 0.0, ((13.0, 30.0), (0.1, 8.0))),
    ("wet asphalt", 2, 0.0, ((0.0, 20.0), (6.0, 30.0))),
    ("snow", 2, 0.0, ((20.0, 40.0), (6.0, 30.0))),
)
NAMES = ("white plaster", "wet asphalt", "snow")


def points_of(file: Path) -> Float64s:
    table = read_ply(file)
    return np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64)


def surfaces_of(truth: Float64s) -> np.ndarray:
    """(n,) index into `PLANES` of the plane that each point lies on, -1 for none."""
    found = np.full(len(truth), -1)
    for k, (_, axis, where, limits) in enumerate(PLANES):
        on = np.abs(truth[:, axis] - where) < ON_PLANE_M
        for other, (low, high) in zip([a for a in range(3) if a != axis], limits, strict=True):
            on &= (truth[:, other] > low) & (truth[:, other] < high)
        found[on] = k
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("truth", type=Path)
    parser.add_argument("clouds", type=Path, nargs="+")
    options = parser.parse_args()
    truth = points_of(options.truth / "reference.ply")
    plane = surfaces_of(truth)
    tree = cKDTree(truth)
    for file in options.clouds:
        cloud = points_of(file)
        missing = cKDTree(cloud).query(truth, distance_upper_bound=0.5)[0]
        distance, nearest = tree.query(cloud, distance_upper_bound=0.5)
        near = np.isfinite(distance)
        cloud, of = cloud[near], plane[nearest[near]]
        print(f"{file}: {len(cloud):,} points;  completeness, precision at 5 cm; at 10 cm")
        for name in (*NAMES, "all else"):
            rows = [k for k, row in enumerate(PLANES) if row[0] == name] if name in NAMES else [-1]
            mine, error = np.isin(plane, rows), distance[near][np.isin(of, rows)]
            if name in NAMES:
                error = np.concatenate([np.abs(cloud[of == k, PLANES[k][1]] - PLANES[k][2]) for k in rows])
            scores = [f"{100 * (missing[mine] <= tau).mean():5.1f} {100 * (error <= tau).mean():5.1f}" for tau in TAUS]
            print(f"  {name:14} {';  '.join(scores)}   ({mine.sum():,} true points, {len(error):,} points of the cloud)")


if __name__ == "__main__":
    main()
