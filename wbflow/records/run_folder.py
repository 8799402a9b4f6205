"""Reading a run's folder, and publishing it so that `runs/latest` never shows an incomplete run."""

from __future__ import annotations

import contextlib
import datetime
import functools
import hashlib
import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.atomic import sync_folder, write_atomic
from ..cache.checksum import NoChecksum, dump_with_checksum, parse_checksummed, sha256_of
from ..cache.layout import RunPaths, WorkFolder, run_id, started_by
from ..cache.lock import Locked, hold
from ..cache.memo import file_stamp
from ..cache.untrusted import read_untrusted
from ..errors import ExitCode, WbflowError
from ..pipeline.summaries import RecordedChange
from ..remote import Mirror, writing
from ..task import Task
from .events import Event, TaskEvent, event_from_json, event_to_json
from .record import RunRecord

_IDENTITY = "run"
"""What the checksummed record says that it is."""
_NIGHT_PATTERN = re.compile(r"\d{4}-\d{2}-\d{2}")


class NoSuchRun(WbflowError, ValueError):
    """No run has that name, or its folder cannot be read."""

    exit_code = ExitCode.USAGE


@dataclass(frozen=True)
class RunFolder:
    """The folder of a finished run."""

    paths: RunPaths

    @staticmethod
    def at(path: Path) -> RunFolder:
        """Return the run in a folder; `path` may also be its run.json.  Raises NoSuchRun if it is not the folder of a run."""
        folder_path = path if path.is_dir() else path.parent
        folder = RunFolder(RunPaths(folder_path.resolve()))
        if not RunFolder.is_run_folder(path):
            raise NoSuchRun(f"{path} is not the folder of a run: it holds no {folder.paths.record.name}")
        return folder

    @staticmethod
    def is_run_folder(path: Path) -> bool:
        """Is this the folder of a run, or the run.json in it?"""
        if path.is_file():
            return path == RunPaths(path.parent).record
        return RunPaths(path).record.is_file()

    @staticmethod
    def of(work: WorkFolder, name: str | None = None) -> RunFolder:
        """Return a run by id, or the newest run of a night by its date.

        "latest" (or None) is the run of the newest night; "latest-good" that of the newest night with a cloud whose verdict is
        good or degraded.  Raises NoSuchRun.
        """
        # links are not trusted alone: they may be missing in a copy, or point to a folder that was removed
        ids = work.run_ids()
        if not ids:
            raise NoSuchRun(f"{work.root} has no runs yet", remedy="wbflow run SITE.yaml  makes one")
        if name is None or name == work.latest.name:
            newest = _of_newest_night(work, work.latest, lambda run: True)
            return RunFolder(work.run(newest or ids[-1]))
        if name == work.latest_good.name:
            newest_good = _of_newest_night(work, work.latest_good, RunFolder.is_good)
            if newest_good:
                return RunFolder(work.run(newest_good))
            raise NoSuchRun("no run has made a cloud yet", remedy=f"the last run is {ids[-1]}: its report says why")
        if _NIGHT_PATTERN.fullmatch(name):
            for folder, record in newest_runs(work):
                if record.date == name:
                    return folder
            raise NoSuchRun(f"no run has worked on the night of {name}", remedy="wbflow history SITE.yaml  lists all runs")
        if name in ids:
            return RunFolder(work.run(name))
        raise NoSuchRun(f"there is no run {name!r}; the last ones are {', '.join(ids[-3:])}")

    @property
    def id(self) -> str:
        return self.paths.folder.name

    def record(self) -> RunRecord:
        """Return the content of run.json.  Raises NoSuchRun if it cannot be read."""
        try:
            return _read_record(self.paths.record, tuple(file_stamp(self.paths.record) or ()))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            what = f"{self.paths.folder} is not the folder of a run: {type(error).__name__}: {error}"
            raise NoSuchRun(what) from None

    def events(self) -> list[Event]:
        """Return the events of the log, in order.  Raises NoSuchRun if it cannot be read."""
        try:
            lines = [json.loads(line) for line in read_untrusted(self.paths.log).splitlines()]
            return [event for event in map(event_from_json, lines) if event]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise NoSuchRun(f"{self.paths.log} cannot be read: {type(error).__name__}: {error}") from None

    def tasks(self) -> dict[Task, TaskEvent]:
        """Return how each task ended, by its last event if it ran again."""
        return {event.task: event for event in self.events() if isinstance(event, TaskEvent)}

    def cameras(self) -> dict[str, Any]:
        """Return cameras by id in the format of a calibration file (K, R, C, width, height, ...); empty if none were solved.

        Raises NoSuchRun if the file cannot be read.
        """
        try:
            if not os.path.lexists(self.paths.cameras):
                return {}
            solved: dict[str, Any] = json.loads(read_untrusted(self.paths.cameras))
        except (OSError, ValueError) as error:
            raise NoSuchRun(f"{self.paths.cameras} cannot be read: {error}") from None
        return solved

    def damaged(self, missing: bool) -> list[Path]:
        """Return the products of the run that differ from what was published.  Raises NoSuchRun if run.json itself is damaged.

        missing: include products that no longer exist.
        """
        damaged = []
        for name, digest in self.record().files.items():
            path = self.paths.folder / name
            if not path.is_file() and not missing:
                continue
            if sha256_of(path) != digest:
                damaged.append(path)
        return damaged

    def night(self) -> str:
        """Return the night (ISO 8601) that puts the run in order; "" if its record cannot be read.

        It is the day of the run itself if the names of captures tell no night, and never later than that: a camera whose clock
        is years ahead does not hold `latest` for years.
        """
        try:
            record = self.record()
        except NoSuchRun:
            return ""
        started = started_by(self.id)
        if started is None:
            return record.date
        day = started.date().isoformat()
        if not record.dated:
            return day
        return min(record.date, day)

    def is_good(self) -> bool:
        """Is there a cloud, and a verdict that is good or degraded?  (Runs of earlier versions need only a cloud.)"""
        if not self.paths.cloud.is_file():
            return False
        try:
            verdict = self.record().verdict
        except NoSuchRun:
            return False
        return verdict is None or verdict.level != "failed"

    def add(self, event: Event) -> None:
        """Append to the log an event that happened after the run was published."""
        write_atomic(self.paths.log, read_untrusted(self.paths.log) + log_of([event]))

    def write_report(self, page: str) -> Path:
        """Replace the report."""
        write_atomic(self.paths.report, page.encode(errors="backslashreplace"))
        return self.paths.report


