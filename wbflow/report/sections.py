"""The sections of the report: first screen, cameras, pairs with the stages they reached, site-wide results, and settings."""

from __future__ import annotations

import mimetypes
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from ..cache.store import Preimage, Receipt
from ..outcome.baseline import figures_of
from ..pipeline.meanings import meaning, shown
from ..pipeline.stages import STAGES, Stage
from ..pipeline.summaries import Change, ChangesSummary, PairFigures, SiteSummary
from ..records.findings import Finding
from ..records.record import CameraRecord, PairRecord, RunRecord
from ..runner.state import Cause
from ..site.models import Measure
from ..task import Task
from ..words import counted, format_value
from .data import Comparison, ReportData, since_last_good, state_of
from .pictures import Picture, Pictures

BADGES = {"good": "as it should be", "warn": "look at it", "bad": "down"}
"""Labels of the camera states."""
_MOST_OF_A_KIND = 4
"""Largest number of findings of one kind that are shown in full; further ones are folded."""
_MOST_FIGURES = 8
"""Largest number of figures shown for a stage that a pair reached."""

Fact = tuple[str, str, str, str]
"""A main figure of the night: value, label, usual value, and "fair" or "bad" if it is clearly below the usual value, else ""."""


def headline(data: ReportData) -> tuple[str, str, str]:
    """Return the level of the verdict, a title, and a text with its reason and what to do first."""
    record, verdict = data.record, data.record.verdict
    level = verdict.level if verdict else "good" if record.exit_code == 0 else "degraded" if record.cloud else "failed"
    findings = verdict.findings if verdict else ()
    cameras = [finding for finding in findings if finding.kind.startswith("camera-")]
    changes = _changes_sentence(data)
    if level == "good":
        advice = "The findings below may wait." if findings else f"There is nothing to {'repair' if changes else 'do'}."
        return level, "A good night", f"{changes} {advice}".strip()
    if level == "degraded":
        title = f"{counted(len(cameras), 'camera')} to look at" if cameras else f"{counted(len(findings), 'thing')} to look at"
        cloud = "There is a cloud, but it is not as good as it should be. " if record.cloud else ""
        return level, title, f"{cloud}{_first_remedy(findings)} {changes}".strip()
    title = "Interrupted" if any(finding.kind == "interrupted" for finding in findings) else "No cloud this night"
    return level, title, _same_fault(record, cameras) or _first_remedy(findings) or "The reasons are below."


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
    record = data.record
    usual, values = record.usual.figures if record.usual else {}, figures_of(record)
    base_name = "reference" if record.usual and record.usual.reference else "usual"

    def measured_fact(name: str, unit: str, label: str) -> Fact:
        base = usual.get(name)
        comparison = f"{base_name}: {base:,.0f} {unit}".rstrip() if base else ""
        return f"{values[name]:,.0f} {unit}".rstrip(), label, comparison, _grade(values[name], base)

    usable_cameras, usable_pairs = sum(camera.ok for camera in record.cameras), sum(pair.ok for pair in record.pairs)
    yield f"{usable_cameras} of {len(record.cameras)}", "cameras", "", "" if usable_cameras == len(record.cameras) else "bad"
    if expected_pairs := max(len(record.pairs), round(usual.get(Measure.PAIRS, 0))):
        yield f"{usable_pairs} of {expected_pairs}", "pairs of cameras", "", _grade(usable_pairs, usual.get(Measure.PAIRS))
    if record.cloud:
        yield measured_fact(Measure.POINTS, "", "points")
    if record.poses and record.poses.unverified:
        yield "unverified", "calibration: too few matches to check it", "", "fair"
    for stage, result in record.results.items():
        if stage in values:
            yield measured_fact(stage, *result.AMOUNT)
        if (count := _change_count(result)) is not None:
            since, label = since_last_good(data, stage), f"change{'s' * (count != 1)} since the reference"
            acknowledged = _acknowledged_count(result)
            notes = [
                f"{_new_count(count, result, since)} since {since.date}" if since else "",
                f"{acknowledged} acknowledged" if acknowledged else "",
            ]
            yield str(count), label, ", ".join(filter(None, notes)) if count else "", ""
    seconds = record.seconds.wall
    duration = f"{seconds / 60:.0f} min" if seconds >= 100 else f"{seconds:.0f} s"
    yield duration, "from captures to cloud" if record.cloud else "until the run ended", "", ""


