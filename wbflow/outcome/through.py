"""A night from its plan to what is published of it."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable

from ..cache.cleanup import clean
from ..cache.layout import WorkFolder
from ..cache.room import in_words
from ..errors import WbflowError
from ..records.ledger import Ledger
from ..reference.create import prepare
from ..runner.context import Arrivals, open_night
from ..runner.journal import Costs, Journal
from ..runner.loop import work
from ..runner.options import Options
from ..site.models import Site
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

    The night is published: a fault here costs nothing, but is told of.
    """
    told = len(journal.events)
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
    with contextlib.suppress(OSError):  # a full disk: it has been told
        for event in journal.events[told:]:
            run.folder.add(event)


def through(
    run: str,
    site: Site,
    there: Arrivals,
    options: Options,
    journal: Journal,
    costs: Costs,
    tell: Callable[[FinishedRun], None],
) -> FinishedRun:
    """Plan a night, do its work, and publish it.

    Parameters
    ----------
    run : str
        The run's id.
    site : Site
        Whose night; the caller holds the lock of its work folder.
    there : Arrivals
        What has arrived.
    options : Options
        What else is asked.
    journal, costs : Journal, Costs
        Are told.
    tell : callable
        Tells people of the finished run.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    night = open_night(site, options.date, options.until, options.force, there)
    place = night.plan.cache.work
    prepare(night, journal)
    worked = work(night, options, journal, costs)
    finished = publish(run, place, night, worked, journal, costs, own_process=options.backend == "threading")
    afterwards(finished, site, journal)
    if not options.until and not worked.interrupted:
        tell(finished)
    return finished
