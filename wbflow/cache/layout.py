"""Where everything in the work folder lies.  No other file of the engine spells one of these names."""

from __future__ import annotations

import datetime
import hashlib
import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..task import Task
from .atomic import clear, sync_folder

_RUN_ID = "%Y%m%dT%H%M%SZ"
_UNFINISHED = ".tmp"


def run_id(moment: datetime.datetime) -> str:
    """The id of a run that starts at `moment` (UTC, to the second): ids sort as the runs did."""
    return moment.strftime(_RUN_ID)


def started_by(name: str) -> datetime.datetime | None:
    """When the run of an id was started (UTC); None for a folder that somebody else has made."""
    try:
        return datetime.datetime.strptime(name, _RUN_ID).replace(tzinfo=datetime.UTC)
    except ValueError:
        return None


def cloud_name(component: tuple[str, ...] = ()) -> str:
    """The name of a component's cloud in a run's folder; () is the main one."""
    return f"cloud{''.join(f'-{name}' for name in component)}.ply"


@dataclass(unsafe_hash=True)
class RunPaths:
    """The files in the folder of one run."""

    folder: Path

    def __post_init__(self) -> None:
        self.record = self.folder / "run.json"
        """The run in figures (see `records.record`)."""
        self.log = self.folder / "log.jsonl"
        """What happened, one event a line (see `records.events`)."""
        self.cameras = self.folder / "cameras.json"
        """The cameras that the cloud rests on, in the form of a calibration."""
        self.report = self.folder / "report.html"
        """The run for people."""
        self.metrics = self.folder / "metrics.prom"
        """The run for Prometheus."""
        self.cloud = self.folder / cloud_name()
        """The cloud of the main component."""

    def clouds(self) -> list[Path]:
        """Every cloud in the folder, by name."""
        return sorted(self.folder.glob("*.ply"))


