"""Where everything in the work folder lies.  No other file of the engine spells one of these names.

cache/<stage>/<subject>/<key>.*      artifacts, their receipts and pictures
runs/<run id>/                       what a night left for people and programs
runs/latest                          link to the newest run, whatever came of it
runs/latest-good                     link to the newest run with a cloud whose verdict is good or degraded
reference/                           what nights are compared with: reference.json (twice), and copies of its artifacts
quarantine/                          artifacts whose bytes were not what their receipts promised
ledger.sqlite                        an index of all this; can be deleted
notified.json                        what somebody was told last
site.json                            which site it belongs to
lock                                 held by the one run that may write
mirror.json                          what was last agreed with the object store that this folder mirrors
"""

from __future__ import annotations

import datetime
import hashlib
import itertools
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..task import Task
from .atomic import sync_folder

_RUN_ID = "%Y%m%dT%H%M%SZ"
_UNFINISHED = ".tmp"
_LOOK_BACK = 7


def run_id(moment: datetime.datetime) -> str:
    """The id of a run that starts at `moment` (UTC, to the second): ids sort as the runs did."""
    return moment.strftime(_RUN_ID)


def started_by(name: str) -> datetime.datetime | None:
    """When the run of an id was started (UTC); None for a folder that somebody else has made."""
    digits = name[:8] + name[9:15]
    if len(name) != 16 or name[8] + name[15] != "TZ" or not (digits.isascii() and digits.isdigit()):
        return None
    try:  # not strptime, which compiles expressions first
        return datetime.datetime.fromisoformat(name)
    except ValueError:
        return None


@dataclass(frozen=True)
class RunPaths:
    """The files in the folder of one run."""

    folder: Path

    @property
    def record(self) -> Path:
        """The run in figures (see `records.record`)."""
        return self.folder / "run.json"

    @property
    def log(self) -> Path:
        """What happened, one event a line (see `records.events`)."""
        return self.folder / "log.jsonl"

    @property
    def cameras(self) -> Path:
        """The cameras that the cloud rests on, in the form of a calibration."""
        return self.folder / "cameras.json"

    @property
    def report(self) -> Path:
        """The run for people."""
        return self.folder / "report.html"

    def clouds(self) -> list[Path]:
        """Every cloud in the folder, by name."""
        return sorted(self.folder.glob("*.ply"))

    @property
    def metrics(self) -> Path:
        """The run for Prometheus."""
        return self.folder / "metrics.prom"

    @property
    def cloud(self) -> Path:
        """The cloud of the main component."""
        return self.folder / cloud_name()


def cloud_name(component: tuple[str, ...] = ()) -> str:
    """The name of a component's cloud in a run's folder; () is the main one."""
    return f"cloud{''.join(f'-{name}' for name in component)}.ply"


