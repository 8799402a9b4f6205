"""The sections of the report: first screen, cameras, pairs with the stages they reached, site-wide results, and settings."""

from __future__ import annotations

import math
import mimetypes
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

from ..cache.receipt import Preimage, Receipt
from ..json_dataclass import read_json
from ..pipeline.meanings import meaning, shown
from ..pipeline.stages import CHANGES, STAGES, Stage
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
    record = data.record
    level = _level(record)
    findings = record.verdict.findings if record.verdict else ()
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
        subjects = counted(len(cameras), "camera") if cameras else counted(len(findings), "thing")
        title = f"{subjects} to look at"
        cloud = "There is a cloud, but it is not as good as it should be." if record.cloud else ""
        return level, title, _sentences(cloud, _first_remedy(findings), changes, _scale_sentence(record))
    was_interrupted = any(finding.kind == "interrupted" for finding in findings)
    title = "Interrupted" if was_interrupted else "No cloud this night"
    return level, title, _same_fault(record, cameras) or _first_remedy(findings) or "The reasons are below."


def _level(record: RunRecord) -> str:
    """Return the level of the verdict; of a run without one, what its exit code says."""
    if record.verdict:
        return record.verdict.level
    if record.exit_code == 0:
        return "good"
    return "degraded" if record.cloud else "failed"


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
    kinds = {finding.kind for finding in cameras}
    if len(kinds) != 1 or len(cameras) < max(_FEWEST_ALIKE, _LEAST_ALIKE * len(record.cameras)):
        return ""
    affected = "All"
    if len(cameras) < len(record.cameras):
        affected = f"{len(cameras)} of {len(record.cameras)}"
    shared = "power, network, the folder of the captures"
    return f"{affected} cameras have the same problem. Check first what they have in common: {shared}."


def _first_remedy(findings: tuple[Finding, ...]) -> str:
    with_remedy = [finding for finding in findings if finding.remedy]
    if not with_remedy:
        return ""
    # what is about a camera or a pair says best where to go
    first = with_remedy[0]
    for finding in with_remedy:
        if finding.subject:
            first = finding
            break
    about = f"{first.about}: " if first.subject else ""
    end = "" if first.remedy[-1] in ".?!" else "."
    return f"First: {about}{first.remedy}{end}"


def facts(data: ReportData) -> Iterator[Fact]:
    """Yield the main figures."""
    record = data.record
    values = figures_of(record)
    usual = record.usual.figures if record.usual else {}
    base_name = "reference" if record.usual and record.usual.reference else "usual"

    def measured_fact(name: str, unit: str, label: str) -> Fact:
        base = usual.get(name)
        note = f"{base_name}: {base:,.0f} {unit}".rstrip() if base else ""
        return Fact(f"{values[name]:,.0f} {unit}".rstrip(), label, note, _grade(values[name], base))

    # 1. What was in use.
    usable_cameras = sum(camera.ok for camera in record.cameras)
    all_cameras = len(record.cameras)
    yield Fact(f"{usable_cameras} of {all_cameras}", "cameras", grade="" if usable_cameras == all_cameras else "bad")
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
    for stage, result in record.results.items():
        if stage in values:
            yield measured_fact(stage, *result.AMOUNT)
    if _is_compared(record):
        changes = record.changes
        since = data.since_last_good
        notes = [f"{since.new} since {since.date}"] if since and changes else []
        acknowledged = sum(bool(change.acknowledged) for change in changes.values())
        if acknowledged:
            notes.append(f"{acknowledged} acknowledged")
        yield Fact(str(len(changes)), f"change{'s' * (len(changes) != 1)} since the reference", ", ".join(notes))

    # 3. How long it took.
    seconds = record.seconds.wall
    duration = f"{seconds / 60:.0f} min" if seconds >= _LONGEST_IN_SECONDS else f"{seconds:.0f} s"
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
    if not base or value >= _GOOD_SHARE * base:
        return ""
    return "fair" if value >= _FAIR_SHARE * base else "bad"