def volume_facts(data: ReportData) -> Iterator[Fact]:
    """Yield the volumes that changed, as main figures."""
    unit = "m" if data.record.poses is None or data.record.poses.metric else ""
    for result in data.record.results.values():
        for ground, gained, lost, seen_area, unseen_area in _volumes(result, unit):
            yield gained, f"gained, {ground}", "", ""
            yield lost, f"lost, {ground}", "", ""
            yield seen_area, "seen on both nights", f"not seen: {unseen_area}", ""


def _change_count(result: SiteSummary) -> int | None:
    """Return how many objects a stage found to differ from the reference; None if it compared nothing."""
    return result.count if isinstance(result, ChangesSummary) and result.compared else None


def _acknowledged_count(result: SiteSummary) -> int:
    """Return how many of a stage's objects are acknowledged."""
    return sum(bool(entry.acknowledged) for entry in result.objects.values())


def _new_count(count: int, result: SiteSummary, since: Comparison) -> int:
    """Return how many objects were not there on the last good night and are not acknowledged."""
    return count - len(since.known) - sum(bool(item.acknowledged) and n not in since.known for n, item in result.objects.items())


def _changes_sentence(data: ReportData) -> str:
    """Return a sentence with the number and kinds of changes since the reference; "" if there are none."""
    for stage, result in data.record.results.items():
        if count := _change_count(result):
            kinds = Counter(entry.kind or "other" for entry in result.objects.values())
            named = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common())
            since = since_last_good(data, stage)
            new_text = f"; {_new_count(count, result, since) or 'none'} of them since {since.date}" if since else ""
            acknowledged = f"; {_acknowledged_count(result)} acknowledged" if _acknowledged_count(result) else ""
            return f"{counted(count, 'change')} since the reference{f' ({named})' if named else ''}{new_text}{acknowledged}."
    return ""


def _grade(value: float, base: float | None) -> str:
    """Grade a figure against its usual value, for its colour only; the verdict has its own limits."""
    if not base:
        return ""
    return "" if value >= 0.9 * base else "fair" if value >= 0.7 * base else "bad"


def findings(data: ReportData, album: Pictures) -> list[dict[str, Any]]:
    """Return the findings of a night with their pictures, the most important first.

    Each has the number of its camera in the page, from 1 (0 if it is about none), pictures with their captions (None for a
    missing picture), and the text that replaces a missing picture.
    """
    record = data.record
    numbers = {camera.id: k for k, camera in enumerate(record.cameras, 1)}
    without_capture = {camera.id for camera in record.cameras if camera.code == Cause.NO_CAPTURE}
    rows: list[dict[str, Any]] = []
    counts, reported = Counter[str](), record.verdict.findings if record.verdict else ()
    limit = 1 if _same_fault(record, [finding for finding in reported if finding.kind.startswith("camera-")]) else _MOST_OF_A_KIND
    for finding in reported:
        counts[finding.kind] += 1
        folded, number = counts[finding.kind] > limit, numbers.get(finding.about, 0)
        pictures = () if folded else tuple(_pictures(data, album, finding, number))
        missing = "no picture arrived" if finding.about in without_capture else "no picture could be read"
        row = {"finding": finding, "number": number, "pictures": pictures}
        rows.append({**row, "missing": missing, "folded": folded})
    return rows


