"""Damage in Matroska files (MKV, WebM), by their structure: FFmpeg goes on behind a damaged place without a word.

References
----------
RFC 8794 (EBML): elements of identifier, size and content; 11.3.1: check sums.  RFC 9559 (Matroska): the elements of a segment and
of its clusters, which hold the packets.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from ..types import Uint8s

_SEGMENT = 0x18538067
_CLUSTER = 0x1F43B675
_CRC = 0xBF
_VOID = 0xEC
_OF_SEGMENT = {_CLUSTER, _CRC, _VOID, 0x114D9B74, 0x1549A966, 0x1654AE6B, 0x1C53BB6B, 0x1941A469, 0x1043A770, 0x1254C367}
"""Identifiers of all elements that a segment may hold."""
_OF_CLUSTER = {_CRC, _VOID, 0xE7, 0x5854, 0xA7, 0xAB, 0xA3, 0xA0, 0xAF}
"""Identifiers of all elements that a cluster may hold."""
_BLOCKS = {0xA3, 0xA0, 0xAF}
"""Identifiers of the elements that hold packets."""


@dataclass(frozen=True)
class _Element:
    """An element of a file: its identifier, and where its content begins and ends; end None: its size is not stated."""

    identifier: int
    begin: int
    end: int | None


def damaged_places(data: Uint8s) -> list[int]:
    """Positions in a file, ascending, behind each of which a packet ends that is damaged, or is missing.

    Elements fill their parents without gaps, so that lost or added bytes show where the next element should begin; clusters with
    a check sum, as FFmpeg writes them, show every damage.  Nothing is found in other files.

    data: (n,) uint8, the whole file.
    """
    file = data.tobytes()
    places: list[int] = []
    header = _element(file, 0)
    if header is None or header.end is None:
        return places
    segment = _element(file, header.end)
    if segment is None or segment.identifier != _SEGMENT:
        return places
    position = segment.begin
    while position < len(file):
        element = _element(file, position)
        if element is not None and element.identifier == _CLUSTER:
            found, position = _read_cluster(file, element)
            places += found
        elif element is not None and element.identifier in _OF_SEGMENT and element.end is not None:
            position = element.end
        else:
            found, position = _lost_until_next_cluster(file, position, position)
            places += found
    return sorted(places)


def _read_cluster(file: bytes, cluster: _Element) -> tuple[list[int], int]:
    """The damaged places of a cluster, and where to read on."""
    places: list[int] = []
    position = cluster.begin
    last_begin = cluster.begin
    end = len(file) if cluster.end is None else min(cluster.end, len(file))
    checked_from = None  # where the bytes begin that the check sum is of
    blocks: list[int] = []
    while position < end:
        element = _element(file, position)
        if element is not None and cluster.end is None and element.identifier in _OF_SEGMENT - _OF_CLUSTER:
            return places, position  # the cluster's size is not stated: the next element ends it
        is_known = element is not None and element.identifier in _OF_CLUSTER
        if element is None or not is_known or element.end is None or (cluster.end is not None and element.end > cluster.end):
            return _lost_until_next_cluster(file, position, last_begin)
        if element.identifier == _CRC and position == cluster.begin and element.end - element.begin == 4:
            checked_from = element.end
        if element.identifier in _BLOCKS:
            blocks.append(element.begin)
        last_begin = element.begin
        position = element.end
    if checked_from is not None and cluster.end is not None and cluster.end <= len(file):
        stated = int.from_bytes(file[checked_from - 4 : checked_from], "little")
        if zlib.crc32(file[checked_from : cluster.end]) != stated:
            # any of its packets may be the damaged one
            places += [begin + 1 for begin in blocks]
    return places, position


def _lost_until_next_cluster(file: bytes, broken: int, last_begin: int) -> tuple[list[int], int]:
    """The places around a part of a file that is no element, and where the next cluster begins.

    last_begin: where the element before it begins, which may have swallowed the beginning of a cluster.
    """
    following = file.find(_CLUSTER.to_bytes(4, "big"), last_begin)
    if following < 0:
        following = len(file)
    return [last_begin + 1, broken, following], following


def _element(file: bytes, position: int) -> _Element | None:
    """The element that begins at a position; None if none can begin there."""
    identifier = _number(file, position, 4, keeps_marker=True)
    if identifier is None:
        return None
    size = _number(file, position + identifier[1], 8, keeps_marker=False)
    if size is None:
        return None
    begin = position + identifier[1] + size[1]
    is_unknown = size[0] == (1 << (7 * size[1])) - 1
    return _Element(identifier[0], begin, None if is_unknown else begin + size[0])


def _number(file: bytes, position: int, most_bytes: int, keeps_marker: bool) -> tuple[int, int] | None:
    """A number whose first byte tells its length by its leading zeros, and this length in bytes; None if there is none."""
    if position >= len(file) or file[position] == 0:
        return None
    length = 9 - file[position].bit_length()
    if length > most_bytes or position + length > len(file):
        return None
    value = int.from_bytes(file[position : position + length], "big")
    if not keeps_marker:
        value &= (1 << (7 * length)) - 1
    return value, length
