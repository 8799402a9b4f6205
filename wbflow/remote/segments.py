"""What an object store knows of a work folder: segments, each telling of some files, all of them together of every file.

A segment is written when the objects that it tells of are there, so that nothing is believed before its data.  It holds small
files (receipts) itself: thousands of them are one request.  Segments are never changed; their names count, and what a later
one says of a file takes the place of what earlier ones said.  From time to time one tells of all there is, and what came
before is dropped, but for the last such and what followed it: should the new one be damaged, these are still there.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from ..cache.signed import Damaged, signed, unsigned

FOLDER = "index"
"""Of the store, where the segments are."""
MANY = 24
"""From so many segments on they are brought together."""


@dataclass(frozen=True)
class Entry:
    """A file as the store has it."""

    size: int
    digest: str
    at: str = ""
    """The object that holds its bytes; "" where only a segment does."""


@dataclass(frozen=True)
class Segment:
    """What changed, or all there is."""

    files: Mapping[str, Entry] = field(default_factory=dict)
    """By place in the work folder."""
    small: Mapping[str, bytes] = field(default_factory=dict)
    """Bytes of those that it holds itself."""
    gone: tuple[str, ...] = ()
    """Places of files that are not there any more."""
    whole: bool = False
    """Is it of all there is?"""

    def encoded(self, name: str) -> bytes:
        """Its bytes under a name."""
        import zstandard

        files = {place: [entry.size, entry.digest, entry.at] for place, entry in self.files.items()}
        small = {place: data.decode("latin-1") for place, data in self.small.items()}
        told = signed(name, {"files": files, "small": small, "gone": list(self.gone), "whole": self.whole})
        return zstandard.ZstdCompressor(level=3).compress(told)

    @staticmethod
    def decoded(name: str, data: bytes) -> Segment:
        """The segment in an object.  Raises Damaged for one that is not as it was written."""
        import zstandard

        try:
            told: dict[str, Any] = unsigned(zstandard.ZstdDecompressor().decompress(data), name)
            files = {place: Entry(*entry) for place, entry in told["files"].items()}
            small = {place: text.encode("latin-1") for place, text in told["small"].items()}
            if any(place.startswith("/") or ".." in place.split("/") for place in (*files, *small, *told["gone"])):
                raise Damaged("tells of files that are not of a work folder")
            return Segment(files, small, tuple(told["gone"]), told["whole"])
        except Damaged:
            raise
        except (zstandard.ZstdError, ValueError, KeyError, TypeError) as error:
            raise Damaged("is damaged") from error


def next_name(names: Iterable[str]) -> str:
    """A name for the segment after these, which nobody else will choose."""
    newest = max((_number(name) for name in names), default=0)
    return f"{FOLDER}/{newest + 1:09d}-{os.urandom(4).hex()}"


def whole_name(name: str) -> str:
    """The same for one that tells of all there is."""
    return f"{name}-whole"


def outdated(names: Iterable[str]) -> list[str]:
    """Segments that may go: those before the last but one that tells of all there is."""
    known = sorted(names)
    wholes = [name for name in known if name.endswith("-whole")]
    return [name for name in known if name < wholes[-2]] if len(wholes) > 1 else []


def many(names: Iterable[str]) -> bool:
    """Are there so many since the last that tells of all, that it is time for another?"""
    known = sorted(names)
    wholes = [k for k, name in enumerate(known) if name.endswith("-whole")]
    return len(known) - (wholes[-1] if wholes else 0) > MANY


def _number(name: str) -> int:
    digits = name.rpartition("/")[2].partition("-")[0]
    return int(digits) if digits.isdigit() else 0
