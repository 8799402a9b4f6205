"""The data of a report: the run, its events, the nights before it, and its differences from the last good one."""

from __future__ import annotations

from collections.abc import Mapping, Set
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeGuard

from ..cache.layout import WorkFolder
from ..cache.receipt import Receipt
from ..cache.store import Cache
from ..pipeline.stages import FRAMES
from ..pipeline.summaries import RecordedChange
from ..records.events import Event, TaskEvent
from ..records.record import CameraRecord, RunRecord
from ..records.reference import BadReference, Reference, read_reference
from ..records.run_folder import NoSuchRun, RunFolder, last_of_nights, newest_runs
from ..site.models import Site
from ..task import Task, view_name

NIGHTS = 30
"""Number of nights in the report's charts."""


@dataclass(frozen=True)
class Comparison:
    """Changes since the reference, compared between tonight and the last good night."""

    date: str
    known: Set[str]
    """Ids of tonight's changes that were already there on the last good night."""
    gone: Mapping[str, RecordedChange]
    """Changes of the last good night that are there no more."""
    new: int
    """Number of changes that were not there on the last good night, and that nobody has acknowledged."""


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
        outcomes: dict[Task, TaskEvent] = {}
        for event in self.events:
            # a task that was tried again has several events: the last one counts
            if isinstance(event, TaskEvent):
                outcomes[event.task] = event
        return outcomes

    @cached_property
    def keys(self) -> dict[Task, str]:
        """The cache key of each result."""
        keys: dict[Task, str] = {}
        for task, event in self.tasks.items():
            if event.usable and event.key:
                keys[task] = event.key
        return keys

    @cached_property
    def numbers(self) -> dict[str, int]:
        """The number of each camera in the page, from 1."""
        return {camera.id: number for number, camera in enumerate(self.record.cameras, 1)}

    def receipt(self, task: Task) -> Receipt | None:
        """Return the receipt of a result, also of a rejection; None if it is gone or never existed."""
        event = self.tasks.get(task)
        if event is None or not event.key:
            return None
        return self.cache.by_key(task, event.key)

    def product_file(self, task: Task, name: str) -> bytes | None:
        """Return a product file of a result (see `Products.product_files`); None if it is gone or never existed."""
        key = self.keys.get(task)
        if key is None:
            return None
        return self.cache.product_file(task, key, name)

    def frame(self, camera: str) -> Task:
        """Return the task of a camera's frame; if it has several views, that of the first one, which shows the middle."""
        # a camera that is too wide for one pinhole is split into views
        first_view = Task(FRAMES, (view_name(camera, 1),))
        if first_view in self.tasks:
            return first_view
        return Task(FRAMES, (camera,))

    @cached_property
    def earlier(self) -> list[RunRecord]:
        """The last run of each earlier night, the latest night first."""
        # a night that is run again has later nights among the earlier runs
        runs = newest_runs(self.work, before=self.record.run)
        of_earlier_nights = (run for run in runs if run[1].date < self.record.date)
        return last_of_nights(of_earlier_nights, NIGHTS - 1)[::-1]

    @property
    def nights(self) -> list[RunRecord]:
        """The earlier nights and this one, oldest first."""
        return [*reversed(self.earlier), self.record]

    @cached_property
    def last_good(self) -> RunRecord | None:
        """The last earlier night with a good verdict."""
        for night in self.earlier:
            if night.verdict and night.verdict.good:
                return night
        return None

    @cached_property
    def since_last_good(self) -> Comparison | None:
        """Tonight's changes compared with those of the last good night; None if that night does not have the same reference."""
        record = self.record
        good = self.last_good
        if good is None or record.reference is None or record.reference not in {good.reference, good.run}:
            return None
        tonight = record.changes
        # on the night of the reference, nothing differs from it
        before = good.changes if good.run != record.reference else {}
        # a change keeps its id for life
        known = tonight.keys() & before.keys()
        gone = {name: change for name, change in before.items() if name not in tonight}
        new = [change for name, change in tonight.items() if name not in before and not change.acknowledged]
        return Comparison(good.date, known, gone, len(new))

    @cached_property
    def reference(self) -> Reference | None:
        """The reference of the work folder; None if there is none, or it cannot be read."""
        try:
            return read_reference(self.work)
        except BadReference:
            return None

    @cached_property
    def placements(self) -> dict[str, tuple[Mapping[str, Any], str]]:
        """The entry of each camera whose C is known, as in cameras.json, and a note on its source ("" for tonight).

        Tonight's are best, then those of the reference, of the last earlier night that has any, and of the site file.
        """
        # 1. The sources, from the worst to the best.
        stated: dict[str, Any] = {}
        for camera in self.site.cameras:
            if camera.placement.C is not None:
                lens = camera.lens
                stated[camera.id] = {**vars(camera.placement), "K": lens.K, "width": lens.width, "height": lens.height}
        sources: list[tuple[Mapping[str, Any], str]] = [(stated, "position from the site file")]
        sources += self._last_solved()
        if self.reference:
            sources.append((self.reference.cameras, f"position on {self.reference.date}"))
        sources.append((self.cameras, ""))

        # 2. A better source replaces what a worse one says of a camera.
        placements: dict[str, tuple[Mapping[str, Any], str]] = {}
        for cameras, note in sources:
            for name, entry in cameras.items():
                if entry.get("C"):
                    placements[name] = entry, note
        return placements

    def _last_solved(self) -> list[tuple[Mapping[str, Any], str]]:
        """Return the cameras of the last earlier night that has any, with a note; nothing if there is none."""
        for record in self.earlier:
            with suppress(NoSuchRun):
                cameras = RunFolder.of(self.work, record.run).cameras()
                if cameras:
                    return [(cameras, f"position on {record.date}")]
        return []

    @property
    def unit(self) -> str:
        """The unit of lengths: m, or "" if the scale is unknown."""
        return self.record.unit

    def report_of(self, run: str) -> str:
        """Return the link to another run's report."""
        return f"../{run}/{self.work.run(run).report.name}"


def state_of(camera: CameraRecord, record: RunRecord) -> str:
    """Return the state of a camera: good, warn (usable, but something is wrong with it) or bad (no usable result)."""
    if not camera.ok:
        return "bad"
    # a camera in use can still be turned, dirty, or doubted by the others
    is_healthy = camera.health is None or camera.health.ok
    poses = record.poses
    is_suspect = poses is not None and any(issue.camera == camera.id for issue in poses.issues)
    if is_healthy and not is_suspect and camera.down is None:
        return "good"
    return "warn"


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a number, and not a bool."""
    return isinstance(value, int | float) and not isinstance(value, bool)
