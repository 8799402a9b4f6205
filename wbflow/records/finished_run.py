"""`Run`: a finished run and the results of its tasks, read from its folder and the cache; nothing is run again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..cache.layout import WorkFolder
from ..cache.ply import read_ply
from ..cache.receipt import Receipt
from ..cache.store import Cache, OnDemand
from ..errors import UsageError, WbflowError
from ..pipeline.stages import FRAMES, RESTORE_CLOUD, STAGES
from ..plugins import load
from ..task import Subject, Task, camera_of
from .events import Event, TaskEvent
from .record import CameraRecord, PairRecord, RunRecord
from .run_folder import RunFolder

if TYPE_CHECKING:
    import open3d


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """A finished run, and all its results."""

    run_folder: RunFolder
    record: RunRecord
    task_events: Mapping[Task, TaskEvent]
    cache: Cache

    @staticmethod
    def at(folder: RunFolder) -> Run:
        """The run in a folder, with the work folder around it.  Raises NoSuchRun."""
        return Run(folder, folder.record(), folder.tasks(), Cache(WorkFolder.of_run(folder.paths)))

    def __repr__(self) -> str:
        return repr(self.record).replace("RunRecord", "Run", 1)

    @property
    def id(self) -> str:
        """Its start, UTC: 20261120T031500Z."""
        return self.run_folder.id

    @property
    def folder(self) -> Path:
        """The folder of its files: run.json, cloud.ply, cameras.json, report.html, log.jsonl."""
        return self.run_folder.paths.folder

    @property
    def events(self) -> list[Event]:
        """Its events, in order."""
        return self.run_folder.events()

    @cached_property
    def cameras(self) -> Mapping[str, CameraRecord]:
        """Records of the cameras, by id."""
        return {camera.id: camera for camera in self.record.cameras}

    @cached_property
    def pairs(self) -> Mapping[str, PairRecord]:
        """Records of the pairs, by "left--right"."""
        return {pair.name: pair for pair in self.record.pairs}

    @cached_property
    def calibration(self) -> Mapping[str, Any]:
        """The cameras of the cloud, by id: K, R, C, width, height, as a site file's `calibration` takes them."""
        return self.run_folder.cameras()

    @cached_property
    def cloud(self) -> open3d.geometry.PointCloud:
        """The cloud with normals and colours.  Raises WbflowError if the run made none."""
        point_cloud: open3d.geometry.PointCloud = load("wbflow_stages.io.clouds:point_cloud")(self.cloud_table())
        return point_cloud

    @property
    def tasks(self) -> list[Task]:
        """The tasks that made an artifact."""
        return [task for task, event in self.task_events.items() if event.usable]

    def artifact(self, task: Task | str) -> Any:
        """Return the result of a task: a dataclass of `wbflow_stages.types`.

        task: such as "geometry gate--roof", "frames gate" or "poses".  Raises UsageError where the run had no such task, or it
        made nothing; WbflowError if the cache does not hold it any more.
        """
        if isinstance(task, str):
            task = task_named(task)
        event = self.task_events.get(task)
        if event is None:
            of_stage = [str(other) for other in self.task_events if other.stage == task.stage]
            known = ", ".join(of_stage) or "none of this stage"
            raise UsageError(f"run {self.id} had no task '{task}'", remedy=f"it had {known}")
        if not event.usable:
            what = f"'{task}' made nothing: {event.outcome}"
            if event.reason:
                what += f": {event.reason}"
            raise UsageError(what, remedy="wbflow report SITE.yaml  shows why")
        return self.load(task)

    def receipt(self, task: Task) -> Receipt | None:
        """The receipt of a task that made a result in this run, or None.  Raises WbflowError if the cache has lost it."""
        event = self.task_events.get(task)
        if event is None or not event.usable or event.key is None:
            return None
        receipt = self.cache.by_key(task, event.key)
        if receipt is None:  # removed by a cleanup, or damaged
            raise WbflowError(f"the cache no longer holds '{task}' of run {self.id}", remedy="run the night again")
        return receipt

    def load(self, task: Task) -> Any:
        """The result of a task (a dataclass of `wbflow_stages.types`), or None if it made nothing.

        Raises WbflowError if the cache no longer holds it, DamagedArtifact if the disk has lost a part of it.
        """
        receipt = self.receipt(task)
        if receipt is None:
            return None
        return self.cache.load(task, receipt)

    def of_cameras(self, *stages: str) -> Mapping[str, Any]:
        """The result of the first of these stages that made one, for each camera, or for each view of a camera that has several;
        each is read when it is accessed."""
        views: dict[str, list[str]] = {camera.id: [] for camera in self.record.cameras}
        for task in self.task_events:
            if task.stage == FRAMES:
                view = task.subject[0]
                views.setdefault(camera_of(view), []).append(view)
        subjects: dict[str, Subject] = {}
        for camera, ids in views.items():
            # by length first: view 10 comes after view 9
            for view in sorted(ids, key=lambda name: (len(name), name)) or [camera]:
                subjects[view] = (view,)
        return self._on_demand(subjects, stages)

    def of_pairs(self, *stages: str) -> Mapping[str, Any]:
        """The result of the first of these stages that made one, by pair: "left--right"."""
        return self._on_demand({pair.name: (pair.left, pair.right) for pair in self.record.pairs}, stages)

    def _on_demand(self, subjects: Mapping[str, Subject], stages: tuple[str, ...]) -> Mapping[str, Any]:
        """The results of the first of the stages that made one, by name of the subject; subjects without one are left out."""
        made = set(self.tasks)
        tasks: dict[str, Task] = {}
        for name, subject in subjects.items():
            for stage in stages:
                task = Task(stage, subject)
                if task in made:
                    tasks[name] = task
                    break
        return OnDemand(tasks, self.load)

    def cloud_table(self) -> Any:
        """The main cloud as it was published.  Raises WbflowError if there is none, or it cannot be read."""
        cloud = self.record.cloud
        if cloud is None or not (self.folder / cloud.path).is_file():
            raise WbflowError(f"run {self.id} made no cloud: {self.record.reason or 'the run was not meant to'}")
        try:
            return load(RESTORE_CLOUD)(read_ply(self.folder / cloud.path))
        except ValueError as error:
            raise WbflowError(str(error), remedy="run the night again") from None


def task_named(name: str) -> Task:
    """A task from its name: "geometry gate--roof", "frames gate", "poses".  Raises UsageError."""
    stage, _, subject = name.partition(" ")
    stages = [row.name for row in STAGES]
    if stage not in stages:
        remedy = f"stages are {', '.join(stages)}; a task is a stage and its subject: 'geometry gate--roof'"
        raise UsageError(f"{name!r}: there is no stage {stage!r}", remedy=remedy)
    if not subject:
        return Task(stage)
    return Task(stage, tuple(subject.split("--")))
