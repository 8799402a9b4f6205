"""Photographs of a calibration board determine the lens."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from wbflow.cli.main import main
from wbflow.site.calibration import read_calibration
from wbflow_stages.board import fit_lens
from wbflow_stages.core.lenses import lens_pixels, lens_rays
from wbflow_stages.types import Float64s, Lens, Uint8s

WIDTH, HEIGHT, SQUARE, PX = 640, 480, 0.03, 40
LENS = Lens(np.array([[420.0, 0, 322], [0, 418.0, 236], [0, 0, 1]]), np.array([-0.2, 0.06, 0, 0, 0]), None, WIDTH, HEIGHT)
CHECKERS = np.where(np.add.outer(np.arange(7 * PX) // PX, np.arange(10 * PX) // PX) % 2, 240, 15).astype(np.uint8)


def seen(texture: Uint8s, rays: Float64s, turn: tuple[float, float, float], shift: tuple[float, float, float]) -> Uint8s:
    """The image of a board whose middle is at `shift`, as `LENS` shows it."""
    R = np.asarray(cv2.Rodrigues(np.array(turn))[0], dtype=np.float64)
    t = np.array(shift)
    depth = (R[:, 2] @ t) / (rays @ R[:, 2])
    at = (rays * depth[:, None] - t) @ R[:, :2] / SQUARE * PX + np.array(texture.shape[::-1]) / 2 - 0.5
    maps = at.reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    picture = cv2.remap(texture, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderValue=200)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7), dtype=np.uint8)


def calibrated(folder: Path, texture: Uint8s, *options: str, without_board: int = 0) -> tuple[Lens, str]:
    """The lens found from seven pictures of a board, and what was printed.  without_board: pictures before them without it."""
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = lens_rays(LENS, np.column_stack([x.ravel(), y.ravel()]).astype(np.float64))
    places = [(-0.1, -0.05), (0.1, -0.05), (-0.1, 0.06), (0.1, 0.06), (0.0, 0.0), (0.05, 0.02), (-0.04, -0.02)]
    (folder / "pictures").mkdir()
    for k, (a, b) in enumerate(places):
        turn = (0.5 * np.sin(k), 0.5 * np.cos(2 * k), 0.1 * k)
        cv2.imwrite(str(folder / "pictures" / f"{k}.png"), seen(texture, rays, turn, (a, b, 0.36 + 0.02 * k)))
    for k in range(without_board):
        noise = np.random.default_rng(k).integers(0, 255, (HEIGHT // 8, WIDTH // 8), np.uint8)
        cv2.imwrite(str(folder / "pictures" / f"-{k}.png"), cv2.resize(noise, (WIDTH, HEIGHT)))
    command = ["calibrate", "gate", str(folder / "pictures"), "--square", str(SQUARE), *options, "--out", str(folder)]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    found = read_calibration(folder / "gate.json")["gate"].lens
    return Lens(np.array(found.K), np.array(found.distortion), None, found.width, found.height, found.model), result.output


def assert_is_the_lens(lens: Lens) -> None:
    assert lens.K is not None and LENS.K is not None
    assert lens.K[[0, 1], [0, 1]] == pytest.approx(LENS.K[[0, 1], [0, 1]], rel=0.01)
    assert lens.K[:2, 2] == pytest.approx(LENS.K[:2, 2], abs=4.0)
    assert lens.distortion[0] == pytest.approx(LENS.distortion[0], abs=0.04)


def charuco(columns: int, rows: int, dictionary: str = "4X4_50", legacy: bool = False, inverted: bool = False) -> Uint8s:
    """The picture of a board with markers of 22 mm."""
    table = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}"))
    board = cv2.aruco.CharucoBoard((columns, rows), SQUARE, 0.022, table)
    board.setLegacyPattern(legacy)
    texture = np.asarray(board.generateImage((columns * PX, rows * PX)), np.uint8)
    return 255 - texture if inverted else texture


@pytest.mark.parametrize("is_charuco", [False, True])
def test_a_folder_of_board_pictures_is_calibrated_with_residuals_and_coverage(tmp_path: Path, is_charuco: bool) -> None:
    options = ["--board", "10x7", "--marker", "0.022"] if is_charuco else ["--board", "9x6"]
    lens, output = calibrated(tmp_path, charuco(10, 7) if is_charuco else CHECKERS, *options)
    assert_is_the_lens(lens)
    assert " not " not in output and "inverted" not in output and "legacy" not in output
    reported = json.loads((tmp_path / "gate.json").read_text())["gate"]
    assert max(reported["residuals_px"].values()) < 0.3 and reported["covered"] > 0.4
    assert (tmp_path / "gate-coverage.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("stated", "legacy", "inverted"),
    [("10x8", True, False), ("10x8", False, True), ("9x7", False, False), ("9x7", True, True), ("7x9", True, False)],
)
def test_a_charuco_board_is_found_however_it_is_printed_and_counted(
    tmp_path: Path, stated: str, legacy: bool, inverted: bool
) -> None:
    texture = charuco(10, 8, legacy=legacy, inverted=inverted)
    lens, output = calibrated(tmp_path, texture, "--board", stated, "--marker", "0.022")
    assert_is_the_lens(lens)
    assert ("before 4.6" in output) == legacy
    assert ("inverted" in output) == inverted
    assert (f"10x8 squares, not {stated}" in output) == (stated != "10x8")


@pytest.mark.parametrize("dictionary", ["4X4_1000", "6X6_250", "APRILTAG_36h11"])
def test_the_dictionary_of_the_markers_is_found_out(tmp_path: Path, dictionary: str) -> None:
    lens, output = calibrated(tmp_path, charuco(10, 7, dictionary), "--board", "10x7", "--marker", "0.022")
    assert_is_the_lens(lens)
    family = dictionary.rsplit("_", 1)[0] if dictionary[1] == "X" else dictionary
    if dictionary != "4X4_1000":  # its first markers are those of the default, 4X4_50
        assert f"of the dictionary {family}" in output


@pytest.mark.parametrize("without_board", [1, 3])
def test_pictures_without_the_board_do_not_hide_its_dictionary(tmp_path: Path, without_board: int) -> None:
    texture = charuco(10, 7, "5X5_100", inverted=True)
    lens, output = calibrated(tmp_path, texture, "--board", "10x7", "--marker", "0.022", without_board=without_board)
    assert_is_the_lens(lens)
    assert "of the dictionary 5X5" in output and "inverted" in output
    assert output.count("no board is found") == without_board


def test_a_board_of_more_markers_than_its_dictionary_has_is_found(tmp_path: Path) -> None:
    lens, output = calibrated(tmp_path, charuco(12, 9, "4X4_100"), "--board", "12x9", "--marker", "0.022")
    assert_is_the_lens(lens)
    assert "of the dictionary 4X4_1000, not 4X4_50" in output


@pytest.mark.parametrize(("stated", "is_mirrored"), [("9x6", False), ("8x6", True)])
def test_a_board_whose_corners_are_mixed_up_gives_no_lens(tmp_path: Path, stated: str, is_mirrored: bool) -> None:
    """Stated with another size, or in mirrored pictures: a wrong lens must not be written."""
    texture = charuco(8, 6)
    if is_mirrored:
        texture = np.ascontiguousarray(texture[:, ::-1])
    with pytest.raises(AssertionError, match=r"px rms|is seen in") as caught:
        calibrated(tmp_path, texture, "--board", stated, "--marker", "0.022")
    assert "columns and rows right" in str(caught.value)
    assert not (tmp_path / "gate.json").exists()


def test_a_checkerboard_counted_by_its_squares_is_found_and_said(tmp_path: Path) -> None:
    lens, output = calibrated(tmp_path, CHECKERS, "--board", "10x7")
    assert_is_the_lens(lens)
    assert "9x6 inner corners, not 10x7" in output


def test_an_unknown_dictionary_is_named_with_those_that_exist(tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "0.png").write_bytes(cv2.imencode(".png", CHECKERS)[1].tobytes())
    options = ["--board", "10x7", "--marker", "0.02", "--square", "0.03", "--dictionary", "9X9_50", "--out", str(tmp_path)]
    result = CliRunner().invoke(main, ["calibrate", "gate", str(tmp_path / "pictures"), *options])
    assert result.exit_code == 2
    assert "9X9_50" in result.output and "APRILTAG_36h11" in result.output


FISHEYE = Lens(
    np.array([[205.0, 0, 322], [0, 204.0, 236], [0, 0, 1]]),
    np.array([-0.012, 0.004, -0.0011, 0.0001]),
    None,
    WIDTH,
    HEIGHT,
    "fisheye",
)


def boards_around(count: int, farthest_deg: float) -> tuple[list[Float64s], list[Float64s]]:
    """Corners of boards up to `farthest_deg` off the axis of a fisheye: on the boards, and in its image, with noise."""
    rng = np.random.default_rng(1)
    flat = np.column_stack([np.mgrid[0:9, 0:6].T.reshape(-1, 2) * SQUARE, np.zeros(54)])
    boards, corners = [], []
    for k in range(count):
        off, azimuth = np.deg2rad(farthest_deg) * np.sqrt((k + 0.5) / count), 2.4 * k
        z = np.array([np.sin(off) * np.cos(azimuth), np.sin(off) * np.sin(azimuth), np.cos(off)])
        x = np.cross([0, 1, 0], z)
        R = np.column_stack([x / np.linalg.norm(x), np.cross(z, x / np.linalg.norm(x)), z])
        R = R @ np.asarray(cv2.Rodrigues(rng.normal(0, 0.3, 3))[0])
        at = lens_pixels(FISHEYE, (flat - flat.mean(axis=0)) @ R.T + 0.25 * z)
        seen_here = ((at > 0) & (at < (WIDTH, HEIGHT))).all(axis=1)
        if seen_here.sum() > 7:
            boards.append(flat[seen_here])
            corners.append(at[seen_here] + rng.normal(0, 0.05, (int(seen_here.sum()), 2)))
    return boards, corners


def test_a_fisheye_is_calibrated_from_boards_far_off_its_axis() -> None:
    K, coefficients, residuals = fit_lens(*boards_around(10, 80), (WIDTH, HEIGHT), "fisheye")
    assert np.sqrt(np.mean(np.concatenate(residuals) ** 2)) < 0.06
    found = Lens(K, coefficients, None, WIDTH, HEIGHT, "fisheye")
    border = np.array([[1.0, 236], [639, 236], [322, 1], [322, 479], [60, 60], [580, 420]])
    assert np.abs(lens_pixels(found, lens_rays(FISHEYE, border)) - border).max() < 0.5
