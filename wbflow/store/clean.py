"""Removing what no recent run uses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .cache import Cache
from .events import TaskEvent
from .layout import WorkFolder
from .ledger import Ledger
from .run_folder import NoSuchRun, RunFolder


@dataclass(frozen=True)
class Cleaning:
    """What goes, or went."""

    files: int
    bytes: int
    runs: tuple[str, ...]
    """Whose folders go."""


def clean(work: WorkFolder, keep: int, dry_run: bool) -> Cleaning:
    """Remove artifacts that the last `keep` runs don't use, their quarantine, and the folders of older runs.

    The runs that `runs/latest` and `runs/latest-good` show are always kept.  The caller holds the lock.
    """
    runs = work.run_ids()
    kept = {*runs[len(runs) - keep :], work.latest.resolve().name, work.latest_good.resolve().name}
    with Ledger(work) as ledger:
        used = ledger.keys_of_runs(kept) | _logged_keys(work, kept)
    doomed: list[Path] = []
    for receipt in Cache(work).receipts():
        if receipt.key not in used:
            # the receipt goes first: what is left without one is not believed
            doomed += work.of_key(receipt.preimage.task, receipt.key)
    doomed += sorted(work.quarantine.glob("*"))
    old = tuple(run for run in runs if run not in kept)
    for run in old:
        doomed += sorted(work.run(run).folder.glob("*"))
    size = sum(path.stat().st_size for path in doomed)
    if not dry_run:
        for path in doomed:
            path.unlink(missing_ok=True)
        for run in old:
            work.run(run).folder.rmdir()
    return Cleaning(len(doomed), size, old)


def _logged_keys(work: WorkFolder, runs: set[str]) -> set[str]:
    """Keys that runs name in their own logs, in case the ledger has been lost."""
    found: set[str] = set()
    for run in runs:
        try:
            events = RunFolder.of(work, run).events()
        except NoSuchRun:  # a log that cannot be read: the ledger has its keys
            continue
        found |= {event.key for event in events if isinstance(event, TaskEvent) and event.key}
    return found
