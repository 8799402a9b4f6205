"""Restores results that the reference or the cache has lost, from the other one: before a run, and when a reader finds damage."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import TYPE_CHECKING

from ..cache.atomic import clear, write_atomic
from ..cache.checksum import Damaged, read_checksummed, sha256_of
from ..cache.layout import WorkFolder
from ..cache.store import Cache, Receipt
from ..cache.untrusted import Unreadable, read_untrusted
from ..records.reference_folder import BadReference, PinnedArtifact, Reference, files_of, read_record
from ..task import Task

if TYPE_CHECKING:
    from ..run.journal import Journal
    from ..run.night import RunContext


def prepare(context: RunContext, journal: Journal) -> None:
    """Restore the results of the reference, and warn if it cannot be used.  The caller holds the lock."""
    plan, work = context.plan, context.plan.cache.work
    fault = repair_record(work) if plan.site.settings.pin != "none" else None
    if fault:
        journal.note_repair(fault)
    if plan.incompatible and not fault:
        what = f"the reference is not used: {plan.incompatible}"
        remedy = "this night recomputes everything; wbflow pin SITE.yaml  makes a good night the reference"
        journal.warn(what, remedy=remedy)
    if plan.reference is None:
        return
    to_cache, copied, lost = restore(plan.cache, plan.reference)
    for tasks, action in ((to_cache, "put back from the reference"), (copied, "copied to the reference again")):
        if tasks:
            journal.note_repair(f"{len(tasks)} results of the reference were missing ({tasks[0]}, ...): {action}")
    for task in lost:
        what = f"'{task}' of the reference is damaged, or gone"
        journal.warn(what, remedy="the run continues without it; wbflow pin SITE.yaml  creates a complete reference")


def repair_record(work: WorkFolder) -> str | None:
    """Restore the record of the reference or its twin from the intact one; returns what was wrong, as text, or None.

    If neither is intact, both are removed, so that the next good night is pinned.  The caller holds the lock.
    Raises OSError.
    """
    record, twin = work.reference_record, work.reference_twin
    intact, fault = None, None
    for path in (record, twin):
        try:
            intact = intact or (path if read_record(path) else None)
        except BadReference as error:
            fault = error.what
    if intact is None:
        for path in (record, twin):
            clear(path)
        return f"{fault}, and so is its twin: the next good night becomes the reference" if fault else None
    counterpart, data = (twin if intact is record else record), read_untrusted(intact)
    with suppress(Unreadable):
        if read_untrusted(counterpart) == data:
            return None
    fault = fault or f"{counterpart} is {'not as it was' if os.path.lexists(counterpart) else 'gone'}"
    clear(counterpart)
    write_atomic(counterpart, data)
    return f"{fault}: taken from {intact.name}"


def restore(cache: Cache, reference: Reference) -> tuple[list[Task], list[Task], list[Task]]:
    """Restore results that the cache or the reference has lost, as far as the other still has them.  The caller holds the lock.

    Returns the tasks whose results were restored to the cache, copied to the reference, and found in neither.  Raises OSError.
    """
    work = cache.work
    to_cache: list[Task] = []
    copied: list[Task] = []
    lost: list[Task] = []
    for task, pinned in reference.artifacts.items():
        receipt = cache.by_key(task, pinned.key)
        if receipt is None:
            (to_cache if restore_to_cache(work, pinned) else lost).append(task)
        elif _copy_differs(cache, receipt) and (receipt.file is None or sha256_of(cache.path(receipt))[:32] == receipt.digest):
            for path in files_of(cache, receipt):
                clear(work.pinned(path))
                write_atomic(work.pinned(path), path.read_bytes(), own_path=True)
            copied.append(task)
    return to_cache, copied, lost


def restore_to_cache(work: WorkFolder, pinned: PinnedArtifact) -> bool:
    """Put a result of the reference back into the cache; returns False if the reference's own copy is damaged or gone.

    The caller holds the lock.  Raises OSError.
    """
    path = work.receipt(pinned.task, pinned.key)
    copies = sorted(work.pinned(path).parent.glob(f"{pinned.key}.*"), key=lambda p: p.suffix == path.suffix)
    artifacts = [copy for copy in copies if copy.suffix != path.suffix]
    try:
        is_intact = read_checksummed(work.pinned(path), work.identity_of(path)) is not None
    except Damaged:
        is_intact = False
    if not is_intact or (pinned.digest and [sha256_of(copy)[:32] for copy in artifacts if copy.is_file()] != [pinned.digest]):
        return False
    for copy in copies:  # the receipt last
        write_atomic(path.with_suffix(copy.suffix), copy.read_bytes(), own_path=True)
    return True


def _copy_differs(cache: Cache, receipt: Receipt) -> bool:
    """Quick check: is the reference's copy of a receipt or an artifact gone, or of another size?"""
    work, path = cache.work, cache.work.receipt(receipt.preimage.task, receipt.key)
    try:
        if work.pinned(path).stat().st_size != path.stat().st_size:
            return True
        return receipt.file is not None and work.pinned(cache.path(receipt)).stat().st_size != receipt.bytes
    except OSError:
        return True
