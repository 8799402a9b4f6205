"""Frames of a video with what is known about damage.

A decoder that meets damage shows what it has: grey, black, or remains of earlier frames.  It reports damage late or not at all,
and builds its pictures on earlier ones.  What can be trusted is therefore decided for whole stretches: the packets from one frame
that is coded by itself (a key frame) to the next.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import av

_OPTIONS = {"err_detect": "crccheck+explode"}
"""Of FFmpeg's decoders: check sums where the video has them, and report damage instead of concealing it."""
_START_CODE_CODECS = frozenset({"h264", "hevc", "mpeg1video", "mpeg2video", "mpeg4"})
"""Codecs whose data hold no long run of zeros, for zeros announce a start code (e.g. ITU-T H.264, 7.4.1)."""
_LOST_BYTES = re.compile(rb"\0{8}\0*[^\0\1]")
"""Zeros that are neither padding at the end nor the beginning of a start code: bytes of a file that were never written."""


@dataclass(eq=False)
class Stretch:
    """Packets in the order of decoding, from a key frame to before the next one.

    has_key: False for the packets before a video's first key frame, of which nothing can be shown; key_time: time stamp of the
    key frame, None if not known; is_fresh: the decoder knows nothing of earlier packets; damaged_at: number of the first packet
    that is damaged; is_cut: that packet is the last one of all, the video is cut off there.
    """

    has_key: bool
    key_time: int | None
    is_fresh: bool
    damaged_at: int | None = None
    is_cut: bool = False

    def note_damage(self, number: int) -> None:
        """Packet `number` is damaged."""
        if self.damaged_at is None or number < self.damaged_at:
            self.damaged_at = number

    def trusts(self, number: int) -> bool:
        """May the frame of packet `number` be shown, as far as is known until now?"""
        if not self.has_key:
            return False
        if self.damaged_at is None:
            return True
        return self.is_cut and number < self.damaged_at


@dataclass(frozen=True)
class Decoded:
    """A frame as it was decoded (av.VideoFrame), None if there is none; the stretch and the number of its packet."""

    frame: Any
    stretch: Stretch
    number: int

    @property
    def is_trusted(self) -> bool:
        """Is there a frame, and no damage known that may have reached it?  Final when the next stretch has begun."""
        return self.frame is not None and self.stretch.trusts(self.number)


def decoded_frames(container: Any, begins_whole: bool = True, lost_places: Sequence[int] = ()) -> Iterator[Decoded]:
    """Each frame of an opened video or stream in order of time, those of a stretch one after the other.

    begins_whole: False if the beginning is lost, perhaps within the first packet; lost_places: positions in the file, ascending,
    at which its packets are known to be damaged.
    """
    stream = container.streams.video[0]
    codec = stream.codec_context
    codec.thread_count = 1
    codec.options = _OPTIONS
    codec.copy_opaque = True
    stretch = Stretch(has_key=False, key_time=None, is_fresh=True)
    number = -1
    for number, packet in enumerate(_packets(container, stream)):
        # a loss before the beginning of a packet has damaged the one before it
        is_after_loss = packet.pos is not None and bisect_left(lost_places, packet.pos) > 0
        if is_after_loss:
            lost_places = lost_places[bisect_left(lost_places, packet.pos) :]
            stretch.note_damage(number - 1)
        if packet.is_keyframe or number == 0:
            if stretch.damaged_at is not None:
                yield from _waiting(codec, stretch)
                codec.flush_buffers()
            is_fresh = number == 0 or stretch.damaged_at is not None or not stretch.has_key
            stretch = Stretch(packet.is_keyframe and (begins_whole or number > 0), packet.pts, is_fresh)
        if packet.is_corrupt or _has_lost_bytes(packet, codec.name):
            stretch.note_damage(number)
        if stretch.trusts(number) and not _refers_to_lost(packet, stretch):
            yield from _frames_of(packet, stretch, number)
        else:
            yield Decoded(None, stretch, number)
        if stretch.damaged_at is not None:
            yield from _waiting(codec, stretch)  # they may be sound, and the next key frame clears the decoder
    if lost_places:
        stretch.note_damage(number)
    yield from _waiting(codec, stretch)
    stretch.is_cut = stretch.damaged_at == number


def _packets(container: Any, stream: Any) -> Iterator[Any]:
    """The packets of a video that hold data, up to its end."""
    try:
        for packet in container.demux(stream):
            if packet.size:
                yield packet
    except (av.error.EOFError, av.error.InvalidDataError):
        return


def _refers_to_lost(packet: Any, stretch: Stretch) -> bool:
    """Is a packet shown before its key frame, and refers to frames before it, which the decoder does not have?"""
    if not stretch.is_fresh or stretch.key_time is None or packet.pts is None:
        return False
    return bool(packet.pts < stretch.key_time)


def _has_lost_bytes(packet: Any, codec: str) -> bool:
    """Does a packet hold zeros where its codec writes none?"""
    return codec in _START_CODE_CODECS and _LOST_BYTES.search(packet) is not None


def _frames_of(packet: Any, stretch: Stretch, number: int) -> Iterator[Decoded]:
    """The frames that decoding a packet brings, mostly those of earlier packets."""
    packet.opaque = (stretch, number)
    try:
        frames = packet.decode()
    except av.error.InvalidDataError:
        stretch.note_damage(number)
        yield Decoded(None, stretch, number)
        return
    yield from _noted(frames, stretch)


def _waiting(codec: Any, stretch: Stretch) -> Iterator[Decoded]:
    """The frames that the decoder has not shown yet."""
    try:
        frames = codec.decode(None)
    except (av.error.EOFError, av.error.InvalidDataError):
        return
    yield from _noted(frames, stretch)


def _noted(frames: list[Any], latest: Stretch) -> Iterator[Decoded]:
    """Frames with their stretches; damage that one shows may have reached the stretch that is being decoded, too."""
    for frame in frames:
        if frame.opaque is None:  # of no packet: a stand-in for a missing frame
            continue
        stretch, number = frame.opaque
        if frame.is_corrupt:
            stretch.note_damage(number)
            latest.note_damage(number)
        yield Decoded(frame, stretch, number)
