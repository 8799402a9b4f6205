"""Pictures of a live video stream, each as near to its moment as the stream has one."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence

import cv2

_QUALITY = 95
"""Of the JPEG files: a stream has been coded before."""
_YEAR_2000_US = 946_684_800e6


def stream_pictures(url: str, moments: Sequence[float], patience: float) -> Iterator[tuple[bytes, float | None]]:
    """Yield a JPEG file's bytes for each moment (Unix times, in order), and when its sender says that it was taken; None: it does
    not.  url: with user and password, where they are needed; patience: seconds that opening the stream, or one picture, may take.

    Raises OSError where the stream cannot be opened, or ends; the message is without its URL.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg's own messages hold the password
    limit = int(1000 * patience)
    video = cv2.VideoCapture(url, cv2.CAP_FFMPEG, [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, limit, cv2.CAP_PROP_READ_TIMEOUT_MSEC, limit])
    try:
        if not video.isOpened():
            raise OSError("the stream cannot be opened: look at its address, user and password")
        for moment in moments:
            while video.grab():
                if time.time() >= moment:
                    break
            else:
                raise OSError("the stream has ended")
            whole, image = video.retrieve()
            if not whole or image is None:
                raise OSError("the stream sends what cannot be decoded")
            began = video.get(cv2.CAP_PROP_STREAM_OPEN_TIME_USEC)  # by the sender's report; nonsense before it has come
            sent = (began / 1e6 + video.get(cv2.CAP_PROP_POS_MSEC) / 1e3) if began > _YEAR_2000_US else None
            yield cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes(), sent
    finally:
        video.release()
