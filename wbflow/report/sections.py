"""The sections of the report: first screen, cameras, pairs with the stages they reached, site-wide results, and settings."""

from __future__ import annotations

import math
import mimetypes
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from ..cache.receipt import Preimage
from ..json_dataclass import read_json
from ..pipeline.meanings import meaning, shown
from ..pipeline.stages import CHANGES, STAGES
from ..pipeline.summaries import ChangesSummary, PairFigures, RecordedChange, SiteSummary, volume_words
from ..records.findings import Finding
from ..records.record import NO_SCALE, STATE_SCALE, CameraRecord, PairRecord, RunRecord
from ..runner.state import Cause
from ..site.models import Measure
from ..task import Task
from ..verdict.baseline import figures_of
from ..words import counted, format_value
from .data import ReportData, is_number, state_of
from .pictures import Picture, Pictures

BADGES = {"good": "as it should be", "warn": "look at it", "bad": "down"}
"""Labels of the camera states."""
_MOST_OF_A_KIND = 4
"""Largest number of findings of one kind that are shown in full; further ones are folded."""
_SAID_OF_CHANGES = {"id", "kind", "first", "last", "grown", "news_most", "seen", "acknowledged"}
"""What a change's title and text say; all else is listed with its figures."""
_MOST_FIGURES = 8
"""Largest number of figures shown for a stage that a pair reached."""


Captioned = tuple[Picture | str, str]
"""A picture, or the text that replaces it if it is missing; and its caption."""


class Fact(NamedTuple):
    """A main figure of the night."""

    value: str
    label: str
    note: str = ""
    grade: str = ""
    """fair or bad if it is clearly below the usual value."""


@dataclass(frozen=True)
class Thing:
    """A change since the reference."""

    name: str
    title: str
    size: str
    since: str
    known: str
    """Who has acknowledged it; "" if it is not acknowledged."""
    picture: Picture | None
    figures: Mapping[str, Any]


@dataclass(frozen=True)
class Part:
    """The result of a site-wide stage."""

    title: str
    reason: str
    files: tuple[str, ...]
    since: str = ""
    """What is different from the last good night."""
    picture: Picture | None = None
    rows: tuple[tuple[str, str], ...] = ()
    volumes: tuple[tuple[str, ...], ...] = ()
    things: tuple[Thing, ...] = ()


def headline(data: ReportData) -> tuple[str, str, str]:
    """Return the level of the verdict, a title, and a text with its reason and what to do first."""
    record, verdict = data.record, data.record.verdict
    level = verdict.level if verdict else "good" if record.exit_code == 0 else "degraded" if record.cloud else "failed"
    findings = verdict.findings if verdict else ()
    cameras = [finding for finding in findings if finding.kind.startswith("camera-")]
    changes = _changes_sentence(data)
    if level == "good":
        advice = "The findings below may wait." if findings else f"There is nothing to {'repair' if changes else 'do'}."
        return level, "A good night", _sentences(changes, _scale_sentence(record), advice)
    if level == "degraded":
        title = f"{counted(len(cameras), 'camera')} to look at" if cameras else f"{counted(len(findings), 'thing')} to look at"
        cloud = "There is a cloud, but it is not as good as it should be." if record.cloud else ""
        return level, title, _sentences(cloud, _first_remedy(findings), changes, _scale_sentence(record))
    title = "Interrupted" if any(finding.kind == "interrupted" for finding in findings) else "No cloud this night"
    return level, title, _same_fault(record, cameras) or _first_remedy(findings) or "The reasons are below."


def _sentences(*sentences: str) -> str:
    return " ".join(sentence for sentence in sentences if sentence)


def _scale_sentence(record: RunRecord) -> str:
    """Return what to do about a cloud whose lengths are not metres."""
    return f"{NO_SCALE.capitalize()}, not metres: {STATE_SCALE}." if record.unscaled else ""


def _same_fault(record: RunRecord, cameras: list[Finding]) -> str:
    """Return what to do if nearly all cameras have the same fault, whose cause is then common to them; else ""."""
    kinds = {finding.kind for finding in cameras}
    if len(kinds) != 1 or len(cameras) < max(3, 0.8 * len(record.cameras)):
        return ""
    affected = "All" if len(cameras) == len(record.cameras) else f"{len(cameras)} of {len(record.cameras)}"
    shared = "power, network, the folder of the captures"
    return f"{affected} cameras have the same problem. Check first what they have in common: {shared}."


