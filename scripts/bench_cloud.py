#!/usr/bin/env python3
"""Compare the fountain's cloud with laser depth: accuracy, completeness, F, colours, CPU seconds and memory.

Each row is a whole `wbflow run` in one process.  Its rivals are a plain OpenCV script (stereoRectify, SGBM, voxels, removal of
outliers) in its own process, and quoted figures of COLMAP + OpenMVS, measured on the same photographs on another day (on CPUs,
true poses).  Clouds from solved poses are first aligned to the true camera centres by a similarity.  Surveyed poses are the true
ones with the errors of a survey: 0.02 degrees and 5 mm (standard deviations of each coordinate).

    scripts/bench_cloud.py                                     all 11, six and four cameras at 768, true poses
    scripts/bench_cloud.py --sizes 768 1536 --poses true solved --modes refined pairs sgbm strict
    scripts/bench_cloud.py --json rows.json
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from itertools import combinations
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import Any

import cv2
import numpy as np
from pairs_with_truth import read_rgb
from scores import compare_clouds, similarity_between, voxel_means

from wbflow.cache.ply import read_ply
from wbflow_stages.core.cameras import backproject, project, relative_pose, scaled_intrinsics
from wbflow_stages.core.rotations import rotation_matrix
from wbflow_stages.types import Camera, Float32s, Float64s, Uint8s

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("WBFLOW_DATA") or ROOT.parent / "shared" / "data") / "fountain"
SETS = {"all": range(11), "six": (0, 2, 4, 6, 8, 10), "four": (1, 4, 7, 10)}
MODES: dict[str, dict[str, Any]] = {
    "refined": {},
    "pairs": {"refine": False},
    "sgbm": {"refine": False, "disparity": {"matcher": "sgbm"}},
    "strict": {"fuse": {"min_consistent_pairs": 2}},
}
TAUS = (0.01, 0.02, 0.05, 0.10)
LAUNCHER = ProcessPoolExecutor(1, mp_context=get_context("spawn"))


@dataclass
class Row:
    """accuracy, completeness, F: percent at 1, 2, 5, 10 cm; colour: mean absolute difference from the photographs (0 to
    255); peak_mb: peak memory of the run's largest process.  Figures that were not measured are 0."""

    what: str
    cameras: str
    size: int
    poses: str
    points: int
    accuracy: list[float]
    completeness: list[float]
    F: list[float]
    colour: float
    cpu: float
    peak_mb: float
    stages: dict[str, float] = field(default_factory=dict)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--sizes", nargs="+", type=int, default=[768])
    parser.add_argument("--poses", nargs="+", choices=["true", "surveyed", "solved"], default=["true"])
    parser.add_argument("--modes", nargs="+", choices=MODES, default=["refined"])
    parser.add_argument("--rivals", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    if not DATA.is_dir():
        raise SystemExit(f"{DATA} is not there: point WBFLOW_DATA at the folder that holds fountain/")
    LAUNCHER.submit(int).result()  # a process inherits its parent's peak memory: start it while that is small
    reference, rows = laser_cloud(), []
    print(HEAD)
    for size in arguments.sizes:
        for cameras in arguments.sets:
            for poses in arguments.poses:
                for mode in arguments.modes:
                    rows.append(show(run(mode, cameras, size, poses, reference)))
            if arguments.rivals:
                rows.append(show(rival(cameras, size, reference)))
                rows += [show(row) for row in quoted(cameras, size)]
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))


HEAD = f"{'':32}{'points':>9}  {'accuracy / completeness / F at 1, 2, 5, 10 cm':56}{'colour':>7}{'CPU s':>8}{'MB':>7}"


def show(row: Row) -> Row:
    scores = "  ".join(f"{a:.0f}/{c:.0f}/{f:.1f}" for a, c, f in zip(row.accuracy, row.completeness, row.F, strict=True))
    label = f"{row.what} {row.cameras} {row.size} {row.poses}"
    print(f"{label:32}{row.points:9}  {scores:56}{row.colour:7.1f}{row.cpu:8.1f}{row.peak_mb:7.0f}")
    if row.stages:
        print(" " * 30 + "  ".join(f"{name} {seconds:.1f}" for name, seconds in row.stages.items()), flush=True)
    return row


