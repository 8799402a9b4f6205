"""A run's folder: read, and put together so that `runs/latest` never shows half a run."""

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
from typing import TYPE_CHECKING, Any

from ..cache.atomic import sync_folder, write_atomic
from ..cache.checksum import NoChecksum, checked, sha256_of, with_checksum
from ..cache.layout import RunPaths, WorkFolder, run_id, started_by
from ..cache.lock import hold
from ..cache.untrusted import read_untrusted
from ..errors import ExitCode, WbflowError
from ..task import Task
from .events import Event, TaskEvent, event_from_json, event_to_json
from .record import RunRecord

if TYPE_CHECKING:
    from ..remote import Mirror

_OF = "run"
_NIGHT = re.compile(r"\d{4}-\d{2}-\d{2}")


def _link(path: Path, earlier: Path | None, data: bytes) -> bool:
    """Give a file a second name where it holds these bytes, and the file system can."""
    try:
        if earlier is None or earlier.stat().st_size != len(data) or read_untrusted(earlier, most=sys.maxsize) != data:
            return False
        path.parent.mkdir(parents=True, exist_ok=True)
        path.hardlink_to(earlier)
    except OSError:
        return False
    return True


class NoSuchRun(WbflowError, ValueError):
    """There is no run of that name, or its folder cannot be read."""

    exit_code = ExitCode.USAGE


@dataclass(frozen=True)
class RunFolder:
    """What a finished run left."""

    paths: RunPaths

    @staticmethod
    def at(path: Path) -> RunFolder:
        """The run in a folder (or of the run.json in it).  Raises NoSuchRun where it is not the folder of a run."""
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
        """A run by id, or by the night of its captures: the newest run of that night.

        "latest-good" is the newest with a cloud whose verdict is good or degraded, "latest" (or None) the newest.
        Raises NoSuchRun.
        """
        known = work.run_ids()
        if not known:
            raise NoSuchRun(f"{work.root} has no runs yet", remedy="wbflow run SITE.yaml  makes one")
        if name == work.latest_good.name:
            newest_first = (RunFolder(work.run(run)) for run in reversed(known))
            shown = work.led_to(work.latest_good) or next((run.id for run in newest_first if run.is_good()), None)
            if shown is None:
                raise NoSuchRun("no run has made a cloud yet", remedy=f"the last run is {known[-1]}: its report says why")
            return RunFolder(work.run(shown))
        name = None if name == work.latest.name else name
        if name is not None and _NIGHT.fullmatch(name):
            if found := next((folder for folder, record in newest_runs(work) if record.date == name), None):
                return found
            raise NoSuchRun(f"no run has worked on the night of {name}", remedy="wbflow history SITE.yaml  lists all runs")
        if name is not None and name not in known:
            raise NoSuchRun(f"there is no run {name!r}; the last ones are {', '.join(known[-3:])}")
        return RunFolder(work.run(name or known[-1]))

    @property
    def id(self) -> str:
        return self.paths.folder.name

    def __repr__(self) -> str:
        return f"RunFolder({str(self.paths.folder)!r})"

    def record(self) -> RunRecord:
        """run.json.  Raises NoSuchRun for one that cannot be read."""
        try:
            status = self.paths.record.stat()
            return _read(self.paths.record, (status.st_ino, status.st_mtime_ns, status.st_size))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            what = f"{self.paths.folder} is not the folder of a run: {type(error).__name__}: {error}"
            raise NoSuchRun(what) from None

    def events(self) -> list[Event]:
        """What happened, in order.  Raises NoSuchRun for a log that cannot be read."""
        try:
            lines = [json.loads(line) for line in read_untrusted(self.paths.log).splitlines()]
            return [event for event in map(event_from_json, lines) if event]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise NoSuchRun(f"{self.paths.log} cannot be read: {type(error).__name__}: {error}") from None

    def tasks(self) -> dict[Task, TaskEvent]:
        """How each task ended (the last word of one that was done again)."""
        return {event.task: event for event in self.events() if isinstance(event, TaskEvent)}

    def cameras(self) -> dict[str, Any]:
        """Cameras by id in the form of a calibration (K, R, C, width, height, ...); empty where none were solved.

        Raises NoSuchRun for a file that cannot be read.
        """
        try:
            if not os.path.lexists(self.paths.cameras):
                return {}
            found: dict[str, Any] = json.loads(read_untrusted(self.paths.cameras))
        except (OSError, ValueError) as error:
            raise NoSuchRun(f"{self.paths.cameras} cannot be read: {error}") from None
        return found

    def damaged(self, missing: bool) -> list[Path]:
        """Products of the run that are not as they were published.  Raises NoSuchRun where run.json itself is damaged.

        missing: count those, too, that are not there any more.
        """
        files = ((self.paths.folder / name, digest) for name, digest in self.record().files.items())
        return [path for path, digest in files if (path.is_file() or missing) and sha256_of(path) != digest]

    def is_good(self) -> bool:
        """Is there a cloud, and a verdict that is good or degraded?  (Runs of earlier versions have a cloud, and no verdict.)"""
        if not self.paths.cloud.is_file():
            return False
        try:
            verdict = self.record().verdict
        except NoSuchRun:
            return False
        return verdict is None or verdict.level != "failed"

    def add(self, event: Event) -> None:
        """Add to the log of a finished run what has happened after it."""
        write_atomic(self.paths.log, read_untrusted(self.paths.log) + log_of([event]))

    def write_report(self, page: str) -> Path:
        """Put a report in the place of the one that is there."""
        write_atomic(self.paths.report, page.encode(errors="backslashreplace"))
        return self.paths.report


