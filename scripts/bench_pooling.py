"""Is F of a wide pair more accurate if the matches of many nights are pooled?

    bench_pooling.py DEMO RUN RUN... --pairs gate--mast-2 ...
    bench_pooling.py --dark 320x180 --nights 4 --pairs gate--mast-2 ...

DEMO is a folder made by `wbflow demo --nights N`; the RUNs are folders of runs of its nights, whose work folder still has its
cache.  Their frames are matched here, whether or not the runs did so.  With --dark, the yard is rendered here in this size,
without lamps, one capture per night: so dark that one night gives too few matches for wide pairs.  The error of F is the median
symmetric epipolar distance of true correspondences, in pixels of the frames.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import wbflow
from wbflow.pipeline.stages import FRAMES
from wbflow_demo.render.photograph import DemoCamera
from wbflow_demo.render.sensor import jpeg, png
from wbflow_demo.scenes import render
from wbflow_stages.core.cameras import backproject, project, ray_angles
from wbflow_stages.core.epipolar import symmetric_epipolar_distance
from wbflow_stages.features import detect
from wbflow_stages.frames import clean_frame
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.other_nights import pool_matches
from wbflow_stages.types import Camera, Capture, Float32s, Float64s, Frame, Geometry, Matches, Rejected

_STEP_PX = 4
"""Spacing of the true correspondences in rows and columns of the true depth map, pixels."""

_SAME = 0.02
"""Both cameras see a point if their true depths of it differ by less than this share."""


@dataclass(frozen=True)
class Truth:
    """True correspondences of a pair."""

    x1: Float64s
    x2: Float64s
    """(n, 2) pixels."""
    angle_deg: float
    """Median angle between their rays."""

    def scaled(self, scale: float) -> Truth:
        """The same correspondences in images scaled by this factor."""
        return replace(self, x1=(self.x1 + 0.5) * scale - 0.5, x2=(self.x2 + 0.5) * scale - 0.5)

    def describe(self, found: Geometry | Rejected) -> str:
        """Describe the error of a geometry, or why it was rejected."""
        if isinstance(found, Rejected):
            return f"rejected: {found.reason} { ({k: round(v, 2) for k, v in found.figures.items()}) }"
        error = float(np.median(symmetric_epipolar_distance(found.F, self.x1, self.x2)))
        return f"F is {error:.2f} px off, {found.inliers} inliers of {found.matches} matches, score {found.score:.1f}"


def cameras_of(demo: Path) -> dict[str, Camera]:
    """The true cameras by name, in the size of their depth maps."""
    entries = json.loads((demo / "cameras.json").read_text())
    found = {}
    for name, entry in entries.items():
        depth = _depth(demo, name)
        K, R, C = (np.array(entry[key], dtype=np.float64) for key in ("K", "R", "C"))
        found[name] = Camera(K=K.reshape(3, 3), R=R.reshape(3, 3), C=C.ravel(), width=depth.shape[1], height=depth.shape[0])
    return found


def _depth(demo: Path, name: str) -> Float32s:
    return np.asarray(np.load(demo / "truth" / "depth" / f"{name}.npz")["depth"])


def truth_of(one: Camera, depth: Float32s, two: Camera, other: Float32s) -> Truth:
    """Correspondences of the points that both cameras see, from their true depths."""
    y, x = np.mgrid[0 : one.height : _STEP_PX, 0 : one.width : _STEP_PX].reshape(2, -1)
    seen = depth[y, x] > 0
    x1 = np.column_stack([x, y])[seen].astype(np.float64)
    X = backproject(one, x1, depth[y, x][seen].astype(np.float64))
    x2, z = project(two, X)
    inside = (z > 0) & (x2 > 0).all(axis=1) & (x2 < [two.width - 1, two.height - 1]).all(axis=1)
    x1, x2, z, X = x1[inside], x2[inside], z[inside], X[inside]
    column, row = np.rint(x2).astype(int).T
    same = np.abs(other[row, column] - z) < _SAME * z
    angle = float(np.degrees(np.median(ray_angles(one.C - X[same], two.C - X[same]))))
    return Truth(x1[same], x2[same], angle)


def report_runs(demo: Path, runs: list[Path], pairs: list[str]) -> None:
    """Report pairs over the nights of a demo."""
    cameras = cameras_of(demo)
    nights = [wbflow.open_run(folder).of_cameras(FRAMES) for folder in runs]
    for pair in pairs:
        left, right = pair.split("--")
        truth = truth_of(cameras[left], _depth(demo, left), cameras[right], _depth(demo, right))
        scale = nights[0][left].view.width / cameras[left].width
        report_pair(pair, truth.scaled(scale), [(frames[left], frames[right]) for frames in nights])


def report_dark_nights(size: tuple[int, int], nights: int, pairs: list[str]) -> None:
    """Report pairs over nights of the yard without lamps, one capture per night."""
    site = render("yard", cameras=8, size=size, captures=nights, light="dark")
    for pair in pairs:
        left, right = (site[name] for name in pair.split("--"))
        report_pair(
            pair,
            truth_of(left.camera, left.depth, right.camera, right.depth),
            [(frame(left, k), frame(right, k)) for k in range(nights)],
        )


def frame(camera: DemoCamera, night: int) -> Frame:
    """The clean frame of a camera's capture of one night."""
    picture, mask = (np.frombuffer(data, np.uint8) for data in (jpeg(camera.captures[night]), png(camera.mask)))
    return clean_frame([Capture("picture.jpg", picture)], camera.lens, Capture("mask.png", mask), resolution=None)


def report_pair(pair: str, truth: Truth, frames: list[tuple[Frame, Frame]]) -> None:
    """Print the error of F from each night alone, and from all nights up to it together."""
    print(f"{pair}: {truth.angle_deg:.1f} degrees, {len(truth.x1)} true correspondences")
    matched: list[Matches] = []
    for number, (left, right) in enumerate(frames, 1):
        first, second = detect(left), detect(right)
        if isinstance(first, Rejected) or isinstance(second, Rejected):
            print(f"  night {number}: no keypoints")
            continue
        found = match(first, second, left_frame=left, right_frame=right)
        if isinstance(found, Rejected):
            print(f"  night {number}: {found.reason}")
            continue
        print(f"  night {number}: {truth.describe(estimate_geometry(found, first, second))}", flush=True)
        matched.append(found)
        if len(matched) > 1:
            together = estimate_geometry(pool_matches({str(k): night for k, night in enumerate(matched)}), first, second)
            print(f"  {number} nights: {truth.describe(together)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("demo", type=Path, nargs="?")
    parser.add_argument("runs", type=Path, nargs="*")
    parser.add_argument("--pairs", nargs="+", required=True)
    parser.add_argument("--dark", metavar="WIDTHxHEIGHT")
    parser.add_argument("--nights", type=int, default=4)
    arguments = parser.parse_args()
    if arguments.dark:
        width, _, height = arguments.dark.partition("x")
        report_dark_nights((int(width), int(height)), arguments.nights, arguments.pairs)
    elif arguments.demo:
        report_runs(arguments.demo, arguments.runs, arguments.pairs)
    else:
        parser.error("DEMO with its runs, or --dark")


if __name__ == "__main__":
    main()
