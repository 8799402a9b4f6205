"""Was it a good night?  This module alone decides the findings of a run, its level, and its exit code.

A night is good if there are no findings, failed if there is no cloud, and degraded if a camera that should contribute does not
or is not as it should be, if a task failed, or if the results are far fewer than usual (the last good nights with the same
settings) or, without such nights, than planned.  A pair without matches is not a failure.

`CHECKS` lists the checks.  `records.findings.FINDINGS` explains each finding.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from statistics import median

from wbflow_stages.contracts.pose_figures import CalibrationCheck, PoseIssue

from ..cache.atomic import free_bytes
from ..errors import ExitCode
from ..pipeline.stages import FUSE, STAGES
from ..pipeline.summaries import PosesSummary, SiteSummary
from ..records.findings import FINDINGS, Baseline, Down, Finding, Level, Verdict, finding
from ..records.record import CameraRecord, PairRecord, RunRecord
from ..records.run_folder import NoSuchRun, RunFolder
from ..runner.disk import night_bytes
from ..runner.night import Night
from ..runner.state import Cause, State
from ..site.models import Expected, Measure
from ..task import Task, camera_of
from ..words import counted, format_size
from .acknowledge import Acknowledgement, split
from .baseline import earlier_runs, figures_of, settings_of, usual_before, usual_of, with_appearance
from .ended import EndedNight

PLANNED_PAIRS = 0.5
"""Smallest share of the planned pairs that must be usable on a night without earlier ones to compare with."""
LEAST_CORRECT_SHARE = 0.9
"""Smallest share of a cloud's points that must be right, as expected from the confidence of each."""
LEAST_CONTRAST = 2.0
"""Images with a smaller standard deviation, in grey levels, show nothing, and may be identical."""
SOFT_PX = 1.3
"""Images count as soft if their sharper edges are blurred by more than this (standard deviation, pixels).  The softest parts of
photographs at 320 to 1600 pixels, and of rendered scenes by day and night, have 0.8 at most, unscaled images 1.0."""
COARSE = 1.465
"""Images count as soft above this JPEG blockiness (measured at working resolution).  Quality 50 gives 1.1 to 1.45 on sixteen
scenes; quality 20 gives 1.48 on a yard, where 87 % of the points are right."""
NOISY = 10.0
"""Images count as soft if more noise than this is left (grey levels): 13 leaves 86 % of a yard's points right, 6 leaves 95 %."""
_SOFT_LIMITS: Mapping[str, float] = {"blur_px": SOFT_PX, "coarseness": COARSE, "noise_left": NOISY}
_SHOWN_FIGURES = ("detail_px", "saturated", "contrast", "misfit")
LEAST_MISFIT, UNRESOLVED = 1.1, 2.2
"""Images count as soft if the ratio of their points' errors to the expected ones exceeds `LEAST_MISFIT`, and this ratio times the
pixels between details exceeds `UNRESOLVED`.  The product, fitted on a yard and a stadium: smeared by 5 px 2.0 (92 % of the points
right), enlarged twice 2.2 (90 %), smeared by 7 px 3.9 (86 %), enlarged three times 4.0 (78 %).  Judged on another yard (unaltered
1.1, enlarged twice 2.7, smeared by 9 px 7), an apron (unaltered 1.4, smeared 17), fountain, entry and belvedere (0.5 to 1.4)."""
BLURRED_BY_CODING = 2.45
"""Images count as soft if the ratio of their points' errors to the expected ones, times their JPEG blockiness, exceeds this.
Values that a third of the cameras reach, fitted on the fountain and seven rendered scenes: 1.4 to 2.35 at quality 50, 2.6 to 4 at
quality 20 (but 2.3 on a yard).  Judged on the entry and seven others: 1.4 to 2.2 at quality 50, but 2.8 on an apron and 2.6 on a
car park; 2.6 to 3.7 at quality 20, but 2.0 on a solar farm (89 % of the points right)."""
MOST_MISFIT = 2.0
"""Images count as soft if the ratio of their points' errors to the expected ones exceeds this, however they are coded.  A third
of the cameras reach at most 1.9 at quality 50, except on an apron and a car park, and 1.9 on an unaltered car park."""
UNSTEADY = 1.0
"""Images count as soft if the ratio of their points' errors to the expected ones, times the distance of their matches from the
epipolar lines of their pairs' own F (median, pixels), exceeds this: hot air and shaking distort images as no F does.  Values that
a third of the cameras reach, fitted on a yard, a hall, a tank farm, a railyard and the entry: at most 0.75 on nights as they
should be, 0.96 with a solved pose that is off, 1.1 to 1.5 in hot air that moves pixels by 1 px (72 to 87 % of the points right).
Judged on a building: at most 0.73 in noise, 1.1 behind webs."""
WORSE_THAN_USUAL = 1.5
"""Images count as soft if the ratio of their points' errors to the expected ones exceeds the usual ratio by this factor.  Values
that a third of the cameras reach on second nights, relative to an unharmed one.  Fitted on a yard and a market: at most 1.26 by
other weather, light, noise and JPEG quality 50; 1.7 and 1.4 at quality 20; in hot air 2.25 (80 % of the yard's points right, and
no other check finds it) and 1.55.  Judged on a railyard and the entry: at most 1.18 and 1.30; 1.5 and 1.7 at quality 20; 1.6 and
2.05 in hot air.  Relative to a first night they are 8 to 17 % smaller: 1.86, 1.40, 1.43 and 1.84 in hot air.  Nine nights of the
demo, with rain, dusk and lamps: at most 1.12."""
OVEREXPOSED = 0.5
"""Images count as soft if a larger share of their pixels is pure white.  Photographs and rendered scenes have up to 0.03; by day
with grey levels tripled 0.4 to 0.9 (a yard 0.66, 87 % of its points right).  The sky of a grey day may be white, too."""
FAINT = 10.0
"""Images count as soft if their grey levels have a smaller standard deviation: eight bits and JPEG leave little detail.  Fitted
on six scenes in thick fog or underexposed: 4.2 to 8.8 (82 to 90 % of the points right, 90 to 95 unaltered); in thinner fog 10.5
and more.  Judged on a solar farm and a stadium: 6.8 to 9.1 (87 to 90 %).  Photographs by day and night have 17 to 76."""
MOST_DIFFERENCE_PX = 0.25
"""Largest overall difference tolerated between the depths that two pairs give to one view.  Right poses give 0.02 to 0.16
(yard, apron, stadium, fountain, entry), a camera moved by half a metre or turned by half a degree 0.38 to 2.1."""
MOST_DIFFERENCE_SOLVED_PX = 0.5
"""Limit instead of `MOST_DIFFERENCE_PX` if a pose is solved, since tonight's matches determine it no better, or if dense
matching confirms the rows of the stated cameras.  Judged on a quarry (one pose solved 0.25, all 0.3; 94 and 93 % of the points
right) and a stadium (all 0.8, 76 %)."""
SINGLE_DIFFERENCE_FACTOR = 2.0
"""A single difference between two pairs, with no other above its limit, may exceed its own by this factor: a wrong pose shows in
more than one view or pair.  Fitted on a harbour with exact poses: 0.3 to 0.4 px beside its water, in 6 % of one view; judged on
the records of a solar farm, a stadium, a tank farm and a park."""
LOOK_ALIKES_PX = 12.0
"""Larger differences between pairs are ignored: these pairs match different parts of a repeating pattern, and harm only
themselves.  On a solar farm such differences are 19 to 96, and 7 with a camera turned by 2 degrees."""
LEAST_PROBABILITY = 0.8
"""A pair contradicts a stated pose only if it is right with at least this probability (odds of four to one)."""
LINES_PX, ROWS_PX = 1.0, 0.7
"""A pair agrees with stated poses if its matches lie at most `LINES_PX` from the epipolar lines (as in `orientation.pose_check`),
or if its rows, by dense matching, are off by at most `ROWS_PX`.  On a solar farm, matches of look-alikes lie 1.5 to 20 px off,
rows 0 to 0.65; with a stadium's camera tilted by half a degree, rows lie 1.6 and 1.7 px off."""
SOFT_SHARE = 1 / 3
"""Unless an image is soft by itself (`_is_soft`), soft images are reported only from this share of the cameras in use: a single
camera may see what is hard to measure."""
MOST_LETTERS = 200
"""Longest reason in a finding, in characters."""


