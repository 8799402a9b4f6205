"""A mapping of a calibration file that knows which of its keys were read, so that none is ignored in silence."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ...errors import Location
from ..yaml_document import suggest
from .calibrated import REMEDY, Faulty

IRRELEVANT = frozenset(
    {
        # what the file is, who wrote it and when
        *(
            "classname",
            "versionmajor",
            "versionminor",
            "version",
            "schema",
            "comment",
            "comments",
            "description",
            "note",
            "notes",
        ),
        *("date", "time", "calibrationtime", "calibrationdate", "timestamp", "created", "manufacturer", "serial", "serialnumber"),
        # names of the camera and its pictures beside the one that the entry is filed under
        *("id", "name", "cameraname", "cameraid", "imgname", "imagename", "filename", "filepath", "label", "type"),
        *("panel", "node"),
        # how well the calibration fits
        *("rms", "rmserror", "error", "residualspx", "covered", "reprojectionerror", "reprojerr", "avgreprojectionerror"),
        *("meanreprojectionerror", "perviewreprojectionerrors", "perviewerrors", "stddeviations", "stddeviationsintrinsics"),
        # the board, and where it was in each picture
        *("boardwidth", "boardheight", "boardsize", "squaresize", "markersize", "patternsize", "gridpoints", "nframes"),
        *("nrofframes", "nrframes", "imagepoints", "objectpoints", "extrinsicparameters", "rvecs", "tvecs", "fixaspectratio"),
        *("aspectratio", "fixprincipalpoint", "zerotangentdist", "flagvalue", "essentialmatrix", "fundamentalmatrix"),
    }
)
"""Keys, as `plain` gives them, that say nothing about a lens or a pose, whatever their values."""


def plain(key: str) -> str:
    """A key without what programs spell differently: `camera_matrix`, `cameraMatrix` and `Camera_Matrix` are one key.

    A single letter stays as it is, as K and k, or C and c, are different things.
    """
    if len(key) == 1:
        return key
    return "".join(letter for letter in key.lower() if letter.isalnum())


class Entry:
    """The keys and values of one camera, or of a whole file; `finish` refuses those that nothing has asked for."""

    def __init__(self, data: dict[str, Any], location: Location = (), name: str = "") -> None:
        """location: of the mapping in its file.  name: the camera's, for messages; "" for a file of one camera."""
        self.location = location
        self.name = name
        self._values = {str(key): value for key, value in data.items()}
        self._unread = set(self._values)

    def key(self, names: Iterable[str]) -> str | None:
        """The key that is one of these names and has a value, as it is spelt in the file; None if there is none.

        All such keys count as read.  Raises Faulty if there are two with different values.
        """
        wanted = {plain(name) for name in names}
        first = None
        for key, value in self._values.items():
            if plain(key) not in wanted:
                continue
            self._unread.discard(key)
            if value is None:
                continue
            if first is None:
                first = key
            elif value != self._values[first]:
                raise self.fault(key, f"differs from {first}, which says the same thing", "keep the right one of them")
        return first

    def value(self, *names: str) -> Any:
        """The value of the key that is one of these names; None if there is none.  Raises Faulty, as `key` does."""
        key = self.key(names)
        if key is None:
            return None
        return self._values[key]

    def __getitem__(self, key: str) -> Any:
        """The value of a key as it is spelt in the file."""
        return self._values[key]

    def unfold(self, *names: str) -> None:
        """Put the keys of inner mappings with these names among the entry's own: `intrinsics: {fx: ...}`.

        A matrix, which OpenCV and ROS write as a mapping with `data`, is none.  Raises Faulty if a key would be there twice.
        """
        wanted = {plain(name) for name in names}
        for key, inner in list(self._values.items()):
            if plain(key) not in wanted or not isinstance(inner, dict) or "data" in inner:
                continue
            del self._values[key]
            self._unread.discard(key)
            for inner_key, value in inner.items():
                if str(inner_key) in self._values:
                    raise self.fault(key, f"holds {inner_key}, which is given beside it as well", "keep one of them")
                self._values[str(inner_key)] = value
                self._unread.add(str(inner_key))

    def has(self, *names: str) -> bool:
        """Is one of these names a key with a value?  This does not count as reading it."""
        wanted = {plain(name) for name in names}
        return any(plain(key) in wanted and value is not None for key, value in self._values.items())

    def ignore(self, *names: str) -> None:
        """Take keys for read that say nothing about this camera."""
        wanted = {plain(name) for name in names}
        self._unread = {key for key in self._unread if plain(key) not in wanted}

    def finish(self, known: Iterable[str], remedy: str) -> None:
        """Raise Faulty for the first key that nothing has asked for.

        known: keys to suggest instead of a misspelt one.  remedy: what to do if none is similar.
        """
        # keys that begin like a comment are one
        for key in self._values:
            if key in self._unread and plain(key) not in IRRELEVANT and not key.startswith(("_", "//", "$")):
                raise self.fault(key, "is not read, so what it says would be lost", suggest(key, known, remedy))

    def fault(self, key: str, what: str, remedy: str = "") -> Faulty:
        """The fault of a key: `gate.K must be 3x3 numbers`."""
        full_name = f"{self.name}.{key}" if self.name else key
        return Faulty(f"{full_name} {what}", (*self.location, key), remedy or REMEDY)
