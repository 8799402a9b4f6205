"""Layout of the work folder.  No other module of the engine spells out any of its file names."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import itertools
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..task import Task
from .atomic import UNSUPPORTED_ERRORS, clear, sync_folder

_RUN_ID = "%Y%m%dT%H%M%SZ"
"""Form of a run's id: its start, as in 20261120T031500Z."""
_UNFINISHED = ".tmp"
"""Suffix of files and folders that are still written; their names begin with a dot."""
_LONGEST_ID = 64
"""A file in place of a link is read only if it has fewer bytes: it holds the id of a run."""


def run_id(moment: datetime.datetime) -> str:
    """Return the id of a run that starts at `moment` (UTC, to the second).  Sorting ids sorts runs by start time."""
    return moment.strftime(_RUN_ID)


def started_by(name: str) -> datetime.datetime | None:
    """Return the start time (UTC) that a run id encodes; None for the name of any other folder."""
    try:
        return datetime.datetime.strptime(name, _RUN_ID).replace(tzinfo=datetime.UTC)
    except ValueError:
        return None


def cloud_name(component: tuple[str, ...] = ()) -> str:
    """Return the file name of a component's cloud in a run's folder; () is the main component."""
    return "-".join(["cloud", *component]) + ".ply"


def picture_name(camera: str) -> str:
    """Return the file name of the picture that shows what was found in a camera's recording."""
    return f"{camera}.jpg"


def _folder_name(task: Task) -> str:
    """Return the folder of a task's artifacts, relative to the cache."""
    subject = "--".join(task.subject) or "site"
    return f"{task.stage}/{subject}"


@dataclass(unsafe_hash=True)
class RunPaths:
    """The files in the folder of one run."""

    folder: Path

    def __post_init__(self) -> None:
        self.record = self.folder / "run.json"
        """The run's figures (see `records.record`)."""
        self.log = self.folder / "log.jsonl"
        """The run's events, one per line (see `records.events`)."""
        self.cameras = self.folder / "cameras.json"
        """The cameras from which the cloud was computed, in the format of a calibration file."""
        self.report = self.folder / "report.html"
        """The report for people."""
        self.metrics = self.folder / "metrics.prom"
        """Metrics for Prometheus."""
        self.cloud = self.folder / cloud_name()
        """The cloud of the main component."""

    def clouds(self) -> list[Path]:
        """Return every cloud in the folder, sorted by name."""
        return sorted(self.folder.glob("*.ply"))


