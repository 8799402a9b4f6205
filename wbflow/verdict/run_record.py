"""A run in figures: run.json, made from the states of a plan and the summaries of their results."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from wbflow_stages.contracts.camera_figures import DepthFigures, Notes
from wbflow_stages.contracts.ground_figures import CloudFigures
from wbflow_stages.contracts.pair_figures import PairsFigures
from wbflow_stages.contracts.pose_figures import CalibrationCheck, PoseIssue

from .. import __version__
from ..cache.layout import cloud_name
from ..cache.versions import installed_versions
from ..errors import ExitCode
from ..pipeline.stages import CALIBRATION, DENSE_PAIRS, DEPTH, DISPARITY, FUSE, GEOMETRY, PAIRS, POSES, STAGES, Stage
from ..pipeline.summaries import CameraFigures, ChangesSummary, PairFigures, PosesSummary, SiteSummary
from ..records.changes import with_nights
from ..records.record import CameraRecord, CloudRecord, PairRecord, RunRecord, Seconds, TaskCounts, stamp
from ..runner.state import Cause, summary_of
from ..site.stale_cameras import night_by_pictures, stale_by_image
from ..task import Subject, Task, camera_of
from .ended import EndedNight

_SUMMED = {"keypoints", "points"}
"""Figures that are summed over a camera's views; the others are averaged."""


def run_record(
    run: str,
    ended: EndedNight,
    started: datetime.datetime,
    seconds: Seconds,
    peak_rss_mb: float,
    files: Mapping[str, Collection[str]],
) -> RunRecord:
    """Return the record of a run that ends now, without a verdict yet.

    Parameters
    ----------
    run, started : str, datetime
        The run's id, and when it began (UTC).
    ended : EndedNight
        The night, whose tasks have all ended.
    seconds, peak_rss_mb : Seconds, float
        Time that the run took, and the memory of its largest worker.
    files : mapping
        Names of the files that are published beside the cloud, by stage.
    """
    site = ended.night.site
    site_wide = _SiteWide.from_plan(ended)
    # 1. cameras, each from its views
    views: dict[str, list[CameraRecord]] = {}  # by camera
    for view in site.views:
        views.setdefault(view.camera, []).append(_camera_record(ended, view.id, site_wide))
    cameras = [_joined_views(records) for records in views.values()]
    # 2. the night: stated, or the one that the pictures say that they are of
    dated = site.captures.dated
    date = str(ended.night.date)
    night = date
    if not dated:
        night = night_by_pictures(camera.figures for camera in cameras)
        if night and not ended.night.date_stated:
            date = night
    # 3. the clouds, or why there is none
    clouds = _clouds(ended)
    reason = None
    code = None
    fuse = ended.states.get(Task(FUSE))
    if fuse and not fuse.usable:
        reason = ended.root_cause(Task(FUSE))
        code = fuse.code
    # 4. the poses
    poses = None
    if ended.is_usable(POSES):
        poses = _by_camera(site_wide.poses, {view.id: view.camera for view in site.views})
    return RunRecord(
        run=run,
        site=site.name,
        version=__version__,
        date=date,
        started=stamp(started),
        finished=stamp(datetime.datetime.now(datetime.UTC)),
        exit_code=ExitCode.GOOD,
        tasks=TaskCounts(**Counter[str](state.outcome for state in ended.states.values())),
        seconds=seconds,
        peak_rss_mb=round(peak_rss_mb),
        cameras=tuple(_with_staleness(camera, night, dated) for camera in cameras),
        pairs=tuple(_pair_record(ended, pair, site_wide) for pair in _pairs(ended)),
        cloud=clouds.get(()),
        other_clouds=tuple(cloud for component, cloud in clouds.items() if component),
        poses=poses,
        reason=reason,
        code=code,
        versions=installed_versions(),
        reference=ended.night.reference.run if ended.night.reference else None,
        dated=dated,
        results=dict(_results(ended, files, date)),
    )


@dataclass(frozen=True)
class _SiteWide:
    """What site-wide results contain about single cameras and pairs."""

    poses: PosesSummary
    points: Mapping[str, int]
    """By camera: the number of its points in its cloud."""
    misfits: Mapping[str, float]
    """By camera: the ratio of the error of its points to the expected one."""
    crowded: Mapping[str, str]
    """By camera: a note on pairs that the pair graph left out."""
    dense: frozenset[tuple[str, str]]
    """Pairs for dense matching, if these are chosen separately."""
    angles: Mapping[str, float]
    """Degrees between the views of pairs, as the poses tell it, by `left--right`."""

    @staticmethod
    def from_plan(ended: EndedNight) -> _SiteWide:
        pairs = summary_of(ended.states.get(Task(PAIRS)), PairsFigures)
        dense = summary_of(ended.states.get(Task(DENSE_PAIRS)), PairsFigures)
        poses = summary_of(ended.states.get(Task(POSES)), PosesSummary)
        row_check = ended.states.get(Task(CALIBRATION))
        if row_check and row_check.usable:
            poses = replace(poses, rows=summary_of(row_check, CalibrationCheck))
        points: dict[str, int] = {}
        misfits: dict[str, float] = {}
        for task, state in ended.states.items():  # one cloud for each component of the pair graph
            if task.stage == FUSE:
                cloud = summary_of(state, CloudFigures)
                points.update(cloud.sample_counts)
                misfits.update(cloud.misfits)
        return _SiteWide(
            poses,
            points,
            misfits,
            crowded={**pairs.crowded, **dense.crowded},
            dense=frozenset(_usable_pairs(ended, DENSE_PAIRS)),
            angles={**pairs.angles, **dense.angles},
        )


