"""The whole product on photographs with laser ground truth: four cameras, 30 degrees between neighbours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scores import compare_clouds

from wbflow.cache.ply import read_ply
from wbflow_stages.core.cameras import backproject
from wbflow_stages.types import Camera

DATA = Path(os.environ.get("WBFLOW_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")) / "fountain"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the fountain photographs are not at {DATA}; set WBFLOW_DATA")
FOUR = ["0001", "0004", "0007", "0010"]


def laser_points(step: int = 4) -> np.ndarray:
    """World coordinates of every `step`-th pixel, in both directions, of all depth maps."""
    points = []
    for name, entry in json.loads((DATA / "cameras.json").read_text()).items():
        depth = np.load(DATA / "depth" / f"{Path(name).stem}.npz")["depth"][::step, ::step].astype(np.float64)
        v, u = np.nonzero(depth > 0)
        K, R, C = (np.array(entry[key]) for key in ("K", "R", "C"))
        camera = Camera(K, R, C, entry["width"], entry["height"])
        points.append(backproject(camera, np.column_stack([u, v]) * np.float64(step), depth[v, u]))
    return np.concatenate(points)


def test_four_photographs_far_apart_give_a_cloud_near_the_laser(tmp_path: Path) -> None:
    site = {
        "site": "four",
        "captures": {"root": str(DATA / "images"), "pattern": "{camera}.jpg"},
        "calibration": str(DATA / "cameras.json"),
        "cameras": FOUR,
        "resolution": 768,
    }
    (tmp_path / "site.yaml").write_text(json.dumps(site))
    command = [sys.executable, "-m", "wbflow", "run", str(tmp_path), "--json"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    table = read_ply(tmp_path / ".wbflow" / "four" / "runs" / "latest-good" / "cloud.ply")
    score = compare_clouds(np.stack([table[axis] for axis in "xyz"], axis=1), laser_points(), taus=(0.02, 0.05))
    assert score.accuracy[0] > 0.88
    assert score.F[0] > 0.62
    assert score.F[1] > 0.70
