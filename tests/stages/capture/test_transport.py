"""Lost and damaged packets of MPEG transport streams."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.capture.transport import damaged_places
from wbflow_stages.types import Uint8s

PID = 256


def packet(counter: int, pid: int = PID, field: bytes = b"", content: bool = True) -> bytes:
    """A packet of 188 bytes; field: its adaptation field after the length."""
    control = (0x10 if content else 0) | (0x20 if field else 0)
    head = bytes([0x47, pid >> 8, pid & 0xFF, control | counter % 16])
    if field:
        head += bytes([len(field)]) + field
    return head.ljust(188, b"\x5a")


def places(packets: list[bytes], before: bytes = b"", after: bytes = b"") -> list[int]:
    """Damaged places of a file of packets, each between other bytes."""
    data: Uint8s = np.frombuffer(b"".join(before + p + after for p in packets), np.uint8)
    return damaged_places(data, PID)


SOUND = [packet(k) for k in range(40)]


@pytest.mark.parametrize(("before", "after"), [(b"", b""), (b"time", b""), (b"", b"sixteen checking")])
def test_a_sound_stream_has_no_damaged_place(before: bytes, after: bytes) -> None:
    assert places(SOUND, before, after) == []
    step = 188 + len(before) + len(after)
    begun = len(before)
    assert places(SOUND[:10] + SOUND[12:], before, after) == [begun + 9 * step, begun + 10 * step]


def test_other_streams_and_packets_without_content_do_not_count() -> None:
    mixed = [p for k in range(20) for p in (packet(k), packet(7 * k, pid=17), packet(k, field=b"\0" * 183, content=False))]
    assert places(mixed) == []


def test_a_packet_sent_twice_and_an_announced_jump_are_no_damage() -> None:
    assert places([*SOUND[:10], SOUND[9], *SOUND[10:]]) == []
    assert places([*SOUND[:10], packet(3, field=b"\x80"), *[packet(4 + k) for k in range(9)]]) == []
    assert places([*SOUND[:10], packet(3, field=b"\x00"), *[packet(4 + k) for k in range(9)]]) == [9 * 188, 10 * 188]


def test_sixteen_packets_that_are_overwritten_or_cut_out_askew_are_found() -> None:
    stream = b"".join(SOUND)
    for damaged in (stream[:1880] + bytes(16 * 188) + stream[26 * 188 :], stream[:1900] + stream[1900 + 16 * 188 - 8 :]):
        found = damaged_places(np.frombuffer(damaged, np.uint8), PID)
        assert found and 9 * 188 <= found[0] <= 11 * 188


def test_a_file_that_ends_within_a_packet_and_one_that_a_sender_calls_damaged_are_found() -> None:
    stream = np.frombuffer(b"".join(SOUND), np.uint8)
    assert damaged_places(stream[:-100], PID) == [39 * 188]
    marked = stream.copy()
    marked[5 * 188 + 1] |= 0x80
    assert damaged_places(marked, PID) == [5 * 188]


def test_bytes_that_hold_no_packet_are_searched_to_the_end() -> None:
    assert damaged_places(np.zeros(200_000, np.uint8), PID) == []
    assert damaged_places(np.zeros(0, np.uint8), PID) == []
    late = np.concatenate([np.zeros(200_000, np.uint8), np.frombuffer(b"".join(SOUND), np.uint8)])
    assert damaged_places(late, PID) == []
