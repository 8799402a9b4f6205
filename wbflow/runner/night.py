"""The facts of one run: its site, its night, the files of that night, and the reference that they are compared with.

`tonight.read_night` finds these facts; they stay as they are until the run ends.  Only files may be replaced while a run reads
them (`NightFiles`).
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from wbflow_stages.contracts.camera_figures import Health

from ..cache.memo import Digests, EarlierCaptures
from ..cache.store import Cache
from ..pipeline.stages import Stage
from ..records.reference import Reference
from ..site.capture_files import CaptureFile, changes_of, with_current_digest
from ..site.models import Site


@dataclass
class NightFiles:
    """The files that a night's tasks read, with their digests."""

    captures: dict[str, list[CaptureFile]]
    """Captures by camera; cameras without any have an empty list."""
    named: dict[str, CaptureFile]
    """Masks, models and other files that the site file names, by the key under which it names them."""
    digests: Digests
    """Digests of files on disk; saved at the end of a run."""
    earlier: EarlierCaptures
    """Digests of the captures of earlier nights; saved at the end of a run."""
    growing: frozenset[Path] = frozenset()
    """Captures that were still being written when the run began."""
    replaced: set[Path] = field(default_factory=set)
    """Files that were found to have changed after their digests were taken."""

    def reread(self, path: Path) -> None:
        """Take a new digest of a file that has changed."""
        self.replaced.add(path)
        self.digests.forget(path)  # else its stamp may still fit, on disks that count in seconds
        for files in self.captures.values():
            for k, file in enumerate(files):
                if file.path == path:
                    files[k] = with_current_digest(file, self.digests)
        for name, file in self.named.items():
            if file.path == path:
                self.named[name] = with_current_digest(file, self.digests)

    def in_motion(self, dated: bool) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
        """Captures that have changed since the run began, by camera: first harmful changes, then harmless ones.

        dated: do the names of captures contain a date?  If not, a camera overwrites the same file again and again.  A file is
        read as a whole, so overwriting it is harmless if it was complete when the run began.
        """
        changed = changes_of(self.captures, self.replaced, self.digests)
        if dated:
            return changed, {}
        # a file that was still being written may have been read in part, so its replacement is no mere overwriting
        unfinished = set()
        for files in self.captures.values():
            unfinished |= {file.name for file in files if file.path in self.growing}
        harmful: dict[str, list[str]] = {}
        harmless: dict[str, list[str]] = {}
        for camera, names in changed.items():
            harmful[camera] = [name for name in names if name in unfinished]
            harmless[camera] = [name for name in names if name not in unfinished]
        return harmful, harmless


@dataclass(frozen=True)
class Night:
    """The facts of one run."""

    site: Site
    date: datetime.date
    stages: tuple[Stage, ...]
    """The stages that take part, in the order of the pipeline."""
    cache: Cache
    files: NightFiles
    date_stated: bool = False
    """Did the user give the night?  Otherwise dates in the pictures may determine it, if file names contain none."""
    until: str | None = None
    """The last stage; None: all of them."""
    force: frozenset[str] = frozenset()
    """Stages and tasks to run again."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Why a camera has no captures, by camera."""
    stale: Mapping[str, Health] = field(default_factory=dict)
    """Health of the cameras whose captures are not of this night."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """Remarks about captures, by camera."""
    reference: Reference | None = None
    """The reference of this night; None if there is none, or if it cannot be used."""
    reference_fault: str = ""
    """Why an existing reference cannot be used: it is unreadable, or the site file has changed since it was pinned."""
    calibration_change: str = ""
    """If the site file has changed: how its lenses and poses differ from those of the reference."""

    @cached_property
    def _stage_names(self) -> frozenset[str]:
        return frozenset(stage.name for stage in self.stages)

    def takes_part(self, stage: str) -> bool:
        """Does the stage with this name take part?"""
        return stage in self._stage_names