@dataclass(frozen=True)
class UnfinishedRun:
    """A run's folder while it is put together, under another name."""

    work: WorkFolder
    name: str
    files: dict[str, str] = field(default_factory=dict)
    """SHA-256 of the products that have been written, by name."""

    def write_cameras(self, cameras: Mapping[str, Any]) -> None:
        """The cameras in the form of a calibration.  Raises OSError."""
        self.write(self.paths.cameras.name, json.dumps(cameras, indent=1).encode())

    def write(self, name: str, data: bytes) -> None:
        """A product that is not changed after the run; what an earlier run has just the same takes no room.

        Products can be read only, so that no program writes through one name what is then read under the other; wbflow itself
        only ever puts new files in the place of old ones.  Raises OSError.
        """
        path, earlier = self.paths.folder / name, (self.work.run(run).folder / name for run in reversed(self.work.run_ids()))
        if not _link(path, next((place for place in earlier if place.is_file()), None), data):
            write_atomic(path, data)
        with contextlib.suppress(OSError):  # a file system without rights: nothing depends on them
            path.chmod(0o444)
        self.files[name] = hashlib.sha256(data).hexdigest()

    def publish(self, record: RunRecord, events: Iterable[Event], report: str, metrics: str = "") -> RunFolder:
        """Add record, log, report and metrics, and give the folder its name; the links lead there.  Raises OSError.

        Parameters
        ----------
        record, events : RunRecord, iterable of Event
            The run in figures, and what happened.
        report, metrics : str
            The run for people (HTML), and for Prometheus.
        """
        write_atomic(self.paths.report, report.encode(errors="backslashreplace"))
        write_atomic(self.paths.log, log_of(events))
        write_atomic(self.paths.record, with_checksum(_OF, record.to_json(), in_lines=True))
        write_atomic(self.paths.metrics, metrics.encode(errors="backslashreplace"))
        final = self.work.run(self.name)
        self.paths.folder.rename(final.folder)
        sync_folder(self.work.runs)
        turn_links(self.work)
        return RunFolder(final)

    @property
    def paths(self) -> RunPaths:
        """Where it is put together."""
        return self.work.unfinished_run(self.name)