def _first_remedy(findings: tuple[Finding, ...]) -> str:
    with_remedy = [finding for finding in findings if finding.remedy]
    first = next((finding for finding in with_remedy if finding.subject), next(iter(with_remedy), None))
    if first is None:
        return ""
    end = "" if first.remedy[-1] in ".?!" else "."
    return f"First: {f'{first.about}: ' if first.subject else ''}{first.remedy}{end}"


def facts(data: ReportData) -> Iterator[Fact]:
    """Yield the main figures."""
    record, values = data.record, figures_of(data.record)
    usual = record.usual.figures if record.usual else {}
    base_name = "reference" if record.usual and record.usual.reference else "usual"

    def measured_fact(name: str, unit: str, label: str) -> Fact:
        base = usual.get(name)
        note = f"{base_name}: {base:,.0f} {unit}".rstrip() if base else ""
        return Fact(f"{values[name]:,.0f} {unit}".rstrip(), label, note, _grade(values[name], base))

    usable_cameras = sum(camera.ok for camera in record.cameras)
    all_cameras = len(record.cameras)
    yield Fact(f"{usable_cameras} of {all_cameras}", "cameras", grade="" if usable_cameras == all_cameras else "bad")
    usable_pairs, usual_pairs = sum(pair.ok for pair in record.pairs), usual.get(Measure.PAIRS, 0)
    if all_pairs := max(len(record.pairs), round(usual_pairs)):
        yield Fact(f"{usable_pairs} of {all_pairs}", "pairs of cameras", grade=_grade(usable_pairs, usual_pairs))
    if record.cloud:
        yield measured_fact(Measure.POINTS, "", "points")
    if record.unscaled:
        yield Fact("no scale", NO_SCALE, grade="fair")
    if record.poses and record.poses.unverified:
        yield Fact("unverified", "calibration: too few matches to check it", grade="fair")
    for stage, result in record.results.items():
        if stage in values:
            yield measured_fact(stage, *result.AMOUNT)
    if _is_compared(record):
        changes, since = record.changes, data.since_last_good
        notes = [f"{since.new} since {since.date}"] if since and changes else []
        if acknowledged := sum(bool(change.acknowledged) for change in changes.values()):
            notes.append(f"{acknowledged} acknowledged")
        yield Fact(str(len(changes)), f"change{'s' * (len(changes) != 1)} since the reference", ", ".join(notes))
    seconds = record.seconds.wall
    duration = f"{seconds / 60:.0f} min" if seconds >= 100 else f"{seconds:.0f} s"
    yield Fact(duration, "from captures to cloud" if record.cloud else "until the run ended")


def volume_facts(data: ReportData) -> Iterator[Fact]:
    """Yield the volumes that changed, as main figures."""
    for result in data.record.results.values():
        for ground, gained, lost, seen_area, unseen_area in _volumes(result, data.unit):
            yield Fact(gained, f"gained, {ground}")
            yield Fact(lost, f"lost, {ground}")
            yield Fact(seen_area, "seen on both nights", f"not seen: {unseen_area}")


def _is_compared(record: RunRecord) -> bool:
    """Return whether the night was compared with the reference."""
    result = record.results.get(CHANGES)
    return isinstance(result, ChangesSummary) and result.compared is True


def _changes_sentence(data: ReportData) -> str:
    """Return a sentence with the number and kinds of changes since the reference; "" if there are none."""
    changes, since = data.record.changes, data.since_last_good
    if not changes or not _is_compared(data.record):
        return ""
    kinds = Counter(change.kind or "other" for change in changes.values())
    named = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common())
    parts = [f"{counted(len(changes), 'change')} since the reference ({named})"]
    if since:
        parts.append(f"{since.new or 'none'} of them since {since.date}")
    if acknowledged := sum(bool(change.acknowledged) for change in changes.values()):
        parts.append(f"{acknowledged} acknowledged")
    return "; ".join(parts) + "."


def _grade(value: float, base: float | None) -> str:
    """Grade a figure against its usual value, for its colour only; the verdict has its own limits."""
    if not base:
        return ""
    return "" if value >= 0.9 * base else "fair" if value >= 0.7 * base else "bad"


def findings(data: ReportData, album: Pictures) -> tuple[list[tuple[Finding, Sequence[Captioned]]], list[Finding]]:
    """Return the findings of a night with their pictures, the most important first; and further ones of the same kinds, which are
    folded and have no pictures."""
    reported = data.record.verdict.findings if data.record.verdict else ()
    is_common = _same_fault(data.record, [finding for finding in reported if finding.kind.startswith("camera-")])
    limit = 1 if is_common else _MOST_OF_A_KIND
    counts, in_full, folded = Counter[str](), [], []
    for finding in reported:
        counts[finding.kind] += 1
        if counts[finding.kind] > limit:
            folded.append(finding)
        else:
            in_full.append((finding, _pictures(data, album, finding)))
    return in_full, folded


