"""Small preview images for the report."""

from __future__ import annotations

import cv2
import numpy as np

from tests.helpers.exact_scene import make_yard
from wbflow_stages.exports.previews import (
    cloud_preview,
    disparity_preview,
    frame_large,
    frame_preview,
    inlier_marks,
    keypoint_marks,
    matches_preview,
    rectified_preview,
)
from wbflow_stages.fuse import fuse
from wbflow_stages.types import Cloud, Disparity, Features, Frame, Matches, View


def picture(data: np.ndarray) -> np.ndarray:
    assert data.dtype == np.uint8 and data.ndim == 1
    image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    assert image is not None and image.shape[1] <= 480
    return image[..., ::-1]


def frame(width: int = 960, height: int = 640, level: int = 200) -> Frame:
    return Frame(np.full((height, width, 3), level, np.uint8), np.ones((height, width), bool), View(width, height))


def matches(x1: np.ndarray, x2: np.ndarray) -> Matches:
    n = len(x1)
    index, view = np.arange(n, dtype=np.int32), View(960, 640)
    return Matches(x1, x2, index, index, np.ones(n, np.float32), np.tile(np.eye(2), (n, 1, 1)), view, view)


def test_the_preview_of_a_frame_keeps_its_shape_and_darkens_masked_pixels() -> None:
    masked = frame()
    masked.mask[:, :480] = False
    shown = picture(frame_preview(masked))
    assert shown.shape == (320, 480, 3)
    assert shown[:, 250:].mean() > 190 and shown[:, :230].mean() < 100


def test_a_match_is_drawn_as_a_line_between_its_points() -> None:
    x = np.array([[480.0, 320.0]])
    plain = picture(matches_preview(matches(x[:0], x[:0]), frame(), frame()))
    drawn = picture(matches_preview(matches(x, x), frame(), frame()))
    rows, columns = np.nonzero(np.abs(drawn.astype(int) - plain).max(axis=2) > 60)
    assert abs(columns.min() - 119) < 5 and abs(columns.max() - (119 + 242)) < 5 and abs(np.median(rows) - 79) < 3


def test_disparity_is_drawn_black_where_unknown_and_coloured_by_distance() -> None:
    left = np.full((100, 200), -32768, np.int16)
    left[:, 100:] = 16 * np.linspace(5, 60, 100).astype(np.int16)
    confidence = np.zeros((100, 200), np.uint8)
    shown = picture(disparity_preview(Disparity(left, left, confidence, confidence, 0, 0.5)))
    assert shown.shape[1] == 404 and shown[:100, :95].max() < 40
    ramp = shown[100:][len(shown[100:]) // 2].astype(int)
    assert shown.shape[0] > 110 and (ramp[:, 2] - ramp[:, 0]).argmax() < (ramp[:, 0] - ramp[:, 2]).argmax(), "far to near"
    far, near = shown[50, 105].astype(int), shown[50, 195].astype(int)
    assert far[2] > far[0] and near[0] > near[2]


def test_the_cloud_preview_shows_the_points_from_above_and_the_cameras() -> None:
    yard = make_yard()
    cloud = fuse(yard.frames, yard.cameras, yard.depths())
    assert isinstance(cloud, Cloud)
    shown = picture(cloud_preview(cloud, yard.cameras)).astype(int)
    red = (shown[..., 0] > 150) & (shown[..., 1] < 120) & (shown[..., 2] < 120)
    covered = np.abs(shown - 24).max(axis=2) > 30
    assert red[-shown.shape[0] // 5 :].sum() > 60  # three cameras at the lower edge, where there are no points
    assert covered.mean() > 0.1
    assert cloud_preview(cloud, yard.cameras).tobytes() == cloud_preview(cloud, yard.cameras).tobytes()


def test_the_disparity_preview_of_a_rectified_pair_has_its_rows_and_a_scale() -> None:
    yard = make_yard()
    pair, rectification = next(iter(yard.rectifications.items()))
    left, right = (yard.frames[name] for name in pair)
    rows = picture(rectified_preview(rectification, left, right))
    both = picture(disparity_preview(yard.disparities[pair], left=left, right=right, rectification=rectification))
    alone = picture(disparity_preview(yard.disparities[pair]))
    assert rows.std() > 20 and abs(both.shape[0] - rows.shape[0] - alone.shape[0] - 4) <= 1
    assert 0 < alone.shape[0] - rows.shape[0] < 30, "a scale below it"


def test_previews_of_empty_clouds_and_disparities_are_drawn() -> None:
    none = np.zeros(0, np.float32)
    empty = Cloud(
        np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), none, none.astype(np.uint16), none
    )
    picture(cloud_preview(empty, {}))
    nothing = np.full((10, 10), -32768, np.int16)
    confidence = np.zeros((10, 10), np.uint8)
    assert picture(disparity_preview(Disparity(nothing, nothing, confidence, confidence, 0, 0.0))).max() < 40


def test_a_large_preview_has_the_frame_size_and_marks_are_fractions_of_it() -> None:
    large = cv2.imdecode(frame_large(frame()), cv2.IMREAD_COLOR)
    assert large is not None and large.shape == (640, 960, 3)
    corners = np.array([[-0.5, -0.5], [959.5, 639.5]])
    both = np.frombuffer(inlier_marks(matches(corners, corners[::-1])), "<u2").reshape(2, -1, 2)  # type: ignore[arg-type]
    assert both.tolist() == [[[0, 0], [65535, 65535]], [[65535, 65535], [0, 0]]]
    xy = np.column_stack([np.linspace(0, 959, 5000), np.full(5000, 319.5)])
    ones = np.ones(5000, np.float32)
    found = Features(
        xy, np.tile(np.eye(2), (5000, 1, 1)), np.ones((5000, 4), np.float32), ones, ones.astype(np.uint8), View(960, 640)
    )
    marks = np.frombuffer(keypoint_marks(found), "<u2").reshape(-1, 2)
    assert len(marks) == 3000
    assert np.ptp(marks[:, 0]) > 65000 and np.abs(marks[:, 1].astype(int) - 32768).max() <= 1
