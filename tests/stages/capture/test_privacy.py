"""Private areas are visible in no frame."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from wbflow_stages.capture.files import BadCapture
from wbflow_stages.capture.privacy import GREY
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Capture, Lens, Privacy

WIDTH, HEIGHT = 320, 180
MAGENTA = (255, 0, 255)
PIXELS = Privacy(np.array([[40.0, 30], [120, 30], [120, 90], [40, 90]]), np.array([4.0]))
FRACTIONS = Privacy(PIXELS.corners / (WIDTH, HEIGHT), PIXELS.counts)


def captures(count: int = 3) -> list[Capture]:
    rng = np.random.default_rng(0)
    still = cv2.resize(rng.integers(40, 200, (12, 20, 3), np.uint8), (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    found = []
    for k in range(count):
        image = np.clip(still.astype(float) * (0.9 + 0.1 * k) + rng.normal(0, 2, still.shape), 0, 255).astype(np.uint8)
        image[30:91, 40:121] = MAGENTA
        found.append(Capture(f"{k}.png", cv2.imencode(".png", image)[1].ravel()))
    return found


@pytest.mark.parametrize("privacy", [PIXELS, FRACTIONS], ids=["pixels", "fractions"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_private_area_is_grey_and_masked_at_every_resolution(privacy: Privacy, count: int) -> None:
    K = np.array([[260.0, 0, 159.5], [0, 260, 89.5], [0, 0, 1]])
    lens = Lens(K, np.array([-0.2, 0.05, 0, 0, 0]), None, WIDTH, HEIGHT)
    for size in (None, 200):
        frame = clean_frame(captures(count), lens, None, privacy, resolution=size)
        magenta = (frame.image[..., 0] > frame.image[..., 1] + 60.0) & (frame.image[..., 2] > frame.image[..., 1] + 60.0)
        assert not magenta[~frame.mask].any()
        # the scene itself contains purple, but nothing of the pure magenta of the private area may remain
        assert not ((frame.image[..., 0] > 235) & (frame.image[..., 1] < 40) & (frame.image[..., 2] > 235)).any()
        hidden = (frame.image == GREY).all(axis=2)
        assert hidden.mean() > 0.07
        assert not (hidden & frame.mask).any()
    assert (clean_frame(captures(count), lens, None).image[..., 1] < 10).mean() > 0.05, "it was there"


def test_a_privacy_polygon_outside_the_image_is_refused() -> None:
    large = Privacy(PIXELS.corners * 10, PIXELS.counts)
    with pytest.raises(BadCapture, match="privacy polygon"):
        clean_frame(captures(1), Lens(), None, large)


def test_several_privacy_polygons_are_all_grey_and_masked() -> None:
    both = Privacy(np.vstack([PIXELS.corners, [[200.0, 100], [250, 100], [225, 150]]]), np.array([4.0, 3.0]))
    frame = clean_frame(captures(1), Lens(), None, both)
    assert (frame.image[[60, 115], [80, 225]] == GREY).all()
    assert not frame.mask[[60, 115], [80, 225]].any()
