"""What follows a published run: it is indexed, pinned if it is the first good one, made known, and old results are removed."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable

from ..errors import WbflowError
from ..records.cleanup import clean
from ..records.finished_run import Run
from ..records.keep import Keep
from ..records.ledger import Ledger
from ..records.run_folder import RunFolder
from ..reference.create import fit_to_pin, pin
from ..site.models import Site
from ..words import format_size
from .journal import Journal
from .notify import NotifyFailed, notify

DrawSite = Callable[[Site, Journal], None]
"""Writes the page about all nights of a site; a fault becomes a warning."""


def follow_up(run: Run, site: Site, journal: Journal, draw: DrawSite, *, send: bool) -> None:
    """Do what follows a published run.  No fault in this affects the night: it becomes a warning, in the run's log as well.

    Parameters
    ----------
    run, site, journal : Run, Site, Journal
        The published run, its site, and its events.
    draw : callable
        Writes the page about all nights of the site.
    send : bool
        May the site's `notify` command be called?  It is not called for the rerun of an old night, which is no news.
    """
    event_count = len(journal.events)  # these are in the published log; what comes now is added to it
    if index(run, site, journal):
        draw(site, journal)
    is_news = RunFolder.of(run.cache.work).id == run.id
    if send and is_news and site.settings.notify:
        try:
            notify(site.settings.notify, site.folder, run)
        except (NotifyFailed, OSError) as error:
            journal.warn(str(error), remedy="the command is called again after the next run")
    with contextlib.suppress(OSError):  # a full disk: there is a warning already
        for event in journal.events[event_count:]:
            run.run_folder.add(event)


def index(run: Run, site: Site, journal: Journal) -> bool:
    """Index the run, pin the first good one, and clean up; return whether that worked.

    The night is already published, so faults are only warnings.
    """
    try:
        with Ledger(run.cache.work, writes=True) as ledger:
            receipts = []
            for task, event in run.task_events.items():
                receipt = run.receipt(task) if event.outcome in {"ran", "rejected"} else None
                if receipt:
                    receipts.append(receipt)
            ledger.record_artifacts(receipts)
            ledger.record_run(run.record)
        # after the ledger, before the cleanup: what is pinned is kept
        if site.settings.pin == "auto" and not run.cache.work.reference_record.exists() and fit_to_pin(run.record):
            pin(run.cache, run.run_folder, automatic=True)
        keep = site.settings.keep.limits()
        if keep != Keep():
            excess = clean(run.cache.work, keep, requested=False).excess_bytes
            if excess:
                what = f"the cache holds {format_size(excess)} more than keep.bytes allows"
                journal.warn(what, remedy="the newest night alone needs it: allow more, or lower `resolution`")
    except sqlite3.Error as error:
        journal.warn(f"the ledger was not written: {error}", remedy="the next run catches up")
    except (OSError, WbflowError) as error:
        journal.warn(f"after the run: {error}", remedy="no result is lost; the next run tries again")
    else:
        return True
    return False
