"""The first screen of the report: the verdict, what to do first, the main figures, and the findings with their pictures."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from ..errors import counted
from ..outcome.baseline import figures_of
from ..pipeline.stages import STAGES
from ..pipeline.summaries import ChangesSummary, SiteSummary
from ..records.record import Finding, RunRecord
from ..runner.state import Cause
from ..site.models import Measure
from ..task import Task
from .data import ReportData, since_last_good
from .pictures import Picture, Pictures

_MOST_OF_A_KIND = 4
"""Findings of one kind that are shown; more are folded."""


@dataclass(frozen=True)
class Fact:
    """A main figure of the night."""

    value: str
    words: str
    usual: str = ""
    grade: str = ""
    """fair or bad where it is clearly below usual."""


@dataclass(frozen=True)
class Headline:
    """The verdict in words."""

    level: str
    title: str
    words: str
    facts: tuple[Fact, ...]


@dataclass(frozen=True)
class ShownFinding:
    """A finding with its pictures."""

    subject: str
    camera: bool
    """Whether it is about one camera."""
    number: int
    """Of the camera in the page, from 1."""
    text: str
    remedy: str
    pictures: tuple[tuple[Picture | None, str], ...]
    """With their captions; None for a picture that is missing."""
    missing: str = "no picture could be read"
    """Text instead of a missing picture."""
    folded: bool = False


def headline(data: ReportData) -> Headline:
    """Return the verdict, what to do first, and the main figures."""
    record, verdict = data.record, data.record.verdict
    level = verdict.level if verdict else "good" if record.exit_code == 0 else "degraded" if record.cloud else "failed"
    findings = verdict.findings if verdict else ()
    cameras = [finding for finding in findings if finding.kind.startswith("camera-")]
    if level == "good":
        title = "A good night"
        words = "There is nothing to repair." if not findings else "The findings below may wait."
        words = f"{changes} {words}" if (changes := _changes(data)) else words if findings else "There is nothing to do."
    elif level == "degraded":
        title = f"{counted(len(cameras), 'camera')} to look at" if cameras else f"{counted(len(findings), 'thing')} to look at"
        cloud = "There is a cloud, but it is not as good as it should be. " if record.cloud else ""
        words = f"{cloud}{_first_remedy(findings)} {_changes(data)}".strip()
    else:
        interrupted = any(finding.kind == "interrupted" for finding in findings)
        title = "Interrupted" if interrupted else "No cloud this night"
        words = _shared(record, cameras) or _first_remedy(findings) or "The reasons are below."
    return Headline(level, title, words, tuple(_facts(data)))


def _shared(record: RunRecord, cameras: list[Finding]) -> str:
    """Return what to do where nearly all cameras have the same fault: then none of them is to blame."""
    kinds = {finding.kind for finding in cameras}
    if len(kinds) != 1 or len(cameras) < max(3, 0.8 * len(record.cameras)):
        return ""
    whose = "every camera" if len(cameras) == len(record.cameras) else f"{len(cameras)} of {len(record.cameras)} cameras"
    return f"The same is wrong with {whose}. First: look at what they share: power, network, the folder of the captures."


def _first_remedy(findings: tuple[Finding, ...]) -> str:
    first = next((finding for finding in findings if finding.remedy and finding.subject), None)
    first = first or next((finding for finding in findings if finding.remedy), None)
    if first is None:
        return ""
    end = "" if first.remedy[-1] in ".?!" else "."
    return f"First: {f'{first.about}: ' if first.subject else ''}{first.remedy}{end}"


def _facts(data: ReportData) -> list[Fact]:
    record = data.record
    usual = record.usual.figures if record.usual else {}
    now = figures_of(record)
    whose = "reference" if record.usual and record.usual.reference else "usual"
    well = sum(camera.ok for camera in record.cameras)
    found = [Fact(f"{well} of {len(record.cameras)}", "cameras", grade="" if well == len(record.cameras) else "bad")]
    good = sum(pair.ok for pair in record.pairs)
    most = max(len(record.pairs), round(usual.get(Measure.PAIRS, 0)))
    if most:
        found.append(Fact(f"{good} of {most}", "pairs of cameras", grade=_grade(good, usual.get(Measure.PAIRS))))
    if record.cloud:
        base = usual.get(Measure.POINTS)
        words = f"{whose}: {base:,.0f}" if base else ""
        found.append(Fact(f"{record.cloud.points:,}", "points", words, _grade(now[Measure.POINTS], base)))
    for stage, result in record.results.items():
        if stage in now:
            base, (unit, measured) = usual.get(stage), result.AMOUNT
            words = f"{whose}: {base:,.0f} {unit}" if base else ""
            found.append(Fact(f"{now[stage]:,.0f} {unit}", measured, words, _grade(now[stage], base)))
        if (count := _change_count(result)) is not None:
            since, words = since_last_good(data, stage), f"change{'s' * (count != 1)} since the reference"
            found.append(Fact(str(count), words, f"{count - len(since.known)} since {since.date}" if since and count else ""))
    seconds = record.seconds.wall
    found.append(
        Fact(
            f"{seconds / 60:.0f} min" if seconds >= 100 else f"{seconds:.0f} s",
            "from captures to cloud" if record.cloud else "until it was clear",
        )
    )
    return found


def _change_count(result: SiteSummary) -> int | None:
    """Return how many objects a stage has found to differ from the reference; None where it compared nothing."""
    return result.count if isinstance(result, ChangesSummary) and result.compared else None


def _changes(data: ReportData) -> str:
    """Return a sentence with the number and kinds of changes since the reference; "" without any."""
    for stage, result in data.record.results.items():
        if count := _change_count(result):
            kinds = Counter(thing.kind or "other" for thing in result.objects.values())
            named = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common())
            since = since_last_good(data, stage)
            newer = f"; {count - len(since.known) or 'none'} of them since {since.date}" if since else ""
            return f"{counted(count, 'change')} since the reference{f' ({named})' if named else ''}{newer}."
    return ""


def _grade(value: float, base: float | None) -> str:
    """Compare a figure with what is usual: for the colour alone, the verdict has its own limits."""
    if not base:
        return ""
    return "" if value >= 0.9 * base else "fair" if value >= 0.7 * base else "bad"


def findings(data: ReportData, album: Pictures) -> list[ShownFinding]:
    """Return the findings of a night with their pictures, the most important first."""
    record = data.record
    numbers = {camera.id: k for k, camera in enumerate(record.cameras, 1)}
    absent = {camera.id for camera in record.cameras if camera.code == Cause.NO_CAPTURE}
    found: list[ShownFinding] = []
    kinds, stated = Counter[str](), record.verdict.findings if record.verdict else ()
    shown = 1 if _shared(record, [finding for finding in stated if finding.kind.startswith("camera-")]) else _MOST_OF_A_KIND
    for finding in stated:
        kinds[finding.kind] += 1
        folded = kinds[finding.kind] > shown
        name = finding.about
        camera = finding.subject[0] if len(finding.subject) == 1 and finding.subject[0] in numbers else None
        pictures: list[tuple[Picture | None, str]] = []
        if camera and not folded:
            tonight, then = album.of_frame(camera, f"{camera} on {record.date}"), album.of_last_good(camera)
            if tonight or then:
                pictures = [(tonight, f"this night, {record.date}"), *([(then, then.alt)] if then else [])]
        elif len(finding.subject) == 2:
            of_pair = [album.of_task(Task(stage.name, finding.subject), name) for stage in STAGES if stage.scope == "pair"]
            pictures.extend([(picture, name) for picture in of_pair if picture][:2])
        number = numbers.get(name, 0)
        one = ShownFinding(name, camera is not None, number, finding.text, finding.remedy, tuple(pictures), folded=folded)
        found.append(replace(one, missing="no picture arrived") if camera in absent else one)
    return found
