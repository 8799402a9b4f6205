"""A run from its plan to its published folder: work, records, files beside the cloud, report, ledger, reference."""

from __future__ import annotations

import contextlib
import json
import sqlite3
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import replace
from html import escape
from typing import Any

from ..cache import artifact
from ..cache.cleanup import Keep, clean
from ..cache.layout import WorkFolder, cloud_name
from ..cache.ply import ply_bytes, with_comments
from ..errors import UsageError, WbflowError
from ..pipeline.stages import FRAMES, FUSE, POSES, stage_named
from ..pipeline.summaries import PosesSummary
from ..plugins import load
from ..records.events import TaskEvent
from ..records.finished_run import Run
from ..records.ledger import Ledger
from ..records.metrics import metrics
from ..records.record import CameraRecord, RunRecord
from ..records.run_folder import UnfinishedRun
from ..reference.create import fit_to_pin, pin
from ..reference.restore import prepare
from ..site.geodesy import origin_of
from ..site.models import Site
from ..task import Task
from ..verdict import acknowledge
from ..verdict.acknowledge import Acknowledgement, with_known
from ..verdict.rules import Facts, judge_run
from ..verdict.run_record import run_record
from ..words import format_size
from .journal import Journal
from .loop import run_tasks
from .night import RunContext
from .notify import NotifyFailed, notify
from .options import Options
from .plan import Plan
from .state import summary_of


def run_pipeline(run: str, context: RunContext, options: Options, journal: Journal) -> Run:
    """Run the tasks of a plan, and publish the run.  Raises OSError.

    Parameters
    ----------
    run, context : str, RunContext
        The run's id, and its plan; the caller holds the lock.
    options, journal : Options, Journal
        Options of the run, and the journal that records its events.
    """
    site = context.plan.site
    for camera, note in context.notes.items():
        journal.warn(note, task=Task(FRAMES, (camera,)))
    prepare(context, journal)
    products = run_tasks(context, options, journal)
    finished = _publish(run, context, products, journal, own_process=options.backend == "threading")
    post_run(finished, site, journal)
    if site.settings.notify and not options.until and products is not None:
        try:
            notify(site.settings.notify, site.folder, finished)
        except (NotifyFailed, OSError) as error:  # the night itself is not affected
            journal.warn(str(error), remedy="the command is called again after the next run")
            finished.run_folder.add(journal.events[-1])
    return finished


def _publish(run: str, context: RunContext, products: dict[Task, bytes] | None, journal: Journal, own_process: bool) -> Run:
    """Write the folder of a run, and point `latest` to it.  What cannot be drawn or written as a file becomes a warning.

    products: None if the run was interrupted.  own_process: did the tasks run in this process?
    """
    artifacts = products or {}
    plan, work = context.plan, context.plan.cache.work
    unfinished = UnfinishedRun(work, run)
    has_poses = Task(POSES) in artifacts
    cameras = _cameras(plan, artifacts[Task(POSES)]) if has_poses else {}
    comments = _place_comments(summary_of(plan.states[Task(POSES)], PosesSummary).crs) if has_poses else ()
    for task, product in artifacts.items():
        if task.stage == FUSE:
            unfinished.write(cloud_name(task.subject), with_comments(product, () if task.subject else comments))
    if has_poses:
        unfinished.write_cameras(cameras)
    files: dict[str, list[str]] = {}
    for stage, name, data in _files(plan, journal):
        unfinished.write(name, data)
        files.setdefault(stage, []).append(name)
    record = run_record(run, plan, journal.started, journal.seconds(own_process), journal.peak_rss_mb, files)
    harmful, harmless = context.captures_in_motion()
    record = replace(record, cameras=tuple(_with_motion(camera, harmful, harmless) for camera in record.cameras))
    acknowledged = _acknowledged(plan.site, journal)
    facts = replace(Facts.from_plan(plan, products is None), upload_finding=journal.upload(), acknowledged=acknowledged)
    record = with_known(judge_run(record, plan, facts), acknowledged)
    record = replace(record, repaired=tuple(journal.repairs), files=unfinished.files)
    page = _report(plan, record, journal, cameras, unfinished)
    folder = unfinished.publish(record, journal.events, page, metrics(record))
    with contextlib.suppress(OSError):  # functions are then read again by the next run
        context.plan.site.reader.save()
    tasks = {event.task: event for event in journal.events if isinstance(event, TaskEvent)}
    return Run(folder, record, tasks, plan.cache)