@dataclass(frozen=True)
class UnfinishedRun:
    """The folder of a run that is not published yet, under a temporary name."""

    work: WorkFolder
    name: str
    files: dict[str, str] = field(default_factory=dict)
    """SHA-256 of the products that have been written, by name."""

    def write_cameras(self, cameras: Mapping[str, Any]) -> None:
        """Write the cameras in the format of a calibration file.  Raises OSError."""
        self.write(self.paths.cameras.name, json.dumps(cameras, indent=1).encode())

    def write(self, name: str, data: bytes) -> None:
        """Write a product that does not change after the run; it is a hard link if the newest earlier copy has the same bytes.

        Products are read-only, so that no program changes one run's file through the name in another run's folder; wbflow itself
        only replaces files, and never writes into them.  Raises OSError.
        """
        path = self.paths.folder / name
        newest_copy = self._newest_copy(name)
        if newest_copy is None or not _hard_link(path, newest_copy, data):
            write_atomic(path, data)
        with contextlib.suppress(OSError):  # some file systems have no permissions, and nothing depends on them
            path.chmod(0o444)
        self.files[name] = hashlib.sha256(data).hexdigest()

    def _newest_copy(self, name: str) -> Path | None:
        """The product with this name in the folder of the newest run that has one."""
        for run in reversed(self.work.run_ids()):
            copy = self.work.run(run).folder / name
            if copy.is_file():
                return copy
        return None

    def publish(self, record: RunRecord, events: Iterable[Event], report: str, metrics: str = "") -> RunFolder:
        """Add record, log, report and metrics, rename the folder to its final name, and update the links.  Raises OSError.

        Parameters
        ----------
        record, events : RunRecord, iterable of Event
            The content of run.json, and of the log.
        report, metrics : str
            The report (HTML), and the metrics for Prometheus.
        """
        write_atomic(self.paths.report, report.encode(errors="backslashreplace"))
        write_atomic(self.paths.log, log_of(events))
        write_atomic(self.paths.record, dump_with_checksum(_IDENTITY, record.to_json(), in_lines=True))
        write_atomic(self.paths.metrics, metrics.encode(errors="backslashreplace"))
        # complete: from the rename on it is a run, and only then do links show it
        final = self.work.run(self.name)
        self.paths.folder.rename(final.folder)
        sync_folder(self.work.runs)
        update_links(self.work)
        return RunFolder(final)

    @property
    def paths(self) -> RunPaths:
        """Paths in the temporary folder."""
        return self.work.unfinished_run(self.name)