def true_cameras(width: int) -> dict[str, Camera]:
    """The calibration's cameras by id, for images of this width."""
    cameras = {}
    for name, entry in json.loads((DATA / "cameras.json").read_text()).items():
        s = width / entry["width"]
        K = scaled_intrinsics(np.array(entry["K"]), s, s)
        cameras[Path(name).stem] = Camera(K, np.array(entry["R"]), np.array(entry["C"]), width, round(entry["height"] * s))
    return cameras


def laser_cloud() -> Float64s:
    """World points of every second pixel of each laser depth map, thinned to one point per voxel of 1 cm."""
    points = []
    for name, camera in true_cameras(3072).items():
        depth = laser_depth(name)[::2, ::2].astype(np.float64)
        v, u = np.nonzero(depth > 0)
        points.append(backproject(camera, np.float64(2) * np.column_stack([u, v]), depth[v, u]))
    return voxel_means(np.concatenate(points), 0.01)


def photographed(name: str) -> Uint8s:
    return read_rgb(DATA / "images" / f"{name}.jpg")


def laser_depth(name: str) -> Float32s:
    with np.load(DATA / "depth" / f"{name}.npz") as file:
        return np.asarray(file["depth"], dtype=np.float32)


def run(mode: str, cameras: str, size: int, poses: str, reference: Float64s) -> Row:
    """Run a night of the site in its own folder, and score the cloud."""
    names = [f"{n:04d}" for n in SETS[cameras]]
    with tempfile.TemporaryDirectory() as folder:
        calibration = json.loads((DATA / "cameras.json").read_text())
        if poses == "surveyed":
            calibration = surveyed(calibration)
        elif poses == "solved":
            calibration = {n: {k: v for k, v in c.items() if k not in ("R", "C")} for n, c in calibration.items()}
        (Path(folder) / "cameras.json").write_text(json.dumps(calibration))
        captures = {"root": str(DATA / "images"), "pattern": "{camera}.jpg"}
        site = {"site": "fountain", "captures": captures, "calibration": "cameras.json", "cameras": names, "resolution": size}
        (Path(folder) / "site.yaml").write_text(json.dumps(site | {"stages": MODES[mode]}))
        command = [sys.executable, "-m", "wbflow", "run", str(Path(folder) / "site.yaml"), "--jobs", "1", "--json"]
        environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        done = LAUNCHER.submit(subprocess.run, command, env=environment, capture_output=True, text=True, check=False).result()
        if done.returncode not in (0, 3):
            raise SystemExit(f"{mode} {cameras} {size} {poses}: {done.stderr or done.stdout}")
        record = json.loads(done.stdout)
        latest = Path(folder) / ".wbflow" / "fountain" / "runs" / "latest-good"
        cloud = read_ply(latest / "cloud.ply")
        solved = json.loads((latest / "cameras.json").read_text())
    points = np.column_stack([cloud[axis] for axis in "xyz"]).astype(np.float64)
    if poses == "solved":
        points = in_true_frame(points, solved)
    colors = np.column_stack([cloud[name] for name in ("red", "green", "blue")])
    stages = {name: figures["cpu"] for name, figures in record["seconds"]["stages"].items()}
    return score(mode, cameras, size, poses, points, colors, reference, record["seconds"]["cpu"], record["peak_rss_mb"], stages)


def surveyed(calibration: dict[str, Any], seed: int = 0) -> dict[str, Any]:
    """The calibration with the errors of a survey: 0.02 degrees and 5 mm (standard deviations of each coordinate)."""
    rng = np.random.default_rng(seed)

    def measured(entry: dict[str, Any]) -> dict[str, Any]:
        turn, shift = rng.normal(0.0, np.radians(0.02), 3), rng.normal(0.0, 0.005, 3)
        return entry | {
            "R": (rotation_matrix(turn) @ np.array(entry["R"])).tolist(),
            "C": (np.array(entry["C"]) + shift).tolist(),
        }

    return {name: measured(entry) for name, entry in calibration.items()}


