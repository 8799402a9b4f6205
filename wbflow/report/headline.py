"""The first words of a report: what the night came to, what to do, and what each finding looks like."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from ..errors import counted
from ..outcome.past import figures_of
from ..pipeline.stages import STAGES
from ..records.record import Finding, RunRecord
from ..runner.state import Cause
from ..site.models import Measure
from ..task import Task
from .album import Album, Shown
from .since import since_last_good
from .sources import Sources

_OF_A_KIND = 4
"""So many findings of one kind are shown; more are folded."""


@dataclass(frozen=True)
class Fact:
    """A figure that tells how much came of the night."""

    value: str
    words: str
    usual: str = ""
    grade: str = ""
    """fair or bad where it is clearly less than usual."""


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
    """It is about one camera."""
    number: int
    """Of the camera in the page, from 1."""
    text: str
    remedy: str
    pictures: tuple[tuple[Shown | None, str], ...]
    """With what is said below them; none for one that is not there."""
    lacking: str = "no picture could be read"
    """What is said in its place."""
    folded: bool = False
    """So many of its kind stand before it that it is shown on demand."""


def headline(sources: Sources) -> Headline:
    """The verdict, what to do first, and how much there is."""
    record, verdict = sources.record, sources.record.verdict
    level = verdict.level if verdict else "good" if record.exit_code == 0 else "degraded" if record.cloud else "failed"
    findings = verdict.findings if verdict else ()
    cameras = [finding for finding in findings if finding.kind.startswith("camera-")]
    if level == "good":
        title = "A good night"
        words = "There is nothing to do." if not findings else "What is said below may wait."
    elif level == "degraded":
        title = f"{counted(len(cameras), 'camera')} to look at" if cameras else f"{counted(len(findings), 'thing')} to look at"
        words = f"There is a cloud, but it is not all that it should be. {_todo(findings)}"
    else:
        interrupted = any(finding.kind == "interrupted" for finding in findings)
        title = "Interrupted" if interrupted else "No cloud this night"
        words = _shared(record, cameras) or _todo(findings) or "The reasons stand below."
    return Headline(level, title, words, tuple(_facts(sources)))


def _shared(record: RunRecord, cameras: list[Finding]) -> str:
    """What to do where next to all cameras have the same trouble: one of them is not to blame."""
    kinds = {finding.kind for finding in cameras}
    if len(kinds) != 1 or len(cameras) < max(3, 0.8 * len(record.cameras)):
        return ""
    whose = "every camera" if len(cameras) == len(record.cameras) else f"{len(cameras)} of {len(record.cameras)} cameras"
    return f"The same is wrong with {whose}. First: look at what they share: power, network, the folder of the captures."


def _todo(findings: tuple[Finding, ...]) -> str:
    """What to do first."""
    first = next((finding for finding in findings if finding.remedy and finding.subject), None)
    first = first or next((finding for finding in findings if finding.remedy), None)
    if first is None:
        return ""
    end = "" if first.remedy[-1] in ".?!" else "."
    return f"First: {f'{first.about}: ' if first.subject else ''}{first.remedy}{end}"


def _facts(sources: Sources) -> list[Fact]:
    record = sources.record
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
    for stage in STAGES:
        if stage.name in now and stage.reports and (expects := stage.reports.expects):
            base = usual.get(stage.name)
            words = f"{whose}: {base:,.0f} {expects.unit}" if base else ""
            found.append(Fact(f"{now[stage.name]:,.0f} {expects.unit}", expects.words, words, _grade(now[stage.name], base)))
        told = record.later.get(stage.name) or {}
        if isinstance(told, dict) and told.get("compared") and isinstance(told.get("count"), int):
            since, words = since_last_good(record, sources, stage.name), f"change{'s' * (told['count'] != 1)} since the reference"
            newer = f"{told['count'] - len(since.then)} since {since.date}" if since and told["count"] else ""
            found.append(Fact(str(told["count"]), words, newer))
    seconds = record.seconds.wall
    found.append(
        Fact(
            f"{seconds / 60:.0f} min" if seconds >= 100 else f"{seconds:.0f} s",
            "from captures to cloud" if record.cloud else "until it was clear",
        )
    )
    return found


def _grade(value: float, base: float | None) -> str:
    """Against what is usual: the verdict alone decides whether it is enough."""
    if not base:
        return ""
    return "" if value >= 0.9 * base else "fair" if value >= 0.7 * base else "bad"


def findings(sources: Sources, album: Album) -> list[ShownFinding]:
    """The findings of a night, the most important first."""
    record = sources.record
    numbers = {camera.id: k for k, camera in enumerate(record.cameras, 1)}
    absent = {camera.id for camera in record.cameras if camera.code == Cause.NO_CAPTURE}
    found: list[ShownFinding] = []
    kinds, all_told = Counter[str](), record.verdict.findings if record.verdict else ()
    shown = 1 if _shared(record, [finding for finding in all_told if finding.kind.startswith("camera-")]) else _OF_A_KIND
    for finding in all_told:
        kinds[finding.kind] += 1
        folded = kinds[finding.kind] > shown
        name = finding.about
        camera = finding.subject[0] if len(finding.subject) == 1 and finding.subject[0] in numbers else None
        pictures: list[tuple[Shown | None, str]] = []
        if camera and not folded:
            tonight, then = album.of_frame(camera, f"{camera} on {record.date}"), album.of_last_good(camera)
            if tonight or then:
                pictures = [(tonight, f"this night, {record.date}"), *([(then, then.alt)] if then else [])]
        elif len(finding.subject) == 2:
            of_pair = [album.of_task(Task(stage.name, finding.subject), name) for stage in STAGES if stage.scope == "pair"]
            pictures.extend([(picture, name) for picture in of_pair if picture][:2])
        number = numbers.get(name, 0)
        told = ShownFinding(name, camera is not None, number, finding.text, finding.remedy, tuple(pictures), folded=folded)
        found.append(replace(told, lacking="no picture has come") if camera in absent else told)
    return found