@dataclass(unsafe_hash=True)
class WorkFolder:
    """Every path of a work folder."""

    root: Path
    store: str = ""
    """URL of the object store that it is a mirror of; "" for an ordinary one."""

    def __post_init__(self) -> None:
        self.cache = self.root / "cache"
        """cache/<stage>/<subject>/<key>.*: artifacts, their receipts, and what was drawn of them."""
        self.captures_memo = self.cache / "captures.json"
        """Digests of captures, remembered from run to run."""
        self.functions_memo = self.cache / "functions.json"
        """What was read of the stages' functions, remembered from run to run."""
        self._writing = self.cache / ".writing"
        """There while somebody writes; there at the start: a run was killed."""
        self.runs = self.root / "runs"
        """runs/<run id>/: what a night left for people and programs."""
        self.latest = self.runs / "latest"
        """A link to the newest run, whatever came of it."""
        self.latest_good = self.runs / "latest-good"
        """A link to the newest run with a cloud whose verdict is good or degraded."""
        self.reference = self.root / "reference"
        """What nights are compared with; also copies of its artifacts, as in the cache."""
        self.reference_record = self.reference / "reference.json"
        """What is pinned; without it nothing is (see `records.reference_folder`)."""
        self.reference_twin = self.reference / "reference-twin.json"
        """The same again: it takes the place of a record that is damaged."""
        self.quarantine = self.root / "quarantine"
        """Artifacts whose bytes were not what their receipts promised."""
        self.ledger = self.root / "ledger.sqlite"
        """An index of runs and artifacts; can be deleted."""
        self.delivered_memo = self.root / "delivered.json"
        """Digests of what cameras have delivered in earlier nights."""
        self.notified = self.root / "notified.json"
        """The state of the site that somebody was told of last."""
        self.owner = self.root / "site.json"
        """Which site the folder belongs to (see `cache.lock`)."""
        self.mirror_memo = self.root / "mirror.json"
        """What was agreed with the object store that this folder mirrors (see `remote`); an ordinary one has none."""
        self.lock = self.root / "lock"
        """Held while somebody writes."""
        self.progress = self.root / ".progress"
        """What the workers of a run are at (see `runner.worker.Progress`); gone when it has ended."""

    @staticmethod
    def mirroring(url: str, site: str) -> WorkFolder:
        """The folder of this machine that mirrors a store's: in WBFLOW_CACHE, else in the user's folder of caches."""
        caches = os.environ.get("WBFLOW_CACHE") or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wbflow"
        mark = hashlib.sha256(url.rstrip("/").encode()).hexdigest()[:12]
        return WorkFolder(Path(caches).absolute() / f"{site}-{mark}", url.rstrip("/"))

    @staticmethod
    def beside(site_file: Path, site: str) -> WorkFolder:
        """The work folder of a site whose file names none."""
        return WorkFolder(site_file.resolve().parent / ".wbflow" / site)

    @staticmethod
    def of_run(run: RunPaths) -> WorkFolder:
        """The work folder that a run's folder stands in."""
        return WorkFolder(run.folder.parent.parent)

    @staticmethod
    def unfinished(path: Path) -> Path:
        """Where a file is put together that comes from an object store."""
        return path.with_name(f".{path.name}{_UNFINISHED}")

    def task(self, task: Task) -> Path:
        """Where the artifacts of a task lie, whatever their key."""
        return self.cache / f"{task.stage}/{'--'.join(task.subject) or 'site'}"  # one step: a path is slow to join

    def artifact(self, task: Task, key: str, suffix: str) -> Path:
        """The artifact of a task; `suffix` says what it is: .wbf, .ply."""
        return self.cache / f"{task.stage}/{'--'.join(task.subject) or 'site'}/{key}{suffix}"

    def receipt(self, task: Task, key: str) -> Path:
        """What is known of an artifact; without it there is none."""
        return self.artifact(task, key, ".json")

    def drawing(self, task: Task, key: str, name: str) -> Path:
        """What the report shows of an artifact, by the name of the product (see `Products.drawings`)."""
        return self.artifact(task, key, ".jpg" if name == "picture" else f".{name}")

    def of_key(self, task: Task, key: str) -> list[Path]:
        """All files of a task under a key, the receipt first."""
        first = self.receipt(task, key)
        return [first, *(p for p in sorted(self.task(task).glob(f"{key}.*")) if p != first)]

    def half_written(self, task: Task) -> list[Path]:
        """Files of a task that somebody has begun and not finished."""
        return sorted(self.task(task).glob(f".*{_UNFINISHED}"))

    def receipt_beside(self, artifact: Path) -> Path:
        """The receipt of the artifact in a file."""
        return artifact.with_suffix(".json")

    def place(self, path: Path) -> str:
        """What a file of the cache is of, in words that are the same wherever the work folder lies: stage/subject/key.suffix."""
        return "/".join(path.parts[-3:])

    def receipts(self, task: Task | None = None) -> list[Path]:
        """The receipts of a task, or of all tasks, by name."""
        return sorted(self.task(task).glob("*.json") if task else self.cache.glob("*/*/*.json"))

    def cached(self) -> Iterator[Path]:
        """Every file of every task, whatever its key."""
        return (path for path in self.cache.glob("*/*/*") if not path.name.startswith("."))

    def quarantined(self, path: Path) -> Path:
        """Where a damaged file of the cache is put."""
        return self.quarantine / "--".join(path.relative_to(self.cache).parts)

    def pinned(self, path: Path) -> Path:
        """Where the reference keeps a file of the cache."""
        return self.reference / str(path).removeprefix(f"{self.cache}/")  # one step: a path is slow to join

    def run(self, name: str) -> RunPaths:
        """The folder of a run."""
        return RunPaths(self.runs / name)

    def unfinished_run(self, name: str) -> RunPaths:
        """The folder of a run that is being put together."""
        return RunPaths(self.runs / f".{name}{_UNFINISHED}")

    def run_ids(self) -> list[str]:
        """Every published run, oldest first."""
        links = {self.latest.name, self.latest_good.name}  # folders in a copy of the work folder
        names = [path.name for path in self.runs.glob("*") if path.name not in links and not path.is_symlink()]
        return sorted(name for name in names if not name.startswith(".") and self.run(name).record.is_file())

    def links(self) -> list[Path]:
        """Whatever leads to a run, now."""
        return [path for path in self.runs.glob("*") if path.is_symlink()]

    def led_to(self, link: Path) -> str | None:
        """The run that a link leads to; None where there is no link, or no whole run behind it."""
        name = link.readlink().name if link.is_symlink() else None
        return name if name and self.run(name).record.is_file() else None

    def turn(self, link: Path, run: str) -> None:
        """Turn a link beside the runs, such as `latest`, to a run with one rename: whoever looks sees the old run or the new one.

        Nothing is ever written or removed through the link.  A copy of the work folder may hold a folder there: it is set aside.
        Raises OSError.
        """
        fresh = self.unfinished_run(link.name).folder
        clear(fresh)
        if link.is_dir() and not link.is_symlink():
            self.quarantine.mkdir(parents=True, exist_ok=True)
            places = (self.quarantine / f"{link.name}-{number}" for number in itertools.count(1))
            link.rename(next(place for place in places if not place.exists()))
        fresh.symlink_to(run)
        fresh.replace(link)
        sync_folder(self.runs)

    def ledger_files(self) -> list[Path]:
        """The ledger and what SQLite keeps beside it."""
        return [self.ledger.with_name(self.ledger.name + end) for end in ("", "-wal", "-shm")]

    def start_writing(self) -> bool:
        """Clear away what a killed run left half-written, and mark that there may be such again.  The caller holds the lock.

        Returns whether the last one that wrote here was killed.
        """
        killed = self._writing.exists()
        beside = f".*{_UNFINISHED}"
        if killed:
            left = [*self.cache.rglob(beside), *self.reference.rglob(beside), *self.root.glob(beside)]
            for path in [*left, *self.runs.glob(beside), *self.runs.glob(f"*/{beside}")]:
                clear(path)  # never through a link: behind it stands a run that is published
        self._writing.parent.mkdir(parents=True, exist_ok=True)
        self._writing.touch()
        return killed

    def done_writing(self) -> None:
        """All that was begun is finished."""
        self._writing.unlink(missing_ok=True)