def _hard_link(path: Path, earlier: Path, data: bytes) -> bool:
    """Hard-link `path` to an earlier file if it has these bytes; return False if it does not, or linking fails."""
    try:
        if earlier.stat().st_size != len(data) or read_untrusted(earlier, most=sys.maxsize) != data:
            return False
        path.parent.mkdir(parents=True, exist_ok=True)
        path.hardlink_to(earlier)
    except OSError:
        return False
    return True


def update_links(work: WorkFolder) -> None:
    """Point each link to the run of the newest night that it may show.  Called after a run is published, and before the next run,
    in case the process was killed in between.  Raises OSError."""
    conditions: dict[Path, Callable[[RunFolder], bool]] = {work.latest: lambda run: True, work.latest_good: RunFolder.is_good}
    for link, may_point_to in conditions.items():
        newest = _of_newest_night(work, link, may_point_to)
        if newest and newest != work.link_target(link):
            work.point_link(link, newest)


def _of_newest_night(work: WorkFolder, link: Path, may_point_to: Callable[[RunFolder], bool]) -> str | None:
    """Return the id of the run that a link should point to; None if there is none.

    It is the last run of the newest night, by its date: a rerun of an old night is not news.
    """
    target = work.link_target(link)
    newest = target
    newest_night = RunFolder(work.run(target)).night() if target else ""
    for name in work.run_ids():
        # what ran before the link's target was compared with it when the link was set
        if target and name <= target:
            continue
        run = RunFolder(work.run(name))
        night = run.night()
        # of several runs of one night, the last one
        if night >= newest_night and may_point_to(run):
            newest = name
            newest_night = night
    return newest


def newest_runs(work: WorkFolder, before: str = "", after: str = "") -> Iterator[tuple[RunFolder, RunRecord]]:
    """Yield runs and their records, newest first, without those that cannot be read.

    Records are read lazily: a caller can stop as soon as it has seen enough.
    before, after: ids of runs; if given, only runs strictly between them.
    """
    for name in reversed(work.run_ids()):
        if name > after and (not before or name < before):
            folder = RunFolder(work.run(name))
            try:
                record = folder.record()
            except NoSuchRun:
                continue
            yield folder, record


def compared_before(work: WorkFolder, date: str, reference: str = "") -> Iterator[tuple[RunFolder, RunRecord]]:
    """Yield the runs of nights before a date that have found what changed: the newest night first, of each night its last run.

    Records are read lazily: a caller can stop as soon as it has seen enough.

    date: ISO 8601; "" for all nights.  reference: only runs compared with the reference of this run id; "": with any.
    """
    nights: dict[str, tuple[RunFolder, RunRecord]] = {}  # that have been read, and not yielded yet
    yielded: set[str] = set()
    for folder, record in newest_runs(work, after=reference):
        # 1. this run, unless a later one was of the same night
        is_wanted = record.compared and (not date or record.date < date) and (not reference or record.reference == reference)
        if is_wanted and record.date not in yielded:
            nights.setdefault(record.date, (folder, record))
        # 2. the nights that no older run can come before: no night is later than the day of its run
        latest = _next_day(folder.id)
        for night in sorted(nights, reverse=True):
            if night >= latest or night == _day_before(date):
                yielded.add(night)
                yield nights.pop(night)
    for night in sorted(nights, reverse=True):
        yield nights[night]


