"""The first screen of the report: the verdict in words, the main figures, and the findings with their pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from ..pipeline.stages import CHANGES, STAGES
from ..pipeline.summaries import ChangesSummary
from ..records.findings import Finding
from ..records.record import NO_SCALE, STATE_SCALE, CameraRecord, RunRecord
from ..runner.state import Cause
from ..site.models import Measure
from ..task import Task
from ..verdict.baseline import figures_of
from ..words import counted
from .data import ReportData
from .pictures import Picture, Pictures

_MOST_OF_A_KIND = 4
"""Largest number of findings of one kind that are shown in full; further ones are folded."""
_FEWEST_ALIKE = 3
"""Fewest cameras with the same fault for a common cause; with fewer, it may be chance."""
_LEAST_ALIKE = 0.8
"""Least share of all cameras with the same fault for a common cause: larger, and one camera that works hides it."""
_GOOD_SHARE = 0.9
"""A figure of at least this share of its usual value has no colour."""
_FAIR_SHARE = 0.7
"""A figure below this share of its usual value is bad."""
_LONGEST_IN_SECONDS = 100
"""Longer times are given in minutes."""


Captioned = tuple[Picture | str, str]
"""A picture, or the text that replaces it if it is missing; and its caption."""


class Fact(NamedTuple):
    """A main figure of the night."""

    value: str
    label: str
    note: str = ""
    grade: str = ""
    """fair or bad if it is clearly below the usual value."""


def headline(data: ReportData) -> tuple[str, str, str]:
    """Return the level of the verdict, a title, and a text with its reason and what to do first."""
    record = data.record
    level = _level(record)
    findings = _findings_of(record)
    cameras = _about_cameras(findings)
    changes = _changes_sentence(data)
    if level == "good":
        if findings:
            advice = "The findings below may wait."
        elif changes:
            advice = "There is nothing to repair."
        else:
            advice = "There is nothing to do."
        return level, "A good night", _sentences(changes, _scale_sentence(record), advice)
    if level == "degraded":
        subjects = counted(len(findings), "thing")
        if cameras:
            subjects = counted(len(cameras), "camera")
        cloud = ""
        if record.cloud:
            cloud = "There is a cloud, but it is not as good as it should be."
        text = _sentences(cloud, _first_remedy(findings), changes, _scale_sentence(record))
        return level, f"{subjects} to look at", text
    # no cloud: what all cameras have in common says more than the first of them
    title = "No cloud this night"
    if any(finding.kind == "interrupted" for finding in findings):
        title = "Interrupted"
    return level, title, _same_fault(record, cameras) or _first_remedy(findings) or "The reasons are below."


def _level(record: RunRecord) -> str:
    """Return the level of the verdict; of a run without one, what its exit code says."""
    if record.verdict:
        return record.verdict.level
    if record.exit_code == 0:
        return "good"
    if record.cloud:
        return "degraded"
    return "failed"


def _findings_of(record: RunRecord) -> Sequence[Finding]:
    if record.verdict is None:
        return ()
    return record.verdict.findings


def _about_cameras(findings: Iterable[Finding]) -> list[Finding]:
    return [finding for finding in findings if finding.kind.startswith("camera-")]


def _sentences(*sentences: str) -> str:
    return " ".join(filter(None, sentences))


def _scale_sentence(record: RunRecord) -> str:
    """Return what to do about a cloud whose lengths are not metres."""
    if not record.unscaled:
        return ""
    return f"{NO_SCALE.capitalize()}, not metres: {STATE_SCALE}."


def _same_fault(record: RunRecord, cameras: list[Finding]) -> str:
    """Return what to do if nearly all cameras have the same fault, whose cause is then common to them; else ""."""
    # different faults of many cameras have no common cause that can be named
    kinds = {finding.kind for finding in cameras}
    if len(kinds) != 1 or len(cameras) < max(_FEWEST_ALIKE, _LEAST_ALIKE * len(record.cameras)):
        return ""
    affected = "All"
    if len(cameras) < len(record.cameras):
        affected = f"{len(cameras)} of {len(record.cameras)}"
    shared = "power, network, the folder of the captures"
    return f"{affected} cameras have the same problem. Check first what they have in common: {shared}."


def _first_remedy(findings: Sequence[Finding]) -> str:
    """Return what to do first; "" if nothing can be done."""
    with_remedy = [finding for finding in findings if finding.remedy]
    if not with_remedy:
        return ""
    # what is about a camera or a pair says best where to go
    first = with_remedy[0]
    for finding in with_remedy:
        if finding.subject:
            first = finding
            break
    remedy = first.remedy
    if remedy[-1] not in ".?!":
        remedy += "."
    if first.subject:
        return f"First: {first.about}: {remedy}"
    return f"First: {remedy}"


def facts(data: ReportData) -> Iterator[Fact]:
    """Yield the main figures."""
    record = data.record
    values = figures_of(record)
    usual: Mapping[str, float] = {}
    base_name = "usual"
    if record.usual:
        usual = record.usual.figures
        if record.usual.reference:
            base_name = "reference"

    def measured_fact(name: str, unit: str, label: str) -> Fact:
        base = usual.get(name)
        note = ""
        if base:
            note = f"{base_name}: {base:,.0f} {unit}".rstrip()
        return Fact(f"{values[name]:,.0f} {unit}".rstrip(), label, note, _grade(values[name], base))

    # 1. What was in use.
    usable_cameras = sum(camera.ok for camera in record.cameras)
    all_cameras = len(record.cameras)
    grade = ""
    if usable_cameras < all_cameras:
        grade = "bad"
    yield Fact(f"{usable_cameras} of {all_cameras}", "cameras", grade=grade)
    usable_pairs = sum(pair.ok for pair in record.pairs)
    usual_pairs = usual.get(Measure.PAIRS, 0)
    # a night that tried fewer pairs than usual is measured by the usual number
    all_pairs = max(len(record.pairs), round(usual_pairs))
    if all_pairs:
        yield Fact(f"{usable_pairs} of {all_pairs}", "pairs of cameras", grade=_grade(usable_pairs, usual_pairs))

    # 2. What came of it.
    if record.cloud:
        yield measured_fact(Measure.POINTS, "", "points")
    if record.unscaled:
        yield Fact("no scale", NO_SCALE, grade="fair")
    if record.poses and record.poses.unverified:
        yield Fact("unverified", "calibration: too few matches to check it", grade="fair")
    # a stage may report one amount, such as the area that two cameras see
    for stage, result in record.results.items():
        if stage in values:
            yield measured_fact(stage, *result.AMOUNT)
    if _is_compared(record):
        yield _changes_fact(data)

    # 3. How long it took.
    duration = f"{record.seconds.wall:.0f} s"
    if record.seconds.wall >= _LONGEST_IN_SECONDS:
        duration = f"{record.seconds.wall / 60:.0f} min"
    label = "until the run ended"
    if record.cloud:
        label = "from captures to cloud"
    yield Fact(duration, label)


def _changes_fact(data: ReportData) -> Fact:
    """Return the number of changes since the reference, and how many of them are news."""
    count = len(data.record.changes)
    since = data.since_last_good
    notes = []
    if since and count:
        notes.append(f"{since.new} since {since.date}")
    acknowledged = _acknowledged_count(data.record)
    if acknowledged:
        notes.append(f"{acknowledged} acknowledged")
    plural = "s" * (count != 1)
    return Fact(str(count), f"change{plural} since the reference", ", ".join(notes))


def _acknowledged_count(record: RunRecord) -> int:
    return sum(bool(change.acknowledged) for change in record.changes.values())


def _is_compared(record: RunRecord) -> bool:
    """Return whether the night was compared with the reference."""
    result = record.results.get(CHANGES)
    return isinstance(result, ChangesSummary) and result.compared is True


def _changes_sentence(data: ReportData) -> str:
    """Return a sentence with the number and kinds of changes since the reference; "" if there are none."""
    changes = data.record.changes
    since = data.since_last_good
    if not changes or not _is_compared(data.record):
        return ""
    # the most frequent kinds come first
    kinds = Counter(change.kind or "other" for change in changes.values())
    named = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common())
    parts = [f"{counted(len(changes), 'change')} since the reference ({named})"]
    if since:
        parts.append(f"{since.new or 'none'} of them since {since.date}")
    acknowledged = _acknowledged_count(data.record)
    if acknowledged:
        parts.append(f"{acknowledged} acknowledged")
    return "; ".join(parts) + "."


def _grade(value: float, base: float | None) -> str:
    """Grade a figure against its usual value, for its colour only; the verdict has its own limits."""
    if not base or value >= _GOOD_SHARE * base:
        return ""
    if value >= _FAIR_SHARE * base:
        return "fair"
    return "bad"


def findings(data: ReportData, album: Pictures) -> tuple[list[tuple[Finding, Sequence[Captioned]]], list[Finding]]:
    """Return the findings of a night with their pictures, the most important first; and further ones of the same kinds, which are
    folded and have no pictures."""
    reported = _findings_of(data.record)
    limit = _MOST_OF_A_KIND
    if _same_fault(data.record, _about_cameras(reported)):
        # the headline says what all of them have
        limit = 1
    counts = Counter[str]()
    in_full: list[tuple[Finding, Sequence[Captioned]]] = []
    folded: list[Finding] = []
    # they come in the order of their importance
    for finding in reported:
        counts[finding.kind] += 1
        if counts[finding.kind] > limit:
            folded.append(finding)
        else:
            in_full.append((finding, _pictures(data, album, finding)))
    return in_full, folded


def _pictures(data: ReportData, album: Pictures, finding: Finding) -> Sequence[Captioned]:
    for camera in data.record.cameras:
        if camera.id == finding.about:
            return _pictures_of_camera(data, album, camera)
    if len(finding.subject) == 2:
        return _pictures_of_pair(album, finding)
    return []


def _pictures_of_camera(data: ReportData, album: Pictures, camera: CameraRecord) -> Sequence[Captioned]:
    """Return a camera's picture beside the last good one, so that one sees what is wrong; its own alone if there is none."""
    date = data.record.date
    picture = album.of_task(data.frame(camera.id), f"{camera.id} on {date}")
    good_picture = album.of_last_good(camera.id)
    caption = f"this night, {date}"
    if good_picture:
        missing = "no picture could be read"
        if camera.code == Cause.NO_CAPTURE:
            missing = "no picture arrived"
        return [(picture or missing, caption), (good_picture, good_picture.alt)]
    if picture:
        return [(picture, caption)]
    return []


def _pictures_of_pair(album: Pictures, finding: Finding) -> Sequence[Captioned]:
    """Return the first two pictures that stages made of a pair."""
    found: list[Captioned] = []
    for stage in STAGES:
        picture = album.of_task(Task(stage.name, finding.subject), finding.about)
        if picture:
            found.append((picture, finding.about))
    return found[:2]
