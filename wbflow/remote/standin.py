"""Stand-ins: files of a mirror that have their name and size, and whose bytes are still in the object store.

All that asks for names, sizes and times finds the work folder complete; whoever reads a file through `cache.untrusted` gets its
bytes, which are fetched then, compared with their digest, and put in the stand-in's place.  A stand-in says itself what it
stands for, so that a copy of it, or a second name, stands for the same.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path

from ..cache.atomic import prepare, put
from ..cache.layout import STAND_IN, WorkFolder
from .objects import Objects, StoreError

_MOST = 4096
"""Bytes of what a stand-in says."""


@dataclass(frozen=True)
class StandIn:
    """What a file stands for."""

    size: int
    digest: str
    """"" where nobody knows: of what others have put into a store."""
    at: str
    """The object that has its bytes."""


class NotFetched(OSError):
    """The bytes of a stand-in cannot be had."""


def write_stand_in(path: Path, stands_for: StandIn) -> None:
    """Put a stand-in where a file is to be.  Raises OSError."""
    told = {"size": stands_for.size, "digest": stands_for.digest, "at": stands_for.at}
    prepared = prepare(path, STAND_IN + json.dumps(told).encode() + b"\n")
    if stands_for.size > prepared.size:
        os.truncate(prepared.temporary, stands_for.size)  # a hole, which takes no room
    put(prepared, ours=True)


def stand_in(path: Path | str) -> StandIn | None:
    """What a file stands for; None for one that has its own bytes, or is not there."""
    try:
        with open(path, "rb", 0) as file:  # noqa: PTH123 (hot path)
            data = file.read(_MOST)
        if not data.startswith(STAND_IN):
            return None
        return StandIn(**json.loads(data[len(STAND_IN) :].partition(b"\n")[0]))
    except (OSError, ValueError, TypeError):
        return None


def fill(path: Path | str) -> bool:
    """Put a file's own bytes in the place of its stand-in; False where it is none, or its folder mirrors no store.

    Raises
    ------
    NotFetched
        The store does not answer, or what it has is not what was put there.
    OSError
        The disk is full, or there is no right to write.
    """
    place = Path(path)
    stands_for, work = stand_in(path), WorkFolder.around(place)
    url = mirrored_url(work) if work else None
    if stands_for is None or url is None:
        return False
    objects, temporary = Objects(url), Path(prepare(path, b"").temporary)
    try:
        try:
            there = objects.fetch(stands_for.at, temporary)
        except StoreError as error:
            raise NotFetched(error.what) from error
        if not there:
            raise NotFetched(f"{url}/{stands_for.at} is gone")
        with temporary.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()[:32]
        if temporary.stat().st_size != stands_for.size or found != (stands_for.digest or found) or stand_in(temporary):
            raise NotFetched(f"{url}/{stands_for.at} is {'damaged' if stands_for.digest else 'not what it was'}")
        with contextlib.suppress(FileNotFoundError):
            was = place.stat()
            os.utime(temporary, ns=(was.st_atime_ns, was.st_mtime_ns))  # nothing has changed, for who compares with the store
        temporary.replace(place)
    finally:
        temporary.unlink(missing_ok=True)
    return True


def mirrored_url(work: WorkFolder) -> str | None:
    """The store that a work folder mirrors."""
    try:
        return str(json.loads(work.mirror_memo.read_bytes())["url"])
    except (OSError, ValueError, KeyError):
        return None