def _pictures(data: ReportData, album: Pictures, finding: Finding) -> Sequence[Captioned]:
    name, record = finding.about, data.record
    if camera := next((camera for camera in record.cameras if camera.id == name), None):
        picture, good_picture = album.of_task(data.frame(name), f"{name} on {record.date}"), album.of_last_good(name)
        missing = "no picture arrived" if camera.code == Cause.NO_CAPTURE else "no picture could be read"
        if good_picture:
            return [(picture or missing, f"this night, {record.date}"), (good_picture, good_picture.alt)]
        return [(picture, f"this night, {record.date}")] if picture else []
    if len(finding.subject) == 2:
        of_pair = (album.of_task(Task(stage.name, finding.subject), name) for stage in STAGES)
        return [(picture, name) for picture in of_pair if picture][:2]
    return []


def cameras(data: ReportData) -> list[tuple[str, int, CameraRecord]]:
    """Return state, number in the site file (from 1), and record of each camera: "bad" ones first, then "warn" ones, otherwise in
    the order of the site file."""
    rows = [(state_of(camera, data.record), data.numbers[camera.id], camera) for camera in data.record.cameras]
    return sorted(rows, key=lambda entry: ("bad", "warn", "good").index(entry[0]))


def camera_figures(data: ReportData, camera: CameraRecord) -> tuple[list[tuple[str, str, str]], dict[str, float]]:
    """Return title, explanation and value of a camera's main figures, and its other numbers by name."""
    numbers = {name: value for name, value in vars(camera.figures).items() if is_number(value)}
    points, pairs = numbers.pop("points", None), data.record.pairs_of(camera.id)
    main_figures = [("used pairs", "of its pairs, those matched densely", f"{sum(p.ok for p in pairs)} of {len(pairs)}")]
    if points is not None:
        main_figures.append((meaning("points").title, meaning("points").words, format_value(points)))
    for result in data.record.results.values():
        for name, value in vars(result).items():
            if isinstance(value, Mapping) and isinstance(share := value.get(camera.id), float):
                main_figures.append((meaning(name).title, meaning(name).words, f"{100 * share:.1f} %"))
    return main_figures, numbers


def keypoints(data: ReportData, camera: CameraRecord) -> str:
    """Return how many keypoints and inliers a camera's picture has."""
    points = camera.figures.keypoints
    inliers = [p.figures.inliers for p in data.record.pairs_of(camera.id) if p.matched and p.figures.inliers]
    texts = f"{points:,} keypoints" if points else "", f"{sum(inliers):,} inliers in {len(inliers)} pairs" if inliers else ""
    return ", ".join(filter(None, texts))


def camera_words(data: ReportData, camera: CameraRecord) -> str:
    """Return the state of a camera in words; "" if it is well on a night without a reference."""
    without_reference = data.record.reference is None
    health = camera.health.text if camera.health and not (without_reference and camera.health.ok) else ""
    text = health if camera.ok else camera.reason or camera.outcome
    return "; ".join(filter(None, (text, camera.down.words(left_out=not camera.ok) if camera.down else "")))


def pair_columns(data: ReportData) -> list[str]:
    """Return the names of the figures that at least one pair has."""
    names = [field.name for field in fields(PairFigures)]
    return [name for name in names if any(getattr(pair.figures, name) not in {None, ""} for pair in data.record.pairs)]


def tried(data: ReportData, pair: PairRecord) -> Iterator[tuple[str, str, str]]:
    """Yield name, outcome and figures, named as in run.json, of each stage that a pair reached; for a rejection, the figures that
    led to it."""
    for stage in STAGES:
        event = data.tasks.get(Task(stage.name, (pair.left, pair.right)))
        if event is None or event.outcome == "skipped":
            continue
        method, texts = None, list[str]()
        if receipt := data.receipt(event.task):
            method = receipt.preimage.parameters.get(stage.method.parameter) if stage.method else None
            summary = stage.summary if receipt.outcome != "rejected" else None
            figures = vars(read_json(summary, receipt.figures)) if summary else receipt.figures
            numbers = [(name, value) for name, value in figures.items() if is_number(value) and not math.isnan(value)]
            texts = [f"{meaning(name).title} {format_value(value)}" for name, value in numbers[:_MOST_FIGURES]]
        details = "; ".join(filter(None, (f"by {method}" if method else "", event.reason, ", ".join(texts))))
        yield stage.name, "done" if event.usable else event.outcome, details


