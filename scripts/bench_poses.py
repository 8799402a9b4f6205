#!/usr/bin/env python3
"""Compare solved poses with pycolmap's own pipeline (its SIFT, exhaustive matching, incremental mapper) on scenes with truth.

Poses are withheld, and with --unknown the intrinsics too.  Columns: mean rotation error in degrees, and mean and largest centre
error in centimetres, after similarity alignment of the camera centres; largest error of a focal length in percent; CPU seconds
from photographs to poses (for wbflow also of the poses stage alone).  "turn" is the mean rotation error after the common rotation
that fits the orientations best, instead of the one from the centres: errors of 2 mm in the centres of four cameras almost in a
row rotate all of them by 0.04 degrees.

    scripts/bench_poses.py
    scripts/bench_poses.py --sets fountain:0-5-10 fountain:1-5-9 --width 1536
    scripts/bench_poses.py --unknown --sets entry:all
    scripts/bench_poses.py --json rows.json
    scripts/bench_poses.py --ours --detector onnx --model aliked-n32.onnx --width 1024 --sets fountain:all desk
    scripts/bench_poses.py --check        the four-camera set at 768 with thresholds, for CI

"wrong" are the pairs of wbflow that are believed (probability of at least 0.5) although their rotation is off by more than
5 degrees or the direction of their baseline by more than 15.  "desk" is one moment of four webcams, whose true centres are good
to about a centimetre.  The model of --detector is the file that COLMAP publishes, or what `aliked_onnx.py` writes.

"yard" is the rendered demo site, whose truth is exact; for "yard:one-lens" its images are warped to a common lens.  The truth of
the photographs is not exact: two programs' solutions of all of fountain, from different features, are rotated by 0.005 degrees
against each other and by 0.025 degrees against the truth.  So "to whole" is the rotation of a part of a scene against the same
program's solution of the whole scene, if that came earlier in the run.

pycolmap's figures vary from run to run.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from pathlib import Path
from time import process_time
from typing import Literal

import cv2
import numpy as np
from pairs_with_truth import DATA, pose_error_deg, read_rgb
from scores import pose_errors, turn_errors_deg

from wbflow.commands.demo import write_demo
from wbflow.pipeline.pairs import select_pairs
from wbflow_stages.features import DETECTORS, detect
from wbflow_stages.frames import clean_frame
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.overlap import estimate_overlap
from wbflow_stages.poses import solve_poses
from wbflow_stages.types import Camera, Capture, Features, Frame, Geometry, Lens, Pair, Poses, Rejected

SETS = (
    "fountain:all",
    "fountain:0-2-4-6-8-10",
    "fountain:1-4-7-10",
    "fountain:0-5-10",
    "fountain:1-5-9",
    "entry:all",
    "yard",
)


DESK_FRAME = 31
"""Frame of the desk's videos that is taken: the cameras' times differ by 20 ms at most."""
BELIEVED = 0.5
"""Pairs of at least this probability are believed."""
WRONG_ROTATION_DEG = 5.0
WRONG_BASELINE_DEG = 15.0
"""A pair with a larger error of its rotation, or of the direction of its baseline, is wrong, degrees."""


@dataclass(frozen=True)
class Keypoints:
    """How keypoints are found."""

    detector: str = "sift"
    model: Capture | None = None
    """The file of a learned detector."""


@dataclass(frozen=True)
class Row:
    """One set, one program.  Errors are nan where fewer than three cameras were solved."""

    images: str
    width: int
    lenses: str
    program: str
    solved: int
    cameras: int
    rotation_deg: float
    centre_cm: float
    centre_max_cm: float
    focal_percent: float
    cpu_s: float
    poses_cpu_s: float = float("nan")
    turn_deg: float = float("nan")
    to_whole_deg: float = float("nan")
    pairs: int = 0
    wrong: int = 0


SCENE_SOLUTIONS: dict[tuple[str, int, bool, str], dict[str, Camera]] = {}
"""Solutions of whole scenes so far, by scene, width, whether intrinsics were known, and program."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", default=list(SETS), metavar="SCENE:IMAGES")
    parser.add_argument("--width", type=int, default=1536)
    parser.add_argument("--unknown", action="store_true", help="withhold the intrinsics too")
    parser.add_argument("--ours", action="store_true", help="measure wbflow only, without pycolmap's pipeline")
    parser.add_argument("--detector", default="sift", choices=list(DETECTORS), help="wbflow's keypoints")
    parser.add_argument("--model", type=Path, help="ONNX file of a learned detector")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    if options.check:
        check()
        return
    rows = []
    model = Capture(options.model.name, np.fromfile(options.model, np.uint8)) if options.model else None
    measure_ours = partial(measure_wbflow, keypoints=Keypoints(options.detector, model))
    print(
        f"{'set':24} {'program':9} {'solved':>7} {'rot deg':>8} {'cm':>7} {'max cm':>7} {'focal %':>8} {'CPU s':>7} {'poses':>6} "
        f"{'turn':>7} {'to whole':>8} {'wrong':>9}"
    )
    for images in options.sets:
        for program in (measure_ours,) if options.ours else (measure_ours, measure_pycolmap):
            row = program(images, options.width, not options.unknown)
            rows.append(row)
            print(
                f"{row.images:24} {row.program:9} {row.solved:>3}/{row.cameras:<3} {row.rotation_deg:8.4f} {row.centre_cm:7.3f} "
                f"{row.centre_max_cm:7.3f} {row.focal_percent:8.3f} {row.cpu_s:7.1f} {row.poses_cpu_s:6.2f} "
                f"{row.turn_deg:7.4f} {row.to_whole_deg:8.4f} {row.wrong:>3}/{row.pairs:<5}",
                flush=True,
            )
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))


