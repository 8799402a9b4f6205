"""Cameras that are not in use or not as they should be, and since when."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from wbflow_stages.contracts.reasons import Reason

from ..pipeline.summaries import PosesSummary
from ..records.findings import FINDINGS, Down, Finding, finding
from ..records.record import CameraRecord, PairRecord, RunRecord
from ..runner.state import Cause
from ..site.models import Measure
from ..words import counted
from .blame import blame
from .facts import Facts
from .pose_votes import among_stated, is_refuted
from .wording import LEARNED_KEYPOINTS, listed, most_common_reason, shortened

_FEW_MATCHES = {
    Reason.TOO_FEW_MATCHES,
    Reason.TOO_FEW_INLIERS,
    Reason.WRONG_MATCHES,
    Reason.UNLIKELY_GEOMETRY,
    Reason.UNCERTAIN_ROWS,
}
"""Reasons of rejected pairs that more matches may remove."""
_WIDE_DEG = 30.0
"""If the views of all pairs of a camera are further apart, that is why few or none of them can be used."""
_OF_ITS_TASK = {Cause.TOO_SLOW, Cause.WORKER_LOST, Cause.OUT_OF_MEMORY}
"""Causes that lie in a task, not in the camera."""


def check_cameras(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Is each camera in use, and as it should be?  At most one finding each, with the number of nights that it has lasted."""
    blamed = blame(record)
    excused: set[str] = set()
    for names in blamed.values():
        excused.update(names)
    for camera in record.cameras:
        entry = _camera_finding(camera, record)
        down = camera.down
        if entry is None or down is None:  # `down` of a camera with a finding is never None
            continue
        if facts.disk_full and (camera.health is None or camera.health.ok):
            continue  # without its own results and those of its pairs, nothing can be said of it
        if facts.sift_alone and _lacks_matches(entry, camera, record):
            entry = replace(entry, remedy=f"{entry.remedy}; or {LEARNED_KEYPOINTS}")
        if entry.kind == "camera-no-usable-pair":
            may_be_dense = not facts.product and camera.figures.pose_from in {
                "stated",
                "observed",
            }  # on rows that its pose predicts
            if may_be_dense or camera.id in excused:
                continue
            if camera.id in blamed:
                entry = _with_blame(entry, blamed[camera.id])
        text = entry.text
        if down.nights > 1:
            text += f"; {down.words(left_out=not camera.ok)}"
        figures = {**entry.figures, "since": down.since, "nights": down.nights}
        yield replace(entry, text=text, figures=figures)


def _lacks_matches(entry: Finding, camera: CameraRecord, record: RunRecord) -> bool:
    """Does a camera have no pair, and so this finding, because too little of what it sees was matched?"""
    if entry.kind == "camera-unpaired":
        return camera.figures.pose_from != "stated"  # else pairs are chosen by the poses, not by what matches
    if entry.kind not in {"camera-no-usable-pair", "camera-unsolved"}:
        return False
    tried = _tried(camera.id, record)
    few = [pair for pair in tried if pair.code in _FEW_MATCHES]
    return not any(pair.ok or pair.matched for pair in tried) and 2 * len(few) > len(tried)


def with_down(camera: CameraRecord, record: RunRecord, earlier: Sequence[RunRecord]) -> CameraRecord:
    """Count for how many nights a camera has been down; add a note to one that is well again.

    earlier: the nights before, newest first.
    """
    last_date, last_down = _last_down(camera.id, earlier)
    if _camera_finding(camera, record):
        if last_down is None:
            return replace(camera, down=Down(record.date))
        nights = last_down.nights
        if last_date != record.date:  # another run of a night adds none
            nights += 1
        return replace(camera, down=Down(last_down.since, nights))
    if last_down:
        note = f"back after {counted(last_down.nights, 'night')}: it was down since {last_down.since}"
        return replace(camera, notes=(*camera.notes, note))
    return camera


def _last_down(camera: str, earlier: Sequence[RunRecord]) -> tuple[str, Down | None]:
    """The newest night that knows a camera, and since when it was down then; "" and None without such a night."""
    for night in earlier:
        for entry in night.cameras:
            if entry.id == camera:
                return night.date, entry.down
    return "", None


def _camera_finding(camera: CameraRecord, record: RunRecord) -> Finding | None:
    """Return the most important finding about a camera, if there is one."""
    if (camera.health and not camera.health.ok) or not camera.ok:
        return _fault_finding(camera)
    poses = record.poses or PosesSummary()
    moved = poses.issues_of("moved").get(camera.id)
    if moved:
        return finding("camera-moved", (camera.id,), reason=moved.text)
    unverified = poses.issues_of("unverified").get(camera.id)
    if unverified and not is_refuted(unverified, record):
        return finding("camera-unverified", (camera.id,), reason=unverified.text)
    return _pairs_finding(camera, record)


