"""Recordings as streams of frames with their times: one picture is in memory at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, BinaryIO

import av
import cv2
import numpy as np

from ..capture.decoding import decoded_frames
from ..capture.files import BadCapture
from ..capture.video import MOST_FRAMES, upright
from ..types import Float64s, Uint8s


@dataclass(frozen=True)
class Recording:
    """A video of one camera."""

    name: str
    """Of its file."""
    file: BinaryIO
    """Its content; it is read from the beginning for each pass."""
    times: Float64s | None = None
    """(n,) float64 seconds of its frames by the camera's clock, nan for those that are not known; None: the video's own times."""
    size: tuple[int, int] = (0, 0)
    """Width and height of its upright frames, pixels."""

    def frames(self, most_per_s: float = np.inf) -> Iterator[RecordedFrame]:
        """Its frames in the order of time, upright, without those that are known to be damaged.  Raises BadCapture.

        most_per_s: frames of a second that are enough; between them, frames are left out evenly.
        """
        with self._opened() as container:
            last = -np.inf
            for number, decoded in enumerate(decoded_frames(container)):
                if number >= MOST_FRAMES:
                    break
                if not decoded.is_trusted:
                    continue
                time = self._time(number, decoded.frame, container)
                # a little less than the interval: times are rounded
                if not np.isfinite(time) or time < last + 0.9 / most_per_s:
                    continue
                last = time
                yield RecordedFrame(time, upright(decoded.frame, "bgr24"))

    def _time(self, number: int, frame: Any, container: Any) -> float:
        """Time of a frame, seconds; nan if it is not known."""
        if self.times is not None:
            return float(self.times[number]) if number < len(self.times) else np.nan
        stream = container.streams.video[0]
        if frame.pts is not None:  # in the stream's unit: the last frames that a decoder hands out do not state theirs
            return float(frame.pts * stream.time_base)
        rate = stream.average_rate
        return number / float(rate) if rate else np.nan

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """The opened file (av.container.InputContainer)."""
        self.file.seek(0)
        try:
            # a playlist could name other files and addresses: none may be opened
            container = av.open(self.file, options={"protocol_whitelist": "none"})
        except (av.error.FFmpegError, ValueError):
            raise BadCapture(f"{self.name} is no video that can be read") from None
        with container:
            if not container.streams.video:
                raise BadCapture(f"{self.name} holds no video")
            yield container


@dataclass(frozen=True)
class RecordedFrame:
    """A frame of a recording."""

    time: float
    """Seconds by the camera's clock."""
    image: Uint8s
    """(h, w, 3) uint8 BGR, as OpenCV has it."""

    @property
    def grey(self) -> Uint8s:
        """(h, w) uint8."""
        return np.asarray(cv2.cvtColor(self.image, cv2.COLOR_BGR2GRAY), np.uint8)


def open_recording(camera: str, file: BinaryIO, times: Float64s | None) -> Recording:
    """The recording of a camera; times: see `Recording`.  Raises BadCapture if it cannot be read or has no frame."""
    recording = Recording(f"the recording of {camera}", file, times)
    first = next(recording.frames(), None)
    if first is None:
        raise BadCapture(f"{recording.name} has no frame that can be decoded, and whose time is known")
    height, width = first.image.shape[:2]
    return replace(recording, size=(width, height))
