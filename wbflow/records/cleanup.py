"""Removal of artifacts that are no longer needed, and of published files if a limit for them is set."""

from __future__ import annotations

import contextlib
import shutil
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..cache.layout import WorkFolder
from ..pipeline.stages import CHANGES
from ..task import Task
from .events import TaskEvent
from .keep import Keep
from .ledger import Ledger
from .reference import BadReference, read_reference
from .run_folder import NoSuchRun, RunFolder

_NEXT_NIGHT = "9999"
"""Stands for the night to come: it is later than any date."""
_QUARANTINED = 20
"""Number of quarantined files, newest first, that an automatic cleanup keeps so that their damage can be investigated."""


@dataclass(frozen=True)
class Cleaning:
    """What a cleanup removed, or would remove."""

    files: int = 0
    bytes: int = 0
    runs: tuple[str, ...] = ()
    """Ids of the runs whose folders are removed."""
    excess_bytes: int = 0
    """Bytes by which the cache still exceeds its limit, because the artifacts left are needed."""


def clean(work: WorkFolder, keep: Keep, *, dry_run: bool = False, requested: bool = True) -> Cleaning:
    """Remove everything that exceeds the limits.  The caller holds the lock.

    Parameters
    ----------
    work, keep : WorkFolder, Keep
        The folder and its limits; the newest run and the targets of links always stay, with all artifacts that they use.
    dry_run, requested : bool
        Only report what would be removed.  Did the user request the cleanup?  Then all quarantined files are removed, too.
    """
    with Ledger(work, writes=True) as ledger:
        nights = _Nights(work, ledger)
        # 1. artifacts that no run needs any more
        unused_runs = nights.beyond(keep.nights) | nights.runs_beyond(keep.runs)  # runs whose artifacts are removed
        artifacts, excess_bytes = _unneeded_artifacts(work, keep, nights, unused_runs)
        files: list[Path] = []
        for paths in artifacts.values():
            files.extend(paths)
        artifact_folders = {path.parent for path in files}
        # 2. damaged files
        files += _old_quarantined(work, 0 if requested else _QUARANTINED)
        # 3. what was published: whole folders of runs, or single files in them
        folders = nights.beyond(keep.clouds) & nights.beyond(keep.reports)
        files += _unneeded_products(work, keep, nights, unused_runs, folders)
        in_folders: list[Path] = []
        for run in folders:
            in_folders.extend(work.run(run).folder.glob("*"))

        size = _freed_bytes([*files, *in_folders])
        cleaning = Cleaning(len(files) + len(in_folders), size, tuple(sorted(folders)), excess_bytes)
        if dry_run:
            return cleaning

        for path in files:
            path.unlink(missing_ok=True)
        for folder in artifact_folders:
            with contextlib.suppress(OSError):  # not empty
                folder.rmdir()
                folder.parent.rmdir()
        for run in cleaning.runs:  # once renamed it is no run any more; if this process is killed, the next run removes it
            renamed = work.unfinished_run(run).folder
            work.run(run).folder.rename(renamed)
            shutil.rmtree(renamed)
        if artifacts:
            ledger.forget(artifacts)
    return cleaning


def _old_quarantined(work: WorkFolder, newest: int) -> list[Path]:
    """The quarantined files but the newest ones."""
    files = [path for path in work.quarantine.glob("*") if path.is_file()]
    return sorted(files, key=lambda path: -path.stat().st_ctime_ns)[newest:]


def _unneeded_products(work: WorkFolder, keep: Keep, nights: _Nights, unused_runs: set[str], folders: set[str]) -> list[Path]:
    """The published files to remove of runs whose folders stay.

    Parameters
    ----------
    work, keep, nights : WorkFolder, Keep, _Nights
        The folder, its limits and its runs.
    unused_runs, folders : set of str
        Runs that need no artifacts; runs whose whole folders are removed.
    """
    clouds = nights.beyond(keep.clouds)
    reports = nights.beyond(keep.reports)
    # a log lists the artifacts that a run used: while they are kept, it is needed to tell them from surplus ones
    logs = reports
    if not keep.keeps_artifacts:
        logs = reports & unused_runs
    files: list[Path] = []
    for run in clouds - folders:
        files.extend(work.run(run).clouds())
    for run in reports - folders:
        files.append(work.run(run).report)
    for run in logs - folders:
        files.append(work.run(run).log)
    return [path for path in files if path.is_file()]


