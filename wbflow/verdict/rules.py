"""Was it a good night?  This module alone decides the findings of a run, its level, and its exit code.

A night is good if there are no findings, failed if there is no cloud, and degraded if a camera that should contribute does not
or is not as it should be, if a task failed, or if the results are far fewer than usual (the last good nights with the same
settings) or, without such nights, than planned.  A pair without matches is not a failure.

`CHECKS` lists the checks; each is in the module named after what it judges, with its limits.  `records.findings.FINDINGS`
explains each finding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

from ..cache.atomic import free_bytes
from ..errors import ExitCode
from ..pipeline.stages import FEATURES, FUSE, MATCHES
from ..records.findings import FINDINGS, Baseline, Finding, Level, Verdict
from ..records.record import RunRecord
from ..records.run_folder import NoSuchRun, RunFolder
from ..runner.disk import night_bytes
from ..runner.night import Night
from ..runner.state import Cause, State
from ..site.models import Site
from ..task import Task
from .acknowledge import name_of, split, with_known
from .amounts import check_amounts, check_cloud
from .baseline import baseline_before, baseline_of, earlier_runs, settings_of, with_appearance
from .calibration import check_calibration
from .cameras import check_cameras, with_down
from .captures import check_captures
from .changes import check_changes
from .consequences import with_causes
from .depths import check_depths
from .ended import EndedNight
from .ends import check_end
from .facts import Facts
from .observed import check_observed
from .pictures import check_pictures
from .poses import check_poses
from .survey import check_survey
from .tasks import check_tasks

Check = Callable[[RunRecord, Facts], Iterator[Finding]]
CHECKS: tuple[Check, ...] = (
    check_end,
    check_cameras,
    check_captures,
    check_pictures,
    check_calibration,
    check_observed,
    check_poses,
    check_depths,
    check_survey,
    check_tasks,
    check_cloud,
    check_amounts,
    check_changes,
)
"""All checks, in the order in which their findings are reported."""


def facts_of(ended: EndedNight, interrupted: bool) -> Facts:
    """Return the facts of a night whose tasks have all ended."""
    night = ended.night
    failed: list[tuple[Task, State]] = []
    stopped: list[State] = []
    for task, state in ended.states.items():
        if state.outcome == "failed":
            failed.append((task, state))
        if state.code == Cause.STOPPED:
            stopped.append(state)
    # a run of single stages (--until) is judged by the last of them
    product = night.takes_part(FUSE)
    missing = None
    if night.until and not product:
        last = Task(night.until)
        last_state = ended.states.get(last)
        if last_state and not last_state.usable:
            missing = (night.until, ended.root_cause(last) or "")
    night_size = 0
    free_size = 0
    if any(state.code == Cause.DISK_FULL for _, state in failed):
        night_size = night_bytes(night)
        free_size = free_bytes(night.cache.work.root)
    return Facts(
        tuple(failed),
        product,
        missing,
        interrupted,
        night_bytes=night_size,
        free_bytes=free_size,
        stopped=tuple(stopped),
        calibration_change=night.calibration_change,
        expected=night.site.settings.expect,
        still_zones=frozenset(zone.name for zone in night.site.settings.zones or () if zone.expect == "none"),
        sift_alone=uses_sift_alone(night.site),
    )


def uses_sift_alone(site: Site) -> bool:
    """Does a site use no learned model, nor keypoints of its own?"""
    features = site.stages[FEATURES]
    has_model = bool(features.files or site.stages[MATCHES].files)
    return features.use is None and ":" not in features.parameters.get("detector", "") and not has_model


def judge_run(record: RunRecord, night: Night, facts: Facts) -> RunRecord:
    """Return the record with the figures it is compared with, the health of its cameras, its verdict and its exit code."""
    settings = settings_of(night.site)
    work = night.cache.work
    earlier = earlier_runs(work, record.run, record.date)
    baseline = baseline_before(earlier, settings, facts.expected.since)
    if night.reference and not night.reference.automatic:  # pinned by an operator: its figures count as usual
        with suppress(NoSuchRun):  # removed since
            pinned = RunFolder.of(work, night.reference.run).record()
            if pinned.settings == settings and pinned.cloud:
                pinned_baseline = baseline_of([pinned])
                # looks vary with the weather: medians of several nights are the better measure of a camera
                cameras = baseline.cameras if baseline else pinned_baseline.cameras
                baseline = Baseline(1, pinned_baseline.figures, cameras, pinned.run)
    return judge(replace(record, settings=settings, usual=baseline), replace(facts, earlier=earlier))


def judge(record: RunRecord, facts: Facts) -> RunRecord:
    """Return a record, whose usual figures are set, with the health of its cameras, its verdict and its exit code."""
    # 1. the state of each camera, and the changes that somebody has acknowledged, which the checks build on
    record = with_known(with_appearance(record, facts.expected), facts.acknowledged)
    cameras = [with_down(camera, record, facts.earlier) for camera in record.cameras]
    record = replace(record, cameras=tuple(cameras))
    # 2. what is wrong with the night, without what somebody has acknowledged
    reported: list[Finding] = []
    for check in CHECKS:
        reported += check(record, facts)
    effective, acknowledged = split(reported, facts.acknowledged, record.date)
    findings = with_causes(effective, record, facts)
    # 3. how bad that is
    levels = {FINDINGS[entry.kind].level for entry in findings if not _is_tolerated(entry, record, facts)}
    level: Level = "good"
    if "failed" in levels:
        level = "failed"
    elif "degraded" in levels:
        level = "degraded"
    code = ExitCode.INTERRUPTED if facts.interrupted else ExitCode[level.upper()]
    recovered = _recovered(reported, facts.earlier) if level == "good" else ()
    return replace(record, verdict=Verdict(level, findings, acknowledged), exit_code=code, recovered=recovered)


def _recovered(reported: list[Finding], earlier: tuple[RunRecord, ...]) -> tuple[str, ...]:
    """Return the findings of the night before that are no more; those of the whole site only if there are no others."""
    if not earlier or earlier[0].verdict is None:
        return ()
    still = {name_of(entry) for entry in reported}
    ended = [entry for entry in earlier[0].verdict.findings if name_of(entry) not in still]
    of_cameras = [entry for entry in ended if entry.subject]
    return tuple(name_of(entry) for entry in of_cameras or ended)


def _is_tolerated(entry: Finding, record: RunRecord, facts: Facts) -> bool:
    """Is it about a camera, while as many cameras are up as the site file requires?"""
    limit = facts.expected.cameras
    if not entry.kind.startswith("camera-") or limit >= 1:
        return False
    cameras = record.cameras
    return sum(camera.down is None for camera in cameras) >= limit * len(cameras)
