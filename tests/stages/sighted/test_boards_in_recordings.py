"""Boards that are carried through the views of cameras: corners with their numbers, in each frame that shows them."""

from __future__ import annotations

import csv
import functools
import io
import json
import os
from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tests.helpers.videos import video
from wbflow_stages.core.rotations import angle_between_deg
from wbflow_stages.observed_poses import solve_observations
from wbflow_stages.recordings import observe_recordings
from wbflow_stages.types import Float64s, Lens, ObservedPoses, Sightings, Uint8s

DESK = Path(os.environ.get("WBFLOW_DATA") or Path(__file__).resolve().parents[4] / "shared" / "data") / "desk"
WIDTH, HEIGHT, FRAMES = 640, 480, 6
K = np.array([[520.0, 0, 321], [0, 520.0, 237], [0, 0, 1]])
SQUARE = 0.06
PX = 40
"""Pixels of a drawn board per `SQUARE`."""
MARGIN = 20
"""White pixels around it."""

Picture = Callable[[], Uint8s]


def charuco(is_inverted: bool = False) -> Uint8s:
    """A board of 6 x 4 squares."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    pattern = cv2.aruco.CharucoBoard((6, 4), SQUARE, 0.75 * SQUARE, dictionary)
    drawn = np.asarray(pattern.generateImage((6 * PX, 4 * PX), marginSize=0), np.uint8)
    return 255 - drawn if is_inverted else drawn


def april_grid(is_upward: bool) -> Uint8s:
    """A grid of 5 x 4 AprilTags, `SQUARE` apart; upward: rows are numbered from the bottom, as Kalibr does."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    edge = 30
    drawn = np.full((4 * PX, 5 * PX), 255, np.uint8)
    for number in range(20):
        row, column = divmod(number, 5)
        top = PX * (3 - row if is_upward else row) + (PX - edge) // 2
        left = PX * column + (PX - edge) // 2
        drawn[top : top + edge, left : left + edge] = cv2.aruco.generateImageMarker(dictionary, number, edge)
    return drawn


def checkers(columns: int, rows: int) -> Uint8s:
    """A checkerboard by its inner corners."""
    squares = np.indices((rows + 1, columns + 1)).sum(axis=0) % 2
    return np.asarray(np.kron(squares * 215 + 20, np.ones((PX, PX))), np.uint8)


def pose(camera: int, frame: int) -> tuple[Float64s, Float64s]:
    """Rotation vector and translation of the board in a camera; the second camera is upside down."""
    turn = np.array([0.35 * np.sin(frame), 0.3 * np.cos(frame), 0.1 * frame + np.pi * camera])
    return turn, np.array([0.06 * np.cos(frame), 0.04 * np.sin(2 * frame), 0.55 + 0.03 * frame])


def recorded(drawn: Uint8s, camera: int) -> io.BytesIO:
    """A recording of a drawn board, whose top left corner (without margin) is its origin."""
    framed = cv2.copyMakeBorder(drawn, MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_CONSTANT, value=255)
    frames = []
    for frame in range(FRAMES):
        turn, shift = pose(camera, frame)
        R = cv2.Rodrigues(turn)[0]
        middle = np.array([drawn.shape[1], drawn.shape[0]]) / PX * SQUARE / 2
        # pixels of the drawing to metres, then to the picture
        metres = np.array([[SQUARE / PX, 0, 0.5 * SQUARE / PX], [0, SQUARE / PX, 0.5 * SQUARE / PX], [0, 0, 1]])
        metres[:2, 2] -= MARGIN * SQUARE / PX + middle
        H = K @ np.column_stack([R[:, :2], shift]) @ metres
        grey = cv2.warpPerspective(
            framed, H, (WIDTH, HEIGHT), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=120
        )
        grey = cv2.GaussianBlur(grey, (0, 0), 0.8)
        frames.append(np.repeat(np.asarray(grey, np.uint8)[..., None], 3, axis=2))
    return video(frames)


def found(drawn: Uint8s, **board: float | str) -> Sightings:
    """What two recordings show of a drawn board."""
    return observe_recordings({name: recorded(drawn, k) for k, name in enumerate(("a", "b"))}, {"square": SQUARE, **board})


def errors_px(sightings: Sightings, places: Float64s, drawn: Uint8s) -> Float64s:
    """Distance of each observation from its corner; places: (n, 2) of the corners on the drawn board, metres."""
    observed = sightings.observations
    middle = np.array([drawn.shape[1], drawn.shape[0]]) / PX * SQUARE / 2
    errors = []
    for camera, thing, time, xy in zip(observed.camera, observed.thing, observed.time, observed.xy, strict=True):
        name = observed.things[thing]
        turn, shift = pose("ab".index(observed.cameras[camera]), round(time * 5))
        X = np.append(places[int(name.removeprefix("corner"))] - middle, 0.0)
        expected = cv2.projectPoints(X[None], turn, shift, K, None)[0].ravel()
        errors.append(np.linalg.norm(expected - xy))
    return np.array(errors)


