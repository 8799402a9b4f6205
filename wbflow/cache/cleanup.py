"""Removing what nobody asks for any more: artifacts, and published runs only where somebody has said so."""

from __future__ import annotations

import contextlib
import shutil
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..records.events import TaskEvent
from ..records.ledger import Ledger
from ..records.reference_folder import BadReference, read_reference
from ..records.run_folder import NoSuchRun, RunFolder
from .layout import WorkFolder


@dataclass(frozen=True)
class Keep:
    """What stays; None: all of it."""

    runs: int | None = None
    nights: int | None = None
    """Artifacts that so many of the newest runs, or the runs of so many of the newest nights, use."""
    bytes: int | None = None
    """So much of the cache: the artifacts of older runs go first, those of the newest and of the last good one never."""
    clouds: int | None = None
    reports: int | None = None
    """Published clouds, and reports with their logs, of so many of the newest nights."""

    @property
    def keeps_artifacts(self) -> bool:
        """Is no artifact ever removed?"""
        return self.runs is self.nights is self.bytes is None


_QUARANTINED = 20
"""So many damaged files are kept, for whoever wants to know why, when nobody has asked for a cleaning."""


@dataclass(frozen=True)
class Cleaning:
    """What goes, or went."""

    files: int = 0
    bytes: int = 0
    runs: tuple[str, ...] = ()
    """Whose folders go."""
    over: int = 0
    """Bytes of the cache that are more than may stay, and are needed."""


def clean(work: WorkFolder, keep: Keep, *, dry_run: bool = False, asked: bool = True) -> Cleaning:
    """Remove what need not stay.  The caller holds the lock.

    Parameters
    ----------
    work, keep : WorkFolder, Keep
        Where, and what stays; the runs that links show always do, with all that they use.
    dry_run, asked : bool
        Only say what would go; somebody has asked for it: damaged files that were put aside go, too.
    """
    with Ledger(work, writes=True) as ledger:
        nights = _Nights(work, ledger)
        older = nights.runs[: len(nights.runs) - keep.runs] if keep.runs is not None else []
        unused = nights.beyond(keep.nights) | set(older) - nights.shown  # runs whose artifacts go
        doomed, keys, over = _artifacts(work, keep, nights, unused)
        damaged = [path for path in work.quarantine.glob("*") if path.is_file()]
        doomed += sorted(damaged, key=lambda path: path.stat().st_ctime_ns, reverse=True)[0 if asked else _QUARANTINED :]
        clouds, reports = nights.beyond(keep.clouds), nights.beyond(keep.reports)
        folders = clouds & reports
        doomed += [path for run in sorted(clouds - folders) for path in work.run(run).clouds()]
        logs = (reports if keep.keeps_artifacts else reports & unused) - folders  # a log names the artifacts that a run used
        pages = [*(work.run(run).report for run in sorted(reports - folders)), *(work.run(run).log for run in sorted(logs))]
        doomed += [path for path in pages if path.is_file()]
        inside = [path for run in sorted(folders) for path in work.run(run).folder.glob("*")]
        size = _size([*doomed, *inside])
        if not dry_run:
            for path in doomed:
                path.unlink(missing_ok=True)
            for run in sorted(folders):  # with one rename it is no run any more; the next run removes what a kill leaves of it
                out = work.unfinished_run(run).folder
                work.run(run).folder.rename(out)
                shutil.rmtree(out)
            if keys:
                ledger.forget(keys)
            _remove_empty(work, doomed)
    return Cleaning(len(doomed) + len(inside), size, tuple(sorted(folders)), over)


class _Nights:
    """Published runs by night."""

    def __init__(self, work: WorkFolder, ledger: Ledger) -> None:
        self.runs = work.run_ids()
        """Oldest first."""
        self.shown = {run for link in work.links() if (run := work.led_to(link))} | set(self.runs[-1:])
        """Runs that stay whatever is said."""
        dates = {run.run: run.date for run in ledger.runs()}
        self._dates = {run: dates.get(run, run) for run in self.runs}  # what the ledger can't read is a night of its own

    def beyond(self, count: int | None) -> set[str]:
        """Runs of nights before the last so many."""
        if count is None:
            return set()
        newest = list(dict.fromkeys(self._dates[run] for run in reversed(self.runs)))[:count]
        return {run for run in self.runs if self._dates[run] not in newest} - self.shown


def _artifacts(work: WorkFolder, keep: Keep, nights: _Nights, unused: set[str]) -> tuple[list[Path], set[str], int]:
    """Files of the cache that go, their keys, and how many bytes too many stay.  unused: runs whose artifacts go."""
    if keep.keeps_artifacts:
        return [], set(), 0
    files: dict[str, list[Path]] = defaultdict(list)
    for path in work.cached():
        files[path.name.partition(".")[0]].append(path)
    used = {run: _keys(work, run) for run in nights.runs if run not in unused}
    newest = {key: run for run in used for key in used[run]}
    pinned = _pinned_keys(work)
    gone = files.keys() - newest.keys() - pinned
    over = 0
    if keep.bytes is not None:
        sizes = {key: _size(files[key]) for key in files.keys() & newest.keys() - pinned}
        over = sum(sizes.values()) - keep.bytes
        for key in sorted(sizes, key=lambda key: (newest[key], -sizes[key])):
            if over > 0 and not any(key in used.get(run, ()) for run in nights.shown):
                over -= sizes[key]
                gone.add(key)
    # the receipt goes first: what is left without one is not believed
    ordered = (path for key in sorted(gone) for path in sorted(files[key], key=lambda path: path != work.receipt_beside(path)))
    return list(ordered), gone, max(over, 0)


def _pinned_keys(work: WorkFolder) -> set[str]:
    """Keys of what the reference holds: nights read them here, and each copy heals the other."""
    try:
        reference = read_reference(work)
    except BadReference:
        return set()
    return {pinned.key for pinned in reference.artifacts.values()} if reference else set()


def _keys(work: WorkFolder, run: str) -> set[str]:
    """Keys of the artifacts that a run used, by its log."""
    try:
        return {event.key for event in RunFolder.of(work, run).events() if isinstance(event, TaskEvent) and event.key}
    except NoSuchRun:  # nobody knows what it used: that is made again if it is asked for
        return set()


def _remove_empty(work: WorkFolder, removed: Iterable[Path]) -> None:
    for folder in sorted({path.parent for path in removed}):
        for place in (folder, folder.parent):
            if place.is_relative_to(work.cache) and place != work.cache:
                with contextlib.suppress(OSError):  # not empty
                    place.rmdir()


def _size(paths: Iterable[Path]) -> int:
    """What files take; what has two names in here, or elsewhere, counts only where its last one goes."""
    total = 0
    seen: dict[tuple[int, int], int] = defaultdict(int)
    for path in paths:
        with contextlib.suppress(OSError):
            status = path.stat()
            seen[status.st_dev, status.st_ino] += 1
            if seen[status.st_dev, status.st_ino] == status.st_nlink:
                total += status.st_size
    return total
