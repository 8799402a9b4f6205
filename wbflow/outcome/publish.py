"""From a night's work to the folder of its run."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from html import escape
from typing import Any

from ..cache import artifact
from ..cache.layout import cloud_name
from ..cache.ply import with_comments
from ..cache.signed import Damaged, read_signed, write_signed
from ..pipeline.stages import CALIBRATION, FUSE, PLACE_COMMENTS, POSES
from ..records.events import TaskEvent
from ..records.record import RunRecord
from ..records.run_folder import UnfinishedRun
from ..runner.context import RunContext
from ..runner.journal import Journal
from ..runner.loop import Worked
from ..runner.planner import Plan
from ..task import Task
from .artifacts import FinishedRun, function
from .baseline import Baseline
from .beside import files_beside
from .notify import metrics
from .run_record import run_record
from .verdict import judge_run


def publish(run: str, context: RunContext, worked: Worked, journal: Journal, own_process: bool) -> FinishedRun:
    """Write what a run left into its folder; `latest` leads there.

    Parameters
    ----------
    run : str
        The run's id.
    context, worked : RunContext, Worked
        What was to be done, and what has become of it.
    journal : Journal
        What happened and what it cost; it receives a warning where no report can be drawn.
    own_process : bool
        Did the tasks run in this process?

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    plan, work = context.plan, context.plan.cache.work
    told = _told_of_world(plan, worked.products, journal)
    unfinished = UnfinishedRun(work, run)
    for task, cloud in worked.products.items():
        if task.stage == FUSE:
            comments = tuple(told.comments) if told and not task.subject else ()
            unfinished.write(cloud_name(task.subject), with_comments(cloud, comments))
    cameras = told.calibration if told else {}
    if told:
        unfinished.write_cameras(cameras)
    beside = files_beside(plan, journal)
    for name, data in (entry for files in beside.values() for entry in files.items()):
        unfinished.write(name, data)
    record = run_record(run, plan, journal.started, journal.seconds(own_process), journal.peak_rss_mb, beside)
    in_motion = context.captures_in_motion()
    cameras_now = (replace(camera, captures_in_motion=tuple(in_motion.get(camera.id, ()))) for camera in record.cameras)
    record = replace(record, cameras=tuple(cameras_now))
    record = judge_run(record, plan, Baseline.before(work, run, record.date), worked.interrupted, journal.behind())
    record = replace(record, repaired=tuple(journal.repairs), files=unfinished.files)
    page = _report(plan, record, journal, cameras, unfinished)
    folder = unfinished.publish(record, journal.events, page, metrics(record))
    with suppress(OSError):  # it costs reading functions again
        context.site.reader.save()
    tasks = {event.task: event for event in journal.events if isinstance(event, TaskEvent)}
    return FinishedRun(work, folder, record, tasks, plan.cache)


@dataclass(frozen=True)
class _World:
    """What is published of the world: of an artifact that has not changed, it is not made again."""

    code: list[str]
    """Fingerprints of the functions that made it."""
    calibration: dict[str, Any]
    comments: list[str]


def _told_of_world(plan: Plan, products: Mapping[Task, bytes], journal: Journal) -> _World | None:
    task = Task(POSES)
    state = plan.states.get(task)
    if task not in products or state is None or state.receipt is None:
        return None
    functions = [CALIBRATION, PLACE_COMMENTS]
    code = [plan.site.reader.read(dotted).code for dotted in functions]
    memo = plan.cache.work.published(task, state.receipt.key)
    try:
        told = read_signed(memo, plan.cache.work.place(memo))
        if told and (known := _World(**told)).code == code:
            return known
    except Damaged as damage:
        journal.repaired(f"{damage.what}: made again", task=task)
    except TypeError:  # by another version
        pass
    result = artifact.decode(products[task])  # numpy is imported for this
    calibration, comments = (function(dotted)(result) for dotted in functions)
    made = _World(code, calibration, list(comments))
    write_signed(memo, plan.cache.work.place(memo), asdict(made))
    plan.site.reader.save()
    return made


def _report(plan: Plan, record: RunRecord, journal: Journal, cameras: Mapping[str, Any], unfinished: UnfinishedRun) -> str:
    """The report.  The night's work is done: a report that cannot be drawn must not lose it, but is told of."""
    try:
        from ..report.page import build_report

        return build_report(plan.site, plan.cache, record, journal.events, cameras, unfinished.paths.folder)
    except Exception as error:  # whatever is wrong in it
        what = f"the report could not be built: {type(error).__name__}: {error}"
        journal.warn(what, remedy="wbflow report SITE.yaml  builds it again", trace=traceback.format_exc())
        return f"<!doctype html><title>wbflow</title><p>No report: {escape(repr(error))}"