def grid_of(columns: int, rows: int, start: float = SQUARE) -> Float64s:
    return np.mgrid[0:columns, 0:rows].T.reshape(-1, 2) * SQUARE + start


@pytest.mark.parametrize("is_inverted", [False, True])
def test_corners_of_a_charuco_board_are_found_with_their_numbers(is_inverted: bool) -> None:
    drawn = charuco(is_inverted)
    sightings = found(drawn, columns=6, rows=4, marker=0.75 * SQUARE, dictionary="5X5_100")
    errors = errors_px(sightings, grid_of(5, 3), drawn)
    assert len(errors) > 0.9 * 2 * FRAMES * 15
    assert np.median(errors) < 0.3
    assert errors.max() < 2


def test_standard_deviations_of_corners_are_as_large_as_their_errors() -> None:
    drawn = charuco()
    sightings = found(drawn, columns=6, rows=4, marker=0.75 * SQUARE, dictionary="5X5_100")
    # at five frames a second the board moves fast; that part of the deviation is for shutters that roll
    ratio = errors_px(sightings, grid_of(5, 3), drawn) / sightings.observations.sigma_px
    assert (ratio < 2.5).mean() > 0.95


@pytest.mark.parametrize("is_upward", [False, True])
def test_a_grid_of_april_tags_is_told_from_a_charuco_board(is_upward: bool) -> None:
    drawn = april_grid(is_upward)
    sightings = found(drawn, columns=5, rows=4, marker=0.75 * SQUARE, dictionary="APRILTAG_36h11")
    inner = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * 0.75 * SQUARE
    places = []
    for number in range(20):
        row, column = divmod(number, 5)
        top = 3 - row if is_upward else row
        places.append(np.array([column, top]) * SQUARE + SQUARE / 8 + inner)
    errors = errors_px(sightings, np.concatenate(places), drawn)
    assert len(errors) > 0.8 * 2 * FRAMES * 80
    # blur draws the corners of a marker inwards, other than those between squares
    assert np.median(errors) < 0.6
    assert any("grid of markers" in message for message in sightings.messages)
    a, b, metres = sightings.survey.lengths[0]
    between = np.linalg.norm(np.concatenate(places)[a] - np.concatenate(places)[b])
    assert metres == pytest.approx(between, rel=1e-6)


def test_a_checkerboard_keeps_its_first_corner_when_it_is_upside_down() -> None:
    drawn = checkers(6, 5)
    sightings = found(drawn, columns=6, rows=5)
    numbers = grid_of(6, 5)
    errors = errors_px(sightings, numbers, drawn)
    turned = errors_px(sightings, numbers[::-1], drawn)
    # which of the two ends comes first is a convention; all cameras and frames must have the same
    best = min(errors, turned, key=lambda each: float(np.median(each)))
    assert len(best) > 0.98 * 2 * FRAMES * 30
    assert best.max() < 1.5


def test_of_a_board_that_looks_the_same_turned_by_half_only_the_centre_is_used() -> None:
    drawn = checkers(6, 4)
    sightings = found(drawn, columns=6, rows=4)
    assert errors_px(sightings, np.array([[3.5, 2.5]]) * SQUARE, drawn).max() < 0.5
    assert sightings.survey.lengths == ()
    assert any("turned by half" in message for message in sightings.messages)


def test_observations_are_in_pixels_of_the_captures_that_the_lens_states() -> None:
    drawn = charuco()
    recordings = {name: recorded(drawn, k) for k, name in enumerate(("a", "b"))}
    board: dict[str, float | str] = {"square": SQUARE, "columns": 6, "rows": 4, "marker": 0.75 * SQUARE, "dictionary": "5X5_100"}
    K2 = np.array([[1040.0, 0, 642.5], [0, 1040.0, 474.5], [0, 0, 1]])
    lens = Lens(K=K2, width=2 * WIDTH, height=2 * HEIGHT)
    small = observe_recordings(recordings, board)
    large = observe_recordings(recordings, board, lenses={"a": lens, "b": lens})
    assert large.observations.xy == pytest.approx((small.observations.xy + 0.5) * 2 - 0.5)


def test_a_turned_recording_and_one_that_is_none_are_said() -> None:
    drawn = charuco()
    recordings = {name: recorded(drawn, 0) for name in ("a", "b", "c")}
    recordings["d"] = io.BytesIO(b"no video")
    board: dict[str, float | str] = {"square": SQUARE, "columns": 6, "rows": 4, "marker": 0.75 * SQUARE, "dictionary": "5X5_100"}
    sightings = observe_recordings(recordings, board, lenses={"c": Lens(width=HEIGHT, height=WIDTH)})
    assert sightings.observations.cameras == ("a", "b")
    assert any("recording of c is 640 x 480, but its lens is for 480 x 640" in message for message in sightings.messages)
    assert any("recording of d is no video" in message for message in sightings.messages)


