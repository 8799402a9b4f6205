"""`wbflow pair`: two photographs and nothing else."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from tests.helpers.images import read_image
from tests.helpers.synthetic_site import small_yard, write_straight
from wbflow.cli.main import main


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("photographs")
    paths = folder / "one.png", folder / "two.png"
    for path, camera in zip(paths, small_yard().cameras[:2], strict=True):
        write_straight(path, camera)
    return paths


def test_two_photographs_give_matches_geometry_rectified_images_and_disparity(
    photographs: tuple[Path, Path], tmp_path: Path
) -> None:
    result = CliRunner().invoke(main, ["pair", *map(str, photographs), "--out", str(tmp_path), "--jobs", "1"])
    assert result.exit_code == 0, result.output
    F = np.loadtxt(tmp_path / "F.txt")
    table = np.loadtxt(tmp_path / "inliers.csv", delimiter=",", skiprows=1)
    ones = np.ones((len(table), 1))
    x1, x2 = np.hstack([table[:, :2], ones]), np.hstack([table[:, 2:4], ones])
    lines = x1 @ F.T
    assert np.median(np.abs((x2 * lines).sum(1)) / np.hypot(lines[:, 0], lines[:, 1])) < 0.5
    summary = json.loads((tmp_path / "pair.json").read_text())
    png = read_image(tmp_path / "left-disparity.png", cv2.IMREAD_UNCHANGED)
    pfm = (tmp_path / "left-disparity.pfm").read_bytes()
    height, width = png.shape
    values = np.frombuffer(pfm[-4 * width * height :], "<f4").reshape(height, width)[::-1]
    known = png > 0
    assert known.mean() > 0.1
    assert np.array_equal(known, np.isfinite(values))
    steps, offset = summary["png_steps_per_px"], summary["png_offset_px"]
    assert np.abs((png[known] - 1.0) / steps + offset - values[known]).max() <= 0.5 / steps
    page = (tmp_path / "index.html").read_text()
    for picture in ("1-matches.jpg", "2-inliers.jpg", "3-rectified.jpg", "4-disparity.jpg"):
        assert f'src="{picture}"' in page
    assert read_image(tmp_path / "1-matches.jpg").shape[1] == 2 * 320 + 4, "as large as the frames"
    shapes = {read_image(tmp_path / f"{name}-rectified.png").shape[0] for name in ("left", "right")}
    assert shapes == {height}, "the same rows in both"


def test_a_repeated_pair_comes_from_the_cache(photographs: tuple[Path, Path], tmp_path: Path) -> None:
    command = ["pair", *map(str, photographs), "--out", str(tmp_path), "--jobs", "1"]
    assert CliRunner().invoke(main, command).exit_code == 0
    before = (tmp_path / "left-disparity.png").read_bytes()
    (tmp_path / "left-disparity.png").unlink()
    assert CliRunner().invoke(main, command).exit_code == 0
    assert (tmp_path / "left-disparity.png").read_bytes() == before
    runs = sorted(p for p in (tmp_path / "work" / "runs").iterdir() if not p.is_symlink())
    assert json.loads((runs[-1] / "run.json").read_text())["tasks"]["ran"] == 0


def test_a_missing_photograph_is_refused(photographs: tuple[Path, Path], tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["pair", str(photographs[0]), str(tmp_path / "none.jpg"), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert "none.jpg" in result.output


def test_unrelated_photographs_end_with_code_1_and_a_reason(photographs: tuple[Path, Path], tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (180, 320, 3)).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "noise.png"), cv2.GaussianBlur(noise, (0, 0), 2))
    command = ["pair", str(photographs[0]), str(tmp_path / "noise.png"), "--out", str(tmp_path / "out"), "--jobs", "1"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 1
    assert "no disparity:" in result.output