def _pictures(data: ReportData, album: Pictures, finding: Finding, number: int) -> Iterator[tuple[Picture | None, str]]:
    name = finding.about
    if number:
        tonight_picture, good_picture = album.of_frame(name, f"{name} on {data.record.date}"), album.of_last_good(name)
        if tonight_picture or good_picture:
            yield tonight_picture, f"this night, {data.record.date}"
        if good_picture:
            yield good_picture, good_picture.alt
    elif len(finding.subject) == 2:
        of_pair = (album.of_task(Task(stage.name, finding.subject), name) for stage in STAGES if stage.scope == "pair")
        yield from [(picture, name) for picture in of_pair if picture][:2]


def cameras(data: ReportData) -> list[tuple[str, int, CameraRecord]]:
    """Return state, number in the site file (from 1), and record of each camera: "bad" ones first, then "warn" ones, otherwise in
    the order of the site file."""
    rows = [(state_of(camera, data.record), k, camera) for k, camera in enumerate(data.record.cameras, 1)]
    return sorted(rows, key=lambda entry: ("bad", "warn", "good").index(entry[0]))


def camera_figures(data: ReportData, camera: CameraRecord) -> tuple[list[tuple[str, str, str]], dict[str, float]]:
    """Return title, explanation and value of a camera's main figures, and its other numbers by name."""
    numbers = {name: v for name, v in vars(camera.figures).items() if isinstance(v, int | float) and not isinstance(v, bool)}
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
    points, inliers = camera.figures.keypoints, [p.figures.inliers for p in data.record.pairs_of(camera.id) if p.matched]
    nonzero = [count for count in inliers if count]
    texts = [f"{points:,} keypoints"] if points else []
    return ", ".join([*texts, *([f"{sum(nonzero):,} inliers in {len(nonzero)} pairs"] if nonzero else [])])


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
    """Yield name, outcome and figures of each stage that a pair reached."""
    for stage in (stage for stage in STAGES if stage.scope == "pair"):
        event = data.tasks.get(Task(stage.name, (pair.left, pair.right)))
        if event is None or event.outcome == "skipped":
            continue
        receipt = data.cache.by_key(event.task, event.key) if event.key else None
        method = receipt.preimage.parameters.get(stage.method.parameter) if stage.method and receipt else None
        figures = ", ".join(_step_figures(stage, receipt)) if receipt else ""
        details = "; ".join(filter(None, (f"by {method}" if method else "", event.reason, figures)))
        yield stage.name, "done" if event.usable else event.outcome, details


def _step_figures(stage: Stage, receipt: Receipt) -> Iterator[str]:
    """Yield the numbers of a result, named as in run.json; for a rejection, the figures that led to it."""
    summary = stage.summary if receipt.outcome != "rejected" else None
    figures = vars(summary.from_json(receipt.figures)) if summary else receipt.figures
    numbers = [(n, v) for n, v in figures.items() if isinstance(v, int | float) and not isinstance(v, bool) and v == v]
    yield from (f"{meaning(name).title} {format_value(value)}" for name, value in numbers[:_MOST_FIGURES])


def pair_pictures(data: ReportData, album: Pictures) -> list[tuple[str, list[Picture]]]:
    """Return the pictures of each pair that has any."""
    stages = [stage.name for stage in STAGES if stage.scope == "pair" and "picture" in stage.products.drawings]
    tasks = {pair.name: [Task(name, (pair.left, pair.right)) for name in stages] for pair in data.record.pairs}
    by_pair = [(name, [p for task in pair_tasks if (p := album.of_task(task, str(task)))]) for name, pair_tasks in tasks.items()]
    return [(name, pictures) for name, pictures in by_pair if pictures]


