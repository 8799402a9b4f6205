#!/usr/bin/env python3
"""How far does a site with other lenses fall behind the same scene seen by pinholes?  Compares F on the surface that both see.

    wbflow demo plain --small --cameras 8;  wbflow demo wide --small --cameras 8 --lenses fisheye
    scripts/bench_lenses.py --withhold plain wide [MORE...]      withholds R and C in the calibration (default: keeps them)

Folders are as `wbflow demo` writes them, of one scene and seed.  Each folder after the first gets two rows: its cloud, and the
cloud of the first folder, both compared with the true points that both sites see.  A point of a cloud counts if the nearest
point of the two truths is one of these.  With --withhold, clouds are first aligned to the true camera centres by a similarity.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from scores import compare_clouds, similarity_between

import wbflow
from wbflow.cache.ply import read_ply
from wbflow_stages.types import Float64s

TAUS = (0.05, 0.10, 0.20)
SAME_M = 0.05
"""Points of two truths show the same surface if they are closer than this, metres."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plain", type=Path)
    parser.add_argument("others", type=Path, nargs="+")
    parser.add_argument("--withhold", action="store_true", help="leave the poses out of the site file")
    parser.add_argument("--work", type=Path, help="folder in which runs are kept and resumed")
    options = parser.parse_args()
    print(f"{'':24}{'exit':>5}{'placed':>8}{'pairs':>6}{'CPU s':>7}   F at 5, 10, 20 cm; accuracy; completeness")
    with tempfile.TemporaryDirectory() as scratch:
        work = options.work or Path(scratch)
        plain_run, plain_cloud = run(options.plain, options.withhold, work)
        plain_truth = points_of(options.plain / "truth" / "reference.ply")
        for folder in options.others:
            other_run, cloud = run(folder, options.withhold, work)
            truth = points_of(folder / "truth" / "reference.ply")
            show(folder.name, other_run, cloud, truth, plain_truth)
            show(f"  {options.plain.name}", plain_run, plain_cloud, plain_truth, truth)


def run(folder: Path, withhold: bool, work: Path) -> tuple[wbflow.Run, Float64s]:
    """Run a night of a demo folder; returns the run, and its cloud in the frame of the truth."""
    site = work / f"{folder.name}-{'withheld' if withhold else 'given'}"
    site.mkdir(parents=True, exist_ok=True)
    for name in ("captures", "masks"):
        if not (site / name).exists():
            (site / name).symlink_to((folder / name).resolve())
    (site / "site.yaml").write_text((folder / "site.yaml").read_text())
    stated = json.loads((folder / "cameras.json").read_text())
    known = {camera: {k: v for k, v in row.items() if not (withhold and k in ("R", "C"))} for camera, row in stated.items()}
    (site / "cameras.json").write_text(json.dumps(known))
    night = wbflow.run(site / "site.yaml", jobs=1)
    cloud = points_of(night.folder / "cloud.ply")
    if withhold:
        centres = {camera: row["C"] for camera, row in night.calibration.items()}
        here = {camera: stated[camera]["C"] for camera in centres}
        moved = similarity_between(np.array(list(centres.values())), np.array(list(here.values())))
        cloud = moved.scale * cloud @ moved.R.T + moved.t
    return night, cloud


def points_of(file: Path) -> Float64s:
    """(n, 3) points of a PLY file, metres."""
    table = read_ply(file)
    return np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64)


def show(name: str, night: wbflow.Run, cloud: Float64s, truth: Float64s, elsewhere: Float64s) -> None:
    """Print the row of a cloud; elsewhere: (m, 3) true points that the other site's cameras see."""
    common = cKDTree(elsewhere).query(truth, distance_upper_bound=SAME_M)[0] < SAME_M
    both = np.concatenate([truth, elsewhere])
    counts = np.concatenate([common, cKDTree(truth).query(elsewhere, distance_upper_bound=SAME_M)[0] < SAME_M])
    found = compare_clouds(cloud[counts[cKDTree(both).query(cloud)[1]]], truth[common], TAUS)
    scores = "  ".join("/".join(f"{100 * v:.1f}" for v in values) for values in (found.F, found.accuracy, found.completeness))
    record = night.record
    placed = f"{len(night.calibration)}/{len(night.cameras)}"
    print(f"{name:24}{record.exit_code:5}{placed:>8}{len(record.pairs):6}{record.seconds.cpu:7.0f}   {scores}", flush=True)


if __name__ == "__main__":
    main()