def _camera_record(ended: EndedNight, camera: str, site_wide: _SiteWide) -> CameraRecord:
    """Return the record of a view, which is that of its camera if it has no other."""
    captures = {file.name: file.digest for file in ended.night.files.captures[camera_of(camera)]}
    record = CameraRecord(camera, "ok", captures=captures, health=ended.health_of(camera))
    figures: dict[str, Any] = {}
    notes: list[str] = []
    for stage, kind in _stages_in(CameraFigures):
        state = ended.states.get(Task(stage.name, (camera,)))
        if state and not state.usable:  # site-wide results cannot contain it
            record = replace(record, outcome=state.outcome, reason=state.reason, code=state.code)
            return replace(record, notes=tuple(notes), figures=CameraFigures(**figures))
        notes += summary_of(state, Notes).notes
        figures |= _not_none(summary_of(state, kind))
    poses = site_wide.poses
    pose_check = poses.pose_checks.get(camera)
    depth = summary_of(ended.states.get(Task(DEPTH, (camera,))), DepthFigures)
    figures["pose"] = pose_check
    figures["verified"] = pose_check.verified if pose_check else None
    figures["pose_from"] = poses.sources.get(camera)
    figures["points"] = site_wide.points.get(camera)
    figures["misfit"] = site_wide.misfits.get(camera)
    figures["offset_px"] = depth.offset_px or None
    if camera in site_wide.crowded:
        notes.append(site_wide.crowded[camera])
    moved = poses.issues_of("moved").get(camera)
    if moved:
        notes.append(moved.text)
    if camera in poses.unsolved:
        record = replace(record, outcome="unsolved", reason=poses.unsolved[camera], code=Cause.UNSOLVED)
    return replace(record, notes=tuple(notes), figures=CameraFigures(**figures))


def _with_staleness(record: CameraRecord, night: str, dated: bool) -> CameraRecord:
    """Add the health of a camera whose images are of another night; dated: do the captures' names contain a date?"""
    if record.outcome in {"ok", "unsolved"} and (record.health is None or record.health.ok):
        record = replace(record, health=stale_by_image(record.figures, night, dated) or record.health)
    return record


def _pair_record(ended: EndedNight, pair: tuple[str, str], site_wide: _SiteWide) -> PairRecord:
    """Return the record of a pair; its outcome is that of the last stage that made nothing, skipped ones aside."""
    figures: dict[str, Any] = {}
    success: dict[str, Any] = {"outcome": "ok"}
    outcome = success
    # in the order of the pipeline, so that later stages decide
    for stage, kind in _stages_in(PairFigures):
        state = ended.states.get(Task(stage.name, pair))
        if state is None:
            continue
        figures |= _not_none(summary_of(state, kind))
        if state.usable and stage.name == DISPARITY:
            outcome = success  # the poses alone sufficed for dense matching
        elif not state.usable and (outcome is success or state.outcome != "skipped"):
            outcome = {"outcome": state.outcome, "reason": state.reason, "code": state.code, "stage": stage.name}
    figures.setdefault("angle_deg", site_wide.angles.get("--".join(pair)))  # without matches that tell it
    check = site_wide.poses.pair_checks.get("--".join(pair))
    if check:
        figures |= {"poses_px": check.adjusted_px, "known": check.known}
    matched = None
    geometry = ended.states.get(Task(GEOMETRY, pair))
    if geometry:
        matched = geometry.usable
    dense = None
    if site_wide.dense:
        dense = pair in site_wide.dense
    return PairRecord(*pair, **outcome, matched=matched, dense=dense, figures=PairFigures(**figures))


def _stages_in(figures: type[CameraFigures | PairFigures]) -> list[tuple[Stage, type[Any]]]:
    """Return the stages whose summaries are part of the figures of a camera or pair, in the order of the pipeline."""
    return [(stage, stage.summary) for stage in STAGES if stage.summary and issubclass(figures, stage.summary)]


def _not_none(summary: object) -> dict[str, Any]:
    return {name: value for name, value in vars(summary).items() if value is not None}