def _next_day(run: str) -> str:
    """Return the day after a run began (ISO 8601), which is after its night in any time zone."""
    started = started_by(run)
    return (started.date() + datetime.timedelta(days=1)).isoformat() if started else ""


def _day_before(date: str) -> str:
    return (datetime.date.fromisoformat(date) - datetime.timedelta(days=1)).isoformat() if date else ""


def newest_compared(work: WorkFolder) -> RunRecord | None:
    """Return the last run of the newest night that has found what changed; None if there is none."""
    return next((record for _, record in compared_before(work, "")), None)


def ended_change(work: WorkFolder, name: str) -> tuple[RecordedChange, str] | None:
    """Return a change with the first night on which it was gone (ISO 8601); None if no night has a change of this id."""
    gone = ""
    for _, record in compared_before(work, ""):
        if name in record.changes:
            return record.changes[name], gone or record.date
        gone = record.date
    return None


def last_of_nights(runs: Iterable[tuple[RunFolder, RunRecord]], most: int = sys.maxsize) -> list[RunRecord]:
    """Return the last run of each of the `most` latest nights, in order of date.  runs: newest first."""
    by_date: dict[str, RunRecord] = {}
    for _, record in runs:
        by_date.setdefault(record.date, record)
        if len(by_date) == most:
            break
    return [by_date[date] for date in sorted(by_date)]


@contextlib.contextmanager
def hold_to_write(work: WorkFolder, wait: bool) -> Iterator[Mirror | None]:
    """Hold the work folder, and the object store that it mirrors, while the block runs; first clean up after a killed run.

    Raises Locked if another process holds either and `wait` is False; StoreError if the store does not answer; OSError.
    """
    with hold(work.lock, wait):
        was_killed = work.start_writing()
        with writing(work, wait) if work.store else contextlib.nullcontext() as mirror:
            if was_killed or mirror:
                update_links(work)
            yield mirror
        work.done_writing()  # not after an exception: then there may be something to clean up


def refresh(work: WorkFolder) -> None:
    """Download the results of other machines, if the work folder mirrors an object store.  Raises StoreError, OSError."""
    if work.store:
        with contextlib.suppress(Locked), hold(work.lock, wait=False):  # a run that holds the folder downloads them itself
            Mirror(work).pull()
        update_links(work)


def new_run(work: WorkFolder) -> tuple[str, datetime.datetime]:
    """Return an id for a run that starts now, and the current time.

    No id is used twice, and ids sort in the order of the runs: a run that starts in the same second as the newest run, or after
    the clock was set back, takes the next free second.
    """
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    free_second = now
    for name in work.run_ids():
        started = started_by(name)
        if started:
            free_second = max(free_second, started + datetime.timedelta(seconds=1))
    # a folder without a record is no run, and has the name all the same
    while work.run(run_id(free_second)).folder.exists():
        free_second += datetime.timedelta(seconds=1)
    return run_id(free_second), now


@functools.lru_cache(maxsize=32)
def _read_record(path: Path, stamp: tuple[int, ...]) -> RunRecord:
    """Read a record once for each `stamp` of its file: verdict, health and report look at the same earlier nights."""
    data = read_untrusted(path)
    try:
        entries = parse_checksummed(data, _IDENTITY)
    except NoChecksum:  # as in earlier versions
        entries = json.loads(data)
        if entries.get("of") == _IDENTITY:
            raise
    return RunRecord.from_json(entries)


def log_of(events: Iterable[Event]) -> bytes:
    """Return events as the lines of a log."""
    return "".join(json.dumps(event_to_json(event)) + "\n" for event in events).encode()
