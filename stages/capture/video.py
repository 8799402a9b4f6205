"""Images from a video file: every n-th frame, up to a maximum number."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import PurePath
from tempfile import NamedTemporaryFile

import cv2
import numpy as np

from ..io.image_headers import is_image, is_video, jpeg_offset
from ..types import Capture, Lens, Uint8s
from .files import BadCapture, EmptyCapture, NotAnImage, decode
from .levels import Levels

SUFFIXES = frozenset({".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts"})
IN_MEMORY = hasattr(os, "memfd_create")
_HEADER_BYTES = 4096
"""Bytes at the beginning of a file that tell its format."""
MOST_FRAMES = 100_000
"""Largest number of frames that are read, in case a file claims to be endless."""


def pictures(capture: Capture, step: int, most_pictures: int) -> Iterator[tuple[str, Uint8s]]:
    """Every `step`-th frame of a video as name and image (h, w, 3) uint8 RGB, at most `most_pictures`.

    If the video's length is known, the step grows so that the images cover all of it.  Raises BadCapture if the file is empty
    or nothing in it can be decoded.
    """
    if capture.data.size == 0:
        raise EmptyCapture(f"{capture.name} is empty (0 bytes)")
    count = 0
    with _opened(capture) as video:
        length = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
        step = max(step, -(-length // most_pictures)) if 0 < length < MOST_FRAMES else step
        for number in range(MOST_FRAMES):
            if count >= most_pictures or not video.grab():
                break
            if number % step:
                continue
            is_complete, image = video.retrieve()
            if is_complete and image is not None and image.ndim == 3:
                count += 1
                name = f"{capture.name} frame {number}"
                yield name, np.asarray(cv2.cvtColor(np.asarray(image), cv2.COLOR_BGR2RGB), dtype=np.uint8)
    if not count:
        raise NotAnImage(f"{capture.name} holds no picture that can be decoded ({capture.data.size:,} bytes)")


def all_pictures(
    capture: Capture, step: int, most_pictures: int, lens: Lens | None = None, levels: Levels | None = None
) -> Iterator[tuple[str, Uint8s]]:
    """A capture's images (h, w, 3) uint8 RGB with their names: one, or several of a video.  Raises BadCapture.

    Parameters
    ----------
    capture : an image file or a video.
    step, most_pictures : for a video, see `pictures`.
    lens, levels : see `files.decode`.
    """
    if is_video_file(capture):
        yield from pictures(capture, step, most_pictures)
    else:
        yield capture.name, decode(capture, lens, levels)


def is_video_file(capture: Capture) -> bool:
    """Is a file a video?  Its content decides; where that is of no known format, its name does."""
    head = capture.data[:_HEADER_BYTES].tobytes()
    if is_image(head) or jpeg_offset(head) is not None:
        return False
    return is_video(head) or PurePath(capture.name).suffix.lower() in SUFFIXES


def one_picture(capture: Capture) -> Uint8s:
    """A capture's image (h, w, 3) uint8 RGB; the first frame of a video.  Raises BadCapture."""
    return next(all_pictures(capture, 1, 1))[1]


@contextmanager
def _opened(capture: Capture) -> Iterator[cv2.VideoCapture]:
    """The opened video; FFmpeg reads only files: one in memory if the system supports that, else a temporary one."""
    suffix = PurePath(capture.name).suffix
    with os.fdopen(os.memfd_create("video"), "wb") if IN_MEMORY else NamedTemporaryFile(suffix=suffix) as file:
        file.write(capture.data.tobytes())
        file.flush()
        path = f"/proc/self/fd/{file.fileno()}" if IN_MEMORY else str(file.name)
        video = cv2.VideoCapture(path, cv2.CAP_FFMPEG)
        try:
            if not video.isOpened():
                raise BadCapture(f"{capture.name} is no video that can be read ({capture.data.size:,} bytes)")
            yield video
        finally:
            video.release()