def check() -> None:
    """Exit with code 1 if the poses of four cameras are worse than the limits."""
    row = measure_wbflow("fountain:1-4-7-10", 768, True)
    print(row)
    if row.solved < 4 or row.rotation_deg > 0.10 or row.centre_cm > 0.8:
        sys.exit("poses are worse than promised: 4 cameras, 0.10 degrees, 0.8 cm")


def measure_wbflow(images: str, width: int, known: bool, keypoints: Keypoints = Keypoints()) -> Row:
    """The stages one after the other, as the engine would run them."""
    if images in PREPARED:
        frames, truth = PREPARED[images]()
        start = process_time()
    else:
        files, truth = photographs(images)
        start, frames = process_time(), {}
        for name, file in files.items():
            camera = truth[name]
            lens = Lens(K=camera.K, width=camera.width, height=camera.height) if known else Lens()
            capture = Capture(file.name, np.fromfile(file, np.uint8))
            frames[name] = clean_frame([capture], lens, None, resolution=width)
    detected = {name: detect(frame, model=keypoints.model, detector=keypoints.detector) for name, frame in frames.items()}
    features: dict[str, Features] = {name: f for name, f in detected.items() if isinstance(f, Features)}
    views = {name: frame.view for name, frame in frames.items()}
    geometries: dict[Pair, Geometry] = {}
    for left, right in select_pairs(estimate_overlap(views, {}, features)).pairs:
        found = match(features[left], features[right])
        geometry = found if isinstance(found, Rejected) else estimate_geometry(found, features[left], features[right])
        if isinstance(geometry, Geometry):
            geometries[left, right] = geometry
    before = process_time()
    poses = solve_poses(views, {}, geometries)
    cameras = {name: c for name, c in poses.cameras.items() if c.component == 0} if isinstance(poses, Poses) else {}
    program = "wbflow" if keypoints.detector == "sift" else keypoints.detector
    row = row_of(images, width, known, program, cameras, truth, process_time() - start, process_time() - before)
    believed = [pair for pair, geometry in geometries.items() if geometry.good_probability >= BELIEVED]
    return replace(row, pairs=len(believed), wrong=sum(is_wrong(truth, pair, geometries[pair]) for pair in believed))


def is_wrong(truth: dict[str, Camera], pair: Pair, geometry: Geometry) -> bool:
    """Does the pose of a pair contradict the true cameras?"""
    rotation, baseline = pose_error_deg(truth[pair[0]], truth[pair[1]], geometry.cam2_R_cam1, geometry.cam2_t_cam1)
    return rotation > WRONG_ROTATION_DEG or baseline > WRONG_BASELINE_DEG