def in_true_frame(points: Float64s, solved: dict[str, Any]) -> Float64s:
    truth = true_cameras(3072)
    common = [name for name in solved if solved[name].get("C") and Path(name).stem in truth]
    moved = similarity_between(np.array([solved[n]["C"] for n in common]), np.array([truth[Path(n).stem].C for n in common]))
    return np.asarray(moved.scale * points @ moved.R.T + moved.t, dtype=np.float64)


def score(
    what: str, cameras: str, size: int, poses: str, points: Float64s, colors: Uint8s, reference: Float64s, cpu: float,
    peak_mb: float, stages: dict[str, float],
) -> Row:  # fmt: skip
    found = compare_clouds(points, reference, TAUS)
    accuracy, completeness, F = (
        [round(100 * float(v), 2) for v in values] for values in (found.accuracy, found.completeness, found.F)
    )
    colour = colour_error(points, colors, cameras)
    return Row(what, cameras, size, poses, len(points), accuracy, completeness, F, colour, cpu, peak_mb, stages)


def colour_error(points: Float64s, colors: Uint8s, cameras: str) -> float:
    """Mean absolute difference from the photographs of all cameras of the set that see the point according to laser depth."""
    chosen = np.linspace(0, len(points) - 1, min(len(points), 100_000)).astype(int)
    differences = []
    for name in (f"{n:04d}" for n in SETS[cameras]):
        camera = true_cameras(768)[name]
        photograph = cv2.resize(
            read_rgb(DATA / "images" / f"{name}.jpg"), (camera.width, camera.height), interpolation=cv2.INTER_AREA
        )
        depth = laser_depth(name)[2::4, 2::4]
        x, z = project(camera, points[chosen])
        u, v = np.rint(np.nan_to_num(x, nan=-1.0).clip(-1, 1e6)).astype(int).T
        inside = np.flatnonzero((z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height))
        seen = inside[np.abs(depth[v[inside], u[inside]] - z[inside]) < 0.01 * z[inside]]
        differences.append(np.abs(photograph[v[seen], u[seen]].astype(float) - colors[chosen[seen]]).mean(axis=1))
    return float(np.concatenate(differences).mean())


COLMAP = {
    ("all", 768): (225, "69/37/48 90/62/73.3 97/74/84 99/80/88"),
    ("six", 768): (88, "77/27/40 94/45/61.1 99/55/71 100/60/75"),
    ("four", 768): (29, "80/13/23 95/25/39.1 99/31/48 100/36/53"),
    ("all", 1536): (884, "73/52/61 91/70/79.0 97/78/87 98/84/90"),
    ("six", 1536): (376, "81/38/52 97/52/67.6 100/58/73 100/63/77"),
    ("four", 1536): (157, "85/25/38 97/32/48.1 100/37/54 100/42/59"),
}
"""COLMAP + OpenMVS by set and image width: CPU seconds, accuracy/completeness/F at 1, 2, 5, 10 cm.  Quoted, not measured here."""


def quoted(cameras: str, size: int) -> list[Row]:
    if (cameras, size) not in COLMAP:
        return []
    cpu, scores = COLMAP[cameras, size]
    accuracy, completeness, F = map(list, zip(*([float(v) for v in triple.split("/")] for triple in scores.split()), strict=True))
    return [Row("COLMAP (quoted)", cameras, size, "true", 0, accuracy, completeness, F, 0.0, cpu, 0.0)]


def rival(cameras: str, size: int, reference: Float64s) -> Row:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as own:
        points, colors, cpu, peak_mb = own.submit(plain_script, cameras, size).result()
    return score("opencv", cameras, size, "true", points, colors, reference, cpu, peak_mb, {})


