"""Publishes a run: its clouds and cameras, the files of its stages, its record with the verdict, its report."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..cache import artifact
from ..cache.layout import WorkFolder, cloud_name
from ..cache.ply import ply_bytes, with_comments
from ..errors import UsageError, WbflowError
from ..pipeline.stages import CHANGES, FUSE, POSES, stage_named
from ..pipeline.summaries import PosesSummary
from ..plugins import load
from ..records.acknowledgement import Acknowledgement
from ..records.events import TaskEvent
from ..records.finished_run import Run
from ..records.metrics import metrics
from ..records.record import CameraRecord, RunRecord
from ..records.run_folder import UnfinishedRun, compared_before
from ..site.geodesy import origin_of
from ..site.models import Site
from ..task import Task
from ..verdict import acknowledge
from ..verdict.ended import EndedNight
from ..verdict.rules import facts_of, judge_run
from ..verdict.run_record import run_record
from .journal import Journal
from .night import Night
from .plan import Plan
from .state import summary_of

_OTHER_WORLD = "unit unknown: these cameras are not connected to the others, and have a frame and a scale of their own"
"""PLY comment of a cloud beside the main one."""

Draw = Callable[[Night, RunRecord, Journal, Mapping[str, Any], Path], str]
"""Draws the report of a run: its night, record, events and cameras, and the folder with its files; returns HTML."""


def publish(run: str, plan: Plan, products: dict[Task, bytes] | None, journal: Journal, draw: Draw, *, own_process: bool) -> Run:
    """Write the folder of a run, and point `latest` to it.  What cannot be drawn or written as a file becomes a warning.

    Parameters
    ----------
    run, plan, journal : str, Plan, Journal
        The run's id, its plan, whose tasks have all ended, and its events.
    products : dict, optional
        The artifacts to publish by task; None if the run was interrupted.
    draw : callable
        Draws the report.
    own_process : bool
        Did the tasks run in this process?

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    night = plan.night
    artifacts = products or {}
    unfinished = UnfinishedRun(night.cache.work, run)
    # 1. the products: clouds, cameras, and the files that stages make of their results
    cameras: dict[str, Any] = {}
    world = PosesSummary()
    if Task(POSES) in artifacts:
        cameras = _cameras(plan, artifacts[Task(POSES)])
        world = summary_of(plan.states[Task(POSES)], PosesSummary)
    for task, product in artifacts.items():
        if task.stage != FUSE:
            continue
        if task.subject:  # a component beside the main one
            comments: tuple[str, ...] = (_OTHER_WORLD,)
        else:
            comments = (*_unit_comments(world.metric), *_place_comments(world.crs))
        unfinished.write(cloud_name(task.subject), with_comments(product, comments))
    if Task(POSES) in artifacts:
        unfinished.write_cameras(cameras)
    files: dict[str, list[str]] = {}
    for stage, name, data in _files(plan, journal):
        unfinished.write(name, data)
        files.setdefault(stage, []).append(name)
    # 2. the record, and what it says of the night
    ended = EndedNight(night, plan.states, plan.resolver.health, plan.upstreams, plan.resolver.previous_run)
    for date in plan.resolver.lost_nights:
        what = f"the changes of the night of {date} are no longer in the cache: tonight's go on from the night before it, if any"
        journal.warn(what, task=Task(CHANGES), remedy="keep more nights (`keep:` in the site file)")
    record = run_record(run, ended, journal.started, journal.seconds(own_process), journal.peak_rss_mb, files)
    harmful, harmless = night.files.in_motion(night.site.captures.dated)
    cameras_of_record = [_with_motion(camera, harmful, harmless) for camera in record.cameras]
    record = replace(record, cameras=tuple(cameras_of_record))
    acknowledged = _acknowledged(night.site, journal)
    facts = replace(facts_of(ended, products is None), upload_finding=journal.upload(), acknowledged=acknowledged)
    record = judge_run(record, night, facts)
    if twice := _given_twice(night.cache.work, record):
        what = f"{', '.join(twice)}: on nights after this one, which ran before it, these are ids of other things"
        journal.warn(what, remedy=f"run them again, in order: wbflow run SITE.yaml --since {record.date}")
    record = replace(record, repaired=tuple(journal.repairs), files=unfinished.files)
    # 3. the report, of the record as run.json has it: built again, it is the same; and the folder as a whole
    written = RunRecord.from_json(json.loads(json.dumps(record.to_json())))
    page = draw(night, written, journal, cameras, unfinished.paths.folder)
    folder = unfinished.publish(record, journal.events, page, metrics(record))
    with contextlib.suppress(OSError):  # functions are then read again by the next run
        night.site.bindings.reader.save()
    tasks = {event.task: event for event in journal.events if isinstance(event, TaskEvent)}
    return Run(folder, record, tasks, night.cache)


def _given_twice(work: WorkFolder, record: RunRecord) -> list[str]:
    """Return the ids that changes have got tonight although other changes have them on later nights: an old night, run again with
    other captures, or for the first time, cannot know them."""
    twice: dict[str, None] = {}
    for _, later in compared_before(work, ""):
        if later.date <= record.date:
            break
        for name, change in record.changes.items():
            other = later.changes.get(name)
            if change.first == record.date and other and other.first != change.first:
                twice[name] = None
    return [*twice]


def _with_motion(camera: CameraRecord, harmful: Mapping[str, list[str]], harmless: Mapping[str, list[str]]) -> CameraRecord:
    """A camera's record, with those of its captures that changed during the run (see `NightFiles.in_motion`)."""
    notes = list(camera.notes)
    for name in harmless.get(camera.id, ()):
        what = f"{name} was overwritten during the run"
        notes.append(f"{what}; it was read as a whole, and `captures` has the digest of what was used")
    return replace(camera, captures_in_motion=tuple(harmful.get(camera.id, ())), notes=tuple(notes))


def _cameras(plan: Plan, poses: bytes) -> dict[str, Any]:
    """Return the solved cameras in the form of a calibration, by id.  poses: the artifact, used if the cache lacks that form."""
    receipt = plan.states[Task(POSES)].receipt
    product = None
    if receipt:
        product = plan.night.cache.product_file(Task(POSES), receipt.key, "cameras")
    if product is None:
        product = load(stage_named(POSES).products.product_files["cameras"])(artifact.decode(poses))
    cameras: dict[str, Any] = json.loads(product)
    return cameras


def _unit_comments(metric: bool) -> tuple[str, ...]:
    """Return PLY comments on the unit of lengths."""
    if metric:
        return ("unit metre",)
    return (
        "unit arbitrary: no camera position, distance or board states a scale",
        "sigma_mm is in thousandths of that unit, not in millimetres",
    )


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
    for stage in plan.night.stages:
        state = plan.states.get(Task(stage.name))
        if not (stage.products.files and state and state.usable and state.receipt):
            continue
        try:
            result = plan.night.cache.load(Task(stage.name), state.receipt)
            for name, content in load(stage.products.files)(result):
                if isinstance(content, bytes):
                    yield stage.name, name, content
                else:  # a cloud
                    yield stage.name, name, bytes(ply_bytes(content, comments=("made by wbflow",)))
        except (WbflowError, ValueError, ImportError) as error:
            journal.warn(f"not all of its files could be made: {error}", task=Task(stage.name))


def _acknowledged(site: Site, journal: Journal) -> tuple[Acknowledgement, ...]:
    """Return the acknowledgements of a site; a file that cannot be read becomes a warning."""
    try:
        return acknowledge.read(site)
    except UsageError as error:
        journal.warn(f"{error.where} {error.what}", remedy=error.remedy)
        return ()