def findings(data: ReportData, album: Pictures) -> tuple[list[tuple[Finding, Sequence[Captioned]]], list[Finding]]:
    """Return the findings of a night with their pictures, the most important first; and further ones of the same kinds, which are
    folded and have no pictures."""
    reported = data.record.verdict.findings if data.record.verdict else ()
    is_common = _same_fault(data.record, _about_cameras(reported))
    limit = 1 if is_common else _MOST_OF_A_KIND
    counts = Counter[str]()
    in_full: list[tuple[Finding, Sequence[Captioned]]] = []
    folded: list[Finding] = []
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
        missing = "no picture arrived" if camera.code == Cause.NO_CAPTURE else "no picture could be read"
        return [(picture or missing, caption), (good_picture, good_picture.alt)]
    return [(picture, caption)] if picture else []


def _pictures_of_pair(album: Pictures, finding: Finding) -> Sequence[Captioned]:
    """Return the first two pictures that stages made of a pair."""
    found: list[Captioned] = []
    for stage in STAGES:
        picture = album.of_task(Task(stage.name, finding.subject), finding.about)
        if picture:
            found.append((picture, finding.about))
    return found[:2]


def cameras(data: ReportData) -> list[tuple[str, int, CameraRecord]]:
    """Return state, number in the site file (from 1), and record of each camera: "bad" ones first, then "warn" ones, otherwise in
    the order of the site file."""
    rows: list[tuple[str, int, CameraRecord]] = []
    for state in ("bad", "warn", "good"):
        for camera in data.record.cameras:
            if state_of(camera, data.record) == state:
                rows.append((state, data.numbers[camera.id], camera))
    return rows


def camera_figures(data: ReportData, camera: CameraRecord) -> tuple[list[tuple[str, str, str]], dict[str, float]]:
    """Return title, explanation and value of a camera's main figures, and its other numbers by name."""
    numbers = _numbers_in(vars(camera.figures))
    points = numbers.pop("points", None)
    pairs = data.record.pairs_of(camera.id)
    used = sum(pair.ok for pair in pairs)
    main_figures = [("used pairs", "of its pairs, those matched densely", f"{used} of {len(pairs)}")]
    if points is not None:
        main_figures.append((meaning("points").title, meaning("points").words, format_value(points)))
    # a site-wide stage may say something of each camera, as a share
    for result in data.record.results.values():
        for name, value in vars(result).items():
            share = value.get(camera.id) if isinstance(value, Mapping) else None
            if isinstance(share, float):
                main_figures.append((meaning(name).title, meaning(name).words, f"{100 * share:.1f} %"))
    return main_figures, numbers


def _numbers_in(figures: Mapping[str, Any]) -> dict[str, float]:
    return {name: value for name, value in figures.items() if is_number(value)}


def keypoints(data: ReportData, camera: CameraRecord) -> str:
    """Return how many keypoints and inliers a camera's picture has."""
    texts = []
    if camera.figures.keypoints:
        texts.append(f"{camera.figures.keypoints:,} keypoints")
    inliers = []
    for pair in data.record.pairs_of(camera.id):
        if pair.matched and pair.figures.inliers:
            inliers.append(pair.figures.inliers)
    if inliers:
        texts.append(f"{sum(inliers):,} inliers in {len(inliers)} pairs")
    return ", ".join(texts)


def camera_words(data: ReportData, camera: CameraRecord) -> str:
    """Return the state of a camera in words; "" if it is well on a night without a reference."""
    text = ""
    if not camera.ok:
        text = camera.reason or camera.outcome
    elif camera.health and not (camera.health.ok and data.record.reference is None):
        text = camera.health.text
    down_text = camera.down.words(left_out=not camera.ok) if camera.down else ""
    return "; ".join(filter(None, (text, down_text)))


def pair_columns(data: ReportData) -> list[str]:
    """Return the names of the figures that at least one pair has."""
    columns = []
    for field in fields(PairFigures):
        values = (getattr(pair.figures, field.name) for pair in data.record.pairs)
        if any(value not in {None, ""} for value in values):
            columns.append(field.name)
    return columns


