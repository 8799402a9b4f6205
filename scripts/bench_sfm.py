#!/usr/bin/env python3
"""Compare sparse reconstruction (photographs to poses) with openMVG (openmvg-rs) and COLMAP (pycolmap; incremental and global).

    scripts/bench_sfm.py [--sets entry:all yard:one-lens ...] [--width 1536] [--systems wbflow openmvg ...] [--json FILE]

All systems get the same images at the same size, and intrinsics; poses are withheld.  wbflow and openMVG run on one thread, as a
worker of the engine does, because idle threads spin and count as CPU seconds.  Errors are those of `bench_poses.py`.  openMVG
takes one calibration matrix for all images, so the yard's clean frames, whose lenses differ, are scaled and shifted to one matrix
for all systems; masked pixels are black for openMVG.  Seeds are fixed, but COLMAP still varies from run to run.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from time import monotonic, process_time

import cv2
import numpy as np
from bench_files import write_rows
from bench_poses import PREPARED, Row, measure_pycolmap, measure_wbflow, photographs, row_of
from bench_poses import SETS as POSE_SETS
from pairs_with_truth import on_one_thread, read_rgb

from wbflow_stages.types import Camera, Float64s

SETS = tuple("yard:one-lens" if images == "yard" else images for images in POSE_SETS)


@dataclass(frozen=True)
class Measured:
    """One set, one system: a row of the JSON file."""

    system: str
    cameras: int
    what: str
    tasks: int
    cpu_s: float
    wall_s: float
    solved: int
    turn_deg: float
    rotation_deg: float
    centre_cm: float

    @classmethod
    def of(cls, system: str, row: Row, wall_s: float) -> Measured:
        """Combine a row of `bench_poses.py` with its wall-clock seconds."""
        errors = row.turn_deg, row.rotation_deg, row.centre_cm
        return cls(system, row.cameras, row.images, 1, row.cpu_s, wall_s, row.solved, *errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", default=list(SETS), metavar="SCENE:IMAGES")
    parser.add_argument("--width", type=int, default=1536)
    parser.add_argument("--systems", nargs="+", default=list(SYSTEMS), choices=list(SYSTEMS))
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    os.environ["RAYON_NUM_THREADS"] = "1"
    on_one_thread()
    measure_wbflow("fountain:0-5-10", 384, True)  # kernels are compiled before anything is timed
    rows = []
    print(f"{'set':24} {'system':15} {'solved':>7} {'turn deg':>9} {'rot deg':>8} {'cm':>7} {'max cm':>7} {'CPU s':>7} {'s':>7}")
    for images in options.sets:
        for system in options.systems:
            began = monotonic()
            try:
                row = SYSTEMS[system](images, options.width)
            except ImportError as error:
                print(f"{images:24} {system:15} not measured: {error}; pip install it beside wbflow")
                continue
            rows.append(Measured.of(system, row, monotonic() - began))
            print(
                f"{images:24} {system:15} {row.solved:>3}/{row.cameras:<3} {row.turn_deg:9.4f} {row.rotation_deg:8.4f} "
                f"{row.centre_cm:7.3f} {row.centre_max_cm:7.3f} {row.cpu_s:7.1f} {rows[-1].wall_s:7.1f}",
                flush=True,
            )
    if options.json:
        write_rows(rows, [field.name for field in fields(Measured)], options.json)


def openmvg(images: str, width: int) -> Row:
    """openMVG's own features, matching and incremental reconstruction."""
    import openmvg_rs

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth, K, width = _written(images, width, folder)
        (folder / "K.txt").write_text("\n".join(" ".join(repr(float(v)) for v in row) for row in K) + "\n")
        start = process_time()
        try:
            found = openmvg_rs.reconstruct(folder, intrinsics=folder / "K.txt", progress=False)
        except openmvg_rs.NoReconstructionError:
            return row_of(images, width, True, "openmvg", {}, truth, process_time() - start)
        cpu = process_time() - start
    cameras = {}
    for view in found.views:
        R = np.asarray(view.pose.rotation)
        cameras[view.image.stem] = Camera(K, R, -R.T @ np.asarray(view.pose.translation), view.camera.width, view.camera.height)
    return row_of(images, width, True, "openmvg", cameras, truth, cpu)


def _written(images: str, width: int, folder: Path) -> tuple[dict[str, Camera], Float64s, int]:
    """Write the set's images into a folder; returns true cameras, the common calibration matrix, and the images' width."""
    if images in PREPARED:
        frames, truth = PREPARED[images]()
        for name, frame in frames.items():
            cv2.imwrite(str(folder / f"{name}.png"), np.where(frame.mask[..., None], frame.image, 0)[..., ::-1])
        any_camera = next(iter(truth.values()))
        return truth, any_camera.K, any_camera.width
    files, truth = photographs(images)
    for name, file in files.items():
        pixels = read_rgb(file)[..., ::-1]
        size = width, round(pixels.shape[0] * width / pixels.shape[1])
        cv2.imwrite(str(folder / f"{name}.png"), cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    camera = next(iter(truth.values()))
    s = width / camera.width
    scaled = np.array([[s, 0, 0.5 * s - 0.5], [0, s, 0.5 * s - 0.5], [0, 0, 1]])
    return truth, scaled @ camera.K, width


SYSTEMS: dict[str, Callable[[str, int], Row]] = {
    "wbflow": lambda images, width: measure_wbflow(images, width, True),
    "openmvg": openmvg,
    "colmap": lambda images, width: measure_pycolmap(images, width, True),
    "colmap-global": lambda images, width: measure_pycolmap(images, width, True, mapper="global"),
}

if __name__ == "__main__":
    main()