def _fault_finding(camera: CameraRecord) -> Finding:
    """Return the finding about a camera that has a fault or gave no result; the fault explains the missing result."""
    code = "camera-unsolved" if camera.code == Cause.UNSOLVED else "camera-lost"
    lost = FINDINGS[code]
    remedy_of_lost = lost.remedy
    if camera.code == Cause.NO_CAPTURE:
        remedy_of_lost = remedy_of_lost.replace("check the camera", "check that it delivers")
    elif camera.code == Cause.FAULT:  # of the program, not of the camera
        remedy_of_lost = FINDINGS["task-failed"].remedy
    elif camera.code in _OF_ITS_TASK:
        remedy_of_lost = ""  # the reason says what to do
    health = camera.health
    if health is None or health.ok:
        reason = shortened(camera.reason or camera.outcome)
        return finding(lost.code, (camera.id,), remedy=remedy_of_lost, reason=reason)
    reason = health.text
    remedy = health.remedy or None
    if not camera.ok:
        reason = f"{shortened(health.text)}; left out tonight"
        remedy = health.remedy or remedy_of_lost
    return finding(f"camera-{health.state}", (camera.id,), health.figures, health.expected, remedy, reason=reason)


def _pairs_finding(camera: CameraRecord, record: RunRecord) -> Finding | None:
    """Return the finding about a camera that has no pair, no usable one, or none that confirms its stated pose."""
    subject = (camera.id,)
    pairs = record.pairs_of(camera.id)
    if record.pairs and not pairs:  # without any pairs, the night has a finding of its own
        return finding("camera-unpaired", subject)
    tried = _tried(camera.id, record)
    unconfirming = _unconfirming(camera.id, tried, record)
    if unconfirming:
        names = listed(pair.name for pair in unconfirming)
        reason = f"no pair with another camera of stated pose could be used ({names}), and solved cameras adapt to a wrong pose"
        return finding("camera-unverified", subject, reason=reason)
    if not tried or any(pair.ok for pair in tried):
        return None
    if all(pair.outcome == "failed" for pair in tried):
        return None  # the tasks are at fault, not the camera, and have a finding
    count_text = f"none of its {len(tried)} pairs could" if len(tried) > 1 else "its only pair could not"
    remedy = FINDINGS["camera-no-usable-pair"].remedy
    if any(pair.figures.known == "stated" for pair in tried):
        remedy += "; or its pose is not the one in the site file: measure it again, or leave it out to have it solved"
    apart = _far_apart(tried)
    if apart:
        remedy = f"views more than {_WIDE_DEG:.0f} degrees apart often show nothing alike: add a camera in between; or {remedy}"
    reason = f"{count_text} be used{apart}: {most_common_reason(tried)}"
    usable = {str(Measure.PAIRS): 0}
    planned = {str(Measure.PAIRS): len(tried)}
    return finding("camera-no-usable-pair", subject, usable, planned, remedy, reason=reason)


def _far_apart(pairs: Sequence[PairRecord]) -> str:
    """How far apart the views of pairs are, as text; "" if those of some are near each other, or nothing is known of it."""
    angles = []
    for pair in pairs:
        if pair.figures.angle_deg is not None:
            angles.append(pair.figures.angle_deg)
    if not angles or min(angles) <= _WIDE_DEG:
        return ""
    return f" (views {min(angles):.0f} to {max(angles):.0f} degrees apart)"


def _tried(camera: str, record: RunRecord) -> list[PairRecord]:
    """Return the pairs of a camera that were worked on."""
    return [pair for pair in record.pairs_of(camera) if pair.outcome != "skipped" and pair.dense is not False]


def _unconfirming(camera: str, tried: Sequence[PairRecord], record: RunRecord) -> list[PairRecord]:
    """Return the pairs of a camera of stated pose with others of stated pose, if only pairs with solved cameras could be used,
    and none of these has a pose that two other probable pairs determine."""
    usable = [pair for pair in tried if pair.ok]
    stated = among_stated(tried, record)
    if not usable or not stated or any(pair.ok for pair in stated):
        return []
    # a partner with two more probable pairs has a pose that does not depend on this camera
    probable = [pair for pair in record.pairs if pair.ok and (pair.figures.probability or 0.0) > 0.5]
    counts: Counter[str] = Counter()
    for pair in probable:
        counts.update(name for name in pair.cameras if name != camera)
    for pair in usable:
        if pair in probable and any(counts[name] > 2 for name in pair.cameras):
            return []
    return stated


def _with_blame(entry: Finding, excused: tuple[str, ...]) -> Finding:
    """Add that the stated pose of the camera is at fault, and which others have no usable pair because of it."""
    text = f"{entry.text}; a wrong stated pose of this camera explains that better than one of any other camera"
    if excused:
        have = "has" if len(excused) == 1 else "have"
        text += f"; {' and '.join(excused)} {have} no conclusive pair with another camera"
    remedy = "its pose is not the one in the site file: measure it again, or leave it out to have it solved"
    return replace(entry, text=text, remedy=remedy)
