"""Damage that cameras and recorders do to images is reported, and repaired where possible."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers.measured import measured
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Capture, Frame, Lens, Uint8s

HEIGHT, WIDTH = 180, 320


@pytest.fixture(scope="module")
def scene() -> Uint8s:
    """A colour image with detail of all sizes."""
    rng = np.random.default_rng(3)
    picture = np.zeros((HEIGHT, WIDTH, 3))
    for sigma in (0.8, 2.0, 6.0, 25.0):
        layer = cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH)), (0, 0), sigma)
        picture += layer[..., None] / layer.std() * sigma**0.7
    colours = cv2.GaussianBlur(rng.standard_normal((HEIGHT, WIDTH, 3)), (0, 0), 12.0)
    picture += 4 * colours / colours.std()
    picture = 118 + 36 * picture / picture.std()
    return np.asarray(np.clip(picture, 0, 255), dtype=np.uint8)


def frame_of(picture: Uint8s, quality: int = 95) -> Frame:
    data = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return clean_frame([Capture("1.jpg", np.frombuffer(data, np.uint8))], Lens(), None, resolution=None)


def mean_difference(frame: Frame, picture: Uint8s) -> float:
    return float(np.abs(frame.image[8:-8, 8:-8].astype(float) - picture[8:-8, 8:-8]).mean())


def test_an_undamaged_picture_has_no_notes_of_damage(scene: Uint8s) -> None:
    frame = frame_of(scene)
    assert not frame.notes
    assert (
        measured(frame.combing) < 0.02
        and measured(frame.blocking) < 1.2
        and measured(frame.cast) < 1.2
        and measured(frame.colour) > 0.1
    )


@pytest.mark.parametrize("shift", [-3, 1, 2])
def test_shifted_rows_of_a_combed_picture_are_shifted_back(scene: Uint8s, shift: int) -> None:
    combed = scene.copy()
    combed[1::2] = np.roll(scene, shift, axis=1)[1::2]
    frame = frame_of(combed)
    assert frame.notes == ("1 of 1 captures are combed: every second row is displaced, and is shifted back",)
    assert mean_difference(frame, scene) < 1.3 * mean_difference(frame_of(scene), scene) + 0.5


def test_only_one_moment_of_an_interlaced_picture_is_used(scene: Uint8s) -> None:
    """Rows of two moments whose contents move by different amounts cannot be aligned by one shift."""
    later = np.concatenate([np.roll(scene[:90], 14, axis=1), np.roll(scene[90:], -11, axis=1)])
    combed = scene.copy()
    combed[1::2] = later[1::2]
    frame = frame_of(combed)
    assert measured(frame.combing) > 0.1 and any("another moment (interlaced)" in note for note in frame.notes)
    assert mean_difference(frame, scene) < 0.6 * mean_difference(frame, later)


@pytest.mark.parametrize(
    ("damage", "quality", "expected"),
    [
        (lambda picture: picture, 8, "coded coarsely"),
        (lambda picture: np.repeat(picture[..., 1:2], 3, axis=2), 95, "without colour"),
        (lambda picture: (picture * [0.5, 0.95, 1.0]).astype(np.uint8), 95, "a cast of colour"),
    ],
)
def test_coarse_coding_missing_colour_and_colour_casts_are_reported(
    scene: Uint8s, damage: object, quality: int, expected: str
) -> None:
    assert callable(damage)
    notes = frame_of(damage(scene), quality).notes
    assert len(notes) == 1 and expected in notes[0]