@dataclass(unsafe_hash=True)
class WorkFolder:
    """Every path of a work folder."""

    root: Path
    store: str = ""
    """URL of the object store that the folder mirrors; "" if it mirrors none."""

    def __post_init__(self) -> None:
        self.cache = self.root / "cache"
        """cache/<stage>/<subject>/<key>.*: artifacts, their receipts, and their product files for the report."""
        self.captures_memo = self.cache / "captures.json"
        """Digests of captures, kept between runs."""
        self.functions_memo = self.cache / "functions.json"
        """Signatures and code fingerprints of the stages' functions, kept between runs."""
        self._writing_mark = self.cache / ".writing"
        """Exists while a process writes; if it exists when a run starts, the previous writer was killed or failed."""
        self.runs = self.root / "runs"
        """runs/<run id>/: the published results of each run, for people and programs."""
        self.latest = self.runs / "latest"
        """A link to the run of the newest night, whatever its outcome; a file that names it where there are no symbolic links."""
        self.latest_good = self.runs / "latest-good"
        """The same for the newest run with a cloud whose verdict is good or degraded."""
        self.site_page = self.root / "site.html"
        """The page about all nights of the site."""
        self.reference = self.root / "reference"
        """The reference that nights are compared with, and copies of its artifacts under the same names as in the cache."""
        self.reference_record = self.reference / "reference.json"
        """The record of what is pinned (see `records.reference`)."""
        self.reference_twin = self.reference / "reference-twin.json"
        """A second copy of the record, used if the first is missing or damaged."""
        self.observed = self.root / "observed"
        """What `wbflow observe` has found: a picture for each camera, and the cameras' poses."""
        self.observed_cameras = self.observed / "cameras.json"
        """The cameras that observations have placed, in the format of a calibration file."""
        self.quarantine = self.root / "quarantine"
        """Artifacts whose bytes did not match the digests in their receipts."""
        self.ledger = self.root / "ledger.sqlite"
        """An index of runs and artifacts; it can be deleted."""
        self.delivered_memo = self.root / "delivered.json"
        """Digests of the captures that cameras delivered in earlier nights."""
        self.current_run = self.root / "current-run.json"
        """The mark of the run that is at work, or that was killed (see `records.killed_runs`)."""
        self.killed_runs = self.root / "killed-runs.json"
        """The list of runs that were killed."""
        self.notified = self.root / "notified.json"
        """The state of the site at the last notification."""
        self.owner = self.root / "site.json"
        """The site that the folder belongs to (see `cache.owner`)."""
        self.mirror_memo = self.root / "mirror.json"
        """State of each file at the last synchronization with the object store (see `remote`); exists only in a mirror."""
        self.lock = self.root / "lock"
        """The lock file, held while a process writes."""
        self.progress = self.root / ".progress"
        """Current tasks of the workers (see `runner.worker.progress_reporter`); removed at the end of a run."""

    @staticmethod
    def mirroring(url: str, site: str) -> WorkFolder:
        """Return this machine's mirror of a work folder in an object store: in WBFLOW_CACHE, else in the user's cache folder."""
        cache_root = os.environ.get("WBFLOW_CACHE")
        if not cache_root:
            user_cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
            cache_root = str(Path(user_cache) / "wbflow")
        store = url.rstrip("/")
        # sites of the same name in different stores have mirrors of their own
        url_digest = hashlib.sha256(store.encode()).hexdigest()[:12]
        return WorkFolder(Path(cache_root).absolute() / f"{site}-{url_digest}", store)

    @staticmethod
    def default_for(site_file: Path, site: str) -> WorkFolder:
        """Return the default work folder, for a site file that names none."""
        return WorkFolder(site_file.resolve().parent / ".wbflow" / site)

    @staticmethod
    def of_run(run: RunPaths) -> WorkFolder:
        """Return the work folder that contains a run's folder."""
        return WorkFolder(run.folder.parent.parent)

    @staticmethod
    def unfinished(path: Path) -> Path:
        """Return the temporary path of a file while it is downloaded from an object store."""
        return path.with_name(f".{path.name}{_UNFINISHED}")

    def task(self, task: Task) -> Path:
        """Return the folder of all artifacts of a task, whatever their key."""
        return self.cache / _folder_name(task)

    def artifact(self, task: Task, key: str, suffix: str) -> Path:
        """Return the path of a task's artifact; `suffix` is that of its format: .wbf or .ply."""
        return self.cache / f"{_folder_name(task)}/{key}{suffix}"  # one join: a night of 300 cameras asks for 14,000 paths

    def receipt(self, task: Task, key: str) -> Path:
        """Return the path of an artifact's receipt; an artifact without a receipt does not count."""
        return self.artifact(task, key, ".json")

    def product_file(self, task: Task, key: str, name: str) -> Path:
        """Return the path of an artifact's product for the report; `name` as in `Products.product_files`."""
        suffix = ".jpg" if name == "picture" else f".{name}"
        return self.artifact(task, key, suffix)

    def of_key(self, task: Task, key: str) -> list[Path]:
        """Return all files of a task under a key."""
        return list(self.task(task).glob(f"{key}.*"))

    def remove_half_written(self, tasks: Iterable[Task]) -> None:
        """Remove temporary files that a dead worker left of some tasks."""
        for task in tasks:
            for leftover in self.task(task).glob(f".*{_UNFINISHED}"):
                with contextlib.suppress(OSError):
                    leftover.unlink()

    def receipt_of(self, artifact: Path) -> Path:
        """Return the path of the receipt of an artifact file."""
        return artifact.with_suffix(".json")

    def stage_of(self, path: Path) -> str:
        """Return the stage that a file of the cache belongs to."""
        return path.parts[-3]

    def identity_of(self, path: Path) -> str:
        """Return the identity of a cache file, independent of where the work folder lies: stage/subject/key.suffix."""
        return "/".join(path.parts[-3:])

    def receipts(self, task: Task | None = None) -> list[Path]:
        """Return the receipts of a task, or of all tasks, sorted by name."""
        if task:
            return sorted(self.task(task).glob("*.json"))
        return sorted(self.cache.glob("*/*/*.json"))

    def cache_files(self) -> Iterator[Path]:
        """Yield every file of every task, whatever its key."""
        return (path for path in self.cache.glob("*/*/*") if not path.name.startswith("."))

    def quarantined(self, path: Path) -> Path:
        """Return the path to which a damaged file of the cache is moved."""
        return self.quarantine / "--".join(path.relative_to(self.cache).parts)

    def pinned(self, path: Path) -> Path:
        """Return the path of the reference's copy of a file of the cache."""
        return self.reference / str(path).removeprefix(f"{self.cache}/")

    def run(self, name: str) -> RunPaths:
        """Return the paths of a run."""
        return RunPaths(self.runs / name)

    def unfinished_run(self, name: str) -> RunPaths:
        """Return the paths of a run that is not published yet."""
        return RunPaths(self.runs / f".{name}{_UNFINISHED}")

    def run_ids(self) -> list[str]:
        """Return the ids of all published runs, oldest first."""
        links = {self.latest.name, self.latest_good.name}  # in a copy of the work folder they can be folders
        ids = []
        for path in self.runs.glob("*"):
            if path.name in links or path.is_symlink() or path.name.startswith("."):
                continue
            if self.run(path.name).record.is_file():
                ids.append(path.name)
        return sorted(ids)

    def folds_case(self) -> bool:
        """Does the file system take names that differ in case alone as one name?  The caller holds the lock."""
        other = self.lock.with_name(self.lock.name.upper())
        return other.exists() and other.samefile(self.lock)

    def links(self) -> list[Path]:
        """Return all links in the folder of runs, and the files that stand for links."""
        named = (self.latest, self.latest_good)
        return [path for path in self.runs.glob("*") if path.is_symlink() or (path in named and path.is_file())]

    def link_target(self, link: Path) -> str | None:
        """Return the id of the run that a link points to; None if there is no link, or its target is not a published run."""
        name = None
        if link.is_symlink():
            name = link.readlink().name
        elif link.is_file() and link.stat().st_size < _LONGEST_ID:
            text = link.read_text(errors="replace").strip()
            if started_by(text):
                name = text
        if name and self.run(name).record.is_file():
            return name
        return None

    def point_link(self, link: Path, run: str) -> None:
        """Point a link such as `latest` to a run with one rename, so that a reader sees either the old run or the new one.

        Nothing is ever written or removed through the link.  If a folder is in its place, as in a copy of the work folder, it is
        moved to the quarantine.  Where the file system has no symbolic links (SMB, FAT, exFAT), a file with the run's id takes
        its place.  Raises OSError.
        """
        new_link = self.unfinished_run(link.name).folder
        clear(new_link)
        if link.is_dir() and not link.is_symlink():
            self.quarantine.mkdir(parents=True, exist_ok=True)
            link.rename(self._free_in_quarantine(link.name))
        # a link cannot be changed in place: a new one is made beside it, and takes its name
        try:
            new_link.symlink_to(run)
        except OSError as error:
            if error.errno not in UNSUPPORTED_ERRORS:
                raise
            new_link.write_text(f"{run}\n")
        new_link.replace(link)
        sync_folder(self.runs)

    def _free_in_quarantine(self, name: str) -> Path:
        """A path in the quarantine that is not in use yet."""
        for number in itertools.count(1):
            place = self.quarantine / f"{name}-{number}"
            if not place.exists():
                break
        return place

    def ledger_files(self) -> list[Path]:
        """Return the paths of the ledger and of SQLite's auxiliary files."""
        return [self.ledger.with_name(self.ledger.name + suffix) for suffix in ("", "-wal", "-shm")]

    def start_writing(self) -> bool:
        """Remove what a killed run left half-written, and mark the folder as being written.  The caller holds the lock.

        Returns whether the previous writer was killed or failed.
        """
        killed = self._writing_mark.exists()
        if killed:  # otherwise there is nothing to look for in a cache of many thousand files
            pattern = f".*{_UNFINISHED}"
            leftovers = [
                *self.cache.rglob(pattern),
                *self.reference.rglob(pattern),
                *self.root.glob(pattern),
                *self.runs.glob(pattern),
                *self.runs.glob(f"*/{pattern}"),
            ]
            for path in leftovers:
                clear(path)  # never through a link: its target is a published run
        self._writing_mark.parent.mkdir(parents=True, exist_ok=True)
        self._writing_mark.touch()
        return killed

    def done_writing(self) -> None:
        """Remove the mark of `start_writing`: every write has finished."""
        self._writing_mark.unlink(missing_ok=True)
