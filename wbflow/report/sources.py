"""What a report is made of: the run, what happened in it, the nights before it, and where its pictures are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..outcome.past import looks_of
from ..records.events import Event, TaskEvent
from ..records.record import CameraRecord, RunRecord
from ..records.reference_folder import BadReference, Reference, read_reference
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.models import Site
from ..task import Task

NIGHTS = 30
"""So many nights are told of."""


@dataclass(frozen=True)
class Sources:
    """A run and what surrounds it."""

    cache: Cache
    record: RunRecord
    events: tuple[Event, ...]
    cameras: Mapping[str, Any] = field(repr=False)
    """The cameras that the cloud rests on by id, in the form of a calibration."""
    files: Path
    """The folder in which the run's products lie now."""
    site: Site

    @property
    def work(self) -> WorkFolder:
        """Where all of it lies."""
        return self.cache.work

    @cached_property
    def tasks(self) -> dict[Task, TaskEvent]:
        """How each task ended."""
        return {event.task: event for event in self.events if isinstance(event, TaskEvent)}

    @cached_property
    def before(self) -> list[RunRecord]:
        """Earlier runs, newest first: the last of each night."""
        found: dict[str, RunRecord] = {}
        for name in reversed([name for name in self.work.run_ids() if name < self.record.run]):
            try:
                record = RunFolder.of(self.work, name).record()
            except NoSuchRun:
                continue
            if record.date != self.record.date:
                found.setdefault(record.date, record)
            if len(found) >= NIGHTS - 1:
                break
        return list(found.values())

    @property
    def nights(self) -> list[RunRecord]:
        """The same and this one, oldest first."""
        return [*reversed(self.before), self.record]

    @cached_property
    def cameras_of_nights(self) -> list[tuple[RunRecord, dict[str, CameraRecord], dict[str, dict[str, float]]]]:
        """Each of these nights, its cameras by id, and what is compared of each of them."""
        return [(night, {camera.id: camera for camera in night.cameras}, looks_of(night)) for night in self.nights]

    @cached_property
    def reference(self) -> Reference | None:
        """What the night was compared with."""
        try:
            return read_reference(self.work)
        except BadReference:
            return None

    @cached_property
    def earlier(self) -> tuple[str, Mapping[str, Any]]:
        """The last earlier night whose cameras were placed, and these."""
        for record in self.before:
            try:
                if cameras := RunFolder.of(self.work, record.run).cameras():
                    return record.date, cameras
            except NoSuchRun:
                continue
        return "", {}

    def last_good(self, camera: str) -> RunRecord | None:
        """The last earlier night in which a camera was as it should be."""
        for record in self.before:
            if any(entry.id == camera and state_of(entry, record) == "good" for entry in record.cameras):
                return record
        return None

    def stood(self, camera: str) -> tuple[Mapping[str, Any], str] | None:
        """A camera in the form of a calibration, and how that is known: from tonight, the reference, an earlier night, or the
        site file."""
        if (entry := self.cameras.get(camera)) and entry.get("C"):
            return entry, ""
        if self.reference and (entry := self.reference.cameras.get(camera)) and entry.get("C"):
            return entry, f"stood here on {self.reference.date}"
        if (entry := self.earlier[1].get(camera)) and entry.get("C"):
            return entry, f"stood here on {self.earlier[0]}"
        stated = next((c for c in self.site.cameras if c.id == camera), None)
        if stated and stated.placement.C is not None:
            lens = {"K": stated.lens.K, "width": stated.lens.width, "height": stated.lens.height}
            return {"C": stated.placement.C, "R": stated.placement.R, **lens}, "stands here by the site file"
        return None


def state_of(camera: CameraRecord, record: RunRecord) -> str:
    """How a camera was: good, warn (of use, but not as it should be) or bad (gave nothing)."""
    if not camera.ok:
        return "bad"
    health = camera.health is None or camera.health.ok
    poses = record.poses
    doubts = (poses.suspects, poses.doubtful, poses.uncertain, poses.unsure_lenses, poses.strained) if poses else ()
    suspect = any(camera.id in named for named in doubts)
    return "good" if health and not suspect and camera.down is None else "warn"
