"""Images from a video file: every n-th frame, up to a maximum number, without frames that were not decoded as they were sent.

A decoder that meets damage shows what it has: grey, black, or remains of earlier frames.  All that depends on a damaged place is
left out here: the frames from there to the next one that is coded by itself (a key frame).
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import PurePath
from typing import Any

import av
import numpy as np

from ..io.image_headers import is_image, is_video, jpeg_offset
from ..types import Capture, Lens, Uint8s
from .files import BadCapture, EmptyCapture, NotAnImage, decode
from .levels import Levels

SUFFIXES = frozenset({".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts"})
"""Suffixes of videos in lower case; they decide where the content is of no known format."""
_HEADER_BYTES = 4096
"""Bytes at the beginning of a file that tell its format."""
MOST_FRAMES = 100_000
"""Largest number of frames that are read, in case a file claims to be endless."""


_BARE_FORMATS = frozenset({"h264", "hevc", "m4v", "mpegvideo"})
"""FFmpeg's names of videos without a container, in which a lost beginning is not noticed."""
_START_CODES = (b"\0\0\1", b"\0\0\0\1")
"""How each unit of such a video begins, and therefore the video itself."""


class DamagedVideo(BadCapture):
    """Frames of a video could not be decoded; the others have been used."""


def pictures(capture: Capture, step: int, most_pictures: int) -> Iterator[tuple[str, Uint8s]]:
    """Every `step`-th frame of a video as name and image (h, w, 3) uint8 RGB, upright, at most `most_pictures`.

    If the video's length is known, the step grows so that the images cover all of it.  In place of a damaged frame the next sound
    one is taken.  Raises BadCapture if the file is empty or nothing in it can be decoded, and, after the last image, DamagedVideo
    if there were damaged frames.
    """
    if capture.data.size == 0:
        raise EmptyCapture(f"{capture.name} is empty (0 bytes)")
    count = 0
    damaged = 0
    wanted = 0
    with _opened(capture) as container:
        is_bare = container.format.name in _BARE_FORMATS
        begins_whole = not is_bare or capture.data[:8].tobytes().startswith(_START_CODES)
        length = frame_count(container)
        if 0 < length < MOST_FRAMES:
            step = max(step, -(-length // most_pictures))
        for number, frame in enumerate(sound_frames(container, begins_whole)):
            if count >= most_pictures or number >= MOST_FRAMES:
                break
            if frame is None:
                damaged += 1
            elif number >= wanted:
                count += 1
                wanted = number - number % step + step
                yield f"{capture.name} frame {number}", upright(frame, "rgb24")
    if not count:
        raise NotAnImage(f"{capture.name} holds no picture that can be decoded ({capture.data.size:,} bytes)")
    if damaged:
        raise DamagedVideo(f"{capture.name} is damaged: {damaged} of its frames cannot be decoded, and are not used")


def sound_frames(container: Any, begins_whole: bool = True) -> Iterator[Any]:
    """Each frame (av.VideoFrame) of an opened video or stream in order of time; None for one that is damaged.

    The decoder reports damage for the packet that it reads; frames that it shows afterwards may depend on that packet.  Frames
    count again from a key frame on whose packet comes after the damage.

    begins_whole: False if the beginning is lost, perhaps within the first packet.
    """
    stream = container.streams.video[0]
    stream.codec_context.thread_count = 1
    stream.codec_context.options = {"err_detect": "explode"}  # report damage instead of concealing it
    is_sound = begins_whole
    is_first = True
    has_new_key = False
    key_time: int | None = None
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
            if packet is None:
                return
            if not is_sound and not has_new_key and packet.is_keyframe and not packet.is_corrupt:
                has_new_key = True
                key_time = packet.pts
            frames = packet.decode()
            is_damaged = packet.is_corrupt or (is_first and not begins_whole)
        except av.error.EOFError:
            return
        except av.error.InvalidDataError:
            frames = [None]
            is_damaged = True
        is_first = False
        if is_damaged:
            is_sound = False
            has_new_key = False
        for frame in frames:
            if frame is not None and not is_sound and has_new_key:
                is_sound = frame.key_frame if key_time is None or frame.pts is None else frame.pts >= key_time
            if frame is None or not is_sound or frame.is_corrupt:
                yield None
            else:
                yield frame


def upright(frame: Any, pixel_format: str) -> Uint8s:
    """The pixels (h, w, 3) uint8 of a frame, turned as the video says.  pixel_format: "rgb24" or "bgr24"."""
    image = frame.to_ndarray(format=pixel_format)
    quarter_turns = round(getattr(frame, "rotation", 0) / 90)  # counterclockwise
    return np.ascontiguousarray(np.rot90(image, quarter_turns))


def frame_count(container: Any) -> int:
    """Number of frames that a file states, or that its length and rate give; 0 if neither is known."""
    stream = container.streams.video[0]
    if stream.frames:
        return int(stream.frames)
    if container.duration and stream.average_rate:
        return int(container.duration / av.time_base * stream.average_rate)
    return 0


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
def _opened(capture: Capture) -> Iterator[Any]:
    """The opened video (av.container.InputContainer)."""
    data = io.BytesIO(np.ascontiguousarray(capture.data).tobytes())
    try:
        # a playlist could name other files and addresses: none may be opened
        container = av.open(data, options={"protocol_whitelist": "none"})
    except (av.error.FFmpegError, ValueError):
        raise BadCapture(f"{capture.name} is no video that can be read ({capture.data.size:,} bytes)") from None
    with container:
        if not container.streams.video:
            raise BadCapture(f"{capture.name} holds no video, only {', '.join({s.type for s in container.streams}) or 'nothing'}")
        yield container