def tried(data: ReportData, pair: PairRecord) -> Iterator[tuple[str, str, str]]:
    """Yield name, outcome and figures, named as in run.json, of each stage that a pair reached; for a rejection, the figures that
    led to it."""
    for stage in STAGES:
        event = data.tasks.get(Task(stage.name, (pair.left, pair.right)))
        if event is None or event.outcome == "skipped":
            continue
        details = [event.reason]
        receipt = data.receipt(event.task)
        if receipt:
            method = receipt.preimage.parameters.get(stage.method.parameter) if stage.method else None
            details = [f"by {method}" if method else "", event.reason, _figures_text(stage, receipt)]
        outcome = "done" if event.usable else event.outcome
        yield stage.name, outcome, "; ".join(filter(None, details))


def _figures_text(stage: Stage, receipt: Receipt) -> str:
    """Return the first figures of a result, or those that led to its rejection, in words."""
    figures = receipt.figures
    if stage.summary and receipt.outcome != "rejected":
        # as run.json names them, in its order
        figures = vars(read_json(stage.summary, receipt.figures))
    texts = []
    for name, value in _numbers_in(figures).items():
        if not math.isnan(value):
            texts.append(f"{meaning(name).title} {format_value(value)}")
    return ", ".join(texts[:_MOST_FIGURES])


def pair_pictures(data: ReportData, album: Pictures) -> list[tuple[str, list[Picture]]]:
    """Return the pictures of each pair that has any."""
    drawn = [stage.name for stage in STAGES if stage.scope == "pair" and "picture" in stage.products.product_files]
    rows = []
    for pair in data.record.pairs:
        pictures = []
        for name in drawn:
            task = Task(name, (pair.left, pair.right))
            picture = album.of_task(task, str(task))
            if picture:
                pictures.append(picture)
        if pictures:
            rows.append((pair.name, pictures))
    return rows


def parts(data: ReportData, album: Pictures) -> list[Part]:
    """Return the results of each site-wide stage in run.json; changes that are not acknowledged come first."""
    rows = []
    for stage in STAGES:
        result = data.record.results.get(stage.name)
        if result is None:
            continue
        title = stage.products.title
        reason = result.reason or ""
        if isinstance(result, ChangesSummary) and result.compared is False:
            rows.append(Part(title, reason, result.files, since="There was nothing to compare this night with."))
            continue
        things = sorted(_things(data, result, album), key=lambda thing: bool(thing.known))
        picture = album.of_task(Task(stage.name), title)
        gone_text = _gone_text(data) if stage.name == CHANGES else ""
        figures = tuple(shown(vars(result)))
        volumes = tuple(_volumes(result, data.unit))
        rows.append(Part(title, reason, result.files, gone_text, picture, figures, volumes, tuple(things)))
    return rows


def _gone_text(data: ReportData) -> str:
    """Return which changes of the last good night are there no more; "" if there are none."""
    since = data.since_last_good
    if since is None or not since.gone:
        return ""
    gone = []
    for change in since.gone.values():
        gone.append(f"{change.kind or 'something'} ({_dimensions(change, data.unit)})")
    return f"Differed on {since.date}, the last good night, and are as in the reference again: {', '.join(gone)}."


def _things(data: ReportData, result: SiteSummary, album: Pictures) -> Iterator[Thing]:
    for name, change in result.objects.items():
        title = f"{name}: {change.kind}".rstrip(": ")
        picture = None
        for file in result.files:
            if file.rpartition(".")[0].endswith(f"-{name}") and is_picture(file):
                picture = album.of_product(file, f"{title}: then and this night")
                break
        figures = {}
        for key, value in vars(change).items():
            if key not in _SAID_OF_CHANGES:
                figures[key.replace("_", " ")] = value
        when = _since(change, data.record.date)
        yield Thing(name, title, _dimensions(change, data.unit), when, change.acknowledged, picture, figures)


def _since(change: RecordedChange, night: str) -> str:
    """Return since when a change is there."""
    texts = []
    if change.first:
        texts.append("new this night" if change.first == night else f"since {change.first}")
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
        # all tasks of a stage have the same parameters: the first one whose receipt is there says them
        if task.stage in preimages:
            continue
        receipt = data.receipt(task)
        if receipt:
            preimages[task.stage] = receipt.preimage
    return [(stage.name, preimages[stage.name]) for stage in STAGES if stage.name in preimages]
