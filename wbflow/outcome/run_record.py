"""A run in figures: run.json made from the states of a plan, by what the rows of the pipeline report."""

from __future__ import annotations

import datetime
import functools
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

from .. import __version__
from ..cache.fingerprint import installed_versions
from ..cache.layout import cloud_name
from ..errors import ExitCode
from ..pipeline.reports import Reports, WorldReports
from ..pipeline.stages import (
    DENSE_PAIRS,
    DISPARITY,
    FRAMES,
    FUSE,
    GEOMETRY,
    PAIRS,
    POSES,
    STAGES,
    Stage,
    stage_named,
)
from ..records.record import CameraRecord, CloudRecord, PairRecord, RunRecord, Seconds, TaskCounts, WorldRecord, stamp
from ..runner.captures import pattern_of
from ..runner.planner import Plan
from ..runner.staleness import by_picture, night_by_pictures
from ..runner.state import Cause, State
from ..task import Task, camera_of
from .views import by_camera, of_camera

_Worlds = list[tuple[dict[str, Any], WorldReports]]


def run_record(run: str, plan: Plan, started: datetime.datetime, seconds: Seconds, peak_rss_mb: float) -> RunRecord:
    """The record of a run that ends now; nothing is judged yet.

    Parameters
    ----------
    run : str
        Its id.
    plan : Plan
        With the states of all its tasks.
    started : datetime
        UTC.
    seconds : Seconds
        What it has cost.
    peak_rss_mb : float
        Memory of its largest worker.
    """
    worlds = _worlds(plan)
    dense = set(_listed(plan, DENSE_PAIRS))
    pairs = tuple(_pair(plan, pair, worlds, dense) for pair in _pairs(plan))
    views: dict[str, list[CameraRecord]] = {}
    for view in plan.site.views:
        views.setdefault(view.camera, []).append(_camera(plan, view.id, worlds))
    cameras = tuple(of_camera(records, _sums()) for records in views.values())
    dated = pattern_of(plan.site).dated
    night = plan.night if dated else night_by_pictures(camera.figures for camera in cameras)
    cameras = tuple(_with_staleness(camera, night, dated) for camera in cameras)
    product = FUSE
    main = plan.states.get(Task(product))
    others = (_cloud(task, state) for task, state in plan.states.items() if task.stage == product and task.subject)
    return RunRecord(
        run,
        plan.site.name,
        __version__,
        plan.night if plan.night_given else night or plan.night,
        stamp(started),
        stamp(datetime.datetime.now(datetime.UTC)),
        ExitCode.GOOD,
        TaskCounts(**Counter[str](state.outcome for state in plan.states.values())),
        seconds,
        round(peak_rss_mb),
        cameras,
        pairs,
        cloud=_cloud(Task(product), main) if main else None,
        other_clouds=tuple(cloud for cloud in others if cloud),
        poses=_world(plan),
        reason=root_cause(plan, Task(product)) if main and not main.usable else None,
        code=main.code if main and not main.usable else None,
        versions=installed_versions(),
        reference=plan.reference.run if plan.reference else None,
    )


def root_cause(plan: Plan, task: Task) -> str | None:
    """Why a task gave nothing: where it was skipped since others were skipped, what that goes back to.

    Of several causes the one that most tasks share.
    """
    state = plan.states[task]
    if state.outcome != "skipped" or "skipped" not in (state.reason or ""):
        return state.reason
    if not _pairs(plan) and (reason := _why_no_pairs(plan)):
        return reason
    waiting, seen, roots = [task], {task}, []
    while waiting:
        at = waiting.pop(0)
        above = [up for up in plan.upstreams(at) if (s := plan.states.get(up)) and not s.usable]
        if plan.states[at].outcome != "skipped" or not above:
            roots.append(at)
            continue
        new = [up for up in dict.fromkeys(above) if up not in seen]
        seen.update(new)
        waiting += new
    kinds = Counter((root.stage, plan.states[root].code) for root in roots)
    kind, count = kinds.most_common(1)[0]
    if kind[0] == FRAMES:  # too few cameras: the reason says how many there are
        return state.reason
    first = next(root for root in roots if (root.stage, plan.states[root].code) == kind)
    more = f" (and {count - 1} more like it)" if count > 1 else ""
    return f"{first}: {plan.states[first].reason}{more}"


def _why_no_pairs(plan: Plan) -> str | None:
    """What the pair graph says of most pairs that it dropped."""
    state = plan.states.get(Task(PAIRS))
    dropped = Counter(edge["reason"] for edge in _figures(state).get("edges", ()))
    if not dropped:
        return None
    reason, count = dropped.most_common(1)[0]
    return f"no two cameras were matched: {reason} ({count} of {dropped.total()} pairs)"


@functools.cache
def reported(scope: str) -> tuple[str, ...]:
    """Names of all figures that stages report of a camera or of a pair, in the order of the pipeline."""
    names: dict[str, None] = {}
    for stage in STAGES:
        if stage.scope == scope and stage.reports:
            names |= dict.fromkeys(stage.reports.fields)
        if stage.world_reports:
            names |= dict.fromkeys(stage.world_reports.cameras if scope == "camera" else stage.world_reports.pairs)
    return tuple(names)


