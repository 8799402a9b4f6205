"""Captures in an object store: a folder of this machine has their names, sizes and times, and the bytes of those that were read.

A listing tells what is there; what is new, or has another ETag than before, is laid as a stand-in (see `remote.standin`).
"""

from __future__ import annotations

import json
import os
from pathlib import Path, PurePosixPath

from ..cache.atomic import write_atomic
from ..cache.layout import WorkFolder
from ..cache.room import FULL
from ..cache.signed import Damaged, read_signed, write_signed
from .objects import Found, Objects
from .standin import StandIn, mirrored_url, write_stand_in

_OF = "captures of an object store"


def bring(root: Path, url: str) -> None:
    """Make a folder show what lies below a URL.

    Parameters
    ----------
    root : Path
        The folder; it is of nothing else.
    url : str
        Of the store.

    Raises
    ------
    StoreError
        The store does not answer.
    OSError
        The disk is full, or there is no right to write.
    """
    place = WorkFolder(root, url)
    objects = Objects(url)
    known, found = _known(place), objects.found()
    if mirrored_url(place) != objects.url:
        write_atomic(place.mirror_memo, json.dumps({"url": objects.url}).encode())
    there: dict[str, list[int | str]] = {}
    for name, entry in found.items():
        path = _place(place, name)
        if path is None:
            continue
        there[name] = [entry.size, entry.mark]
        if known.get(name) != there[name] or not path.is_file():
            _lay(path, name, entry)
    for name in known.keys() - there.keys():
        if path := _place(place, name):
            path.unlink(missing_ok=True)
    if there != known:
        write_signed(place.agreed_memo, _OF, {"files": there}, lasts=False)


def _place(place: WorkFolder, name: str) -> Path | None:
    """Where an object is shown; None for a name that would lead out of the folder, or onto what is not a capture."""
    parts = PurePosixPath(name).parts
    path = place.root.joinpath(*parts) if parts and not {"..", "/"} & set(parts) else None
    return None if path in {place.mirror_memo, place.agreed_memo} else path


def _lay(path: Path, name: str, entry: Found) -> None:
    try:
        write_stand_in(path, StandIn(entry.size, "", name))
        if entry.seconds:
            os.utime(path, (entry.seconds, entry.seconds))
    except OSError as error:
        if error.errno in FULL:
            raise  # else it is a name that no file here can have, beside the others


def _known(place: WorkFolder) -> dict[str, list[int | str]]:
    try:
        told = read_signed(place.agreed_memo, _OF)
        return dict(told["files"]) if told else {}
    except (Damaged, KeyError, TypeError, ValueError):  # it costs reading them again
        return {}