def test_a_wrong_board_is_said() -> None:
    with pytest.raises(ValueError, match="no recording shows the board"):
        found(np.full((160, 240), 255, np.uint8), columns=6, rows=4, marker=0.75 * SQUARE, dictionary="5X5_100")


@functools.cache  # three tests look at it
def desk() -> tuple[Sightings, dict[str, Lens], dict[str, dict[str, list[float]]]]:
    """What the recordings of a desk show, the lenses, and the cameras that are known."""
    stated = json.loads((DESK / "cameras.json").read_text())
    times: dict[str, list[float]] = {}
    for row in csv.DictReader((DESK / "times.csv").open()):
        times.setdefault(row["camera"], []).append(float(row["seconds"]))
    lenses = {name: Lens(np.array(each["K"]), np.array(each["distortion"]), None, 1280, 720) for name, each in stated.items()}
    board: dict[str, float | str] = {"columns": 4, "rows": 5, "square": 0.054, "marker": 0.0405, "dictionary": "4X4_1000"}
    sightings = observe_recordings(
        {name: io.BytesIO((DESK / f"{name}.mp4").read_bytes()) for name in stated},
        board,
        times={name: np.array(each) for name, each in times.items()},
        lenses=lenses,
    )
    return sightings, lenses, stated


@functools.cache
def desk_cameras() -> ObservedPoses:
    """The cameras as the board places them."""
    sightings, lenses, _ = desk()
    solved = solve_observations(sightings.observations, lenses, {}, sightings.survey)
    assert isinstance(solved, ObservedPoses)
    return solved


@pytest.mark.skipif(not DESK.exists(), reason="needs shared/data/desk")
@pytest.mark.xfail(
    strict=True,
    reason="up to 0.65 degrees and 1.4 cm from them: the solver finds cam1 0.12 s late, which brings its residuals from 2.5 to "
    "0.5 px; the known cameras were perhaps solved as if frames of one number were taken at once",
)
def test_the_board_on_the_desk_gives_the_known_cameras() -> None:
    _, _, stated = desk()
    solved = desk_cameras()
    names = list(stated)
    for first, second in combinations(names, 2):
        R1, R2 = solved.placements[first].R, solved.placements[second].R
        C1, C2 = solved.placements[first].C, solved.placements[second].C
        assert R1 is not None and R2 is not None and C1 is not None and C2 is not None
        known = np.array(stated[second]["R"]) @ np.array(stated[first]["R"]).T
        assert angle_between_deg(R2 @ R1.T, known) < 0.3
        length = float(np.linalg.norm(np.array(stated[second]["C"]) - np.array(stated[first]["C"])))
        assert float(np.linalg.norm(C2 - C1)) == pytest.approx(length, abs=0.01)


@pytest.mark.skipif(not DESK.exists(), reason="needs shared/data/desk")
def test_lenses_are_not_blamed_for_a_board_that_is_turned_by_hand() -> None:
    solved = desk_cameras()
    assert len(solved.placements) == 4
    assert all(camera.focal_change is None for camera in solved.cameras.values())
    assert solved.reprojection_px is not None and solved.reprojection_px < 0.5


@pytest.mark.skipif(not DESK.exists(), reason="needs shared/data/desk")
def test_corners_of_a_turned_board_on_a_desk_agree_with_the_cameras_that_are_known() -> None:
    sightings, _, stated = desk()
    observed = sightings.observations
    assert len(observed.time) > 2000
    errors = []
    moments = np.round(6 * observed.time).astype(int)
    for moment in np.unique(moments):
        for thing in np.unique(observed.thing[moments == moment]):
            rows = np.flatnonzero((moments == moment) & (observed.thing == thing))
            if len(rows) >= 2:
                errors += reprojection(rows, sightings, stated)
    # the cameras' frames are up to 20 ms apart, in which the board moves by a pixel or two
    assert np.median(errors) < 1.2
    assert (np.array(errors) > 10).mean() < 0.01


def reprojection(rows: npt.NDArray[np.intp], sightings: Sightings, stated: dict[str, dict[str, list[float]]]) -> list[float]:
    """Distances in pixels between observations of a point and its projections by known cameras."""
    observed = sightings.observations
    equations = []
    cameras = []
    for row in rows:
        entry = stated[observed.cameras[observed.camera[row]]]
        lens, R, C = np.array(entry["K"]), np.array(entry["R"]), np.array(entry["C"])
        D = np.array(entry["distortion"])
        x, y = cv2.undistortPoints(observed.xy[row].reshape(1, 1, 2), lens, D).ravel()
        M = np.column_stack([R, -R @ C])
        equations += [x * M[2] - M[0], y * M[2] - M[1]]
        cameras.append((lens, D, R, C))
    X = np.linalg.svd(np.array(equations))[2][-1]
    errors = []
    for row, (lens, D, R, C) in zip(rows, cameras, strict=True):
        projected = cv2.projectPoints((X[:3] / X[3])[None], cv2.Rodrigues(R)[0], -R @ C, lens, D)[0].ravel()
        errors.append(float(np.linalg.norm(projected - observed.xy[row])))
    return errors
