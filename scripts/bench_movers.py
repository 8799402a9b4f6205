#!/usr/bin/env python3
"""What share of a cloud lies on objects that moved between frames?    bench_movers.py DEMO CLOUD.ply [CLOUD.ply ...]

DEMO is a folder made by `wbflow demo --nights N --frames K`; the clouds are of its first night, from all frames or from the first
one alone.  A point lies on a mover if a mover's surface is within `NEAR_M` (0.15 m) of it in any frame, and if the nearest static
surface is farther away than that mover and than one voxel of the truth.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from wbflow.cache.ply import read_ply
from wbflow_demo.files import NIGHT_LARGE, NIGHT_SMALL
from wbflow_demo.nights import traffic_scenes
from wbflow_demo.render.photograph import Shots
from wbflow_demo.render.scene import Scene
from wbflow_stages.types import Float64s

NEAR_M = 0.15
"""A point lies on a mover only if the mover's surface is closer than this, metres."""
STEP_M = 0.03
"""Largest spacing of the points that sample a mover's surface, metres."""


def points_of(file: Path) -> Float64s:
    table = read_ply(file)
    return np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64)


def surface(scene: Scene) -> Float64s:
    """(n, 3) points on all triangles, at most `STEP_M` apart."""
    corners = scene.vertices.astype(np.float64).reshape(-1, 3, 3)
    found = []
    for a, b, c in corners:
        steps = int(np.ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - a)) / STEP_M)) + 1
        u, v = np.meshgrid(np.linspace(0, 1, steps), np.linspace(0, 1, steps))
        inside = u + v <= 1 + 1e-9
        found.append(a + u[inside][:, None] * (b - a) + v[inside][:, None] * (c - a))
    return np.vstack(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path)
    parser.add_argument("clouds", type=Path, nargs="+")
    arguments = parser.parse_args()
    reported = json.loads((arguments.demo / "demo.json").read_text())
    frames = int(reported["frames"])
    shots = Shots(int(reported["cameras"]), frames, NIGHT_SMALL if reported["small"] else NIGHT_LARGE, int(reported["seed"]))
    moves = cKDTree(np.vstack([surface(scene) for scene in traffic_scenes(int(reported["nights"]), shots)[:frames]]))
    still = cKDTree(points_of(arguments.demo / "truth" / "reference.ply"))
    cell = float(json.loads((arguments.demo / "truth" / "reference.json").read_text())["voxel_m"])
    for file in arguments.clouds:
        cloud = points_of(file)
        away, standing = moves.query(cloud, distance_upper_bound=NEAR_M)[0], still.query(cloud)[0]
        on = np.isfinite(away) & (standing > np.maximum(away, cell))
        print(f"{file}: {on.sum():,} of {len(cloud):,} points on movers of {frames} frames, {on.mean():.3%}")


if __name__ == "__main__":
    main()
