"""Runs that ended without publishing anything: killed, or crashed.  Their finished tasks are in the cache, and the next run uses
them; the history has when they began and how far they came.

A run leaves a mark while it works.  A mark that a later run finds is that of a killed one: it goes into a list.
"""

from __future__ import annotations

import contextlib
import datetime
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..cache.checksum import Damaged, read_checksummed, write_checksummed
from ..cache.layout import WorkFolder
from ..cache.lock import holder_of
from ..json_dataclass import JsonDataclass
from ..words import counted
from .record import stamp

_MARK = "current run"
_LIST = "killed runs"


@dataclass(frozen=True)
class KilledRun(JsonDataclass):
    """A run that was killed, or crashed."""

    run: str
    date: str
    """The night that it worked on, ISO 8601."""
    started: str
    """When it began, as in run.json."""
    last: str
    """When it finished its last task, as in run.json; when it began, if it finished none."""
    tasks: int
    """Number of tasks that it finished."""
    stage: str
    """The stage of the last task that it finished; "" if it finished none."""

    @property
    def words(self) -> str:
        """How far it came."""
        if not self.tasks:
            return "killed or crashed before its first result"
        return f"killed or crashed after {counted(self.tasks, 'task')}, in {self.stage}"


def mark_begun(work: WorkFolder, run: str, date: str, started: datetime.datetime) -> None:
    """Leave the mark of a run that begins its work; list the run whose mark is still there.  The caller holds the lock.

    Parameters
    ----------
    work : WorkFolder
        The work folder.
    run, date : str
        The run's id, and the night that it works on, ISO 8601.
    started : datetime
        When it began (UTC).
    """
    killed = _marked_run(work)
    with contextlib.suppress(OSError):  # a full disk is a finding of the run, whose tasks find it, too
        if killed:
            listed = [*_listed_runs(work), killed]
            write_checksummed(work.killed_runs, _LIST, {"killed": [entry.to_json() for entry in listed]})
        write_checksummed(work.current_run, _MARK, {"run": run, "date": date, "started": stamp(started)})


def mark_published(work: WorkFolder) -> None:
    """Remove the mark of a run that has published its results.  The caller holds the lock."""
    work.current_run.unlink(missing_ok=True)


def killed_runs(work: WorkFolder) -> list[KilledRun]:
    """Return the runs that were killed, oldest first."""
    killed = _listed_runs(work)
    if holder_of(work.lock) is None:  # else the mark is that of the run that is at work
        marked = _marked_run(work)
        if marked:
            killed.append(marked)
    return killed


def _listed_runs(work: WorkFolder) -> list[KilledRun]:
    """Return the runs of the list; a list that is damaged counts as empty."""
    return [KilledRun.from_json(entry) for entry in _entries(work.killed_runs, _LIST).get("killed", ())]


def _marked_run(work: WorkFolder) -> KilledRun | None:
    """Return the run whose mark is there, which has ended by now; None if it had published its results before it was killed."""
    marked = _entries(work.current_run, _MARK)
    if not marked or work.run(marked["run"]).record.exists():
        return None
    # its results are the receipts that are younger than its mark
    began = work.current_run.stat().st_mtime
    finished: dict[Path, float] = {}
    for receipt in work.receipts():
        written = receipt.stat().st_mtime
        if written >= began:
            finished[receipt] = written
    killed = KilledRun(**marked, last=marked["started"], tasks=len(finished), stage="")
    if not finished:
        return killed
    newest = max(finished, key=lambda receipt: finished[receipt])
    last = datetime.datetime.fromtimestamp(finished[newest], datetime.UTC)
    return replace(killed, last=stamp(last), stage=work.stage_of(newest))


def _entries(path: Path, of: str) -> Mapping[str, Any]:
    """Return the entries of a file with a checksum; none if it is missing or damaged."""
    try:
        return read_checksummed(path, of) or {}
    except Damaged:
        return {}