@dataclass(frozen=True)
class Facts:
    """What the verdict is based on, besides the record."""

    failed: tuple[tuple[Task, State], ...] = ()
    product: bool = True
    """Was the run meant to make a cloud?"""
    missing: tuple[str, str] | None = None
    """The stage that the run was meant to end with, and why it made nothing; None if it made something."""
    interrupted: bool = False
    night_bytes: int = 0
    """Disk space that a night takes, bytes; 0 if no task found the disk full."""
    free_bytes: int = 0
    """Free disk space at the end of the run, bytes; 0 if no task found the disk full."""
    stopped: tuple[State, ...] = ()
    """States of the tasks that were not started before the time of --stop-at."""
    upload_finding: Finding | None = None
    """The finding if some results are not in the object store yet."""
    calibration_change: str = ""
    """How lenses and poses differ from those of the reference, which is therefore not used."""
    acknowledged: tuple[Acknowledgement, ...] = ()
    expected: Expected = field(default_factory=Expected)
    """What the site file expects of good nights."""
    earlier: tuple[RunRecord, ...] = ()
    """The runs before this one, newest first, one for each night."""

    @property
    def disk_full(self) -> tuple[Task, ...]:
        """The tasks that found no space for their results."""
        return tuple(task for task, state in self.failed if state.code == Cause.DISK_FULL)

    @staticmethod
    def from_night(ended: EndedNight, interrupted: bool) -> Facts:
        """Return the facts of a night whose tasks have all ended."""
        night = ended.night
        failed = tuple((task, state) for task, state in ended.states.items() if state.outcome == "failed")
        stopped = tuple(state for state in ended.states.values() if state.code == Cause.STOPPED)
        product = night.takes_part(FUSE)
        missing = None
        if night.until and not product:
            last = Task(night.until)
            state = ended.states.get(last)
            if state and not state.usable:
                missing = (night.until, ended.root_cause(last) or "")
        is_full = any(state.code == Cause.DISK_FULL for _, state in failed)
        return Facts(
            failed,
            product,
            missing,
            interrupted,
            night_bytes=night_bytes(night) if is_full else 0,
            free_bytes=free_bytes(night.cache.work.root) if is_full else 0,
            stopped=stopped,
            calibration_change=night.calibration_change,
            expected=night.site.settings.expect,
        )


