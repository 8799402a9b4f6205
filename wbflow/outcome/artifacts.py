"""What a finished run made, by task and in the forms that other programs read; nothing is run again."""

from __future__ import annotations

import datetime
import importlib.util
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..cache.layout import WorkFolder
from ..cache.plugins import load
from ..cache.ply import read_ply
from ..cache.store import Cache, Receipt
from ..errors import ExitCode, UsageError, WbflowError
from ..pipeline.exports import EXPORTS, EXTRAS, Export
from ..pipeline.names import FRAMES, FUSE
from ..pipeline.stages import CLOUD_TABLE, STAGES, stage_named
from ..records.events import TaskEvent
from ..records.record import CloudRecord, RunRecord
from ..records.run_folder import RunFolder
from ..task import Subject, Task, camera_of


class Gone(WbflowError):
    """The run made it, but it is not there any more."""


@dataclass(frozen=True)
class FinishedRun:
    """A run with all that it made."""

    work: WorkFolder
    folder: RunFolder
    record: RunRecord
    tasks: Mapping[Task, TaskEvent] = field(repr=False)
    """How each of its tasks ended."""
    cache: Cache = field(repr=False)

    @staticmethod
    def open(work: WorkFolder, folder: RunFolder) -> FinishedRun:
        """Raises NoSuchRun for a folder that cannot be read."""
        return FinishedRun(work, folder, folder.record(), folder.tasks(), Cache(work))

    @staticmethod
    def at(folder: RunFolder) -> FinishedRun:
        """The run in a folder, with the work folder around it.  Raises NoSuchRun."""
        return FinishedRun.open(WorkFolder.of_run(folder.paths), folder)

    def receipt(self, task: Task) -> Receipt | None:
        """The receipt of a task that gave a result in this run, or None.

        Raises
        ------
        Gone
            The cache does not hold it any more.
        """
        event = self.tasks.get(task)
        if event is None or not event.usable or event.key is None:
            return None
        receipt = self.cache.by_key(task, event.key)
        if receipt is None:
            raise Gone(f"the cache no longer holds '{task}' of run {self.folder.id}", remedy="run the night again")
        return receipt

    def load(self, task: Task) -> Any:
        """What a task made (a dataclass of `wbflow_stages.types`), or None where it gave nothing.

        Raises
        ------
        Gone, DamagedArtifact
            The cache does not hold it any more, or its disk has lost something.
        """
        receipt = self.receipt(task)
        return self.cache.load(task, receipt) if receipt else None

    def made(self, stage: str, subject: Subject = ()) -> Any:
        """What a stage made of a subject, or None."""
        return self.load(Task(stage, subject))

    def of_cameras(self, *stages: str) -> Mapping[str, Any]:
        """What the first of these stages that gave something made of each camera, or of each of its views; each is
        read when it is needed."""
        views: dict[str, list[str]] = {camera.id: [] for camera in self.record.cameras}
        for view in (task.subject[0] for task in self.tasks if task.stage == FRAMES):
            views.setdefault(camera_of(view), []).append(view)
        names = [
            view for camera, found in views.items() for view in sorted(found, key=lambda name: (len(name), name)) or [camera]
        ]
        return _OfSubjects(self, {name: (name,) for name in names}, stages)

    def of_pairs(self, *stages: str) -> Mapping[str, Any]:
        """The same of each pair, as "left--right"."""
        return _OfSubjects(self, {pair.name: (pair.left, pair.right) for pair in self.record.pairs}, stages)

    def cloud(self, cloud: CloudRecord | None = None) -> Any:
        """A cloud as it was published; the main one if none is named.

        Raises
        ------
        Gone
            The run made none, or its file cannot be read.
        """
        cloud = cloud or self.record.cloud
        path = self.folder.cloud(cloud) if cloud else None
        if path is None or not path.is_file():
            raise Gone(f"run {self.folder.id} made no cloud: {self.record.reason or 'it was not asked to'}")
        try:
            return load(CLOUD_TABLE.restore)(read_ply(path))
        except ValueError as error:
            raise Gone(str(error), remedy="run the night again") from None


class _OfSubjects(Mapping[str, Any]):
    def __init__(self, run: FinishedRun, subjects: Mapping[str, Subject], stages: tuple[str, ...]) -> None:
        self._run = run
        tasks = {name: [Task(stage, subject) for stage in stages] for name, subject in subjects.items()}
        made = {name: [t for t in group if (event := run.tasks.get(t)) and event.usable] for name, group in tasks.items()}
        self._tasks = {name: group[0] for name, group in made.items() if group}

    def __getitem__(self, name: str) -> Any:
        return self._run.load(self._tasks[name])

    def __contains__(self, name: object) -> bool:
        return name in self._tasks  # without reading it

    def __iter__(self) -> Iterator[str]:
        return iter(self._tasks)

    def __len__(self) -> int:
        return len(self._tasks)


def task_named(name: str) -> Task:
    """A task as it is written: "geometry gate--roof", "frames gate", "poses".  Raises UsageError."""
    stage, _, subject = name.partition(" ")
    if stage not in {row.name for row in STAGES}:
        remedy = f"stages are {', '.join(row.name for row in STAGES)}; a task is a stage and its subject: 'geometry gate--roof'"
        raise UsageError(f"{name!r}: there is no stage {stage!r}", remedy=remedy)
    return Task(stage, tuple(subject.split("--")) if subject else ())


class MissingExtra(WbflowError):
    """Packages that an export needs are not installed; the message says how to get them."""

    exit_code = ExitCode.USAGE


class NothingToExport(WbflowError):
    """The run does not hold what an export needs; the message says what is missing."""


def export(run: FinishedRun, out: Path, forms: frozenset[str]) -> Iterator[Path]:
    """Write a run's results into `out` in some forms (names of `EXPORTS`); yields each file when it is there.

    Raises
    ------
    MissingExtra, NothingToExport, Gone
        Before a file of that form is written.
    DamagedArtifact
        The cache's disk has lost something; the next run makes it again.
    """
    if run.record.poses is None:
        raise NothingToExport(f"run {run.folder.id} solved no cameras: {run.record.reason or 'it ended before'}")
    rows = [row for row in EXPORTS if row.name in forms]
    for row in rows:
        require(row, georeferenced=bool(run.record.poses.crs))
    for row in rows:
        results = {name: _result(run, stages) for name, stages in row.inputs.items()}
        day = datetime.date.fromisoformat(run.record.date)
        try:
            for name, data in load(row.function)(**results, **({"day": day} if row.dated else {})):
                write_atomic(out / name, data)
                yield out / name
        except ValueError as error:
            raise NothingToExport(f"run {run.folder.id}: {error}") from error


def require(row: Export, *, georeferenced: bool) -> None:
    """See that the packages that a form needs are installed.  Raises MissingExtra."""
    extra = row.extra or (row.extra_on_the_map if georeferenced else "")
    missing = [package for package in EXTRAS.get(extra, ()) if importlib.util.find_spec(package) is None]
    if missing:
        what = f"--{row.name}{'' if row.extra else ' of a georeferenced site'}"
        raise MissingExtra(f"{what} needs {' and '.join(missing)}: pip install 'wbflow[{extra}]'")


def _result(run: FinishedRun, stages: tuple[str, ...]) -> Any:
    if stages == (FUSE,):
        return run.cloud()
    scope = stage_named(stages[0]).scope
    return run.made(stages[0]) if scope == "site" else run.of_pairs(*stages) if scope == "pair" else run.of_cameras(*stages)
