"""Prepares the reference for a run: its record is intact, its results are in the cache, and the journal knows what was not."""

from __future__ import annotations

import os
from contextlib import suppress

from ..cache.atomic import clear, write_atomic
from ..cache.layout import WorkFolder
from ..cache.untrusted import Unreadable, read_untrusted
from ..records.reference import BadReference, read_record
from ..runner.journal import Journal
from ..runner.night import Night
from .restore import restore


def prepare(night: Night, journal: Journal) -> None:
    """Restore the results of the reference, and warn if it cannot be used.  The caller holds the lock."""
    fault = None
    if night.site.settings.pin != "none":
        fault = repair_record(night.cache.work)
    if fault:
        journal.note_repair(fault)
    if night.reference_fault and not fault:
        what = f"the reference is not used: {night.reference_fault}"
        remedy = "this night recomputes everything; wbflow pin SITE.yaml  makes a good night the reference"
        journal.warn(what, remedy=remedy)
    if night.reference is None:
        return
    to_cache, copied, lost = restore(night.cache, night.reference)
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
    record = work.reference_record
    twin = work.reference_twin
    source = None
    fault = ""
    for path in (record, twin):
        try:
            if read_record(path):
                source = path
                break
        except BadReference as error:
            fault = error.what
    if source is None:
        for path in (record, twin):
            clear(path)
        if not fault:
            return None  # there was no reference
        return f"{fault}, and so is its twin: the next good night becomes the reference"

    # the record decides if both are intact: it is written last
    counterpart = twin if source is record else record
    data = read_untrusted(source)
    with suppress(Unreadable):
        if read_untrusted(counterpart) == data:
            return None
    if not fault:
        what = "not as it was" if os.path.lexists(counterpart) else "gone"
        fault = f"{counterpart} is {what}"
    clear(counterpart)
    write_atomic(counterpart, data)
    return f"{fault}: taken from {source.name}"