def _pairs(ended: EndedNight) -> list[tuple[str, str]]:
    """Pairs that are matched sparsely or densely; if dense pairs are chosen separately, in the order of the site file."""
    matched = _usable_pairs(ended, PAIRS)
    dense = _usable_pairs(ended, DENSE_PAIRS)
    if not dense:
        return matched
    position = {view.id: k for k, view in enumerate(ended.night.site.views)}
    return sorted({*matched, *dense}, key=lambda pair: [position[view] for view in pair])


def _usable_pairs(ended: EndedNight, stage: str) -> list[tuple[str, str]]:
    """Return the pairs that a stage has chosen; [] if it left no result."""
    if not ended.is_usable(stage):
        return []
    return list(summary_of(ended.states[Task(stage)], PairsFigures).pairs)


def _clouds(ended: EndedNight) -> dict[Subject, CloudRecord]:
    """Return the clouds by component; that of () is the main one.

    The scale of the cameras that form another component is not recorded, so that its lengths are not known to be metres.
    """
    clouds = {}
    is_metric = summary_of(ended.states.get(Task(POSES)), PosesSummary).metric
    for task, state in ended.states.items():
        if task.stage == FUSE and state.usable:
            cloud = summary_of(state, CloudFigures)
            clouds[task.subject] = CloudRecord(
                path=cloud_name(task.subject),
                points=cloud.points,
                bounds=cloud.bounds,
                correct_share=cloud.correct_share,
                metric=is_metric and not task.subject,
            )
    return clouds


def _results(ended: EndedNight, files: Mapping[str, Collection[str]], date: str) -> Iterator[tuple[str, SiteSummary]]:
    """Yield name and summary of each site-wide stage that has one; without a result, a summary that says why.  date: tonight."""
    for stage in ended.night.stages:
        if not stage.summary or not issubclass(stage.summary, SiteSummary):
            continue
        state = ended.states.get(Task(stage.name))
        summary = stage.summary()
        reason = None
        if state and state.usable:
            summary = summary_of(state, stage.summary)
        elif state:
            reason = state.reason
        if isinstance(summary, ChangesSummary):
            summary = with_nights(summary, date, ended.previous)
        yield stage.name, replace(summary, files=tuple(sorted(files.get(stage.name, ()))), reason=reason)


def _joined_views(views: Sequence[CameraRecord]) -> CameraRecord:
    """Return the record of a camera from those of its views: it is ok if one of them is, and its notes name lost ones."""
    if len(views) == 1:
        return views[0]
    usable = [view for view in views if view.ok]
    used = usable or list(views)
    notes: dict[str, None] = {}  # in order, each once: views often have the same
    for view in views:
        notes.update(dict.fromkeys(view.notes))
    lost = []
    if usable:  # else the outcome of the camera is that of its first view
        lost = [f"{view.id}: {view.reason or view.outcome}" for view in views if not view.ok]
    joined = {}
    for name in vars(used[0].figures):
        values = [getattr(view.figures, name) for view in used]
        joined[name] = _joined_figure(values, name in _SUMMED)
    figures = CameraFigures(**joined)
    return replace(used[0], id=camera_of(views[0].id), notes=(*notes, *lost), figures=figures)


def _joined_figure(values: Sequence[Any], is_summed: bool) -> Any:
    """Return a camera's figure from those of its views: all of them hold, their sum or mean, else the first one that is known."""
    known = [value for value in values if value is not None]
    if not known:
        return None
    if all(isinstance(value, bool) for value in known):  # before numbers: a bool is an int
        return all(known)
    if not all(isinstance(value, int | float) for value in known):
        return known[0]
    if is_summed:
        return sum(known)
    mean = sum(known) / len(known)
    if all(isinstance(value, int) for value in known):  # a count
        return round(mean)
    return mean


def _by_camera(poses: PosesSummary, camera_names: Mapping[str, str]) -> PosesSummary:
    """Return the summary with camera ids instead of the ids of views; a camera keeps the first issue of each kind.

    camera_names: the camera's id by the id of each of its views.
    """
    issues: dict[tuple[str, str], PoseIssue] = {}
    # backwards, so that the first issue of a camera wins, but stands where its last one stood
    for issue in reversed(poses.issues):
        camera = camera_names.get(issue.camera, issue.camera)
        issues[issue.kind, camera] = replace(issue, camera=camera)
    renamed = {name: _with_camera_names(value, camera_names) for name, value in vars(poses).items()}
    renamed["issues"] = tuple(reversed(issues.values()))
    return replace(poses, **renamed)


def _with_camera_names(value: Any, camera_names: Mapping[str, str]) -> Any:
    """Replace views by their cameras, keeping each camera's first entry; pairs are of views, and keep their names."""
    if isinstance(value, Mapping):
        by_camera: dict[str, Any] = {}
        for name, entry in value.items():
            by_camera.setdefault(camera_names.get(name, name), entry)
        return by_camera
    if isinstance(value, tuple):
        if all(isinstance(entry, str) for entry in value):
            return tuple(dict.fromkeys(camera_names.get(name, name) for name in value))
        return tuple(_with_camera_names(entry, camera_names) for entry in value)
    return value