def judge_run(record: RunRecord, night: Night, facts: Facts) -> RunRecord:
    """Return the record with the figures it is compared with, the health of its cameras, its verdict and its exit code."""
    settings = settings_of(night.site, night.bindings)
    work = night.cache.work
    earlier = earlier_runs(work, record.run, record.date)
    usual = usual_before(earlier, settings, facts.expected.since)
    if night.reference and not night.reference.automatic:  # pinned by an operator: its figures count as usual
        with suppress(NoSuchRun):  # removed since
            pinned = RunFolder.of(work, night.reference.run).record()
            if pinned.settings == settings and pinned.cloud:
                pinned_usual = usual_of([pinned])
                usual = Baseline(1, pinned_usual.figures, usual.cameras if usual else pinned_usual.cameras, pinned.run)
    return judge(replace(record, settings=settings, usual=usual), replace(facts, earlier=earlier))


def judge(record: RunRecord, facts: Facts) -> RunRecord:
    """Return a record, whose usual figures are set, with the health of its cameras, its verdict and its exit code."""
    record = with_appearance(record, facts.expected)
    record = replace(record, cameras=tuple(_with_down(camera, record, facts.earlier) for camera in record.cameras))
    all_findings = (entry for check in CHECKS for entry in check(record, facts))
    findings, acknowledged = split(all_findings, facts.acknowledged, record.date)
    levels = {FINDINGS[entry.kind].level for entry in findings if not _is_tolerated(entry, record, facts)}
    level: Level = "failed" if "failed" in levels else "degraded" if "degraded" in levels else "good"
    code = ExitCode.INTERRUPTED if facts.interrupted else ExitCode[level.upper()]
    return replace(record, verdict=Verdict(level, findings, acknowledged), exit_code=code)


def _is_tolerated(entry: Finding, record: RunRecord, facts: Facts) -> bool:
    """Is it about a camera, while as many cameras are up as the site file requires?"""
    limit = facts.expected.limit(Measure.CAMERAS)
    if not entry.kind.startswith("camera-") or limit >= 1:
        return False
    cameras = record.cameras
    return sum(camera.down is None for camera in cameras) >= limit * len(cameras)