def pair_pictures(data: ReportData, album: Pictures) -> list[tuple[str, list[Picture]]]:
    """Return the pictures of each pair that has any."""
    rows = []
    drawn = [stage.name for stage in STAGES if stage.scope == "pair" and "picture" in stage.products.product_files]
    for pair in data.record.pairs:
        tasks = [Task(name, (pair.left, pair.right)) for name in drawn]
        if pictures := [picture for task in tasks if (picture := album.of_task(task, str(task)))]:
            rows.append((pair.name, pictures))
    return rows


def parts(data: ReportData, album: Pictures) -> list[Part]:
    """Return the results of each site-wide stage in run.json; changes that are not acknowledged come first."""
    rows = []
    for stage in STAGES:
        result = data.record.results.get(stage.name)
        if result is None:
            continue
        title, reason = stage.products.title, result.reason or ""
        if isinstance(result, ChangesSummary) and result.compared is False:
            rows.append(Part(title, reason, result.files, since="There was nothing to compare this night with."))
            continue
        things = sorted(_things(data, result, album), key=lambda thing: bool(thing.known))
        picture = album.of_task(Task(stage.name), title)
        since = data.since_last_good if stage.name == CHANGES else None
        gone_text = ""
        if since and since.gone:
            gone = (f"{change.kind or 'something'} ({_dimensions(change, data.unit)})" for change in since.gone.values())
            gone_text = f"Differed on {since.date}, the last good night, and are as in the reference again: {', '.join(gone)}."
        figures, volumes = tuple(shown(vars(result))), tuple(_volumes(result, data.unit))
        rows.append(Part(title, reason, result.files, gone_text, picture, figures, volumes, tuple(things)))
    return rows


def _things(data: ReportData, result: SiteSummary, album: Pictures) -> Iterator[Thing]:
    for name, change in result.objects.items():
        file = next((f for f in result.files if f.rpartition(".")[0].endswith(f"-{name}") and is_picture(f)), None)
        title = f"{name}: {change.kind}".rstrip(": ")
        picture = album.of_product(file, f"{title}: then and this night") if file else None
        figures = {}
        for key, value in vars(change).items():
            if key not in _SAID_OF_CHANGES:
                figures[key.replace("_", " ")] = value
        when = _since(change, data.record.date)
        yield Thing(name, title, _dimensions(change, data.unit), when, change.acknowledged, picture, figures)


def _since(change: RecordedChange, night: str) -> str:
    """Return since when a change is there."""
    texts = ["new this night" if change.first == night else f"since {change.first}"] if change.first else []
    if change.grown:
        texts.append("grown this night" if change.grown == night else f"grew on {change.grown}")
    if not change.seen:
        texts.append(f"not seen this night, last on {change.last}")
    return "; ".join(texts)


def _volumes(result: SiteSummary, unit: str) -> Iterator[tuple[str, ...]]:
    def area(value: float) -> str:
        return f"{value:,.1f} {unit}²" if unit else f"{value:,.1f}"

    for zone, part in result.volumes.items():
        gained = volume_words((part.gained_least, part.gained_most), (part.gained, part.gained_sigma), unit)
        lost = volume_words((part.lost_least, part.lost_most), (part.lost, part.lost_sigma), unit)
        yield zone or "whole site", gained, lost, area(part.area), area(part.unseen)


def _dimensions(change: RecordedChange, unit: str) -> str:
    """Return the size, volume and place of a change."""
    size = " × ".join(f"{side:.1f}" for side in (change.length, change.width, change.height))
    texts = [f"{size} {unit}".strip()]
    if change.volume or change.volume_most:
        texts.append(f"volume {change.volume_words(unit)}")
    texts.append(f"at {change.x:.1f}, {change.y:.1f}, {change.z:.1f}")
    return "; ".join(texts)


def is_picture(file: str) -> bool:
    """Return whether a file is a picture, by its name."""
    return (mimetypes.guess_type(file)[0] or "").startswith("image/")


def settings(data: ReportData) -> list[tuple[str, Preimage]]:
    """Return the function, code and parameters of each stage."""
    preimages: dict[str, Preimage] = {}
    for task in data.tasks:
        if task.stage not in preimages and (receipt := data.receipt(task)):
            preimages[task.stage] = receipt.preimage
    return [(stage.name, preimages[stage.name]) for stage in STAGES if stage.name in preimages]