def turn_links(work: WorkFolder) -> None:
    """Turn each link to the newest run that it may show: after a run has its name, and before the next one, in case that was
    killed in between.  Raises OSError."""
    may_show: dict[Path, Callable[[RunFolder], bool]] = {work.latest: lambda run: True, work.latest_good: RunFolder.is_good}
    runs = [RunFolder(work.run(name)) for name in reversed(work.run_ids())]
    for link, suits in may_show.items():
        shown = work.led_to(link)
        for run in runs:
            if run.id == shown:
                break
            if suits(run):
                work.turn(link, run.id)
                break


def newest_runs(work: WorkFolder, before: str = "", after: str = "") -> Iterator[tuple[RunFolder, RunRecord]]:
    """Yield runs and their records, newest first, without those that cannot be read.

    Each record is read when it is needed: whoever looks at the past stops as soon as enough is known.
    before, after: ids of runs; only those between, if given.
    """
    for name in reversed(work.run_ids()):
        if name > after and (not before or name < before):
            folder = RunFolder(work.run(name))
            try:
                record = folder.record()
            except NoSuchRun:
                continue
            yield folder, record


def last_of_nights(runs: Iterable[tuple[RunFolder, RunRecord]], most: int = sys.maxsize) -> list[RunRecord]:
    """The last run of each night, the latest nights but in their order, of runs that come newest first; no more than so many."""
    found: dict[str, RunRecord] = {}
    for _, record in runs:
        found.setdefault(record.date, record)
        if len(found) == most:
            break
    return [record for _, record in sorted(found.items())]


@contextlib.contextmanager
def hold_to_write(work: WorkFolder, wait: bool) -> Iterator[Mirror | None]:
    """Hold the work folder while the block runs, and begin with one that is whole; and so the object store that it mirrors.

    Raises Locked where another process holds it and `wait` is False; StoreError where the store does not answer; OSError.
    """
    with hold(work.lock, wait):
        if work.start_writing():
            turn_links(work)
        if work.store:
            from ..remote import writing  # here: few work folders are mirrors

            with writing(work, wait) as mirror:
                turn_links(work)
                yield mirror
        else:
            yield None
        work.done_writing()  # not where the block was left by an exception: then there may be something to clear away


def refresh(work: WorkFolder) -> None:
    """Bring what other machines have done, where the work folder mirrors an object store.  Raises StoreError, OSError."""
    if work.store:
        from ..remote import pull_to_read

        pull_to_read(work)
        turn_links(work)


def new_run(work: WorkFolder) -> tuple[str, datetime.datetime]:
    """An id for a run that starts now, and that moment.

    No id is used twice, and ids sort as the runs did: one that starts within the second of the newest run, or after the clock has
    been set back, takes the next free second.
    """
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    newest = max((moment for name in work.run_ids() if (moment := started_by(name))), default=None)
    free = now if newest is None else max(now, newest + datetime.timedelta(seconds=1))
    while work.run(run_id(free)).folder.exists():
        free += datetime.timedelta(seconds=1)
    return run_id(free), now


@functools.lru_cache(maxsize=32)
def _read(path: Path, stamp: tuple[int, int, int]) -> RunRecord:
    """Return a record; verdict, health and report look at the same earlier nights, and read each once."""
    return RunRecord.from_json(_entries(read_untrusted(path)))


def _entries(data: bytes) -> dict[str, Any]:
    """Return what run.json holds; that of an earlier version carries no checksum.  Raises ValueError, AttributeError."""
    try:
        return checked(data, _OF)
    except NoChecksum:
        found: dict[str, Any] = json.loads(data)
        if found.get("of") == _OF:
            raise
        return found


def log_of(events: Iterable[Event]) -> bytes:
    """The lines of a log."""
    return "".join(json.dumps(event_to_json(event)) + "\n" for event in events).encode()
