"""Files of captures: what is known of each, and whether one has changed since its digest was taken."""

from __future__ import annotations

import functools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..cache.memo import Digests
from .hanging_disks import results_by_camera


@dataclass(frozen=True)
class CaptureFile:
    """A capture of the night, as it is on disk."""

    name: str
    """Relative to the captures' root."""
    path: Path
    digest: str
    """Digest of its bytes; "" if it cannot be read."""
    fault: str = ""
    """Why it cannot be read."""


def with_current_digest(file: CaptureFile, digests: Digests) -> CaptureFile:
    """The file with its present digest; "" if it is gone."""
    try:
        return replace(file, digest=digests.of(file.path))
    except OSError:  # deleted since then
        return replace(file, digest="")


def changes_of(captures: Mapping[str, list[CaptureFile]], replaced: Collection[Path], digests: Digests) -> dict[str, list[str]]:
    """Names, by camera, of captures that were replaced or have grown since their digests were computed.

    A capture that has been deleted is not reported: recorders delete complete files.

    replaced: files already known to have been replaced.
    """
    changes: dict[str, list[str]] = {}
    reads = ((camera, functools.partial(_changed_names, files, replaced, digests)) for camera, files in captures.items())
    for camera, names in results_by_camera(reads):
        # a mount that has died since is no evidence of a change
        if names and not isinstance(names, OSError):
            changes[camera] = names
    return changes


def _changed_names(files: list[CaptureFile], replaced: Collection[Path], digests: Digests) -> list[str]:
    names: list[str] = []
    for file in files:
        if not file.digest:
            continue
        digest_now = with_current_digest(file, digests).digest
        if file.path in replaced or (digest_now and digest_now != file.digest):
            names.append(file.name)
    return names
