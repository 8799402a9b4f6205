"""What is usual at a site: medians of its last good nights, or the reference; and how tonight's images compare with it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from itertools import islice
from statistics import median

from ..cache.layout import WorkFolder
from ..pipeline.binding import bind
from ..pipeline.stages import STAGES
from ..pipeline.summaries import FrameSummary
from ..records.findings import Health, Usual
from ..records.record import CameraRecord, RunRecord
from ..records.run_folder import newest_runs
from ..site.models import Expected, Measure, Site

LEAST_MATCHED_SHARE = 0.25
"""A camera shows something else if the share of its pairs that find common points is below this fraction of the usual share."""
SHARP_SHARE = 0.4
"""An image with less than this share of its usual sharpness is out of focus, or taken through drops or dirt."""
MOST_RUNS = 14
"""At most this many earlier runs are read; their records contain the usual figures from good nights before them."""


@dataclass(frozen=True)
class Baseline:
    """The runs before a given one, newest first, one for each night."""

    runs: tuple[RunRecord, ...] = ()

    @staticmethod
    def of_earlier_runs(work: WorkFolder, run: str, date: str) -> Baseline:
        """The runs before `run`, of nights up to `date`; records that cannot be read are skipped."""
        by_date: dict[str, RunRecord] = {}
        for _, record in islice(newest_runs(work, before=run), MOST_RUNS):
            if record.date <= date and (record.date not in by_date or not _is_complete(by_date[record.date])):
                by_date[record.date] = record
        return Baseline(tuple(sorted(by_date.values(), key=lambda record: (record.date, record.run), reverse=True)))

    def usual(self, settings: str, since: str = "") -> Usual | None:
        """Medians of good nights with the same settings; else the usual figures that the newest run with these settings recorded.

        settings: digest of tonight's.  since: nights before this one (ISO 8601) don't count.
        """
        comparable = [record for record in self.runs if record.settings == settings and record.date >= since]
        good = [record for record in comparable if record.verdict and record.verdict.good and record.cloud]
        if good:
            return usual_of(good)
        return next((record.usual for record in comparable if record.usual), None)

    def camera(self, name: str) -> tuple[str, CameraRecord] | None:
        """The last night that a camera took part in, and its record."""
        return self._cameras.get(name)

    @cached_property
    def _cameras(self) -> dict[str, tuple[str, CameraRecord]]:
        newest_last = reversed(self.runs)
        return {camera.id: (record.date, camera) for record in newest_last for camera in record.cameras}


def usual_of(records: Sequence[RunRecord]) -> Usual:
    """The medians of the figures of some nights."""
    cameras = list(dict.fromkeys(camera.id for record in records for camera in record.cameras))
    appearances = [appearance_of(record) for record in records]
    by_camera = {name: [appearance.get(name, {}) for appearance in appearances] for name in cameras}
    return Usual(
        len(records),
        _medians([figures_of(record) for record in records]),
        {name: medians for name in cameras if (medians := _medians(by_camera[name]))},
    )


def figures_of(record: RunRecord) -> dict[str, float]:
    """The figures of a whole night that are compared with the usual ones, by name."""
    figures: dict[str, float] = {Measure.POINTS: float(record.cloud.points) if record.cloud else 0.0}
    if record.pairs:
        figures[Measure.PAIRS] = float(sum(pair.ok for pair in record.pairs))
    for stage in STAGES if record.poses and record.poses.metric else ():  # else units differ between nights
        result = record.results.get(stage.name)
        if result and result.amount is not None:
            figures[stage.name] = result.amount
    return figures


def appearance_of(record: RunRecord) -> dict[str, dict[str, float]]:
    """The figures of each usable camera that are compared with the usual ones, by id and name: those of its image, and the share
    of its pairs that found common points."""
    names = [field.name for field in fields(FrameSummary)]
    matched: dict[str, list[bool]] = {}
    usable = {camera.id for camera in record.cameras if camera.ok}  # pairs with a lost camera don't count
    for pair in record.pairs:
        if {*pair.cameras} <= usable and pair.matched is not None:
            for name in pair.cameras:
                matched.setdefault(name, []).append(pair.matched)
    appearances = {}
    for camera in record.cameras:
        if camera.ok and camera.id not in appearances:
            figures = {name: float(value) for name in names if isinstance(value := getattr(camera.figures, name), int | float)}
            if shares := matched.get(camera.id):
                figures["matched_share"] = sum(shares) / len(shares)
            appearances[camera.id] = figures
    return appearances


def with_appearance(record: RunRecord, expected: Expected) -> RunRecord:
    """Return the record with the health of cameras whose images do not look as usual.

    What most cameras have in common tonight (fog, a lamp that is out) is not attributed to a single camera; a camera that an
    earlier stage has found unhealthy keeps that health.
    """
    usual = record.usual.cameras if record.usual else {}
    appearances, common = appearance_of(record), _common_shares(record)

    def with_health(camera: CameraRecord) -> CameraRecord:
        if not camera.ok or not usual.get(camera.id) or (camera.health and not camera.health.ok):
            return camera
        health = _health_by_appearance(appearances.get(camera.id, {}), usual[camera.id], common, expected)
        return camera if camera.health and health.ok else replace(camera, health=health)

    return replace(record, cameras=tuple(map(with_health, record.cameras)))


def _common_shares(record: RunRecord) -> dict[str, float]:
    """Return the medians over the cameras of tonight's figures as shares of the usual ones, at most 1."""
    shares: dict[str, list[float]] = {}
    for name, figures in appearance_of(record).items():
        usual = record.usual.cameras.get(name, {}) if record.usual else {}
        for figure in figures.keys() & usual.keys():
            if usual[figure] > 0:
                shares.setdefault(figure, []).append(figures[figure] / usual[figure])
    return {figure: min(median(values), 1.0) for figure, values in shares.items()}


