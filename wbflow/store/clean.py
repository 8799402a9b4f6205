"""Removing what no recent run uses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .cache import Cache
from .events import TaskEvent
from .layout import WorkFolder
from .ledger import Ledger
from .reference import BadReference, read_reference
from .run_folder import NoSuchRun, RunFolder


@dataclass(frozen=True)
class Cleaning:
    """What goes, or went."""

    files: int
    bytes: int
    runs: tuple[str, ...]
    """Whose folders go."""


def clean(work: WorkFolder, keep: int, dry_run: bool) -> Cleaning:
    """Remove artifacts that neither the last `keep` runs nor the reference use, their quarantine, and the folders of older runs.

    The run that `runs/latest` shows is always kept.  The caller holds the lock.
    """
    runs = work.run_ids()
    kept = {*runs[len(runs) - keep :], work.latest.resolve().name}
    with Ledger(work) as ledger:
        used = ledger.keys_of_runs(kept) | _logged_keys(work, kept) | _pinned_keys(work)
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


def _pinned_keys(work: WorkFolder) -> set[str]:
    """Keys of what the reference links to: it would take the same room on the disk without them."""
    try:
        reference = read_reference(work)
    except BadReference:
        return set()
    return {pinned.key for pinned in reference.artifacts.values()} if reference else set()


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