def parts(data: ReportData, album: Pictures) -> list[dict[str, Any]]:
    """Return the results of each site-wide stage in run.json; objects that are not acknowledged come first."""
    rows = []
    unit = "m" if data.record.poses is None or data.record.poses.metric else ""
    for stage in STAGES:
        if result := data.record.results.get(stage.name):
            part: dict[str, Any] = {"title": stage.products.title, "reason": result.reason or "", "files": result.files}
            if isinstance(result, ChangesSummary) and result.compared is False:
                empty = {"since": "There was nothing to compare this night with.", "picture": None}
                rows.append({**part, **empty, "rows": (), "volumes": (), "things": ()})
                continue
            since = since_last_good(data, stage.name)
            objects = sorted(_object_rows(result, album, since, unit), key=lambda entry: bool(entry["known"]))
            gone = [f"{entry.kind or 'something'} ({_dimensions(entry, unit)})" for entry in since.gone.values()] if since else []
            intro = f"Differed on {since.date}, the last good night, and are as in the reference again:" if since else ""
            picture = album.of_task(Task(stage.name), stage.products.title)
            extras = {"since": f"{intro} {', '.join(gone)}." if gone else "", "picture": picture}
            tables = {"rows": list(shown(vars(result))), "volumes": list(_volumes(result, unit))}
            rows.append({**part, **extras, **tables, "things": tuple(objects)})
    return rows


def _object_rows(result: SiteSummary, album: Pictures, since: Comparison | None, unit: str) -> Iterator[dict[str, Any]]:
    for name, entry in result.objects.items():
        file = next((f for f in result.files if f.rpartition(".")[0].endswith(f"-{name}") and is_picture(f)), None)
        title = f"{name}: {entry.kind}".rstrip(": ")
        figures = {key.replace("_", " "): value for key, value in vars(entry).items() if key not in {"kind", "acknowledged"}}
        picture = album.of_product(file, f"{title}: then and this night") if file else None
        old_name = since.known.get(name) if since else None
        when = "" if since is None else f"already so on {since.date}" if old_name else f"since {since.date}, the last good night"
        texts = {"name": name, "title": title, "size": _dimensions(entry, unit), "since": when, "known": entry.acknowledged}
        yield {**texts, "picture": picture, "figures": figures}


def _volumes(result: SiteSummary, unit: str) -> Iterator[tuple[str, ...]]:
    def quantity(value: float, sigma: float | None, power: str) -> str:
        sigma_text = f" ± {sigma:.1f}" if sigma is not None else ""
        return f"{value:,.1f}{sigma_text} {f'{unit}{power}' if unit else ''}".strip()

    for zone, part in result.volumes.items():
        volumes = quantity(part.gained, part.gained_sigma, "³"), quantity(part.lost, part.lost_sigma, "³")
        yield zone or "whole site", *volumes, quantity(part.area, None, "²"), quantity(part.unseen, None, "²")


def _dimensions(entry: Change, unit: str) -> str:
    """Return the size, volume and place of an object, as far as they are known."""
    size = " × ".join(f"{side:.1f}" for side in (entry.length, entry.width, entry.height) if side is not None)
    volume, sigma = entry.volume, entry.volume_sigma
    volume_text = f"{volume:.1f}" + (f" ± {sigma:.1f}" if sigma else "") + (f" {unit}³" if unit else "") if volume else ""
    place_text = f"at {entry.x:.1f}, {entry.y:.1f}, {entry.z:.1f}"
    return "; ".join(filter(None, (f"{size} {unit}".strip(), volume_text and f"volume {volume_text}", place_text)))


def is_picture(file: str) -> bool:
    """Return whether a file is a picture, by its name."""
    return (mimetypes.guess_type(file)[0] or "").startswith("image/")


def settings(data: ReportData) -> list[tuple[str, Preimage]]:
    """Return the function, code and parameters of each stage."""
    preimages: dict[str, Preimage] = {}
    for task, event in data.tasks.items():
        if task.stage not in preimages and event.key and (receipt := data.cache.by_key(task, event.key)):
            preimages[task.stage] = receipt.preimage
    return [(stage.name, preimages[stage.name]) for stage in STAGES if stage.name in preimages]
