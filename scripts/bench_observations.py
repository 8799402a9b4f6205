#!/usr/bin/env python3
"""How exact are cameras that are placed by observations of a moving thing, and are their standard deviations right?

    bench_observations.py [--seeds N] [--only WORD] [--json FILE]
    bench_observations.py --rolex FOLDER [--json FILE]

Synthetic: cameras on an arc around a lamp that somebody carries, or a drone, with exact truth; errors are measured in the frame
that brings all cameras closest to their true poses.  With --rolex, FOLDER has drone.csv, gps.csv and cameras.json: as recorded,
with clocks shifted, with wrong observations, without GPS, and with a wrong lens.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from observed_scenes import ObservedScene, Recording, camera_ring, plain_lens, record, wrong_places

from wbflow_stages.core.rotations import Similarity, angle_between_deg, nearest_rotation, rotation_vector, skew
from wbflow_stages.observed_poses import solve_observations
from wbflow_stages.types import Float64s, Lens, Observations, ObservedPoses, Placement, Rejected, ThingSurvey


@dataclass(frozen=True)
class Case:
    """A kind of synthetic scene."""

    name: str
    cameras: int
    path: str
    recording: Recording
    spread_deg: float = 120.0
    rolls: tuple[float, ...] = (0.0,)
    focal: float = 1100.0


CASES = (
    Case("2 cameras, walk", 2, "walk", Recording(), 60),
    Case("2 cameras, flight", 2, "flight", Recording(), 60),
    Case("3 cameras, walk", 3, "walk", Recording(offset_s=0.5)),
    Case("4 cameras, walk", 4, "walk", Recording(offset_s=0.5)),
    Case("4 cameras, flight", 4, "flight", Recording(offset_s=0.5)),
    Case("4 cameras, walk, tracker's bias 2 px", 4, "walk", Recording(offset_s=0.5, bias_px=2.0)),
    Case("4 cameras, walk, 30 % wrong, 2 s", 4, "walk", Recording(offset_s=2.0, wrong_share=0.3)),
    Case("4 cameras, flight, 30 % wrong, 2 s", 4, "flight", Recording(offset_s=2.0, wrong_share=0.3)),
    Case("5 cameras, on their side and upside down", 5, "walk", Recording(offset_s=0.5, wrong_share=0.1), 150, (0, 90, 180, -90)),
    Case("5 cameras all around", 5, "walk", Recording(offset_s=0.5, wrong_share=0.1), 288),
    Case("4 cameras, 5 pictures a second", 4, "walk", Recording(rate=5.0, offset_s=0.5)),
    Case("8 cameras, walk", 8, "walk", Recording(offset_s=1.0, wrong_share=0.1, seconds=90), 150),
    Case("12 cameras, flight", 12, "flight", Recording(offset_s=1.0, wrong_share=0.1, seconds=60), 150),
)


def make_scene(case: Case, seed: int) -> ObservedScene:
    """A scene of a kind."""
    rng = np.random.default_rng(seed)
    ring = camera_ring(case.cameras, 15, case.spread_deg, rng, case.rolls)
    lenses = {name: plain_lens(case.focal) for name in ring}
    return record(ring, lenses, case.path, 15, case.recording, rng)


def to_truth(placements: dict[str, Placement], truth: dict[str, Placement]) -> Similarity:
    """The similarity that best brings cameras to their true poses."""
    turns = np.zeros((3, 3))
    for name, placement in placements.items():
        true_R = truth[name].R
        assert placement.R is not None and true_R is not None
        turns += true_R.T @ placement.R
    R = nearest_rotation(turns)
    source = np.array([placement.C for placement in placements.values()])
    target = np.array([truth[name].C for name in placements])
    a = (source - source.mean(axis=0)) @ R.T
    b = target - target.mean(axis=0)
    scale = float(np.sum(a * b) / np.sum(a * a))
    return Similarity(scale, R, target.mean(axis=0) - scale * R @ source.mean(axis=0))


def deviations(result: ObservedPoses, scene: ObservedScene, similarity: Similarity) -> list[tuple[float, float]]:
    """Errors of place and turn of each camera in its standard deviations, in the frame in which these hold.

    That frame brings places and turns of all cameras closest to the truth at once, with places in units of the cameras' mean
    distance from their centre.
    """
    names = list(result.placements)
    C = np.array([similarity.points(result.placements[n].C[None])[0] for n in names])  # type: ignore[index]
    arm = C - C.mean(axis=0)
    size = float(np.linalg.norm(arm, axis=1).mean())
    error = np.zeros((len(names), 6))
    gauge = np.zeros((len(names), 6, 7))
    for k, name in enumerate(names):
        R = result.placements[name].R
        truth = scene.truth[name]
        assert R is not None and truth.R is not None and truth.C is not None
        aligned = R @ similarity.R.T
        error[k, :3] = rotation_vector(aligned @ truth.R.T)
        error[k, 3:] = (C[k] - truth.C) / size
        gauge[k, 3:, :3] = np.eye(3)
        gauge[k, 3:, 3:6] = -skew(arm[k]) / size
        gauge[k, :3, 3:6] = -aligned
        gauge[k, 3:, 6] = arm[k] / size
    basis = np.linalg.qr(gauge.reshape(-1, 7))[0]
    flat = error.ravel()
    error = (flat - basis @ (basis.T @ flat)).reshape(-1, 6)
    rows = []
    for k, name in enumerate(names):
        placement = result.placements[name]
        metres = size * float(np.linalg.norm(error[k, 3:]))
        degrees = float(np.rad2deg(np.linalg.norm(error[k, :3])))
        rows.append((metres / (placement.sigma_m * similarity.scale), degrees / placement.sigma_deg))
    return rows


@dataclass
class Errors:
    """Errors of all cameras of a kind of scene."""

    cameras: int = 0
    placed: int = 0
    wrong: int = 0
    metres: list[float] | None = None

    def __post_init__(self) -> None:
        self.metres = []
        self.degrees: list[float] = []
        self.metres_in_sigmas: list[float] = []
        self.degrees_in_sigmas: list[float] = []
        self.offset_ms: list[float] = []
        self.offset_in_sigmas: list[float] = []

    def add(self, result: ObservedPoses, scene: ObservedScene) -> None:
        """Add the cameras of a result."""
        assert self.metres is not None
        similarity = to_truth(dict(result.placements), scene.truth)
        first = next(iter(result.placements))
        in_sigmas = iter(deviations(result, scene, similarity))
        for name, placement in result.placements.items():
            truth = scene.truth[name]
            assert placement.C is not None and truth.C is not None and placement.R is not None and truth.R is not None
            metres = float(np.linalg.norm(similarity.points(placement.C[None])[0] - truth.C))
            degrees = angle_between_deg(placement.R @ similarity.R.T, truth.R)
            self.metres.append(metres)
            self.degrees.append(degrees)
            metres_in_sigmas, degrees_in_sigmas = next(in_sigmas)
            self.metres_in_sigmas.append(metres_in_sigmas)
            self.degrees_in_sigmas.append(degrees_in_sigmas)
            self.wrong += metres > 1 or degrees > 3
            camera = result.cameras[name]
            if name != first:
                error = camera.offset - (scene.offsets[name] - scene.offsets[first])
                self.offset_ms.append(1000 * abs(error))
                self.offset_in_sigmas.append(abs(error) / camera.offset_sigma)


def bench_case(case: Case, seeds: int) -> list[str | float]:
    """A row of the table."""
    errors = Errors()
    start = time.process_time()
    for seed in range(seeds):
        scene = make_scene(case, seed)
        errors.cameras += len(scene.truth)
        result = solve_observations(scene.observations, scene.lenses, {})
        if isinstance(result, Rejected):
            print(f"  {case.name}, seed {seed}: {result.reason}", file=sys.stderr)
            continue
        errors.placed += len(result.placements)
        errors.add(result, scene)
        for name, camera in result.cameras.items():
            if camera.reason or camera.focal_change is not None:
                print(f"  {case.name}, seed {seed}, {name}: {camera.reason} {camera.focal_change}", file=sys.stderr)
    seconds = (time.process_time() - start) / seeds
    assert errors.metres is not None
    if not errors.placed:
        return [case.name, 0.0]
    within_m = float(np.mean(np.array(errors.metres_in_sigmas) < 2))
    within_deg = float(np.mean(np.array(errors.degrees_in_sigmas) < 2))
    within_s = float(np.mean(np.array(errors.offset_in_sigmas) < 2))
    return [
        case.name,
        round(errors.placed / errors.cameras, 3),
        errors.wrong,
        round(1000 * float(np.median(errors.metres)), 1),
        round(1000 * float(np.max(errors.metres)), 1),
        round(float(np.median(errors.degrees)), 3),
        round(within_m, 2),
        round(within_deg, 2),
        round(float(np.median(errors.offset_ms)), 2),
        round(within_s, 2),
        round(seconds, 1),
    ]


COLUMNS = ("scene", "placed", "wrong", "mm", "most mm", "degrees", "m in 2s", "deg in 2s", "offset ms", "offset in 2s", "s")


def read_rolex(folder: Path) -> tuple[Observations, dict[str, Lens], ThingSurvey]:
    """The drone's pixels, the lenses, and its GPS."""
    with (folder / "drone.csv").open() as file:
        rows = list(csv.DictReader(file))
    cameras = tuple(sorted({row["camera"] for row in rows}))
    numbers = {name: k for k, name in enumerate(cameras)}
    observations = Observations(
        cameras,
        ("drone",),
        np.array([numbers[row["camera"]] for row in rows], np.int32),
        np.zeros(len(rows), np.int32),
        np.array([float(row["frame"]) for row in rows]),
        np.array([[float(row["x"]), float(row["y"])] for row in rows]),
        np.full(len(rows), np.nan),
        "frames",
    )
    lenses = {}
    for name, stated in json.loads((folder / "cameras.json").read_text()).items():
        lenses[name] = Lens(
            K=np.array(stated["K"]),
            distortion=np.array(stated["distortion"]),
            width=stated["width"],
            height=stated["height"],
            model=stated["model"],
        )
    with (folder / "gps.csv").open() as file:
        places = list(csv.DictReader(file))
    survey = ThingSurvey(
        ("drone",),
        np.zeros(len(places), np.int32),
        np.array([float(row["frame"]) for row in places]),
        np.array([[float(row[axis]) for axis in ("easting", "northing", "up")] for row in places]),
        np.full(len(places), np.nan),
    )
    return observations, lenses, survey