def check_end(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Did the run complete, did it make what it was meant to make, and does the object store have everything?"""
    if facts.stopped:
        count = len(facts.stopped)
        yield finding("stopped", (), {"tasks": count}, reason=facts.stopped[0].reason, tasks=counted(count, "task"))
    if facts.interrupted:
        yield finding("interrupted")
    elif facts.missing:
        yield finding("no-result", stage=facts.missing[0], reason=shortened(facts.missing[1]))
    elif facts.product and not record.cloud and not facts.disk_full:
        yield finding("no-cloud", reason=shortened(record.reason or "reason unknown"))
    if facts.disk_full:
        yield _disk_finding(record, facts)
    if facts.upload_finding:
        yield facts.upload_finding


def _disk_finding(record: RunRecord, facts: Facts) -> Finding:
    """The one finding about a full disk: what failed because of it is its consequence, and has none of its own."""
    count = len(facts.disk_full)
    reason = f"the disk is full: {format_size(facts.free_bytes)} free, a night of this site takes about"
    reason += f" {format_size(facts.night_bytes)}; {counted(count, 'task')} could not write"
    figures = {"tasks": count, "free_bytes": facts.free_bytes}
    return finding("disk-short" if record.cloud else "disk-full", (), figures, {"free_bytes": facts.night_bytes}, reason=reason)


def check_cameras(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Is each camera in use, and as it should be?  At most one finding each, with the number of nights that it has lasted."""
    blamed = blame(record)
    excused = {name for excused_names in blamed.values() for name in excused_names}
    for camera in record.cameras:
        entry, down = _camera_finding(camera, record), camera.down
        if entry is None or down is None:  # `down` of a camera with a finding is never None
            continue
        if facts.disk_full and (camera.health is None or camera.health.ok):
            continue  # without its own results and those of its pairs, nothing can be said of it
        if entry.kind == "camera-no-usable-pair":
            may_be_dense = not facts.product and camera.figures.pose_from == "stated"  # on rows that its pose predicts
            if may_be_dense or camera.id in excused:
                continue
            if camera.id in blamed:
                entry = _with_blame(entry, blamed[camera.id])
        duration = f"; {down.words(left_out=not camera.ok)}" if down.nights > 1 else ""
        figures = {**entry.figures, "since": down.since, "nights": down.nights}
        yield replace(entry, text=entry.text + duration, figures=figures)


def _camera_finding(camera: CameraRecord, record: RunRecord) -> Finding | None:
    """Return the most important finding about a camera, if there is one."""
    subject, health, poses = (camera.id,), camera.health, record.poses or PosesSummary()
    lost = FINDINGS["camera-unsolved" if camera.code == Cause.UNSOLVED else "camera-lost"]
    remedy_of_lost = lost.remedy
    if camera.code == Cause.NO_CAPTURE:
        remedy_of_lost = remedy_of_lost.replace("check the camera", "check that it delivers")
    if health and not health.ok:
        reason = health.text if camera.ok else f"{shortened(health.text)}; left out tonight"
        remedy = health.remedy or (None if camera.ok else remedy_of_lost)
        return finding(f"camera-{health.state}", subject, health.figures, health.expected, remedy, reason=reason)
    if not camera.ok:
        return finding(lost.code, subject, remedy=remedy_of_lost, reason=shortened(camera.reason or camera.outcome))
    if moved := poses.issues_of("moved").get(camera.id):
        return finding("camera-moved", subject, reason=moved.text)
    unverified = poses.issues_of("unverified").get(camera.id)
    if unverified and not _is_refuted(unverified, record):
        return finding("camera-unverified", subject, reason=unverified.text)
    pairs = record.pairs_of(camera.id)
    if record.pairs and not pairs:
        return finding("camera-unpaired", subject)
    tried = [pair for pair in pairs if pair.outcome != "skipped" and pair.dense is not False]
    if unconfirming := _unconfirming(camera.id, tried, record):
        names = _names(pair.name for pair in unconfirming)
        reason = f"no pair with another camera of stated pose could be used ({names}), and solved cameras adapt to a wrong pose"
        return finding("camera-unverified", subject, reason=reason)
    if not tried or any(pair.ok for pair in tried):
        return None
    count_text = f"none of its {len(tried)} pairs could" if len(tried) > 1 else "its only pair could not"
    remedy = FINDINGS["camera-no-usable-pair"].remedy
    if any(pair.figures.known == "stated" for pair in tried):
        remedy += "; or its pose is not the one in the site file: measure it again, or leave it out to have it solved"
    reason = f"{count_text} be used: {_most_common_reason(tried)}"
    usable, planned = {str(Measure.PAIRS): 0}, {str(Measure.PAIRS): len(tried)}
    return finding("camera-no-usable-pair", subject, usable, planned, remedy, reason=reason)


def _unconfirming(camera: str, tried: Sequence[PairRecord], record: RunRecord) -> list[PairRecord]:
    """Return the pairs of a camera of stated pose with others of stated pose, if only pairs with solved cameras could be used,
    and none of these has a pose that two other probable pairs determine."""
    usable = [pair for pair in tried if pair.ok]
    among_stated = _among_stated(tried, record) if usable else []
    if not among_stated or any(pair.ok for pair in among_stated):
        return []
    probable = [pair for pair in record.pairs if pair.ok and (pair.figures.probability or 0.0) > 0.5]
    counts = Counter(name for pair in probable for name in pair.cameras if name != camera)
    is_confirmed = any(pair in probable and any(counts[name] > 2 for name in pair.cameras) for pair in usable)
    return [] if is_confirmed else among_stated


def _among_stated(pairs: Iterable[PairRecord], record: RunRecord) -> list[PairRecord]:
    return [pair for pair in pairs if record.stated.issuperset(pair.cameras)]


def _is_refuted(issue: PoseIssue, record: RunRecord) -> bool:
    """Do a camera's pairs with others of stated pose agree with its own after all?  If whole surfaces match on the rows that the
    poses give, matches far from these rows are of look-alikes.  Pairs vote as in `orientation.pose_check.verified`."""
    if issue.triplets:
        return False
    votes = Counter(_agrees_with_poses(pair) for pair in _among_stated(record.pairs_of(issue.camera), record))
    return votes[True] > votes[False] or votes[True] == votes[False] >= 2


def _agrees_with_poses(pair: PairRecord) -> bool | None:
    """Does a pair agree with its stated poses?  None if that is undecided."""
    figures = pair.figures
    if figures.verified == "dense" and abs(figures.row_error_px or 0.0) <= ROWS_PX:
        return True
    if figures.poses_px is None or figures.probability is None or figures.probability < 0.5:
        return None
    if figures.poses_px <= LINES_PX:
        return True
    return False if figures.probability >= LEAST_PROBABILITY else None


def _with_down(camera: CameraRecord, record: RunRecord, earlier: Sequence[RunRecord]) -> CameraRecord:
    """Count for how many nights a camera has been down; add a note to one that is well again."""
    past = ((night.date, known.down) for night in earlier for known in night.cameras if known.id == camera.id)
    last_date, last_down = next(past, ("", None))
    if _camera_finding(camera, record):
        if last_down is None:
            return replace(camera, down=Down(record.date))
        return replace(camera, down=Down(last_down.since, last_down.nights + (last_date != record.date)))
    if last_down:
        note = f"back after {counted(last_down.nights, 'night')}: it was down since {last_down.since}"
        return replace(camera, notes=(*camera.notes, note))
    return camera


def blame(record: RunRecord) -> Mapping[str, tuple[str, ...]]:
    """Return cameras whose stated poses are contradicted by pairs, each with the other cameras that it excuses.

    A pair contradicts its poses if it matches better on shifted rows than on those that they give; if it matches on neither, it
    contradicts nothing.  Of the cameras without a usable pair, the one with most of these pairs explains them, then the one
    with most of the remaining ones.  If two have equally many, neither is more likely, and neither is blamed.
    """
    used = {name for pair in record.pairs if pair.ok for name in pair.cameras}
    remaining = [pair for pair in record.pairs if _contradicts_poses(pair)]
    suspects = {name for pair in remaining for name in pair.cameras} - used
    pairs_of = {name: {pair.name for pair in remaining if name in pair.cameras} for name in suspects}
    blamed: dict[str, set[str]] = {}
    while counts := Counter(name for pair in remaining for name in pair.cameras if name in suspects).most_common(2):
        (name, count), *others = counts
        if count < 2 or (others and others[0][1] == count):
            break
        blamed[name] = {pair.name for pair in remaining if name in pair.cameras}
        remaining = [pair for pair in remaining if name not in pair.cameras]
    explained = set().union(*blamed.values())
    excused = {name for name, pairs in pairs_of.items() if name not in blamed and pairs <= explained}
    return {name: tuple(sorted(n for n in excused if pairs_of[n] & pairs)) for name, pairs in blamed.items()}


def _contradicts_poses(pair: PairRecord) -> bool:
    share, chance = pair.figures.row_share, pair.figures.row_chance
    return not pair.ok and pair.figures.known == "stated" and share is not None and chance is not None and chance > share


def _with_blame(entry: Finding, excused: tuple[str, ...]) -> Finding:
    """Add that the stated pose of the camera is at fault, and which others have no usable pair because of it."""
    text = f"{entry.text}; a wrong stated pose of this camera explains that better than one of any other camera"
    if excused:
        have = "has" if len(excused) == 1 else "have"
        text += f"; {' and '.join(excused)} {have} no conclusive pair with another camera"
    remedy = "its pose is not the one in the site file: measure it again, or leave it out to have it solved"
    return replace(entry, text=text, remedy=remedy)


def check_captures(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Did captures change during the run, and does each camera deliver images of its own?"""
    in_motion = {camera.id: camera.captures_in_motion for camera in record.cameras if camera.captures_in_motion}
    if in_motion:
        files = [name for names in in_motion.values() for name in names]
        yield finding("captures-in-motion", tuple(in_motion), {"captures": len(files)}, captures=_names(files))
    alike: dict[str, list[str]] = {}
    for camera in record.cameras:
        if camera.figures.picture_digest and (camera.figures.contrast or 0.0) > LEAST_CONTRAST:
            alike.setdefault(camera.figures.picture_digest, []).append(camera.id)
    for names in alike.values():
        if len(names) > 1:
            yield finding("cameras-alike", tuple(names), cameras=_names(names))


def check_pictures(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Are images too blurred, noisy, badly lit or coarsely coded for measuring?"""
    used = [camera for camera in record.cameras if camera.ok]
    soft = [camera for camera in used if _is_soft(camera) or _is_unresolved(camera) or _fits_badly(camera, record)]
    if soft and (any(map(_is_soft, soft)) or len(soft) >= SOFT_SHARE * len(used)):
        worst = {name: max(_figure(camera, name) for camera in soft) for name in (*_SOFT_LIMITS, *_SHOWN_FIGURES)}
        worst["off_px"] = max(_off_px(camera, record) for camera in soft)
        worst["contrast"] = min(_figure(camera, "contrast") for camera in soft)
        names = tuple(camera.id for camera in soft)
        usual = max(_usual_misfit(camera, record) for camera in soft)
        compared = f" (usually {usual:.1f})" if usual else ""
        fit = f", points {worst['misfit']:.1f} times as far off as expected{compared}" if worst["misfit"] else ""
        yield finding("pictures-soft", names, worst, None, None, cameras=_names(names), fit=fit, **worst)


def _figure(camera: CameraRecord, name: str) -> float:
    return float(getattr(camera.figures, name) or 0.0)


def _is_soft(camera: CameraRecord) -> bool:
    """Is a camera out of focus, noisy or coarsely coded, by its images alone?"""
    return any(_figure(camera, name) > limit for name, limit in _SOFT_LIMITS.items())


def _is_unresolved(camera: CameraRecord) -> bool:
    """Are a camera's images overexposed or faint, or less resolved, by their points' errors, than their pixels promise?"""
    misfit = _figure(camera, "misfit")
    unresolved = misfit > MOST_MISFIT or (misfit > LEAST_MISFIT and misfit * _figure(camera, "detail_px") > UNRESOLVED)
    coarsely_coded = misfit * _figure(camera, "coarseness") > BLURRED_BY_CODING
    badly_lit = _figure(camera, "saturated") > OVEREXPOSED or 0.0 < _figure(camera, "contrast") < FAINT
    return unresolved or coarsely_coded or badly_lit


def _fits_badly(camera: CameraRecord, record: RunRecord) -> bool:
    """Are a camera's images distorted so that no F fits its matches, or is the misfit of its points much larger than usual?"""
    misfit, usual = _figure(camera, "misfit"), _usual_misfit(camera, record)
    return misfit * _off_px(camera, record) > UNSTEADY or bool(usual and misfit > WORSE_THAN_USUAL * usual)


def _usual_misfit(camera: CameraRecord, record: RunRecord) -> float:
    return record.usual.cameras.get(camera.id, {}).get("misfit", 0.0) if record.usual else 0.0


def _off_px(camera: CameraRecord, record: RunRecord) -> float:
    """Median distance of a camera's matches from the epipolar lines of its pairs' own F, pixels."""
    pairs = [pair.figures for pair in record.pairs_of(camera.id) if pair.ok and (pair.figures.probability or 0.0) > 0.5]
    return median(figures.epipolar_px or 0.0 for figures in pairs) if pairs else 0.0


def check_calibration(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Does the reference, or do the matches, contradict the lenses and poses that the site file states?"""
    if change := facts.calibration_change:
        yield finding("calibration-changed", reason=change)
    if record.poses and (check := record.poses.contradiction):
        figures = {"misfit": check.misfit, "better": check.better, "off_px": check.off_px}
        remedy = "subtract 0.5 from cx and cy of all cameras" if check.cause == "principal-points-corner" else None
        yield finding("calibration-contradicted", check.cameras, figures, None, remedy, explanation=_explanation(check))


_CAUSES: Mapping[str, str] = {
    "focal-lengths": "all focal lengths {longer}",
    "pixel-shape": "all horizontal focal lengths {longer}",
    "pixel-height": "all vertical focal lengths {longer}",
    "distortion": "a radial distortion that remains in all pictures (k1 off by {first:+.3f})",
    "distortion-factor": "{factor:.2g} times the stated distortion in all pictures",
    "distortion-of-one": "a radial distortion that remains in the pictures of {cameras} (k1 off by {first:+.3f})",
    "focal-lengths-and-distortion": "all focal lengths {longer} and k1 off by {last:+.3f}",
    "principal-points-corner": "principal points half a pixel less (counted from the first pixel's centre, not from its corner)",
    "principal-points": "all principal points shifted by {percent:.1f} % of the width",
    "headings": "all headings {degrees:.2f} degrees further {way}",
    "rolls": "all cameras rolled by {degrees:.2f} degrees",
    "focal-length": "the focal length of {cameras} {longer}",
    "turned": "{cameras} turned by {degrees:.2f} degrees",
    "moved": "{cameras} moved by {percent:.1f} % of the distance between cameras",
    "exchanged": "the poses of {cameras} exchanged",
    "captures-exchanged": "captures of {cameras} exchanged",
    "positions-exchanged": "the positions of {cameras} exchanged",
    "lenses-exchanged": "the lenses of {cameras} exchanged",
    "axes-exchanged": "positions with x and y exchanged",
    "t-for-positions": "positions that are in fact the t of x = R X + t",
    "rotations-transposed": "rotations that are in fact camera to world, not world to camera",
    "rotations-opengl": "rotations whose y and z axes point the other way (OpenGL)",
    "rotations-transposed-opengl": "rotations that are in fact camera to world, with y and z pointing the other way (OpenGL)",
    "stretched-x": "all positions {longer} along x",
    "stretched-y": "all positions {longer} along y",
    "stretched-z": "all positions {longer} along z",
    "mirrored-x": "positions mirrored in x",
    "mirrored-y": "positions mirrored in y",
    "mirrored-z": "positions mirrored in z",
    "mirrored-frames": "pictures of {cameras} mirrored",
    "upside-down": "pictures of {cameras} upside down",
}
"""Texts for the cause that best explains matches contradicting the stated calibration, by its name in the check."""
_ALL_CAMERAS = {
    "captures-exchanged": "all cameras, each with the next one,",
    "mirrored-frames": "all cameras",
    "upside-down": "all cameras",
}
"""Texts for `cameras` in causes that name no cameras if all are affected."""


def _explanation(check: CalibrationCheck) -> str:
    misfit = f"they lie {math.sqrt(check.misfit):.1f} times as far from their epipolar lines as noise explains"
    if not check.cause:
        return f"{misfit}; neither the lenses nor a single camera explain that"
    amount = check.amount or (0.0,)
    size, scale = math.hypot(*amount), math.expm1(amount[0])
    cause = _CAUSES[check.cause].format(
        cameras=" and ".join(check.cameras) or _ALL_CAMERAS.get(check.cause, ""),
        longer=f"{100 * abs(scale):.1f} % {'longer' if scale > 0 else 'shorter'}",
        first=amount[0],
        factor=1 + amount[0],
        last=amount[-1],
        percent=100 * size,
        degrees=math.degrees(size),
        way="clockwise" if amount[0] > 0 else "counterclockwise",
    )
    if check.sigmas:
        suffix = "" if check.cause == "principal-points-corner" else " or more"
        return f"dense matches are {check.sigmas:.0f} standard deviations off their predicted rows; {cause}{suffix} explain that"
    return f"{misfit}; {cause} would fit {check.better:.1f} times better"


def check_poses(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Are poses and lenses known well enough?  Even wrong ones may fit the images."""
    poses = record.poses or PosesSummary()
    contradicted: dict[str, list[PoseIssue]] = {}
    for issue in poses.issues_of("contradicted").values():
        contradicted.setdefault(issue.text, []).append(issue)
    for reason, issues in contradicted.items():
        # a contradiction of the calibration as a whole has a finding that explains these, too
        is_refuted = poses.rows_confirm or all(_is_refuted(issue, record) for issue in issues)
        if not poses.contradiction and not is_refuted:
            yield finding("poses-contradicted", tuple(issue.camera for issue in issues), reason=reason)
    if uncertain := poses.issues_of("uncertain"):
        row_px = max(issue.row_px or 0.0 for issue in uncertain.values())
        yield finding("poses-uncertain", tuple(uncertain), {"row_px": row_px}, row_px=row_px, cameras=_names(uncertain))
    if inconsistent := poses.issues_of("inconsistent"):
        strain = max(issue.strain or 0.0 for issue in inconsistent.values())
        excess_px = max(issue.excess_px or 0.0 for issue in inconsistent.values())
        figures = {name: value for name, value in (("strain", strain), ("excess_px", excess_px)) if value}
        reason = f"with these poses they are {excess_px:.1f} px farther from their epipolar lines than with each pair's own F"
        if strain:
            reason = f"those confirmed by a third camera fit other poses {strain:.0f} times better than noise explains"
        yield finding("poses-inconsistent", tuple(inconsistent), figures, cameras=_names(inconsistent), reason=reason)
    if lenses := poses.issues_of("lens-undetermined"):
        focal = max(issue.focal or 0.0 for issue in lenses.values())
        border_px = max(issue.border_px or 0.0 for issue in lenses.values())
        figures, names = {"focal": focal, "border_px": border_px}, _names(lenses)
        words = {"focal_percent": 100 * focal, "border_px": border_px}
        yield finding("lens-undetermined", tuple(lenses), figures, None, None, cameras=names, **words)


def check_depths(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Do pairs agree on depths?  A wrong pose or lens can shift depths along epipolar lines, where matches do not reveal it."""
    if record.poses and record.poses.contradiction:
        return  # the finding on a contradiction explains wrong depths, too
    rows_agree = record.poses is not None and record.poses.rows_agree
    solved = {camera.id for camera in record.cameras if camera.figures.pose_from == "solved"}
    too_large: list[tuple[float, float, float]] = []  # as a multiple of the limit, pixels, limit
    scores: Counter[str] = Counter()
    for camera in record.cameras:
        for pair, px in (camera.figures.offset_px or {}).items():
            if px > LOOK_ALIKES_PX:
                continue
            cameras = dict.fromkeys([camera.id, *map(camera_of, pair.split("--"))])
            limit = MOST_DIFFERENCE_SOLVED_PX if rows_agree or solved & cameras.keys() else MOST_DIFFERENCE_PX
            if px > limit:
                too_large.append((px / limit, px, limit))
            scores.update(dict.fromkeys(cameras, 1 if px > limit else -1))
    if not too_large or (len(too_large) == 1 and too_large[0][0] <= SINGLE_DIFFERENCE_FACTOR):
        return
    _, px, limit = max(too_large)
    highest = max(scores.values())
    suspects = tuple(camera for camera, score in scores.items() if score == highest >= 0)
    cause = "no single camera explains it; all may be slightly off"
    if suspects:
        cause = f"the pose or lens of {' or '.join(suspects)} is probably wrong"
    yield finding("pairs-disagree", suspects, {"offset_px": px}, {"offset_px": limit}, px=px, limit=limit, cause=cause)


def check_survey(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Do stated distances, control points and units agree with the cameras' positions?"""
    poses = record.poses
    if poses is None:
        return
    if poses.distances_off:
        pair, (stated, measured) = max(poses.distances_off.items(), key=lambda entry: abs(math.log(entry[1][1] / entry[1][0])))
        suffix = f"; {others} more distances are off as well" if (others := len(poses.distances_off) - 1) else ""
        subject, figures, expected = tuple(pair.split("--")), {"metres": measured}, {"metres": stated}
        yield finding("distances-contradicted", subject, figures, expected, pair=pair, stated=stated, found=measured, more=suffix)
    if poses.points_off:
        error, tolerated = max(poses.points_off.values())
        names, figures, expected = _names(poses.points_off), {"off_m": error}, {"off_m": tolerated}
        yield finding("control-contradicted", (), figures, expected, off=error, points=names, tolerated=tolerated)
    if "nearest" in poses.units_off:
        nearest, limit = poses.units_off["nearest"]
        unit = "kilometres" if nearest < limit else "millimetres"
        figures, expected = {"nearest_m": nearest}, {"nearest_m": limit}
        yield finding("units-implausible", (), figures, expected, nearest=nearest, limit=limit, unit=unit)


def _names(names: Iterable[str]) -> str:
    return shortened(", ".join(names))


def check_tasks(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Did tasks fail?  One finding for each stage and cause; failures of a camera that is left out belong to its finding."""
    left_out = {camera.id for camera in record.cameras if not camera.ok}
    groups: dict[tuple[str, str | None], list[tuple[Task, State]]] = {}
    for task, state in facts.failed:
        is_of_lost_camera = len(task.subject) == 1 and camera_of(task.subject[0]) in left_out
        if not is_of_lost_camera and state.code != Cause.DISK_FULL:
            groups.setdefault((task.stage, state.code), []).append((task, state))
    for (_, code), tasks in groups.items():
        task, state = tasks[0]
        suffix = f" (and {len(tasks) - 1} more tasks with the same cause)" if len(tasks) > 1 else ""
        reason, remedy = shortened(state.reason or ""), None if code == Cause.FAULT else ""
        yield finding("task-failed", task.subject, {"tasks": len(tasks)}, remedy=remedy, task=task, reason=reason, more=suffix)


def check_cloud(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Is enough of the cloud right, as expected from the confidence of its points?"""
    cloud = record.cloud
    if cloud and cloud.correct_share is not None and cloud.correct_share < LEAST_CORRECT_SHARE:
        figures, expected = {"correct_share": cloud.correct_share}, {"correct_share": LEAST_CORRECT_SHARE}
        yield finding("cloud-doubtful", (), figures, expected, percent=100 * cloud.correct_share, limit=100 * LEAST_CORRECT_SHARE)


def check_amounts(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Is there as much as the site file expects, as the last good nights gave, or as the night itself planned?"""
    if facts.interrupted or not facts.product or not record.cloud or facts.disk_full:
        return
    usual = record.usual or Baseline(0, {})
    figures = figures_of(record) | {Measure.CAMERAS: float(sum(camera.ok for camera in record.cameras))}
    for name, value in figures.items():
        limit, amount, typical = facts.expected.limit(name), _amount_text(name, value), usual.figures.get(name)
        if limit > 1:
            if value < limit:
                yield _fewer_finding(name, value, limit, f"{amount}; at least {limit:,.0f} are expected")
        elif name == Measure.CAMERAS:
            continue  # each lost camera has a finding of its own
        elif typical is not None and value < limit * typical:
            source = "the reference's" if usual.reference else "the usual"
            yield _fewer_finding(name, value, typical, f"{amount}, {100 * value / typical:.0f} % of {source} {typical:,.0f}")
        elif typical is None and name == Measure.PAIRS and value < PLANNED_PAIRS * len(record.pairs):
            planned = float(len(record.pairs))
            text = f"only {value:.0f} of {planned:.0f} pairs could be used; most of the others: {_why_few(record)}"
            yield _fewer_finding(name, value, planned, text)


def _amount_text(name: str, value: float) -> str:
    units = {s.name: " ".join(s.summary.AMOUNT) for s in STAGES if s.summary and issubclass(s.summary, SiteSummary)}
    things: dict[str, str] = {Measure.POINTS: "point", Measure.PAIRS: "pair", Measure.CAMERAS: "camera"}
    return f"{value:,.0f} {units[name]}" if name in units else counted(value, things[name])


def _fewer_finding(name: str, value: float, base: float, text: str) -> Finding:
    return finding(f"fewer-{name}", (), {name: round(value)}, {name: round(base)}, reason=text)


def _most_common_reason(pairs: Iterable[PairRecord]) -> str:
    return shortened(Counter(str(pair.reason) for pair in pairs).most_common(1)[0][0])


def _why_few(record: RunRecord) -> str:
    unused = [pair for pair in record.pairs if not pair.ok]
    left_out = {camera.id for camera in record.cameras if not camera.ok}
    with_left_out = [pair for pair in unused if left_out & {camera_of(pair.left), camera_of(pair.right)}]
    if 2 * len(with_left_out) > len(unused):
        return f"include cameras that are left out ({_names(sorted(left_out))})"
    return _most_common_reason(unused)


def shortened(reason: str) -> str:
    """Limit the length of a reason, which may name every file; the record of the camera, pair or task contains all of it."""
    return reason if len(reason) <= MOST_LETTERS else f"{reason[: MOST_LETTERS - 3]}..."


Check = Callable[[RunRecord, Facts], Iterator[Finding]]
CHECKS: tuple[Check, ...] = (
    check_end,
    check_cameras,
    check_captures,
    check_pictures,
    check_calibration,
    check_poses,
    check_depths,
    check_survey,
    check_tasks,
    check_cloud,
    check_amounts,
)
"""All checks, in the order in which their findings are reported."""
