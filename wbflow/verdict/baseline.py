"""What is usual at a site: medians of its last good nights, or the reference; and how tonight's images compare with it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import asdict, fields, replace
from itertools import islice
from statistics import median

from wbflow_stages.contracts.camera_figures import FrameFigures, Health

from ..cache.layout import WorkFolder
from ..errors import ExitCode
from ..pipeline.stages import STAGES
from ..records.findings import Baseline
from ..records.record import RunRecord
from ..records.run_folder import newest_runs
from ..site.models import Expected, Measure, Site

LEAST_MATCHED_SHARE = 0.25
"""A camera shows something else if the share of its pairs that find common points is below this fraction of the usual share."""
SHARP_SHARE = 0.4
"""An image with less than this share of its usual sharpness is out of focus, or taken through drops or dirt."""
MOST_RUNS = 14
"""At most this many earlier runs are read; their records contain the usual figures from good nights before them."""


def earlier_runs(work: WorkFolder, run: str, date: str) -> tuple[RunRecord, ...]:
    """Return the runs before `run`, one for each night up to `date`, newest first; records that cannot be read are skipped."""
    by_date: dict[str, RunRecord] = {}
    for _, record in islice(newest_runs(work, before=run), MOST_RUNS):
        later = by_date.get(record.date)
        # the last run of a night stands for it, unless it was not the whole night's work (run --until, or interrupted)
        is_partial = later is not None and later.cloud is None and later.exit_code in (ExitCode.GOOD, ExitCode.INTERRUPTED)
        if record.date <= date and (later is None or is_partial):
            by_date[record.date] = record
    return tuple(sorted(by_date.values(), key=lambda record: (record.date, record.run), reverse=True))


def baseline_before(earlier: Sequence[RunRecord], settings: str, since: str = "") -> Baseline | None:
    """Medians of good nights with the same settings; else the usual figures that the newest run with these settings recorded.

    earlier: newest first.  settings: digest of tonight's.  since: nights before this one (ISO 8601) don't count.
    """
    comparable = [record for record in earlier if record.settings == settings and record.date >= since]
    good = [record for record in comparable if record.verdict and record.verdict.good and record.cloud]
    if good:
        return baseline_of(good)
    # all of them bad: their records contain what was usual before
    for record in comparable:
        if record.usual:
            return record.usual
    return None


def baseline_of(records: Sequence[RunRecord]) -> Baseline:
    """The medians of the figures of some nights."""
    by_camera: dict[str, list[dict[str, float]]] = {}
    for record in records:
        for camera in record.cameras:  # lost ones, too, so that cameras keep the order of the records
            by_camera.setdefault(camera.id, [])
        for name, figures in appearance_of(record).items():
            by_camera[name].append(figures)
    cameras = {}
    for name, nights in by_camera.items():
        medians = _medians(nights)
        if medians:
            cameras[name] = medians
    return Baseline(len(records), _medians(map(figures_of, records)), cameras)


def figures_of(record: RunRecord) -> dict[str, float]:
    """The figures of a whole night that are compared with the usual ones, by name."""
    figures: dict[str, float] = {Measure.POINTS: 0.0}
    if record.cloud:
        figures[Measure.POINTS] = float(record.cloud.points)
    if record.pairs:
        figures[Measure.PAIRS] = float(sum(pair.ok for pair in record.pairs))
    if record.poses is None or not record.poses.metric:  # the unit of lengths differs between nights
        return figures
    for stage in STAGES:
        result = record.results.get(stage.name)
        if result and result.amount is not None:
            figures[stage.name] = result.amount
    return figures


def appearance_of(record: RunRecord) -> dict[str, dict[str, float]]:
    """The figures of each usable camera that are compared with the usual ones, by id and name: those of its image, the misfit of
    its points, and the share of its pairs that found common points."""
    names = [field.name for field in fields(FrameFigures)]  # what is not a number is left out below
    appearances: dict[str, dict[str, float]] = {}
    for camera in record.cameras:
        if not camera.ok:
            continue
        figures: dict[str, float] = {}
        for name in (*names, "misfit"):
            value = getattr(camera.figures, name)
            if isinstance(value, int | float):
                figures[name] = float(value)
        appearances[camera.id] = figures
    for name, share in _matched_shares(record, appearances.keys()).items():
        appearances[name]["matched_share"] = share
    return appearances


def _matched_shares(record: RunRecord, usable: Set[str]) -> dict[str, float]:
    """Return the share of each camera's pairs that found common points, by id; pairs with a lost camera don't count."""
    matched: dict[str, list[bool]] = {}
    for pair in record.pairs:
        if pair.matched is not None and usable >= {*pair.cameras}:
            for name in pair.cameras:
                matched.setdefault(name, []).append(pair.matched)
    return {name: sum(pairs) / len(pairs) for name, pairs in matched.items()}


def with_appearance(record: RunRecord, expected: Expected) -> RunRecord:
    """Return the record with the health of cameras whose images do not look as usual.

    What most cameras have in common tonight (fog, a lamp that is out) is not attributed to a single camera; a camera that an
    earlier stage has found unhealthy keeps that health.
    """
    # 1. each camera's figures relative to its usual ones
    usual = record.usual.cameras if record.usual else {}
    tonight: dict[str, dict[str, float]] = {}
    shares: dict[str, dict[str, float]] = {}
    for name, figures in appearance_of(record).items():
        if usual.get(name):
            tonight[name] = figures
            shares[name] = _shares(figures, usual[name])
    # 2. what they have in common; a night on which most look better than usual sets no higher standard
    common = {figure: min(share, 1.0) for figure, share in _medians(shares.values()).items()}
    # 3. each camera compared with the others
    cameras = []
    for camera in record.cameras:
        if camera.id in tonight and (camera.health is None or camera.health.ok):
            health = _health_by_appearance(tonight[camera.id], usual[camera.id], shares[camera.id], common, expected)
            if camera.health is None or not health.ok:
                camera = replace(camera, health=health)
        cameras.append(camera)
    return replace(record, cameras=tuple(cameras))


def _shares(figures: Mapping[str, float], usual: Mapping[str, float]) -> dict[str, float]:
    """Return the figures that have a usual value above 0, divided by it."""
    return {name: value / usual[name] for name, value in figures.items() if usual.get(name, 0.0) > 0}


def _health_by_appearance(
    tonight: Mapping[str, float],
    usual: Mapping[str, float],
    shares: Mapping[str, float],
    common: Mapping[str, float],
    expected: Expected,
) -> Health:
    """Return the health of a camera from its figures tonight, the usual ones, their ratios, and the usual ratios of the night."""
    figures = {name: value for name, value in tonight.items() if name in usual}
    base = {name: usual[name] for name in figures}
    least_brightness = expected.brightness * common.get(Measure.BRIGHTNESS, 1.0)
    if shares.get(Measure.BRIGHTNESS, 1.0) < least_brightness:
        text = f"its picture has {100 * shares[Measure.BRIGHTNESS]:.0f} % of its usual brightness"
        return Health("obscured", text, figures, base, "check its lighting and exposure, and whether something blocks its view")
    least_sharpness = SHARP_SHARE * common.get("sharpness", 1.0)
    if shares.get("sharpness", 1.0) < least_sharpness:
        text = f"its picture has {100 * shares['sharpness']:.0f} % of its usual sharpness"
        return Health("obscured", text, figures, base, "check its focus, and its glass for drops, dirt or fog")
    if shares.get("matched_share", 1.0) < LEAST_MATCHED_SHARE:
        share = 100 * tonight["matched_share"]
        usual_share = 100 * usual["matched_share"]
        text = f"{share:.0f} % of its pairs find common points, usually {usual_share:.0f} % do:"
        text += " it shows another place, or has been turned"
        return Health("wrong-scene", text, figures, base, "check its picture, and where it points")
    return Health("ok", figures=figures, expected=base)


def settings_of(site: Site) -> str:
    """Digest of everything that determines a night's results except its captures: the settings of the site file, and the code."""
    stages = []
    for stage in STAGES:
        settings = site.stages[stage.name]
        if settings.enabled:
            bound = site.bindings.of(stage)
            parameters = {**bound.defaults(), **settings.parameters}
            stages.append([stage.name, bound.function.dotted, bound.code, parameters])
    cameras = [[camera.id, asdict(camera.lens), asdict(camera.placement)] for camera in site.cameras]
    content = [stages, cameras, dict(site.settings.pairs), site.settings.resolution, site.settings.bounds, asdict(site.survey)]
    text = json.dumps(content, sort_keys=True, default=str)  # str: of values from YAML, such as dates
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _medians(figures: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the median of each figure over the entries that have it."""
    values: dict[str, list[float]] = {}
    for entry in figures:
        for name, value in entry.items():
            values.setdefault(name, []).append(value)
    return {name: median(samples) for name, samples in values.items()}
