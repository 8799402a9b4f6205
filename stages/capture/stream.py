"""Images of a live video stream, each the first sound one at or after its requested time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import av
import cv2

from .decoding import decoded_frames
from .video import upright

_QUALITY = 95
"""JPEG quality of the written files; the stream itself has been compressed before."""
_YEAR_2000_US = 946_684_800_000_000
"""Times of a sender before this one, microseconds since 1970, are of a clock that was never set, or not known yet."""
_OVER_TCP = {"rtsp_transport": "tcp"}
"""Without lost packets; FFmpeg's default, UDP, is blocked by many networks."""


def stream_pictures(url: str, moments: Sequence[float], patience: float) -> Iterator[tuple[bytes, float | None]]:
    """Yield, for each moment (Unix times, ascending), a JPEG file's bytes and the sender's time stamp (None: it sends none).

    url: with user and password, if needed; patience: timeout in seconds of opening the stream, and of each image.  Raises
    OSError if the stream cannot be opened or decoded, or ends; the message does not contain the URL.
    """
    options = {}
    if url.startswith("rtsp"):
        options = _OVER_TCP
    try:
        container: Any = av.open(url, options=options, timeout=patience)
    except (av.error.FFmpegError, OSError) as error:
        raise OSError(f"the stream cannot be opened: look at its address, user and password ({_reason(error)})") from None
    with container:
        if not container.streams.video:
            raise OSError("the stream holds no video")
        try:
            yield from _at(moments, container, patience)
        except av.error.FFmpegError as error:
            raise OSError(f"the stream cannot be read: {_reason(error)}") from None


def _at(moments: Sequence[float], container: Any, patience: float) -> Iterator[tuple[bytes, float | None]]:
    """The pictures of an opened stream; parameters and errors as for `stream_pictures`."""
    decoded_of_stream = decoded_frames(container)
    for moment in moments:
        while True:
            decoded = next(decoded_of_stream, None)
            if decoded is None:
                raise OSError("the stream has ended")
            now = time.time()
            if decoded.is_trusted and now >= moment:
                break
            if now > moment + patience:
                raise OSError("the stream sends what cannot be decoded")
        image = upright(decoded.frame, "bgr24")
        yield cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes(), _sent_at(container, decoded.frame)


def _sent_at(container: Any, frame: Any) -> float | None:
    """When a frame was sent by the sender's clock, Unix time; None as long as it has not reported its clock."""
    begun = getattr(container, "start_time_realtime", None)
    if begun is None or begun < _YEAR_2000_US or frame.time is None:
        return None
    stream = container.streams.video[0]
    first = float((stream.start_time or 0) * stream.time_base)
    return float(begun / 1e6 + frame.time - first)


def _reason(error: Exception) -> str:
    """FFmpeg's message without the address, which may hold a password."""
    return str(getattr(error, "strerror", "") or type(error).__name__)