def _camera(plan: Plan, camera: str, worlds: _Worlds) -> CameraRecord:
    captures = {file.name: file.digest for file in plan.captures[camera_of(camera)]}
    figures = {"captures": captures, **dict.fromkeys(reported("camera"))}
    record = CameraRecord(camera, "ok", figures=figures, health=plan.health(camera))
    for stage, reports in _reporting("camera"):
        state = plan.states.get(Task(stage.name, (camera,)))
        if state is None:
            continue
        if not state.usable:
            return replace(record, outcome=state.outcome, reason=state.reason, code=state.code)
        notes = tuple(_figures(state).get(reports.notes, ()))
        record = replace(record, notes=record.notes + notes, figures={**record.figures, **_told(state, reports)})
    for solved, world in worlds:
        entries = {name: _entry(solved, entry.figure, camera, entry.field) for name, entry in world.cameras.items()}
        told = {name: value for name, value in entries.items() if value is not None}
        note = solved.get(world.camera_notes, {}).get(camera)
        record = replace(record, figures={**record.figures, **told}, notes=(*record.notes, *([note] if note else [])))
        if camera in solved.get(world.lost_cameras, {}):
            record = replace(record, outcome="unsolved", reason=solved[world.lost_cameras][camera], code=Cause.UNSOLVED)
    return record


def _with_staleness(record: CameraRecord, night: str, dated: bool) -> CameraRecord:
    """With the health of a camera whose pictures say that they are of another night; dated: do the captures' names say a date?"""
    if record.outcome in {"ok", "unsolved"} and (record.health is None or record.health.ok):
        record = replace(record, health=by_picture(record.figures, night, dated) or record.health)
    return record


def _pair(plan: Plan, pair: tuple[str, str], worlds: _Worlds, dense: Collection[tuple[str, str]]) -> PairRecord:
    record = PairRecord(*pair, "ok", figures=dict.fromkeys(reported("pair")))
    for stage, reports in _reporting("pair"):
        state = plan.states.get(Task(stage.name, pair))
        if state is None:
            continue
        record = replace(record, figures={**record.figures, **_told(state, reports)})
        if state.usable and stage.name == DISPARITY:
            record = replace(record, outcome="ok", reason=None, code=None, stage=None)
        elif not state.usable and (record.ok or state.outcome != "skipped"):
            record = replace(record, outcome=state.outcome, reason=state.reason, code=state.code, stage=stage.name)
    found = plan.states.get(Task(GEOMETRY, pair))
    figures = {"matched": found.usable if found else None, "dense": pair in dense if dense else None}
    record = replace(record, figures={**record.figures, **figures})
    for solved, world in worlds:
        told = {name: _entry(solved, entry.figure, record.name, entry.field) for name, entry in world.pairs.items()}
        record = replace(record, figures={**record.figures, **told})
    return record


def _sums() -> frozenset[str]:
    """Figures of a camera's views that add up to the camera's."""
    return frozenset(name for _, reports in _reporting("camera") for name in reports.sums)


@functools.cache
def _reporting(scope: str) -> list[tuple[Stage, Reports]]:
    return [(stage, stage.reports) for stage in STAGES if stage.scope == scope and stage.reports]


def _worlds(plan: Plan) -> _Worlds:
    """Figures of site-wide results, and what they report of cameras and pairs."""
    reporting = {stage.name: stage.world_reports for stage in STAGES}
    return [(_figures(state), world) for task, state in plan.states.items() if (world := reporting.get(task.stage))]


def _told(state: State, reports: Reports) -> dict[str, Any]:
    """Figures of a task by their names in the record."""
    figures = _figures(state)
    names = reports.fields if state.usable else {**reports.fields, **reports.rejected}
    return {ours: figures[theirs] for ours, theirs in names.items() if theirs in figures}


def _entry(figures: Mapping[str, Any], figure: str, subject: str, name: str) -> Any:
    entry = figures.get(figure, {}).get(subject)
    return entry.get(name) if entry is not None and name else entry


def _pairs(plan: Plan) -> list[tuple[str, str]]:
    """Those that are matched or made dense, in the order of the site file where the latter were chosen anew."""
    matched, dense = _listed(plan, PAIRS), _listed(plan, DENSE_PAIRS)
    place = {view.id: k for k, view in enumerate(plan.site.views)}
    return sorted({*matched, *dense}, key=lambda pair: [place[view] for view in pair]) if dense else matched


def _listed(plan: Plan, stage: str) -> list[tuple[str, str]]:
    state = plan.states.get(Task(stage))
    return [tuple(pair) for pair in _figures(state).get("pairs", [])] if state and state.usable else []


def _cloud(task: Task, state: State) -> CloudRecord | None:
    if not state.usable:
        return None
    figures = _figures(state)
    low, high = figures["bounds"]
    return CloudRecord(cloud_name(task.subject), figures["points_count"], (tuple(low), tuple(high)))


def _world(plan: Plan) -> WorldRecord | None:
    """Without the cameras themselves, and without what is said of each camera and pair elsewhere."""
    stage = stage_named(POSES)
    state = plan.states.get(Task(stage.name))
    if state is None or not state.usable:
        return None
    elsewhere = stage.world_reports.told_elsewhere() if stage.world_reports else set()
    return WorldRecord(by_camera({name: value for name, value in _figures(state).items() if name not in elsewhere}))


def _figures(state: State | None) -> dict[str, Any]:
    return state.receipt.figures if state and state.receipt else {}
