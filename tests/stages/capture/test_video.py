"""Images taken from videos."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from wbflow_stages.capture.files import BadCapture
from wbflow_stages.capture.video import one_picture, pictures
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Capture, Lens

SIZE = (160, 96)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """60 frames of a still scene through which a dark object moves."""
    file = tmp_path_factory.mktemp("video") / "gate.avi"
    still = cv2.resize(np.random.default_rng(0).integers(60, 220, (8, 12, 3), np.uint8), SIZE, interpolation=cv2.INTER_CUBIC)
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 25, SIZE)
    assert writer.isOpened()
    for k in range(60):
        frame = still.copy()
        frame[40:60, 2 * k : 2 * k + 20] = 0
        writer.write(frame)
    writer.release()
    return Capture("gate.avi", np.fromfile(file, np.uint8))


def test_every_nth_video_frame_is_taken_up_to_a_maximum(video: Capture) -> None:
    assert [name for name, _ in pictures(video, 25, 15)] == ["gate.avi frame 0", "gate.avi frame 25", "gate.avi frame 50"]
    spread = [name for name, _ in pictures(video, 1, 4)]
    assert len(spread) == 4 and spread[-1] == "gate.avi frame 45"
    assert one_picture(video).shape == (96, 160, 3)


def test_an_object_that_moves_through_a_video_is_removed(video: Capture) -> None:
    frame = clean_frame([video], Lens(), None, video_step=5)
    assert frame.image[40:60].min() > 30
    assert frame.frames_used == 12


def test_a_file_that_is_not_a_video_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(BadCapture, match=r"gate\.mp4 is no video"):
        clean_frame([Capture("gate.mp4", np.arange(200, dtype=np.uint8))], Lens(), None)
    with pytest.raises(BadCapture, match="empty"):
        clean_frame([Capture("gate.mp4", np.zeros(0, np.uint8))], Lens(), None)