def measure_pycolmap(images: str, width: int, known: bool, *, mapper: Literal["incremental", "global"] = "incremental") -> Row:
    """pycolmap's pipeline on the same photographs at the same size."""
    import pycolmap

    pycolmap.set_random_seed(0)
    folder = Path(tempfile.mkdtemp())
    (folder / "images").mkdir()
    (folder / "masks").mkdir()
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "PINHOLE" if known else "SIMPLE_RADIAL"
    truth: dict[str, Camera]
    if images in PREPARED:
        frames, truth = PREPARED[images]()
        start, groups = process_time(), [[name] for name in frames]
        reader.mask_path = str(folder / "masks")
        for name, frame in frames.items():
            cv2.imwrite(str(folder / "images" / f"{name}.png"), frame.image[:, :, ::-1])
            cv2.imwrite(str(folder / "masks" / f"{name}.png.png"), np.uint8(255) * frame.mask)
        width = next(iter(frames.values())).view.width
    else:
        files, truth = photographs(images)
        start, groups = process_time(), [list(files)]
        for name, file in files.items():
            pixels = read_rgb(file)[..., ::-1]
            size = width, round(pixels.shape[0] * width / pixels.shape[1])
            cv2.imwrite(str(folder / "images" / f"{name}.png"), cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    database = folder / "database.db"
    for names in groups:  # cameras with the same lens
        if known:
            K, s = truth[names[0]].K, width / truth[names[0]].width
            # COLMAP's origin is the corner of the first pixel, not its centre
            params = [K[0, 0] * s, K[1, 1] * s, (K[0, 2] + 0.5) * s, (K[1, 2] + 0.5) * s]
            reader.camera_params = ",".join(map(repr, map(float, params)))
        pycolmap.extract_features(
            database,
            folder / "images",
            image_names=[f"{name}.png" for name in names],
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
            device=pycolmap.Device.cpu,
        )
    pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    if mapper == "global":
        all_at_once = pycolmap.GlobalPipelineOptions()
        adjusted = all_at_once.mapper.bundle_adjustment
        adjusted.refine_focal_length = adjusted.refine_extra_params = not known
        models = pycolmap.global_mapping(database, folder / "images", folder, all_at_once)
    else:
        options = pycolmap.IncrementalPipelineOptions()
        options.ba_refine_focal_length = options.ba_refine_extra_params = not known
        options.ba_refine_principal_point = False
        options.min_model_size = 2
        models = pycolmap.incremental_mapping(database, folder / "images", folder, options)
    cpu = process_time() - start
    cameras = {}
    if models:
        model = max(models.values(), key=lambda m: m.num_reg_images())
        for image in model.images.values():
            if image.has_pose:
                pose, lens = image.cam_from_world(), model.camera(image.camera_id)
                R = np.asarray(pose.rotation.matrix())
                cameras[Path(image.name).stem] = Camera(
                    lens.calibration_matrix(), R, -R.T @ pose.translation, lens.width, lens.height
                )
    shutil.rmtree(folder)
    return row_of(images, width, known, "pycolmap" if mapper == "incremental" else "glomap", cameras, truth, cpu)


def photographs(images: str) -> tuple[dict[str, Path], dict[str, Camera]]:
    """Files and true cameras, by image name without ending, of SCENE:all or SCENE:0-5-10."""
    scene, _, wanted = images.partition(":")
    folder = DATA / scene
    if not folder.exists():
        raise SystemExit(f"no {folder}: say where the photographs are in WBFLOW_DATA")
    files, truth = {}, {}
    for file, c in sorted(json.loads((folder / "cameras.json").read_text()).items()):
        name = Path(file).stem
        if wanted == "all" or str(int(name)) in wanted.split("-"):
            files[name] = folder / "images" / file
            truth[name] = Camera(np.array(c["K"]), np.array(c["R"]), np.array(c["C"]), c["width"], c["height"])
    return files, truth


@cache
def yard_frames() -> tuple[dict[str, Frame], dict[str, Camera]]:
    """Clean frames (without distortion) and true cameras of the demo site."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "yard"
        write_demo(folder)
        frames = {}
        for camera, c in json.loads((folder / "cameras.json").read_text()).items():
            lens = Lens(np.array(c["K"]), np.array(c["distortion"]), None, c["width"], c["height"])
            files = sorted((folder / "captures" / camera).iterdir())
            captures = [Capture(file.name, np.fromfile(file, np.uint8)) for file in files]
            mask = Capture("mask.png", np.fromfile(folder / "masks" / f"{camera}.png", np.uint8))
            frames[camera] = clean_frame(captures, lens, mask, resolution=None)
        truth = {}
        for camera, c in json.loads((folder / "truth" / "cameras.json").read_text()).items():
            view = frames[camera].view
            assert view.K is not None
            truth[camera] = Camera(view.K, np.array(c["R"]), np.array(c["C"]), view.width, view.height)
    return frames, truth


def one_lens() -> tuple[dict[str, Frame], dict[str, Camera]]:
    """The yard's frames and true cameras, all warped to the intrinsics of the widest lens."""
    frames, truth = yard_frames()
    K = min((camera.K for camera in truth.values()), key=lambda one: one[0, 0])
    moved, cameras = {}, {}
    for name, frame in frames.items():
        H, view = K @ np.linalg.inv(truth[name].K), frame.view
        size = view.width, view.height
        image = np.asarray(cv2.warpPerspective(frame.image, H, size, flags=cv2.INTER_AREA), np.uint8)
        mask = cv2.warpPerspective(frame.mask.astype(np.uint8), H, size, flags=cv2.INTER_NEAREST) > 0
        moved[name] = Frame(image, mask, replace(view, K=K))
        cameras[name] = replace(truth[name], K=K)
    return moved, cameras


def desk_frames() -> tuple[dict[str, Frame], dict[str, Camera]]:
    """Clean frames (without distortion) and true cameras of the desk's four webcams at one moment."""
    folder = DATA / "desk"
    if not folder.exists():
        raise SystemExit(f"no {folder}: say where the videos are in WBFLOW_DATA")
    frames = {}
    truth = {}
    for name, c in json.loads((folder / "cameras.json").read_text()).items():
        video = cv2.VideoCapture(str(folder / f"{name}.mp4"))
        video.set(cv2.CAP_PROP_POS_FRAMES, DESK_FRAME)
        _, pixels = video.read()
        capture = Capture.of_pixels(f"{name}.png", np.asarray(pixels[..., ::-1], np.uint8))
        lens = Lens(np.array(c["K"]), np.array(c["distortion"]), None, c["width"], c["height"])
        frames[name] = clean_frame([capture], lens, None, resolution=None)
        view = frames[name].view
        assert view.K is not None
        truth[name] = Camera(view.K, np.array(c["R"]), np.array(c["C"]), view.width, view.height)
    return frames, truth


PREPARED: dict[str, Callable[[], tuple[dict[str, Frame], dict[str, Camera]]]] = {
    "yard": yard_frames,
    "yard:one-lens": one_lens,
    "desk": desk_frames,
}
"""Functions that return the frames and true cameras of sets whose frames are not photographs as they are."""


def row_of(
    images: str,
    width: int,
    known: bool,
    program: str,
    cameras: dict[str, Camera],
    truth: dict[str, Camera],
    cpu_s: float,
    poses_cpu_s: float = float("nan"),
) -> Row:
    """Errors of the solved cameras."""
    rotation = centre = centre_max = focal = turned = to_whole = float("nan")
    scene, _, part = images.partition(":")
    if part == "all":
        SCENE_SOLUTIONS[scene, width, known, program] = cameras
    if len(cameras) >= 3:
        errors = pose_errors(cameras, truth, aligned=True)
        rotation, centre, centre_max = errors.rotation_deg.mean(), 100 * errors.position.mean(), 100 * errors.position.max()
        focal = max(abs(c.K[0, 0] / c.width / (truth[name].K[0, 0] / truth[name].width) - 1) * 100 for name, c in cameras.items())
        turned = turn_errors_deg(cameras, truth).mean()
        whole = SCENE_SOLUTIONS.get((scene, width, known, program), {})
        if part != "all" and set(cameras) <= set(whole):
            to_whole = turn_errors_deg(cameras, whole).mean()
    lenses = "known" if known else "unknown"
    counts = len(cameras), len(truth)
    return Row(
        images,
        width,
        lenses,
        program,
        *counts,
        float(rotation),
        float(centre),
        float(centre_max),
        float(focal),
        cpu_s,
        poses_cpu_s,
        float(turned),
        float(to_whole),
    )


if __name__ == "__main__":
    main()
