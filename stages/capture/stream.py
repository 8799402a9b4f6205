"""Images of a live video stream, each the first at or after its requested time."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence

import cv2

_QUALITY = 95
"""JPEG quality of the written files; the stream itself has been compressed before."""
_YEAR_2000_US = 946_684_800e6


def stream_pictures(url: str, moments: Sequence[float], patience: float) -> Iterator[tuple[bytes, float | None]]:
    """Yield, for each moment (Unix times, ascending), a JPEG file's bytes and the sender's time stamp (None: it sends none).

    url: with user and password, if needed; patience: timeout in seconds of opening the stream, and of each image.  Raises
    OSError if the stream cannot be opened or decoded, or ends; the message does not contain the URL.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg's own messages contain the password
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
            is_complete, image = video.retrieve()
            if not is_complete or image is None:
                raise OSError("the stream sends what cannot be decoded")
            opened = video.get(cv2.CAP_PROP_STREAM_OPEN_TIME_USEC)  # from the sender's report; meaningless until that has arrived
            sent_at = (opened / 1e6 + video.get(cv2.CAP_PROP_POS_MSEC) / 1e3) if opened > _YEAR_2000_US else None
            yield cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes(), sent_at
    finally:
        video.release()
