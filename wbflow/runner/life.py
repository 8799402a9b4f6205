"""The life of a run, from the lock to the message about it.  Read this first."""

from __future__ import annotations

import dataclasses
import sqlite3
import traceback
from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from typing import Any, TypeVar

from ..cache.atomic import disk_fault
from ..cache.layout import WorkFolder
from ..cache.owner import claim
from ..errors import UsageError
from ..pipeline.stages import FRAMES
from ..records.events import Listener
from ..records.finished_run import Run
from ..records.killed_runs import mark_begun, mark_published
from ..records.ledger import Ledger
from ..records.record import RunRecord
from ..records.run_folder import hold_to_write, new_run
from ..reference.prepare import prepare
from ..site.models import Site
from ..task import Task
from .afterwards import follow_up
from .journal import Journal
from .loop import run_tasks
from .night import Night
from .options import Options
from .plan import Plan
from .publish import publish
from .signals import terminate_as_interrupt
from .tonight import read_night

Page = TypeVar("Page")


def run_night(site: Site, options: Options, listen: Listener) -> Run:
    """Process a night of a site, from captures to cloud and report; returns the finished run, whatever came of it.

    Parameters
    ----------
    site, options : Site, Options
        The site, and the options of the run, already checked.
    listen : callable
        Receives every event as it happens.

    Raises
    ------
    Locked
        Another run holds the work folder.
    WbflowError
        The work folder cannot be written.
    """
    work = site.work_folder
    try:
        # only the holder of the lock writes to the work folder; a store on the network has a mirror on this machine
        with hold_to_write(work, options.wait) as mirror, terminate_as_interrupt():
            check_names(site)
            warning = claim(work, site.name, site.file)
            run, started = new_run(work)
            journal = Journal(mirror.wrap_listener(listen) if mirror else listen, started)
            if mirror:
                journal.upload = mirror.upload_finding
            if warning:
                journal.warn(warning, remedy="give each site file a work folder of its own (work: FOLDER)")
            for note in (*site.notes, *site.doubts):
                journal.warn(str(dataclasses.replace(note, remedy="")), remedy=note.remedy)
            repair_ledger(work, journal)
            # from here on: plan, restore, work, publish, follow up
            night = read_night(site, options)
            note_oddities(night, journal)
            mark_begun(work, run, str(night.date), started)
            plan = Plan(night)
            prepare(night, journal)
            products = run_tasks(plan, options, journal)
            finished = publish(run, plan, products, journal, draw_report, own_process=options.backend == "threading")
            mark_published(work)
            follow_up(finished, site, journal, draw_site_page, send=products is not None and not options.until)
            if mirror:
                fault = mirror.finish()
                if fault:
                    journal.warn(fault)
                    finished.run_folder.add(journal.events[-1])  # the log is written already
            return finished
    except OSError as error:
        raise disk_fault(error, work.root) from error


def draw_report(night: Night, record: RunRecord, journal: Journal, cameras: Mapping[str, Any], folder: Path) -> str:
    """The report of a run.  The night's work is done, so a report that cannot be drawn is only a warning.

    Parameters
    ----------
    night, record, journal : Night, RunRecord, Journal
        The run's night, its record with the verdict, and its events.
    cameras : mapping
        The solved cameras in the form of a calibration, by id.
    folder : Path
        The folder with the files of the run.
    """

    def draw() -> str:
        # here: a run that only plans needs no report, and its libraries take a while to import
        from ..report.data import ReportData
        from ..report.page import build_report

        return build_report(ReportData(night.cache, record, tuple(journal.events), cameras, folder, night.site))

    page = drawn(draw, journal, "the report could not be built", "wbflow report SITE.yaml  builds it again")
    if isinstance(page, Exception):
        return f"<!doctype html><title>wbflow</title><p>No report: {escape(repr(page))}"
    return page


def draw_site_page(site: Site, journal: Journal) -> None:
    """Write the page about all nights of a site; it is only a warning if that fails, too."""

    def draw() -> Path:
        from ..report.site_page import write_site_page

        return write_site_page(site)

    drawn(draw, journal, "the page of the site could not be made", "wbflow site-report SITE.yaml  makes it again")


def drawn(draw: Callable[[], Page], journal: Journal, fault: str, remedy: str) -> Page | Exception:
    """Return what a function draws; if it fails, warn, and return the error.

    Parameters
    ----------
    draw, journal : callable, Journal
        Draws a page; the events of the run.
    fault, remedy : str
        What is said of a failure, and what to do about it.
    """
    try:
        return draw()
    except Exception as error:  # whatever goes wrong in drawing
        journal.warn(f"{fault}: {type(error).__name__}: {error}", remedy=remedy, trace=traceback.format_exc())
        return error


def check_names(site: Site) -> None:
    """Raise UsageError if two cameras would share a folder, because the work folder's disk does not tell their names apart."""
    by_name: dict[str, str] = {}
    for camera in site.cameras:
        other = by_name.setdefault(camera.id.casefold(), camera.id)
        if other != camera.id and site.work_folder.folds_case():
            what = f"cameras {other} and {camera.id} would share a folder: the disk of {site.work_folder.root} ignores case"
            raise UsageError(what, remedy="rename one of them, or name a work folder on another disk (work: FOLDER)")


def note_oddities(night: Night, journal: Journal) -> None:
    """Tell the journal what was odd about the memos on disk and the captures."""
    for memo in (night.files.digests, night.files.earlier, night.site.bindings.reader):
        if memo.damage:
            journal.note_repair(memo.damage)
    for camera, text in night.notes.items():
        journal.warn(text, task=Task(FRAMES, (camera,)))


def repair_ledger(work: WorkFolder, journal: Journal) -> None:
    """Rebuild the ledger if it is damaged, before it is read."""
    try:
        with Ledger(work, writes=True) as ledger:
            ledger.catch_up()
            for fault in ledger.faults:
                journal.note_repair(fault)
    except (OSError, sqlite3.Error) as error:
        journal.warn(f"the ledger cannot be used: {error}", remedy="the run continues without it; the next run tries again")
