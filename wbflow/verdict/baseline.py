"""What is usual at a site: medians of its last good nights, or the reference; and how tonight's images compare with it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields, replace
from itertools import islice
from statistics import median

from wbflow_stages.contracts.camera_figures import FrameFigures, Health

from ..cache.layout import WorkFolder
from ..pipeline.stages import STAGES
from ..records.findings import Baseline
from ..records.record import RunRecord
from ..records.run_folder import newest_runs
from ..runner.bindings import Bindings
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
        is_partial = later is not None and later.cloud is None and later.exit_code in (0, 130)  # not the whole night's work
        if record.date <= date and (later is None or is_partial):
            by_date[record.date] = record
    return tuple(sorted(by_date.values(), key=lambda record: (record.date, record.run), reverse=True))


def usual_before(earlier: Sequence[RunRecord], settings: str, since: str = "") -> Baseline | None:
    """Medians of good nights with the same settings; else the usual figures that the newest run with these settings recorded.

    earlier: newest first.  settings: digest of tonight's.  since: nights before this one (ISO 8601) don't count.
    """
    comparable = [record for record in earlier if record.settings == settings and record.date >= since]
    good = [record for record in comparable if record.verdict and record.verdict.good and record.cloud]
    if good:
        return usual_of(good)
    return next((record.usual for record in comparable if record.usual), None)


def usual_of(records: Sequence[RunRecord]) -> Baseline:
    """The medians of the figures of some nights."""
    names = dict.fromkeys(camera.id for record in records for camera in record.cameras)
    appearances = [appearance_of(record) for record in records]
    cameras = {name: _medians(appearance.get(name, {}) for appearance in appearances) for name in names}
    return Baseline(
        len(records), _medians(map(figures_of, records)), {name: medians for name, medians in cameras.items() if medians}
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
    """The figures of each usable camera that are compared with the usual ones, by id and name: those of its image, the misfit of
    its points, and the share of its pairs that found common points."""
    appearances: dict[str, dict[str, float]] = {}
    for camera in record.cameras:
        if camera.ok:
            values = {field.name: getattr(camera.figures, field.name) for field in fields(FrameFigures)}
            values["misfit"] = camera.figures.misfit
            appearances[camera.id] = {name: float(value) for name, value in values.items() if isinstance(value, int | float)}
    matched: dict[str, list[bool]] = {}
    for pair in record.pairs:
        if appearances.keys() >= {*pair.cameras} and pair.matched is not None:  # pairs with a lost camera don't count
            for name in pair.cameras:
                matched.setdefault(name, []).append(pair.matched)
    for name, pairs in matched.items():
        appearances[name]["matched_share"] = sum(pairs) / len(pairs)
    return appearances


def with_appearance(record: RunRecord, expected: Expected) -> RunRecord:
    """Return the record with the health of cameras whose images do not look as usual.

    What most cameras have in common tonight (fog, a lamp that is out) is not attributed to a single camera; a camera that an
    earlier stage has found unhealthy keeps that health.
    """
    usual = record.usual.cameras if record.usual else {}
    tonight = {name: figures for name, figures in appearance_of(record).items() if usual.get(name)}
    shares = {
        name: {figure: value / usual[name][figure] for figure, value in figures.items() if usual[name].get(figure, 0.0) > 0}
        for name, figures in tonight.items()
    }
    common = {figure: min(share, 1.0) for figure, share in _medians(shares.values()).items()}
    cameras = []
    for camera in record.cameras:
        if camera.id in tonight and (camera.health is None or camera.health.ok):
            health = _health_by_appearance(tonight[camera.id], usual[camera.id], shares[camera.id], common, expected)
            cameras.append(camera if camera.health and health.ok else replace(camera, health=health))
        else:
            cameras.append(camera)
    return replace(record, cameras=tuple(cameras))


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


def settings_of(site: Site, bindings: Bindings) -> str:
    """Digest of everything that determines a night's results except its captures: the settings of the site file, and the code."""
    stages = []
    for stage in STAGES:
        settings = site.stages[stage.name]
        if settings.enabled:
            bound = bindings.of(stage)
            stages.append([stage.name, bound.function.dotted, bound.code, {**bound.defaults(), **settings.parameters}])
    cameras = [[camera.id, asdict(camera.lens), asdict(camera.placement)] for camera in site.cameras]
    content = [stages, cameras, dict(site.settings.pairs), site.settings.resolution, site.settings.bounds, asdict(site.survey)]
    return hashlib.sha256(json.dumps(content, sort_keys=True, default=str).encode()).hexdigest()[:16]


def _medians(figures: Iterable[dict[str, float]]) -> dict[str, float]:
    values: dict[str, list[float]] = {}
    for entry in figures:
        for name, value in entry.items():
            values.setdefault(name, []).append(value)
    return {name: median(samples) for name, samples in values.items()}
