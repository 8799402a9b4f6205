"""How far the demo's newest cloud is from the rendered truth.    measure_demo.py DEMO_FOLDER [--json FILE]"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from wbflow.ply import read_ply
from wbflow_stages.evaluate import compare_clouds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cloud = arguments.folder / ".wbflow" / "yard" / "runs" / "latest" / "cloud.ply"
    truth = arguments.folder / "truth" / "reference.ply"
    points, reference = (np.stack([table[axis] for axis in "xyz"], axis=1) for table in (read_ply(cloud), read_ply(truth)))
    rows = compare_clouds(points, reference, taus=(0.02, 0.05, 0.10, 0.20)).rows
    print(f"{cloud}\n{'within':>8} {'accuracy':>9} {'completeness':>13} {'F':>6}")
    for row in rows:
        print(f"{row.tau * 100:5.0f} cm {row.accuracy:8.1%} {row.completeness:12.1%} {row.f_score:7.1%}")
    if arguments.json:
        arguments.json.write_text(json.dumps([vars(row) for row in rows], indent=1))


if __name__ == "__main__":
    main()