def _health_by_appearance(
    tonight: Mapping[str, float], usual: Mapping[str, float], common: Mapping[str, float], expected: Expected
) -> Health:
    """Return the health of a camera from its figures tonight, the usual ones, and what all cameras have in common."""
    shared = [name for name in tonight if name in usual]
    figures, base = {name: tonight[name] for name in shared}, {name: usual[name] for name in shared}
    shares = {name: tonight[name] / usual[name] for name in shared if usual[name] > 0}
    if shares.get(Measure.BRIGHTNESS, 1.0) < expected.limit(Measure.BRIGHTNESS) * common.get(Measure.BRIGHTNESS, 1.0):
        text = f"its picture has {100 * shares[Measure.BRIGHTNESS]:.0f} % of its usual brightness"
        return Health("obscured", text, figures, base, "check its lighting and exposure, and whether something blocks its view")
    if shares.get("sharpness", 1.0) < SHARP_SHARE * common.get("sharpness", 1.0):
        text = f"its picture has {100 * shares['sharpness']:.0f} % of its usual sharpness"
        return Health("obscured", text, figures, base, "check its focus, and its glass for drops, dirt or fog")
    if shares.get("matched_share", 1.0) < LEAST_MATCHED_SHARE:
        share, usual_share = (f"{100 * entry['matched_share']:.0f} %" for entry in (tonight, usual))
        text = f"{share} of its pairs find common points, usually {usual_share} do: it shows another place, or has been turned"
        return Health("wrong-scene", text, figures, base, "check its picture, and where it points")
    return Health("ok", figures=figures, expected=base)


def settings_of(site: Site) -> str:
    """Digest of everything that determines a night's results except its captures: the settings of the site file, and the code."""
    stages = []
    for stage in STAGES:
        settings = site.stage_settings(stage.name)
        if settings.enabled:
            bound = bind(stage, settings.use, settings.parameters, site.reader)
            stages.append([stage.name, bound.function.dotted, bound.code, {**bound.defaults(), **settings.parameters}])
    cameras = [[camera.id, asdict(camera.lens), asdict(camera.placement)] for camera in site.cameras]
    content = [stages, cameras, dict(site.settings.pairs), site.settings.resolution, site.settings.bounds, asdict(site.survey)]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _is_complete(record: RunRecord) -> bool:
    """Did the run do the whole night's work, and not only a part of it?"""
    return record.cloud is not None or record.exit_code not in (0, 130)


def _medians(figures: Iterable[dict[str, float]]) -> dict[str, float]:
    values: dict[str, list[float]] = {}
    for entry in figures:
        for name, value in entry.items():
            values.setdefault(name, []).append(value)
    return {name: median(samples) for name, samples in values.items()}