def plain_script(cameras: str, size: int) -> tuple[Float64s, Uint8s, float, float]:
    """A plain OpenCV script: calibrated rectification, SGBM on both views, triangulation, voxels, removal of outliers.

    Returns points, colours, CPU seconds and the peak memory in MB.
    """
    start = process_time()
    cv2.setNumThreads(1)
    names, truth = [f"{n:04d}" for n in SETS[cameras]], true_cameras(size)
    images = {}
    for name in names:
        photograph = cv2.resize(
            read_rgb(DATA / "images" / f"{name}.jpg"), (size, truth[name].height), interpolation=cv2.INTER_AREA
        )
        images[name] = photograph.astype(np.uint8)
    points, colors = zip(
        *(stereo(truth[a], truth[b], images[a], images[b]) for a, b in combinations(names, 2) if neighbours(truth[a], truth[b])),
        strict=True,
    )
    cells = np.floor(np.concatenate(points) / 0.01).astype(np.int64) + (1 << 19)
    _, inverse, count = np.unique(cells @ (1 << 40, 1 << 20, 1), return_inverse=True, return_counts=True)
    means = [np.bincount(inverse, values) / count for values in np.concatenate([np.vstack(points), np.vstack(colors)], axis=1).T]
    merged = np.column_stack(means)
    from scipy.spatial import cKDTree

    lonely = np.isinf(cKDTree(merged[:, :3]).query(merged[:, :3], k=7, distance_upper_bound=0.03)[0][:, 6])
    merged = merged[~lonely]
    peak_mb = int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024  # Linux only; peak of this process
    return merged[:, :3], merged[:, 3:6].astype(np.uint8), process_time() - start, peak_mb


def neighbours(left: Camera, right: Camera) -> bool:
    """Are the optical axes between 5 and 40 degrees apart?"""
    return bool(np.cos(np.radians(40)) < left.R[2] @ right.R[2] < np.cos(np.radians(5)))


def stereo(left: Camera, right: Camera, image1: Uint8s, image2: Uint8s) -> tuple[Float64s, Float64s]:
    """World points and colours of both views of one pair; the rectified images are large enough to crop nothing."""
    R, t = relative_pose(left, right)
    if t[0] > 0:  # the right camera is to the left of the other
        return stereo(right, left, image2, image1)
    none = np.zeros((5, 1))
    R1, R2, P1, P2, *_ = cv2.stereoRectify(left.K, none, right.K, none, (left.width, left.height), R, t.reshape(3, 1), alpha=-1)
    views = (left, R1, P1, image1), (right, R2, P2, image2)
    w, h = left.width - 1.0, left.height - 1.0
    corners = np.array([[[0, 0]], [[w, 0]], [[0, h]], [[w, h]]])
    boxes = [cv2.undistortPoints(corners, c.K, none, R=turn, P=P[:, :3])[:, 0] for c, turn, P, _ in views]
    low, high = np.min([box.min(axis=0) for box in boxes], axis=0), np.max([box.max(axis=0) for box in boxes], axis=0)
    width, height = (int(max(np.ptp(box[:, 0]) for box in boxes)) + 1, int(high[1] - low[1]) + 1)
    for P, box in ((P1, boxes[0]), (P2, boxes[1])):
        P[0, 2] -= box[:, 0].min()
        P[1, 2] -= low[1]
    pictures = [
        cv2.remap(image, *cv2.initUndistortRectifyMap(c.K, none, turn, P, (width, height), cv2.CV_32FC1), cv2.INTER_LINEAR)
        for c, turn, P, image in views
    ]
    shift, reach = P1[0, 2] - P2[0, 2], abs(P2[0, 3])
    least, most = (int(reach / z + shift) for z in (15.0, 4.5))  # depth range in metres, which the user of a script knows
    count = 16 * -(-(most - least) // 16)
    matcher = cv2.StereoSGBM.create(least, count, 5, 600, 2400, 1, 63, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    pad = max(abs(least), abs(least + count))
    one, two = (cv2.copyMakeBorder(p, 0, 0, pad, pad, cv2.BORDER_CONSTANT) for p in pictures)
    disparities = matcher.compute(one, two), matcher.compute(two[:, ::-1].copy(), one[:, ::-1].copy())[:, ::-1]
    points, colors = [], []
    for disparity, (camera, turn, P, _), picture in zip(disparities, views, pictures, strict=True):
        d = disparity[:, pad:-pad].astype(np.float64) / 16
        v, u = np.nonzero((d >= least) & (picture > 0).any(axis=2))
        rays = np.column_stack([(u - P[0, 2]) / P[0, 0], (v - P[1, 2]) / P[1, 1], np.ones(len(u))])
        points.append((rays * (reach / (d[v, u] - shift))[:, None]) @ turn @ camera.R + camera.C)
        colors.append(picture[v, u].astype(np.float64))
    return np.vstack(points), np.vstack(colors)


if __name__ == "__main__":
    main()
