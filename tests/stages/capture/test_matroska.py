"""Damaged places of Matroska files are found by their structure and their check sums."""

from __future__ import annotations

import zlib

import numpy as np

from wbflow_stages.capture.matroska import damaged_places

HEADER = b"\x1aE\xdf\xa3\x84\x42\x86\x81\x01"  # EBML, with its version
SEGMENT = b"\x18S\x80g\x01" + 7 * b"\xff"  # of unknown size, as of a recording that has not been closed
CLUSTER = b"\x1fC\xb6u"


def element(identifier: bytes, content: bytes) -> bytes:
    """An element with a size of two bytes."""
    return identifier + (0x4000 | len(content)).to_bytes(2, "big") + content


def cluster(number: int, has_sum: bool = False, has_size: bool = True) -> bytes:
    """A cluster of five packets."""
    random = np.random.default_rng(number)
    content = element(b"\xe7", bytes([number])) + b"".join(element(b"\xa3", random.bytes(150)) for _ in range(5))
    if has_sum:
        content = element(b"\xbf", zlib.crc32(content).to_bytes(4, "little")) + content
    return element(CLUSTER, content) if has_size else CLUSTER + b"\x01" + 7 * b"\xff" + content


def places(file: bytes) -> list[int]:
    return damaged_places(np.frombuffer(file, np.uint8))


def test_nothing_is_found_in_sound_files_of_any_layout() -> None:
    for has_sum in (False, True):
        for has_size in (False, True):
            clusters = [cluster(number, has_sum, has_size) for number in range(3)]
            cues = element(b"\x1cS\xbbk", bytes(40))
            assert places(HEADER + SEGMENT + element(b"\xec", bytes(9)) + b"".join(clusters) + cues) == []
    assert places(b"") == places(b"no Matroska file at all") == places(HEADER) == []


def test_lost_bytes_are_found_where_they_are_and_the_next_cluster_is_sound() -> None:
    for has_size in (False, True):
        first, second, third = (cluster(number, has_size=has_size) for number in range(3))
        begin = len(HEADER + SEGMENT + first)
        lost = begin + 300
        file = HEADER + SEGMENT + first + second[:300] + second[340:] + third
        found = places(file)
        assert found and all(lost - 160 <= place <= begin + len(second) - 40 for place in found)
        # a loss that takes the beginning of a cluster with it
        file = HEADER + SEGMENT + first + second[:-100] + third[60:]
        assert places(file)


def test_a_wrong_bit_is_found_by_the_check_sum_of_its_cluster() -> None:
    clusters = [cluster(number, has_sum=True) for number in range(3)]
    file = bytearray(HEADER + SEGMENT + b"".join(clusters))
    begin = len(HEADER + SEGMENT + clusters[0])
    file[begin + 400] ^= 4
    found = places(bytes(file))
    assert len(found) == 5 and all(begin < place < begin + len(clusters[1]) for place in found)