@dataclass(frozen=True)
class WorkFolder:
    """Every path of a work folder."""

    root: Path
    store: str = ""
    """URL of the object store that it is a mirror of; "" for an ordinary one."""

    @staticmethod
    def mirroring(url: str, site: str) -> WorkFolder:
        """The folder of this machine that mirrors a store's: in WBFLOW_CACHE, else in the user's folder of caches."""
        caches = os.environ.get("WBFLOW_CACHE") or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wbflow"
        told = hashlib.sha256(url.rstrip("/").encode()).hexdigest()[:12]
        return WorkFolder(Path(caches).absolute() / f"{site}-{told}", url.rstrip("/"))

    @staticmethod
    def unfinished(path: Path) -> Path:
        """Where a file is put together that comes from an object store."""
        return path.with_name(f".{path.name}{_UNFINISHED}")

    @staticmethod
    def beside(site_file: Path, site: str) -> WorkFolder:
        """The work folder of a site whose file names none."""
        return WorkFolder(site_file.resolve().parent / ".wbflow" / site)

    @staticmethod
    def of_run(run: RunPaths) -> WorkFolder:
        """The work folder that a run's folder stands in."""
        return WorkFolder(run.folder.parent.parent)

    @cached_property
    def cache(self) -> Path:
        """The folder of all artifacts."""
        return self.root / "cache"

    def task(self, task: Task) -> Path:
        """Where the artifacts of a task lie, whatever their key."""
        return Path(self._of(task))

    @cached_property
    def _cache_name(self) -> str:
        return str(self.cache)

    def _of(self, task: Task) -> str:
        return f"{self._cache_name}/{task.stage}/{'--'.join(task.subject) or 'site'}"  # text, not a path: hot

    def artifact_name(self, task: Task, name: str) -> str:
        """A file beside a task's receipts, by its name, as text: a path takes as long to make as a small file to write."""
        return f"{self._of(task)}/{name}"

    def artifact(self, task: Task, key: str, suffix: str) -> Path:
        """The artifact of a task; `suffix` says what it is: .wbf, .ply."""
        return Path(f"{self._of(task)}/{key}{suffix}")

    def drawing(self, task: Task, key: str, name: str) -> Path:
        """What the report shows of an artifact, by the name of the product (see `Products.drawings`)."""
        return self.artifact(task, key, ".jpg" if name == "picture" else f".{name}")

    def receipt(self, task: Task, key: str) -> Path:
        """What is known of an artifact; without it there is none."""
        return self.artifact(task, key, ".json")

    def receipt_name(self, task: Task, key: str) -> str:
        """The same as text, for whoever asks of every task whether it is there."""
        return f"{self._of(task)}/{key}.json"

    @property
    def progress(self) -> Path:
        """What the workers of a run are at (see `runner.worker.Progress`); gone when it has ended."""
        return self.root / ".progress"

    def half_written(self, task: Task) -> list[Path]:
        """Files of a task that somebody has begun and not finished."""
        return sorted(self.task(task).glob(f".*{_UNFINISHED}"))

    def receipt_beside(self, artifact: Path) -> Path:
        """The receipt of the artifact in a file."""
        return artifact.with_suffix(".json")

    def place(self, path: Path | str) -> str:
        """What a file of the cache is of, in words that are the same wherever the work folder lies: stage/subject/key.suffix."""
        return "/".join(str(path).rsplit("/", 3)[-3:])

    def of_key(self, task: Task, key: str) -> list[Path]:
        """All files of a task under a key, the receipt first."""
        first = self.receipt(task, key)
        return [first, *(p for p in sorted(self.task(task).glob(f"{key}.*")) if p != first)]

    def receipts(self) -> list[Path]:
        """The receipts of all tasks, by name."""
        return sorted(self.cache.glob("*/*/*.json"))

    def receipt_names(self, task: Task) -> list[str]:
        """The receipts of a task under whatever key, as text."""
        try:
            with os.scandir(self._of(task)) as files:
                return sorted(file.path for file in files if file.name.endswith(".json"))
        except FileNotFoundError:
            return []

    def cached(self) -> Iterator[Path]:
        """Every file of every task, whatever its key."""
        return (path for path in self.cache.glob("*/*/*") if not path.name.startswith("."))

    def quarantined(self, path: Path) -> Path:
        """Where a damaged file of the cache is put."""
        return self.quarantine / "--".join(path.relative_to(self.cache).parts)

    @property
    def quarantine(self) -> Path:
        """The folder of damaged artifacts."""
        return self.root / "quarantine"

    @property
    def captures_memo(self) -> Path:
        """Digests of captures, remembered from run to run."""
        return self.cache / "captures.json"

    @property
    def seen_memo(self) -> Path:
        """Digests of what cameras have delivered in earlier nights."""
        return self.root / "delivered.json"

    @property
    def functions_memo(self) -> Path:
        """What was read of the stages' functions, remembered from run to run."""
        return self.cache / "functions.json"

    @property
    def runs(self) -> Path:
        """The folder of all runs."""
        return self.root / "runs"

    def run(self, name: str) -> RunPaths:
        """The folder of a run."""
        return RunPaths(self.runs / name)

    def unfinished_run(self, name: str) -> RunPaths:
        """The folder of a run that is being put together."""
        return RunPaths(self.runs / f".{name}{_UNFINISHED}")

    @property
    def latest(self) -> Path:
        """A link to the newest run, whatever came of it."""
        return self.runs / "latest"

    @property
    def latest_good(self) -> Path:
        """A link to the newest run with a cloud whose verdict is good or degraded."""
        return self.runs / "latest-good"

    def links(self) -> list[Path]:
        """Whatever leads to a run, now."""
        return [path for path in self.runs.glob("*") if path.is_symlink()]

    def turn(self, link: Path, run: str) -> None:
        """Turn a link beside the runs, such as `latest`, to a run with one rename: whoever looks sees the old run or the new one.

        Nothing is ever written or removed through the link.  A copy of the work folder may hold a folder there: it is set aside.
        Raises OSError.
        """
        fresh = self.unfinished_run(link.name).folder
        if fresh.is_dir() and not fresh.is_symlink():
            shutil.rmtree(fresh)
        fresh.unlink(missing_ok=True)
        if link.is_dir() and not link.is_symlink():
            self._set_aside(link)
        fresh.symlink_to(run)
        fresh.replace(link)
        sync_folder(self.runs)

    def _set_aside(self, folder: Path) -> None:
        """Move a folder that stands where a link belongs to the quarantine: nothing of it is lost."""
        self.quarantine.mkdir(parents=True, exist_ok=True)
        places = (self.quarantine / f"{folder.name}-{number}" for number in itertools.count(1))
        folder.rename(next(place for place in places if not place.exists()))

    def led_to(self, link: Path) -> str | None:
        """The run that a link leads to; None where there is no link, or no whole run behind it."""
        name = link.readlink().name if link.is_symlink() else None
        return name if name and self.run(name).record.is_file() else None

    def run_ids(self) -> list[str]:
        """Every published run, oldest first."""
        found = (p for p in self.runs.glob("*") if RunPaths(p).record.is_file() and not p.is_symlink())
        links = {self.latest.name, self.latest_good.name}  # folders in a copy of the work folder
        return sorted(p.name for p in found if not p.name.startswith(".") and p.name not in links)

    def newest_runs(self) -> list[str]:
        """Those in which an earlier form of a product is looked for (there are nights that make none), newest first."""
        return self.run_ids()[: -_LOOK_BACK - 1 : -1]

    @cached_property
    def reference(self) -> Path:
        """The folder of the pinned reference."""
        return self.root / "reference"

    @property
    def reference_record(self) -> Path:
        """What is pinned; without it nothing is (see `records.reference_folder`)."""
        return self.reference / "reference.json"

    @property
    def reference_twin(self) -> Path:
        """The same again: it takes the place of a record that is damaged."""
        return self.reference / "reference-twin.json"

    def pinned(self, path: Path) -> Path:
        """Where the reference keeps a file of the cache."""
        within = str(path).removeprefix(f"{self.cache}/")
        if within == str(path):
            raise ValueError(f"{path} is not in {self.cache}")
        return Path(f"{self.reference}/{within}")

    def pinned_name(self, task: Task, key: str) -> str:
        """Where the reference keeps a receipt."""
        return self.pinned_beside(self.receipt_name(task, key))

    def pinned_beside(self, name: str) -> str:
        """Where the reference keeps a file of the cache, as text."""
        return f"{self._reference_name}{name.removeprefix(self._cache_name)}"

    @cached_property
    def _reference_name(self) -> str:
        return str(self.reference)

    @property
    def ledger(self) -> Path:
        """The index of runs and artifacts."""
        return self.root / "ledger.sqlite"

    def ledger_files(self) -> list[Path]:
        """The ledger and what SQLite keeps beside it."""
        return [self.ledger.with_name(self.ledger.name + end) for end in ("", "-wal", "-shm")]

    @property
    def notified(self) -> Path:
        """The state of the site that somebody was told of last."""
        return self.root / "notified.json"

    @property
    def owner(self) -> Path:
        """Which site the folder belongs to (see `cache.owner`)."""
        return self.root / "site.json"

    @property
    def mirror_memo(self) -> Path:
        """What was agreed with the object store that this folder mirrors (see `remote`); an ordinary one has none."""
        return self.root / "mirror.json"

    @property
    def lock(self) -> Path:
        """Held while somebody writes."""
        return self.root / "lock"

    def start_writing(self) -> bool:
        """Clear away what a killed run left half-written, and mark that there may be such again.  The caller holds the lock.

        Returns whether the last one that wrote here was killed.
        """
        killed = self._writing.exists()
        if killed:
            for folder in (self.cache, self.reference):
                for path in folder.rglob(f".*{_UNFINISHED}"):
                    path.unlink(missing_ok=True)
            beside = f".*{_UNFINISHED}"
            for path in [*self.root.glob(beside), *self.runs.glob(beside), *self.runs.glob(f"*/{beside}")]:
                if path.is_dir() and not path.is_symlink():  # never through a link: behind it stands a run that is published
                    shutil.rmtree(path)
                else:
                    path.unlink(missing_ok=True)  # it may have been found by way of a link, too
        self._writing.parent.mkdir(parents=True, exist_ok=True)
        self._writing.touch()
        return killed

    def done_writing(self) -> None:
        """All that was begun is finished."""
        self._writing.unlink(missing_ok=True)

    @property
    def _writing(self) -> Path:
        return self.cache / ".writing"