def _with_motion(camera: CameraRecord, harmful: Mapping[str, list[str]], harmless: Mapping[str, list[str]]) -> CameraRecord:
    overwritten = [
        f"{name} was overwritten during the run; it was read as a whole, and `captures` has the digest of what was used"
        for name in harmless.get(camera.id, ())
    ]
    return replace(camera, captures_in_motion=tuple(harmful.get(camera.id, ())), notes=(*camera.notes, *overwritten))


def _cameras(plan: Plan, poses: bytes) -> dict[str, Any]:
    """Return the solved cameras in the form of a calibration, by id.  poses: the artifact, used if the cache lacks that form."""
    receipt = plan.states[Task(POSES)].receipt
    drawing = plan.cache.drawing(Task(POSES), receipt.key, "cameras") if receipt else None
    cameras: dict[str, Any] = json.loads(drawing or load(stage_named(POSES).products.drawings["cameras"])(artifact.decode(poses)))
    return cameras


def _place_comments(crs: str) -> tuple[str, ...]:
    """Return PLY comments on where the origin is on Earth: the coordinate system as PROJ reads it, and its origin in words."""
    if not crs:
        return ()
    origin = origin_of(crs)
    if origin is None:
        return (f"crs {crs}",)
    position = "latitude {!r} longitude {!r} height {!r}".format(*origin)
    return f"crs {crs}", f"x y z are metres east, north and up of {position} (WGS 84)"


def _files(plan: Plan, journal: Journal) -> Iterator[tuple[str, str, bytes]]:
    """Yield the files that stages make of their results: stage, name, content.

    A file that cannot be made (a library is not installed, no UTM zone covers the site) becomes a warning.
    """
    for stage in plan.stages:
        state = plan.states.get(Task(stage.name))
        if not (stage.products.files and state and state.usable and state.receipt):
            continue
        try:
            for name, content in load(stage.products.files)(plan.cache.load(Task(stage.name), state.receipt)):
                data = content if isinstance(content, bytes) else bytes(ply_bytes(content, comments=("made by wbflow",)))
                yield stage.name, name, data
        except (WbflowError, ValueError, ImportError) as error:
            journal.warn(f"not all of its files could be made: {error}", task=Task(stage.name))


def _acknowledged(site: Site, journal: Journal) -> tuple[Acknowledgement, ...]:
    """Return the acknowledgements of a site; a file that cannot be read becomes a warning."""
    try:
        return acknowledge.read(site)
    except UsageError as error:
        journal.warn(f"{error.where} {error.what}", remedy=error.remedy)
        return ()


def _report(plan: Plan, record: RunRecord, journal: Journal, cameras: Mapping[str, Any], unfinished: UnfinishedRun) -> str:
    """Return the report.  The night's work is done, so a report that cannot be drawn is only a warning."""
    try:
        from ..report.data import ReportData
        from ..report.page import build_report

        return build_report(ReportData(plan.cache, record, tuple(journal.events), cameras, unfinished.paths.folder, plan.site))
    except Exception as error:  # whatever goes wrong in drawing
        what = f"the report could not be built: {type(error).__name__}: {error}"
        journal.warn(what, remedy="wbflow report SITE.yaml  builds it again", trace=traceback.format_exc())
        return f"<!doctype html><title>wbflow</title><p>No report: {escape(repr(error))}"


def repair_ledger(place: WorkFolder, journal: Journal) -> None:
    """Rebuild the ledger if it is damaged, before it is read."""
    try:
        with Ledger(place, writes=True) as ledger:
            ledger.catch_up()
            for fault in ledger.faults:
                journal.note_repair(fault)
    except (OSError, sqlite3.Error) as error:
        journal.warn(f"the ledger cannot be used: {error}", remedy="the run continues without it; the next run tries again")


def post_run(run: Run, site: Site, journal: Journal) -> None:
    """Index the run, pin the first good one, and clean up.  The night is already published, so faults are only warnings."""
    event_count = len(journal.events)
    try:
        with Ledger(run.cache.work, writes=True) as ledger:
            new_tasks = (task for task, event in run.task_events.items() if event.outcome in {"ran", "rejected"})
            ledger.record_artifacts(receipt for task in new_tasks if (receipt := run.receipt(task)))
            ledger.record_run(run.record)
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
    with contextlib.suppress(OSError):  # a full disk: there is a warning already
        for event in journal.events[event_count:]:
            run.run_folder.add(event)
