"""Which changes of the ground are found, by size and height?    bench_changes.py THEN TONIGHT [--json FILE] [--svg FILE]

THEN and TONIGHT are folders of two runs of one site between which nothing has changed; their work folder still has its cache.
Patches of TONIGHT's ground are raised by known steps in its depth maps, its cloud and its photographs (which get another texture
there).  Prints the share of patches found, the error of their volumes, and the share of the surface reported by mistake.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from bench_files import Panel, draw, write_rows

import wbflow
from wbflow.pipeline.stages import DEPTH, FRAMES, POSES, REFINE
from wbflow.task import Task
from wbflow_stages.changes import find_changes
from wbflow_stages.core.cameras import backproject
from wbflow_stages.types import Camera, Changes, Cloud, DepthMap, Float64s, Frame, Poses

STEPS_M = (0.05, 0.10, 0.20)
SIZES_M = (0.5, 1.0, 2.0)
PATCHES = 10
FLAT_M = 0.08
"""A patch is flat enough if its heights differ by less than this from the 5th to the 95th percentile, metres."""


@dataclass(frozen=True)
class Night:
    """The artifacts of one night's run."""

    poses: Poses
    cloud: Cloud
    frames: Mapping[str, Frame]
    depths: Mapping[str, DepthMap]
    refined: Mapping[str, DepthMap]

    def arguments(self, prefix: str = "") -> dict[str, Any]:
        """The fields as keyword arguments of `find_changes`."""
        return {prefix + name: value for name, value in vars(self).items()}


@dataclass(frozen=True)
class Row:
    """Patches of one size and step."""

    size_m: float
    step_m: float
    patches: int
    found: float
    """Share of the patches on which a change is reported."""
    volume_error: float
    """Median of |volume - truth| / truth over the patches found; nan if none is."""
    elsewhere: float
    """Share of the surface that is reported as changed outside the patches."""


def night_of(folder: Path) -> Night:
    """Load a night from the folder of its run and the cache.  Raises WbflowError."""
    run = wbflow.open_run(folder)
    of = {role: dict(run.of_cameras(role)) for role in (FRAMES, DEPTH, REFINE)}
    return Night(run.load(Task(POSES)), run.cloud_table(), of[FRAMES], of[DEPTH], of[REFINE])


def flat_places(night: Night, size: float, count: int) -> Float64s:
    """(n, 3) places on level ground, drawn at random, more than 2.5 sizes plus 1 m apart."""
    rng = np.random.default_rng(round(100 * size))
    points = night.cloud.points.astype(np.float64)
    level = points[np.abs(night.cloud.normals[:, 2]) > 0.9]
    ordered = points[np.argsort(points[:, 0])]
    places: list[Float64s] = []
    for k in rng.permutation(len(level))[:3000]:
        X = level[k]
        strip = slice(*np.searchsorted(ordered[:, 0], [X[0] - 0.6 * size, X[0] + 0.6 * size]))
        over = ordered[strip][np.abs(ordered[strip, :2] - X[:2]).max(axis=1) < 0.6 * size]
        spread = np.ptp(np.quantile(over[:, 2], [0.05, 0.95]))
        apart = all(np.linalg.norm(X[:2] - other[:2]) > 2.5 * size + 1 for other in places)
        if apart and spread < FLAT_M and len(over) > 0.5 * (1.2 * size / 0.05) ** 2:
            places.append(np.append(X[:2], np.median(over[:, 2])))
        if len(places) == count:
            break
    return np.array(places).reshape(-1, 3)


def inside(X: Float64s, places: Float64s, size: float) -> np.ndarray:
    """(n,) index of the patch that each point lies on, -1 for none."""
    found = np.full(len(X), -1)
    for k, place in enumerate(places):
        found[(np.abs(X[:, :2] - place[:2]).max(axis=1) <= size / 2) & (np.abs(X[:, 2] - place[2]) < 0.3)] = k
    return found


def raised(night: Night, places: Float64s, size: float, step: float) -> Night:
    """The night with its patches of ground raised by `step` and covered with another texture."""
    on = inside(night.cloud.points.astype(np.float64), places, size) >= 0
    points = night.cloud.points.astype(np.float64).copy()
    points[on, 2] += step
    frames, depths, refined = dict(night.frames), dict(night.depths), dict(night.refined)
    for name, camera in night.poses.cameras.items():
        kind = refined if name in refined else depths
        if name in kind and name in frames:
            kind[name], frames[name] = _lifted(camera, kind[name], frames[name], places, size, step)
    return replace(night, cloud=replace(night.cloud, points=points), frames=frames, depths=depths, refined=refined)