class _Nights:
    """Published runs by night."""

    def __init__(self, work: WorkFolder, ledger: Ledger) -> None:
        self.runs = work.run_ids()
        """Oldest first."""
        self.shown = set(self.runs[-1:])
        """Runs that no limit removes: the targets of links and the newest run."""
        for link in work.links():
            target = work.link_target(link)
            if target:
                self.shown.add(target)
        dates = {run.run: run.date for run in ledger.runs()}
        self._dates = {run: dates.get(run, run) for run in self.runs}  # a run that the ledger lacks is a night of its own

    def newest_first(self) -> list[tuple[str, str]]:
        """Return the runs with their nights (ISO 8601), the newest night first; of one night, the last run first."""
        return sorted(((run, self._dates[run]) for run in self.runs), key=lambda entry: entry[::-1], reverse=True)

    def beyond(self, count: int | None) -> set[str]:
        """Return the runs of all but the newest `count` nights, without those in `shown`; the empty set for None."""
        newest_nights = list(dict.fromkeys(self._dates[run] for run in reversed(self.runs)))[:count]
        return {run for run in self.runs if self._dates[run] not in newest_nights} - self.shown

    def runs_beyond(self, count: int | None) -> set[str]:
        """Return all but the newest `count` runs, without those in `shown`; the empty set for None."""
        return set(self.runs) - set(self.runs[::-1][:count]) - self.shown


def _unneeded_artifacts(
    work: WorkFolder, keep: Keep, nights: _Nights, unused_runs: set[str]
) -> tuple[dict[str, list[Path]], int]:
    """Return the cache files to remove, by key, and the bytes still over the limit.  `unused_runs` need no artifacts."""
    if keep.keeps_artifacts:
        return {}, 0
    files: dict[str, list[Path]] = defaultdict(list)
    for path in work.cache_files():
        files[path.name.partition(".")[0]].append(path)
    # 1. what no run uses, nor the reference, nor the changes of the next night
    used_keys: dict[str, set[str]] = {}  # by run
    for run in nights.runs:
        if run not in unused_runs:
            used_keys[run] = _used_keys(work, run)
    for run, key in _previous_changes(work, nights, set(used_keys)).items():
        used_keys[run] = {key}
    newest_run: dict[str, str] = {}  # that uses a key
    for run, keys in used_keys.items():
        newest_run |= dict.fromkeys(keys, run)
    pinned = _pinned_keys(work)
    surplus = files.keys() - newest_run.keys() - pinned
    # 2. above the limit of size, what only old runs use: the oldest first, of one run the largest
    excess_bytes = 0
    if keep.bytes is not None:
        sizes = {key: _freed_bytes(files[key]) for key in files.keys() & newest_run.keys() - pinned}
        excess_bytes = sum(sizes.values()) - keep.bytes
        needed: set[str] = set()  # keys that no limit of size removes
        for run in nights.shown:
            needed |= used_keys.get(run, set())
        needed.update(_previous_changes(work, nights, nights.shown).values())
        for key in sorted(sizes.keys() - needed, key=lambda key: (newest_run[key], -sizes[key])):
            if excess_bytes <= 0:
                break
            excess_bytes -= sizes[key]
            surplus.add(key)
    # receipts first: an artifact without a receipt is never used
    ordered: dict[str, list[Path]] = {}
    for key in sorted(surplus):
        ordered[key] = sorted(files[key], key=lambda path: path != work.receipt_of(path))
    return ordered, max(excess_bytes, 0)


def _previous_changes(work: WorkFolder, nights: _Nights, kept: set[str]) -> dict[str, str]:
    """Return the keys of changes that kept runs, if they are repeated, or the next night go on from, by their run.

    kept: runs that keep all their artifacts.
    """
    previous: dict[str, str] = {}
    before = _NEXT_NIGHT  # changes of a night before this one are needed; "": none are
    for run, night in nights.newest_first():
        if run in kept:
            before = night
        elif night < before and (event := _events(work, run).get(Task(CHANGES))) and event.usable and event.key:
            previous[run] = event.key
            before = ""
    return previous


def _pinned_keys(work: WorkFolder) -> set[str]:
    """Return the keys of the reference's artifacts: nights read them from the cache, and each copy can restore the other."""
    try:
        reference = read_reference(work)
    except BadReference:
        return set()
    if reference is None:
        return set()
    return {pinned.key for pinned in reference.artifacts.values()}


def _used_keys(work: WorkFolder, run: str) -> set[str]:
    """Return the keys of the artifacts that a run used, from its log."""
    return {event.key for event in _events(work, run).values() if event.key}


def _events(work: WorkFolder, run: str) -> dict[Task, TaskEvent]:
    try:
        return RunFolder.of(work, run).tasks()
    except NoSuchRun:  # its artifacts are unknown; they are made again when needed
        return {}


def _freed_bytes(paths: Iterable[Path]) -> int:
    """Return the bytes that removing files frees: a file with several hard links counts only if all of them are in `paths`."""
    total = 0
    links_seen: dict[tuple[int, int], int] = defaultdict(int)
    for path in paths:
        with contextlib.suppress(OSError):
            status = path.stat()
            links_seen[status.st_dev, status.st_ino] += 1
            if links_seen[status.st_dev, status.st_ino] == status.st_nlink:
                total += status.st_size
    return total
