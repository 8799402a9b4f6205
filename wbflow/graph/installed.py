"""Is the code that is installed what it was?  Told from the stamps of files alone, without reading one."""

from __future__ import annotations

import functools
import importlib.util
import os
import sys
from collections.abc import Iterator

from .. import __version__
from ..store.artifact import digest
from .fingerprint import FOLLOWED

_OURS = (__package__.partition(".")[0], *FOLLOWED)


@functools.cache
def installed_code() -> str:
    """Digest of the stamps of all code that this process may run, but plug-ins: ours, and which libraries are installed."""
    told: list[object] = [__version__, sys.version]
    for package in _OURS:
        spec = importlib.util.find_spec(package)
        for root in (spec.submodule_search_locations or ()) if spec else ():
            told += sorted(_sources(root))
    told += [(entry, os.stat(entry).st_mtime_ns) for entry in sys.path if entry.endswith("-packages") and os.path.isdir(entry)]  # noqa: PTH112, PTH116
    return digest(repr(told).encode(errors="surrogateescape"))


def _sources(folder: str) -> Iterator[tuple[str, int, int]]:
    """Path, size and time of every source file below a folder."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".py"):
                status = entry.stat()
                yield entry.path, status.st_size, status.st_mtime_ns
            elif entry.is_dir() and entry.name != "__pycache__":
                yield from _sources(entry.path)
