"""Measure how far the demo's newest cloud is from the rendered truth.    measure_demo.py DEMO_FOLDER [--json FILE]

The demo's captures show a burned-in clock, which masks leave out, and people and vehicles that move between captures.
The truth is the empty site, so points on either count as errors of the cloud.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scores import compare_clouds

from wbflow.cache.ply import read_ply


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cloud = next(arguments.folder.glob(".wbflow/*/runs/latest-good/cloud.ply"), None)
    if cloud is None:
        parser.error(f"no run of {arguments.folder} has a cloud: wbflow run {arguments.folder}")
    truth = arguments.folder / "truth" / "reference.ply"
    points, reference = (np.stack([table[axis] for axis in "xyz"], axis=1) for table in (read_ply(cloud), read_ply(truth)))
    score = compare_clouds(points, reference, taus=(0.02, 0.05, 0.10, 0.20))
    columns = zip(score.tau.tolist(), score.accuracy.tolist(), score.completeness.tolist(), score.F.tolist(), strict=True)
    rows = [dict(zip(("tau_m", "accuracy", "completeness", "F"), row, strict=True)) for row in columns]
    print(f"{cloud}\ncompared with the rendered truth ({score.reference_points:,} points that at least two cameras see):")
    print(f"{'within':>8} {'accuracy':>9} {'completeness':>13} {'F':>7}")
    for row in rows:
        print(f"{row['tau_m'] * 100:5.0f} cm {row['accuracy']:9.1%} {row['completeness']:13.1%} {row['F']:7.1%}")
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
