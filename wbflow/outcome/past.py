"""Earlier nights of a site: what is usual, and since when something is not."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property

from ..cache.layout import WorkFolder
from ..pipeline.binding import bind
from ..pipeline.rows import Role
from ..pipeline.stages import STAGES, stage_with
from ..records.record import CameraRecord, RunRecord, Usual
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.models import Measure, Site

MOST_RUNS = 14
"""So many earlier runs are read at most.  What they say of the good nights before them stands in their own records."""


@dataclass(frozen=True)
class Past:
    """The runs before one, newest first: the last of each night."""

    runs: tuple[RunRecord, ...] = ()

    @staticmethod
    def before(work: WorkFolder, run: str, date: str) -> Past:
        """The runs before `run`, of nights up to `date`; what cannot be read is passed over."""
        found: dict[str, RunRecord] = {}
        for name in [name for name in reversed(work.run_ids()) if name < run][:MOST_RUNS]:
            try:
                record = RunFolder.of(work, name).record()
            except NoSuchRun:
                continue
            if record.date <= date and (record.date not in found or not _whole(found[record.date])):
                found[record.date] = record
        return Past(tuple(sorted(found.values(), key=lambda record: (record.date, record.run), reverse=True)))

    def usual(self, settings: str, since: str = "") -> Usual | None:
        """What good nights with the same settings gave; where these runs hold none, what the newest of them was compared with.

        Parameters
        ----------
        settings : str
            Digest of tonight's settings.
        since : str
            Nights before this one (ISO 8601) don't count.
        """
        alike = [record for record in self.runs if record.settings == settings and record.date >= since]
        good = [record for record in alike if record.verdict and record.verdict.good and record.cloud]
        if good:
            return usual_of(good)
        return next((record.usual for record in alike if record.usual), None)

    def camera(self, name: str) -> tuple[str, CameraRecord] | None:
        """The last night that a camera took part in, and its record."""
        return self._cameras.get(name)

    @cached_property
    def _cameras(self) -> dict[str, tuple[str, CameraRecord]]:
        newest_last = reversed(self.runs)
        return {camera.id: (record.date, camera) for record in newest_last for camera in record.cameras}


def usual_of(records: Sequence[RunRecord]) -> Usual:
    """The medians of some nights."""
    cameras = list(dict.fromkeys(camera.id for record in records for camera in record.cameras))
    of_records = [looks_of(record) for record in records]
    looks = {name: [of.get(name, {}) for of in of_records] for name in cameras}
    return Usual(
        len(records),
        _medians([figures_of(record) for record in records]),
        {name: medians for name in cameras if (medians := _medians(looks[name]))},
    )


def pinned_usual(work: WorkFolder, run: str, settings: str, usual: Usual | None) -> Usual | None:
    """What is usual, with the figures of the whole site from a run that somebody has pinned.

    Parameters
    ----------
    work : WorkFolder
        Where the run is.
    run : str
        Its id.
    settings : str
        Digest of tonight's settings; a run with others is not compared with.
    usual : Usual, optional
        What the last good nights gave.
    """
    try:
        record = RunFolder.of(work, run).record()
    except NoSuchRun:  # removed since
        return usual
    if record.settings != settings or not record.cloud:
        return usual
    pinned = usual_of([record])
    return Usual(1, pinned.figures, usual.cameras if usual else pinned.cameras, run)


def figures_of(record: RunRecord) -> dict[str, float]:
    """What is compared of a whole night, by name."""
    found: dict[str, float] = {Measure.POINTS: float(record.cloud.points) if record.cloud else 0.0}
    if record.pairs:
        found[Measure.PAIRS] = float(sum(pair.ok for pair in record.pairs))
    for stage in STAGES if record.poses and record.poses.metric else ():  # else each night has units of its own
        told = record.later.get(stage.name) or {}
        wanted = stage.reports.expects.factors if stage.reports and stage.reports.expects else ()
        factors = [float(factor) for name in wanted if isinstance(factor := told.get(name), int | float)]
        if wanted and len(factors) == len(wanted):
            found[stage.name] = math.prod(factors)
    return found


def looks_of(record: RunRecord) -> dict[str, dict[str, float]]:
    """What is compared of each camera that is well, by id and name: how its picture looks, and the share of its pairs that found
    common points."""
    reports = stage_with(Role.FRAME).reports
    names = reports.fields if reports else ()
    matched: dict[str, list[bool]] = {}
    well = {camera.id for camera in record.cameras if camera.ok}  # what is lost with another camera says nothing of this one
    for pair in record.pairs:
        if {*pair.cameras} <= well and (told := pair.figures.get("matched")) is not None:
            for name in pair.cameras:
                matched.setdefault(name, []).append(bool(told))
    found = {}
    for camera in record.cameras:
        if camera.ok and camera.id not in found:
            looks = {name: float(value) for name in names if isinstance(value := camera.figures.get(name), int | float)}
            if shares := matched.get(camera.id):
                looks["matched_share"] = sum(shares) / len(shares)
            found[camera.id] = looks
    return found


def settings_of(site: Site) -> str:
    """Digest of all that decides what a night gives, besides its captures: the site file's words and the code."""
    stages = []
    for stage in STAGES:
        settings = site.stages.get(stage.name)
        use, values = (settings.use, settings.parameters) if settings else (None, {})
        if settings is None or settings.enabled:
            bound = bind(stage, use, values, site.reader)
            stages.append([stage.name, bound.function.dotted, bound.code, {**bound.defaults(), **values}])
    cameras = [[camera.id, asdict(camera.lens), asdict(camera.placement)] for camera in site.cameras]
    words = [stages, cameras, dict(site.pairs), site.resolution, site.bounds, asdict(site.survey)]
    return hashlib.sha256(json.dumps(words, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _whole(record: RunRecord) -> bool:
    """Was it the night's work, and not a part of it?"""
    return record.cloud is not None or record.exit_code not in (0, 130)


def _medians(figures: Iterable[dict[str, float]]) -> dict[str, float]:
    values: dict[str, list[float]] = {}
    for entry in figures:
        for name, value in entry.items():
            values.setdefault(name, []).append(value)
    return {name: median(found) for name, found in values.items()}


def median(values: Sequence[float]) -> float:
    """Of at least one value."""
    ordered, middle = sorted(values), len(values) // 2
    return ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2