def _lifted(camera: Camera, depth: DepthMap, frame: Frame, places: Float64s, size: float, step: float) -> tuple[DepthMap, Frame]:
    """A camera's depth map and frame after raising: changes each pixel whose ray meets a patch at its new height."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1)
    pixels = np.column_stack([x, y]).astype(np.float64)
    away = backproject(camera, pixels, np.ones(len(pixels))) - camera.C
    z, image = depth.depth.ravel().copy(), frame.image.reshape(-1, 3).copy()
    for place in places:
        at = (place[2] + step - camera.C[2]) / np.where(np.abs(away[:, 2]) > 1e-9, away[:, 2], np.nan)
        X = camera.C + away * at[:, None]
        hit = (at > 0) & (np.abs(X[:, :2] - place[:2]).max(axis=1) <= size / 2)
        # the patch keeps the depth noise of the ground below it; objects in front of it stay in front
        below = (place[2] - camera.C[2]) / away[:, 2]
        error = np.where(hit, z - below, np.nan)
        hit &= ~(error < -1.0)
        keep = np.where(np.abs(error) < 0.5, error, np.nan)
        z[hit] = (at + keep)[hit]
        shade = _texture(X[hit])
        image[hit] = np.clip(image[hit].mean() + shade * max(float(image[hit].std()), 8.0), 0, 255)[:, None] if hit.any() else 0
    shape = depth.depth.shape
    return replace(depth, depth=z.reshape(shape).astype(np.float32)), replace(frame, image=image.reshape(*shape, 3))


def _texture(X: Float64s) -> Float64s:
    """(n,) sum of sine waves of several lengths, fixed in space, with unit standard deviation."""
    waves = [np.sin(X[:, :2] @ np.array(k) + p) for k, p in (((9, 17), 0), ((-23, 8), 1), ((14, -27), 2), ((31, 19), 3))]
    return np.asarray(np.sum(waves, axis=0) / np.sqrt(2.0))


def row_of(found: Changes, places: Float64s, size: float, step: float) -> Row:
    """Compare the reported changes with the raised patches."""
    truth = size * size * step
    hits: dict[int, float] = {}
    for change in found.changes.values():
        near = np.linalg.norm(places[:, :2] - (change.x, change.y), axis=1)
        if len(near) and near.min() < 0.5 * size:
            hits[int(near.argmin())] = abs(change.volume - truth) / truth
    reported = found.blob > 0
    elsewhere = (
        reported & (inside(found.points - [0, 0, step], places, 1.3 * size) < 0) & (inside(found.points, places, 1.3 * size) < 0)
    )
    error = float(np.median(list(hits.values()))) if hits else float("nan")
    return Row(size, step, len(places), len(hits) / max(1, len(places)), error, float(elsewhere.mean()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("then", type=Path)
    parser.add_argument("tonight", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--svg", type=Path)
    arguments = parser.parse_args()
    then, tonight = night_of(arguments.then), night_of(arguments.tonight)
    plain = find_changes(**tonight.arguments(), **then.arguments("reference_"))
    print(f"without added steps: {plain.count} changes on {plain.changed_share:.3%} of the surface; noise {plain.noise:.2f}")
    rows = []
    print(f"{'size':>6} {'step':>6} {'patches':>8} {'found':>6} {'volume off':>11} {'elsewhere':>10}")
    for size in SIZES_M:
        places = flat_places(tonight, size, PATCHES)
        for step in STEPS_M:
            found = find_changes(**raised(tonight, places, size, step).arguments(), **then.arguments("reference_"))
            row = row_of(found, places, size, step)
            rows.append(row)
            words = f"{row.size_m:5.1f}m {row.step_m * 100:4.0f}cm {row.patches:8d} {row.found:6.0%} {row.volume_error:11.0%}"
            print(f"{words} {row.elsewhere:10.3%}", flush=True)
    if arguments.json:
        write_rows(rows, list(vars(rows[0])), arguments.json)
    if arguments.svg:
        curves = {f"{size:g} m": [(100 * r.step_m, r.found) for r in rows if r.size_m == size] for size in SIZES_M}
        draw([Panel("patches that are found", "step, cm", curves)], arguments.svg)


if __name__ == "__main__":
    main()