ROLEX_COLUMNS = (
    "case",
    "placed",
    "px",
    "GPS m",
    "halves m",
    "halves deg",
    "offset frames",
    "to first m",
    "to first deg",
    "focal",
    "s",
)


def bench_rolex(folder: Path) -> list[list[str | float]]:
    """Rows of the table of rolex."""
    observations, lenses, survey = read_rolex(folder)
    rng = np.random.default_rng(0)
    shifts = rng.uniform(-12.5, 12.5, len(observations.cameras))
    shifted = replace(observations, time=observations.time - shifts[observations.camera])
    wrong = rng.random(len(observations.time)) < 0.1
    xy = observations.xy.copy()
    xy[wrong] = wrong_places(observations.time / 25, lenses["cam0"], rng)[wrong]
    K = np.array(lenses["cam2"].K)
    K[:2, :2] *= 1.03
    cases: list[tuple[str, Observations, dict[str, Lens], ThingSurvey | None, Float64s]] = [
        ("as recorded", observations, lenses, survey, 0 * shifts),
        ("clocks up to half a second off", shifted, lenses, survey, shifts),
        ("10 % wrong", replace(observations, xy=xy), lenses, survey, 0 * shifts),
        ("without GPS", observations, lenses, None, 0 * shifts),
        ("cam2 3 % longer", observations, {**lenses, "cam2": replace(lenses["cam2"], K=K)}, survey, 0 * shifts),
    ]
    rows: list[list[str | float]] = []
    reference: ObservedPoses | None = None
    for name, seen, used_lenses, known, moved in cases:
        start = time.process_time()
        result = solve_observations(seen, used_lenses, {}, known)
        seconds = time.process_time() - start
        if isinstance(result, Rejected):
            rows.append([name, 0.0])
            continue
        reference = reference or result
        similarity = to_truth(dict(result.placements), dict(reference.placements))
        metres = []
        degrees = []
        offsets = []
        for k, camera in enumerate(observations.cameras):
            if camera not in result.placements:
                continue
            ours = result.placements[camera]
            theirs = reference.placements[camera]
            assert ours.C is not None and ours.R is not None and theirs.C is not None and theirs.R is not None
            metres.append(float(np.linalg.norm(similarity.points(ours.C[None])[0] - theirs.C)))
            degrees.append(angle_between_deg(ours.R @ similarity.R.T, theirs.R))
            change = result.cameras[camera].offset - reference.cameras[camera].offset
            offsets.append(abs(change - (moved[k] - moved[0])))
        focal = ", ".join(f"{c} {f - 1:+.1%}" for c, f in sorted(result.focal_scales.items()))
        rows.append(
            [
                name,
                len(result.placements),
                round(result.reprojection_px or np.nan, 2),
                round(result.survey_m or np.nan, 3),
                round(result.halves_m or np.nan, 3),
                round(result.halves_deg or np.nan, 4),
                round(max(offsets), 3),
                round(max(metres), 3),
                round(max(degrees), 3),
                focal,
                round(seconds, 1),
            ]
        )
    return rows


def main() -> None:
    """Print the table of one of the two benches."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="scenes of each kind")
    parser.add_argument("--only", default="", help="only scenes whose name contains this")
    parser.add_argument("--rolex", type=Path, help="folder of rolex")
    parser.add_argument("--json", type=Path, help="file for the rows")
    arguments = parser.parse_args()
    if arguments.rolex:
        columns = ROLEX_COLUMNS
        rows = bench_rolex(arguments.rolex)
        for row in rows:
            print(*row, sep=" | ")
    else:
        columns = COLUMNS
        rows = []
        print(*columns, sep=" | ")
        for case in CASES:
            if arguments.only in case.name:
                rows.append(bench_case(case, arguments.seeds))
                print(*rows[-1], sep=" | ", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps([dict(zip(columns, row, strict=False)) for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
