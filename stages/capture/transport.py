"""Places in an MPEG transport stream (ITU-T H.222.0) where bytes were lost or damaged on the way.

FFmpeg notes a gap, but on the picture after it, and passes over bytes that are no packet without a word.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..types import Int64s, Uint8s

_SYNC = 0x47
"""First byte of every packet."""
_PACKET_BYTES = 188
_SPACINGS = (188, 192, 204)
"""Bytes from packet to packet: plain, with a time stamp before each (discs), with check bytes after each (broadcast)."""
_WINDOW_BYTES = 1 << 16
"""A lost beginning of packets is looked for in pieces of this size."""


def damaged_places(data: Uint8s, pid: int) -> list[int]:
    """Positions in a file's bytes (n,) uint8, ascending, at which packets of a stream are damaged or missing.

    Where packets are missing, both the last one before them and the first one after them are given.

    Parameters
    ----------
    data : the whole file.
    pid : number of the stream's packets.
    """
    is_sync = data[:_WINDOW_BYTES] == _SYNC
    spacing = max(_SPACINGS, key=lambda spacing: int((is_sync[:-spacing] & is_sync[spacing:]).sum()))
    starts, places = _packet_starts(data, spacing)
    of_stream = ((data[starts + 1] & 0x1F).astype(np.int64) << 8 | data[starts + 2]) == pid
    starts = starts[of_stream]
    headers = data[starts[:, None] + np.arange(6)].astype(np.int64)
    places += starts[headers[:, 1] & 0x80 != 0].tolist()  # the sender says: damaged

    # the counter of packets with content goes up by one; it may stand still if a packet is sent twice, and jump if so announced
    has_content = headers[:, 3] & 0x10 != 0
    may_jump = (headers[:, 3] & 0x20 != 0) & (headers[:, 4] > 0) & (headers[:, 5] & 0x80 != 0)
    starts = starts[has_content]
    steps = np.diff(headers[has_content, 3] & 0x0F) % 16
    gaps = np.flatnonzero((steps > 1) & ~may_jump[has_content][1:])
    places += starts[gaps].tolist() + starts[gaps + 1].tolist()
    return sorted(places)


def _packet_starts(data: Uint8s, spacing: int) -> tuple[Int64s, list[int]]:
    """Positions (n,) at which packets begin, and those at which something else stands in place of a packet."""
    starts: list[Int64s] = []
    lost: list[int] = []
    place: int | None = _next_start(data, 0, spacing)
    while place is not None:
        is_sync = data[place::spacing] == _SYNC
        count = is_sync.size if is_sync.all() else int(is_sync.argmin())
        starts.append(place + spacing * np.arange(count))
        end = place + spacing * count
        if end - spacing + _PACKET_BYTES > data.size:  # the file ends within the last packet
            starts[-1] = starts[-1][:-1]
            lost.append(end - spacing)
        if count == is_sync.size:
            break
        lost.append(end)
        place = _next_start(data, end, spacing)
    return np.concatenate(starts or [np.zeros(0, np.int64)]), lost


def _next_start(data: Uint8s, begin: int, spacing: int) -> int | None:
    """The first position from `begin` on where three packets follow each other, None if there is none."""
    reach = 2 * spacing + 1
    for window_begin in range(begin, data.size - reach + 1, _WINDOW_BYTES):
        is_sync: NDArray[np.bool_] = data[window_begin : window_begin + _WINDOW_BYTES + reach - 1] == _SYNC
        follow = np.flatnonzero(is_sync[: 1 - reach] & is_sync[spacing : 1 + spacing - reach] & is_sync[reach - 1 :])
        if follow.size:
            return window_begin + int(follow[0])
    return None
