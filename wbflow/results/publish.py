"""From a night's work to the folder of its run."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from html import escape
from typing import Any

from ..graph.pipeline import Role, stage_with
from ..night.journal import Costs, Journal
from ..night.night import Night
from ..night.run import Worked
from ..store import artifact
from ..store.events import TaskEvent
from ..store.layout import WorkFolder
from ..store.ply import with_comments
from ..store.record import RunRecord
from ..store.run_folder import UnfinishedRun
from ..task import Task
from .artifacts import FinishedRun, function
from .record import run_record


def publish(
    run: str, work: WorkFolder, night: Night, worked: Worked, journal: Journal, costs: Costs, own_process: bool
) -> FinishedRun:
    """Write what a night left into the folder of its run; where there is a cloud, `latest` leads there.

    Parameters
    ----------
    run : str
        The run's id.
    work : WorkFolder
        Where it goes.
    night, worked : Night, Worked
        What was to be done, and what has become of it.
    journal : Journal
        What happened; a report that cannot be drawn is told there, too.
    costs : Costs
        What it has cost so far.
    own_process : bool
        Did the tasks run in this process?

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    world = stage_with(Role.WORLD)
    solved = worked.products.get(Task(world.name))
    poses = None if solved is None else artifact.decode(solved)
    clouds = {task.subject: data for task, data in worked.products.items() if task.stage == stage_with(Role.PRODUCT).name}
    if () in clouds and poses is not None and world.comments:
        clouds[()] = with_comments(clouds[()], function(world.comments)(poses))
    cameras = function(world.calibration)(poses) if poses is not None and world.calibration else None
    unfinished = UnfinishedRun(work, run)
    unfinished.write_products(clouds, cameras)
    seconds = costs.seconds(own_process)
    record = run_record(run, night.plan, costs.started, seconds, costs.peak_rss_mb, worked.interrupted)
    page = _report(work, record, journal, cameras or {})
    folder = unfinished.publish(record, journal.events, page)
    return FinishedRun(work, folder, record, {event.task: event for event in journal.events if isinstance(event, TaskEvent)})


def _report(work: WorkFolder, record: RunRecord, journal: Journal, cameras: Mapping[str, Any]) -> str:
    """The report.  The night's work is done: a report that cannot be drawn must not lose it, but is told of."""
    try:
        from .report.page import build_report

        return build_report(work, record, journal.events, cameras)
    except Exception as error:  # whatever is wrong in it
        what = f"the report could not be built: {type(error).__name__}: {error}"
        journal.warn(what, remedy="wbflow report SITE.yaml  builds it again", trace=traceback.format_exc())
        return f"<!doctype html><title>wbflow</title><p>No report: {escape(repr(error))}"
