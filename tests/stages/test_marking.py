"""Images to draw areas on, and masks made from these areas."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers.images import decoded
from wbflow_stages.capture.files import BadCapture
from wbflow_stages.marking import LARGE, as_jpeg, mask_overlay, paint_mask
from wbflow_stages.types import Uint8s


def png(image: Uint8s) -> bytes:
    return bytes(cv2.imencode(".png", image)[1].tobytes())


def test_a_large_capture_is_shown_smaller_and_its_full_size_is_returned() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (20, 40, 3), dtype=np.uint8)
    width, height, jpeg = as_jpeg("a.png", png(np.asarray(cv2.resize(noise, (4000, 2000)), np.uint8)))
    assert (width, height) == (4000, 2000)
    assert decoded(jpeg).shape == (LARGE // 2, LARGE, 3)


def test_unreadable_pictures_and_masks_are_refused_by_name() -> None:
    with pytest.raises(BadCapture, match=r"a\.png"):
        as_jpeg("a.png", b"no picture")
    with pytest.raises(BadCapture, match="mask gate"):
        mask_overlay("gate", b"no picture")
    with pytest.raises(BadCapture, match="64 x 48"):
        paint_mask("gate", png(np.full((48, 64), 255, np.uint8)), (640, 480), [])


def test_areas_are_painted_in_order() -> None:
    square = [[10.0, 10.0], [19.0, 10.0], [19.0, 19.0], [10.0, 19.0]]
    inner = [[12.0, 12.0], [14.0, 12.0], [14.0, 14.0], [12.0, 14.0]]
    mask = decoded(paint_mask("gate", None, (64, 48), [(False, square), (True, inner)]), cv2.IMREAD_GRAYSCALE)
    assert mask.shape == (48, 64)
    assert np.count_nonzero(mask == 0) == 100 - 9
    tinted = decoded(mask_overlay("gate", paint_mask("gate", None, (64, 48), [(False, square)])), cv2.IMREAD_UNCHANGED)
    assert np.count_nonzero(tinted[..., 3]) == 100


def test_a_mask_that_leaves_no_pixel_is_refused() -> None:
    with pytest.raises(BadCapture, match="no pixel"):
        paint_mask("gate", None, (64, 48), [(False, [[-1, -1], [64, -1], [64, 48], [-1, 48]])])
