"""A run's folder: read, and put together so that `runs/latest` never shows half a run."""

from __future__ import annotations

import datetime
import json
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import ExitCode, WbflowError
from ..task import Subject, Task
from .atomic import sync_folder, write_atomic
from .events import Event, TaskEvent, event_from_json
from .layout import RunPaths, WorkFolder, cloud_name, run_id
from .record import CloudRecord, RunRecord


class NoSuchRun(WbflowError, ValueError):
    """There is no run of that name, or its folder cannot be read."""

    exit_code = ExitCode.USAGE


@dataclass(frozen=True)
class RunFolder:
    """What a finished run left."""

    paths: RunPaths

    @staticmethod
    def at(path: Path) -> RunFolder:
        """The run in a folder (or of the run.json in it).

        Raises
        ------
        NoSuchRun
            It is not the folder of a run.
        """
        folder = RunFolder(RunPaths((path if path.is_dir() else path.parent).resolve()))
        if not RunFolder.is_one(path):
            raise NoSuchRun(f"{path} is not the folder of a run: it holds no {folder.paths.record.name}")
        return folder

    @staticmethod
    def is_one(path: Path) -> bool:
        """Is this the folder of a run, or the run.json in it?"""
        return path == RunPaths(path.parent).record if path.is_file() else RunPaths(path).record.is_file()

    @staticmethod
    def of(work: WorkFolder, name: str | None = None) -> RunFolder:
        """A run by id; "latest" is the newest that made a cloud, None the newest.

        Raises
        ------
        NoSuchRun
            There is none.
        """
        known = work.run_ids()
        if not known:
            raise NoSuchRun(f"{work.root} has no runs yet", remedy="wbflow run SITE.yaml  makes one")
        if name == work.latest.name:
            if not work.latest.exists():
                raise NoSuchRun("no run has made a cloud yet", remedy=f"the last run is {known[-1]}: its report says why")
            return RunFolder(RunPaths(work.latest.resolve()))
        if name is not None and name not in known:
            raise NoSuchRun(f"there is no run {name!r}; the last ones are {', '.join(known[-3:])}")
        return RunFolder(work.run(name or known[-1]))

    @property
    def id(self) -> str:
        """The run's id."""
        return self.paths.folder.name

    def __repr__(self) -> str:
        return f"RunFolder({str(self.paths.folder)!r})"

    def record(self) -> RunRecord:
        """run.json.  Raises NoSuchRun for one that cannot be read."""
        try:
            return RunRecord.from_json(json.loads(self.paths.record.read_bytes()))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            what = f"{self.paths.folder} is not the folder of a run: {type(error).__name__}: {error}"
            raise NoSuchRun(what) from None

    def events(self) -> list[Event]:
        """What happened, in order.  Raises NoSuchRun for a log that cannot be read."""
        try:
            lines = [json.loads(line) for line in self.paths.log.read_bytes().splitlines()]
            return [event for event in map(event_from_json, lines) if event]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise NoSuchRun(f"{self.paths.log} cannot be read: {type(error).__name__}: {error}") from None

    def tasks(self) -> dict[Task, TaskEvent]:
        """How each task ended (the last word of one that was done again)."""
        return {event.task: event for event in self.events() if isinstance(event, TaskEvent)}

    def cameras(self) -> dict[str, Any]:
        """Cameras by id in the form of a calibration (K, R, C, width, height, ...); empty where none were solved."""
        try:
            found: dict[str, Any] = json.loads(self.paths.cameras.read_bytes())
        except FileNotFoundError:
            return {}
        return found

    def cloud(self, cloud: CloudRecord) -> Path:
        """The file of one of the record's clouds."""
        return self.paths.folder / cloud.path

    def add(self, event: Event) -> None:
        """Add to the log of a finished run what has happened after it."""
        write_atomic(self.paths.log, self.paths.log.read_bytes() + _lines([event]))

    def write_report(self, page: str) -> Path:
        """Put a report in the place of the one that is there."""
        write_atomic(self.paths.report, page.encode())
        return self.paths.report


@dataclass(frozen=True)
class UnfinishedRun:
    """A run's folder while it is put together, under another name."""

    work: WorkFolder
    name: str

    def write_products(self, clouds: Mapping[Subject, bytes], cameras: Mapping[str, Any] | None) -> None:
        """Clouds (PLY) by component, () being the main one, and cameras in the form of a calibration.  Raises OSError."""
        for component, data in clouds.items():
            write_atomic(self._paths.folder / cloud_name(component), data)
        if cameras is not None:
            write_atomic(self._paths.cameras, json.dumps(cameras, indent=1).encode())

    def write_files(self, files: Iterable[tuple[str, bytes]]) -> None:
        """Name and content of what else is published beside the clouds.  Raises OSError."""
        for name, data in files:
            write_atomic(self._paths.folder / name, data)

    def publish(self, record: RunRecord, events: Iterable[Event], report: str) -> RunFolder:
        """Add what is told of the run and give the folder its name; where there is a cloud, `latest` leads there.

        Raises OSError.
        """
        write_atomic(self._paths.log, _lines(events))
        write_atomic(self._paths.record, json.dumps(record.to_json(), indent=1).encode())
        write_atomic(self._paths.report, report.encode())
        final = self.work.run(self.name)
        has_cloud = self._paths.cloud.is_file()
        self._paths.folder.rename(final.folder)
        sync_folder(self.work.runs)
        if has_cloud:
            link = self.work.unfinished_run(self.work.latest.name).folder
            link.unlink(missing_ok=True)
            link.symlink_to(final.folder.name)
            link.replace(self.work.latest)
            sync_folder(self.work.runs)
        return RunFolder(final)

    @property
    def _paths(self) -> RunPaths:
        return self.work.unfinished_run(self.name)


def new_run(work: WorkFolder) -> tuple[str, datetime.datetime]:
    """An id for a run that starts now, and that moment.  No id is used twice: a second run in the same second waits."""
    while True:
        moment = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
        if not work.run(run_id(moment)).folder.exists():
            return run_id(moment), moment
        time.sleep(0.05)


def _lines(events: Iterable[Event]) -> bytes:
    return "".join(json.dumps(event.to_json()) + "\n" for event in events).encode()
