"""The sections about cameras and about pairs with the stages they reached, and the settings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from ..cache.receipt import Preimage, Receipt
from ..json_dataclass import read_json
from ..pipeline.meanings import meaning
from ..pipeline.stages import STAGES, Stage
from ..pipeline.summaries import PairFigures
from ..records.record import CameraRecord, PairRecord
from ..task import Task
from ..words import format_value
from .data import ReportData, is_number, state_of
from .pictures import Picture, Pictures

BADGES = {"good": "as it should be", "warn": "look at it", "bad": "down"}
"""Labels of the camera states."""
_MOST_FIGURES = 8
"""Largest number of figures shown for a stage that a pair reached."""


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
    # the other numbers are folded in the page
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
            if not isinstance(value, Mapping):
                continue
            share = value.get(camera.id)
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
    texts = [text]
    if camera.down:
        texts.append(camera.down.words(left_out=not camera.ok))
    return "; ".join(filter(None, texts))


def pair_columns(data: ReportData) -> list[str]:
    """Return the names of the figures that at least one pair has."""
    columns = []
    for field in fields(PairFigures):
        # stages that were left out leave empty columns
        values = (getattr(pair.figures, field.name) for pair in data.record.pairs)
        if any(value not in {None, ""} for value in values):
            columns.append(field.name)
    return columns


def tried(data: ReportData, pair: PairRecord) -> Iterator[tuple[str, str, str]]:
    """Yield name, outcome and figures, named as in run.json, of each stage that a pair reached; for a rejection, the figures that
    led to it."""
    for stage in STAGES:
        event = data.tasks.get(Task(stage.name, (pair.left, pair.right)))
        # a pair ends at the first stage that rejects it; the later ones are skipped
        if event is None or event.outcome == "skipped":
            continue
        details = [event.reason]
        receipt = data.receipt(event.task)
        if receipt:
            details = [_method_text(stage, receipt), event.reason, _figures_text(stage, receipt)]
        outcome: str = event.outcome
        if event.usable:
            outcome = "done"
        yield stage.name, outcome, "; ".join(filter(None, details))


def _method_text(stage: Stage, receipt: Receipt) -> str:
    """Return by which of a stage's methods a result was made; "" if the stage has no choice."""
    if stage.method is None:
        return ""
    method = receipt.preimage.parameters.get(stage.method.parameter)
    return f"by {method}" if method else ""


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
