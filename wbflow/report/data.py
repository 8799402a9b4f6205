"""The data of a report: the run, its events, the nights before it, and its differences from the last good one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..pipeline.stages import FRAMES
from ..pipeline.summaries import Change
from ..records.events import Event, TaskEvent
from ..records.record import CameraRecord, RunRecord
from ..records.reference_folder import BadReference, Reference, read_reference
from ..records.run_folder import NoSuchRun, RunFolder, last_of_nights, newest_runs
from ..site.models import Site
from ..task import Task, view_name

NIGHTS = 30
"""Number of nights in the report's charts."""


@dataclass(frozen=True)
class ReportData:
    """A run with the site, cache and earlier nights that its report needs."""

    cache: Cache
    record: RunRecord
    events: tuple[Event, ...]
    cameras: Mapping[str, Any] = field(repr=False)
    """The cameras of the cloud by id, as in cameras.json."""
    files: Path
    """The folder that contains the run's files now."""
    site: Site

    @property
    def work(self) -> WorkFolder:
        return self.cache.work

    @cached_property
    def tasks(self) -> dict[Task, TaskEvent]:
        """The event with the outcome of each task."""
        return {event.task: event for event in self.events if isinstance(event, TaskEvent)}

    @cached_property
    def keys(self) -> dict[Task, str]:
        """The cache key of each result."""
        return {task: event.key for task, event in self.tasks.items() if event.usable and event.key}

    def drawing(self, task: Task, name: str) -> bytes | None:
        """Return a drawing of a result (see `Products.drawings`); None if it is gone or never existed."""
        return self.cache.drawing(task, key, name) if (key := self.keys.get(task)) else None

    def frame(self, camera: str) -> Task:
        """Return the task of a camera's frame; if it has several views, that of the first one, which shows the middle."""
        camera_frame, first_view = (Task(FRAMES, (name,)) for name in (camera, view_name(camera, 1)))
        return first_view if first_view in self.tasks else camera_frame

    @cached_property
    def earlier(self) -> list[RunRecord]:
        """The last run of each earlier night, the latest night first."""
        runs = newest_runs(self.work, before=self.record.run)
        return last_of_nights((run for run in runs if run[1].date < self.record.date), NIGHTS - 1)[::-1]

    @property
    def nights(self) -> list[RunRecord]:
        """The earlier nights and this one, oldest first."""
        return [*reversed(self.earlier), self.record]

    @cached_property
    def last_good(self) -> RunRecord | None:
        """The last earlier night with a good verdict."""
        return next((night for night in self.earlier if night.verdict and night.verdict.good), None)

    def last_good_of(self, camera: str) -> RunRecord | None:
        """Return the last earlier night on which a camera's state was good."""
        for record in self.earlier:
            if any(entry.id == camera and state_of(entry, record) == "good" for entry in record.cameras):
                return record
        return None

    @cached_property
    def _reference(self) -> Reference | None:
        try:
            return read_reference(self.work)
        except BadReference:
            return None

    @property
    def reference_date(self) -> str:
        """The night of the reference; "" without one."""
        return self._reference.date if self._reference else ""

    @cached_property
    def _earlier_cameras(self) -> tuple[Mapping[str, Any], str]:
        """The cameras of the last earlier night on which their poses were found, and the date of that night."""
        for record in self.earlier:
            with suppress(NoSuchRun):
                if cameras := RunFolder.of(self.work, record.run).cameras():
                    return cameras, record.date
        return {}, ""

    def _placements(self) -> Iterator[tuple[Mapping[str, Any], str]]:
        """Yield known camera poses, the best source first, each with a note on the source ("" for tonight)."""
        yield self.cameras, ""
        if self._reference:
            yield self._reference.cameras, f"position on {self._reference.date}"
        yield self._earlier_cameras[0], f"position on {self._earlier_cameras[1]}"
        placed = (camera for camera in self.site.cameras if camera.placement.C is not None)
        from_site = {c.id: {**vars(c.placement), "K": c.lens.K, "width": c.lens.width, "height": c.lens.height} for c in placed}
        yield from_site, "position from the site file"

    def placement(self, camera: str) -> tuple[Mapping[str, Any], str] | None:
        """Return a camera's entry, as in cameras.json, and a note on its source ("" for tonight); None if its C is unknown."""
        known = ((cameras.get(camera), note) for cameras, note in self._placements())
        return next(((entry, note) for entry, note in known if entry and entry.get("C")), None)

    def report_of(self, run: str) -> str:
        """Return the link to another run's report."""
        return f"../{run}/{self.work.run(run).report.name}"


def state_of(camera: CameraRecord, record: RunRecord) -> str:
    """Return the state of a camera: good, warn (usable, but something is wrong with it) or bad (no usable result)."""
    if not camera.ok:
        return "bad"
    is_healthy = camera.health is None or camera.health.ok
    poses = record.poses
    is_suspect = poses is not None and any(issue.camera == camera.id for issue in poses.issues)
    return "good" if is_healthy and not is_suspect and camera.down is None else "warn"


@dataclass(frozen=True)
class Comparison:
    """Objects that differ from the reference, compared between tonight and the last good night."""

    date: str
    known: Mapping[str, str]
    """Tonight's objects that were already there on the last good night, mapped to their names of that night."""
    gone: Mapping[str, Change]
    """Objects of the last good night that no longer differ from the reference."""


def since_last_good(data: ReportData, stage: str) -> Comparison | None:
    """Compare a stage's objects with those of the last good night; None if that night does not have the same reference."""
    record, good = data.record, data.last_good
    if good is None or record.reference is None or record.reference not in {good.reference, good.run}:
        return None
    old_objects = objects_of(good, stage) if good.run != record.reference else {}
    known: dict[str, str] = {}
    for name, change in objects_of(record, stage).items():
        match = next((n for n, old_change in old_objects.items() if n not in known.values() and change.is_same(old_change)), None)
        if match is not None:
            known[name] = match
    return Comparison(good.date, known, {name: change for name, change in old_objects.items() if name not in known.values()})


def objects_of(record: RunRecord, stage: str) -> Mapping[str, Change]:
    """Return all objects that a stage reports, by name."""
    result = record.results.get(stage)
    return result.objects if result else {}
