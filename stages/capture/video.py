"""Images from a video file: every n-th frame, up to a maximum number, without frames that were not decoded as they were sent.

All that a damaged place may have reached is left out: the frames between two that are coded by themselves (see `decoding`).
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby, islice
from pathlib import PurePath
from typing import Any

import av
import numpy as np

from ..io.image_headers import is_image, is_video, jpeg_offset
from ..types import Capture, Lens, Uint8s
from . import matroska
from .decoding import Decoded, decoded_frames
from .files import BadCapture, EmptyCapture, NotAnImage, decode
from .levels import Levels
from .transport import damaged_places

SUFFIXES = frozenset({".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".ts"})
"""Suffixes of videos in lower case; they decide where the content is of no known format."""
_HEADER_BYTES = 4096
"""Bytes at the beginning of a file that tell its format."""
MOST_FRAMES = 100_000
"""Largest number of frames that are read, in case a file claims to be endless."""

_TRANSPORT_FORMAT = "mpegts"
"""FFmpeg's name of MPEG transport streams."""
_MATROSKA_FORMAT = "matroska,webm"
"""FFmpeg's name of Matroska files."""
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
        length = frame_count(container)
        if 0 < length < MOST_FRAMES:
            step = max(step, -(-length // most_pictures))
        frames = islice(enumerate(_decoded(container, capture)), MOST_FRAMES)
        for stretch, frames_of_stretch in groupby(frames, key=lambda numbered: numbered[1].stretch):
            # no picture is handed on before all of its stretch has been decoded without damage
            candidates: list[_Candidate] = []
            packets: list[int] = []
            next_wanted = wanted
            for number, decoded in frames_of_stretch:
                packets.append(decoded.number)
                has_room = count + len(candidates) < most_pictures
                if decoded.frame is not None and stretch.has_key and number >= next_wanted and has_room:
                    candidates.append(
                        _Candidate(f"{capture.name} frame {number}", decoded.number, upright(decoded.frame, "rgb24"))
                    )
                    next_wanted = number - number % step + step
            if stretch.has_key:
                damaged += sum(not stretch.trusts(packet) for packet in packets)
            for candidate in candidates:
                if stretch.trusts(candidate.packet):
                    count += 1
                    wanted = next_wanted
                    yield candidate.name, candidate.image
            if count >= most_pictures:
                break
    if not count:
        raise NotAnImage(f"{capture.name} holds no picture that can be decoded ({capture.data.size:,} bytes)")
    if damaged:
        raise DamagedVideo(
            f"{capture.name} is damaged: {damaged} of its frames cannot be decoded, or not be trusted, and are not used"
        )


@dataclass(frozen=True)
class _Candidate:
    """A picture, (h, w, 3) uint8 RGB, that is shown if its stretch of the video proves sound; packet: number of its packet."""

    name: str
    packet: int
    image: Uint8s


def _decoded(container: Any, capture: Capture) -> Iterator[Decoded]:
    """The frames of an opened file, with all that the file's bytes tell about damage."""
    if container.format.name == _TRANSPORT_FORMAT:
        return decoded_frames(container, lost_places=damaged_places(capture.data, container.streams.video[0].id))
    if container.format.name == _MATROSKA_FORMAT:
        return decoded_frames(container, lost_places=matroska.damaged_places(capture.data))
    is_bare = container.format.name in _BARE_FORMATS
    begins_whole = not is_bare or capture.data[:8].tobytes().startswith(_START_CODES)
    return decoded_frames(container, begins_whole)


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
