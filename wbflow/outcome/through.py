"""A night from its plan to what is published of it."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable

from ..cache.cleanup import clean
from ..cache.layout import WorkFolder
from ..cache.room import in_words
from ..errors import WbflowError
from ..pipeline.stages import FRAMES
from ..records.ledger import Ledger
from ..reference.create import prepare
from ..runner.context import Options, RunContext
from ..runner.journal import Journal
from ..runner.loop import work
from ..site.models import Site
from ..task import Task
from .artifacts import FinishedRun
from .publish import publish


def mend_ledger(place: WorkFolder, journal: Journal) -> None:
    """Have the ledger made again where it is damaged, before anybody asks it for anything."""
    try:
        with Ledger(place, writes=True) as ledger:
            for fault in ledger.faults:
                journal.repaired(fault)
    except (OSError, sqlite3.Error) as error:
        journal.warn(f"the ledger cannot be used: {error}", remedy="the night does without; the next run tries again")


def afterwards(run: FinishedRun, site: Site, journal: Journal) -> None:
    """Index the run, pin the first good one, and remove what need not stay.

    The run is published: a fault here costs nothing, and becomes a warning.
    """
    before = len(journal.events)
    try:
        with Ledger(run.work, writes=True, records=run.folder.id) as ledger:
            fresh = (task for task, event in run.tasks.items() if event.outcome in {"ran", "rejected"})
            ledger.record_artifacts(receipt for task in fresh if (receipt := run.receipt(task)))
            ledger.record_run(run.record, run.tasks.values())
            for fault in ledger.faults:
                journal.warn(fault)
        if site.pin == "auto" and not run.work.reference_record.exists():
            from ..reference.create import fit_to_pin, pin  # here: once in the life of a site, as a rule

            if fit_to_pin(run.record):
                pin(run.cache, run.folder, automatic=True)
        if not site.keep.everything:
            over = clean(run.work, site.keep, asked=False).over
            if over:
                what = f"the cache holds {in_words(over)} more than keep.bytes allows"
                journal.warn(what, remedy="the newest night alone needs it: allow more, or lower `resolution`")
    except sqlite3.Error as error:
        journal.warn(f"the ledger was not written: {error}", remedy="the next run catches up")
    except (OSError, WbflowError) as error:
        journal.warn(f"after the run: {error}", remedy="nothing of the night is lost; the next run tries again")
    with contextlib.suppress(OSError):  # a full disk: that has been reported
        for event in journal.events[before:]:
            run.folder.add(event)


def run_pipeline(
    run: str, context: RunContext, options: Options, journal: Journal, tell: Callable[[FinishedRun], None]
) -> FinishedRun:
    """Do the work of a run, and publish it.

    Parameters
    ----------
    run : str
        The run's id.
    context : RunContext
        With its plan; the caller holds the lock of its work folder.
    options : Options
        How it is done.
    journal : Journal
        Receives everything that happens.
    tell : callable
        Tells people of the finished run.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    for camera, note in context.notes.items():
        journal.warn(note, task=Task(FRAMES, (camera,)))
    prepare(context, journal)
    worked = work(context, options, journal)
    finished = publish(run, context, worked, journal, own_process=options.backend == "threading")
    afterwards(finished, context.site, journal)
    if not options.until and not worked.interrupted:
        tell(finished)
    return finished
