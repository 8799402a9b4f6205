"""How much a night has made, and how much of its cloud is right."""

from __future__ import annotations

from collections.abc import Iterator

from ..pipeline.stages import STAGES
from ..pipeline.summaries import SiteSummary
from ..records.findings import Baseline, Finding, finding
from ..records.record import RunRecord
from ..site.models import Measure
from ..words import counted
from .baseline import figures_of
from .facts import Facts
from .wording import listed, most_common_reason

LEAST_CORRECT_SHARE = 0.9
"""Smallest share of a cloud's points that must be right, as expected from the confidence of each.  Larger: more nights count as
doubtful."""


def check_cloud(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Is enough of the cloud right, as expected from the confidence of its points?"""
    cloud = record.cloud
    if cloud is None or cloud.correct_share is None or cloud.correct_share >= LEAST_CORRECT_SHARE:
        return
    share = cloud.correct_share
    figures = {"correct_share": share}
    expected = {"correct_share": LEAST_CORRECT_SHARE}
    yield finding("cloud-doubtful", (), figures, expected, percent=100 * share, limit=100 * LEAST_CORRECT_SHARE)


def check_amounts(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Is there as much as the site file expects, as the last good nights gave, or as the night itself planned?"""
    if facts.interrupted or not facts.product or not record.cloud or facts.disk_full:
        return
    baseline = record.usual or Baseline(0, {})
    source = "the reference's" if baseline.reference else "the usual"
    figures = figures_of(record)
    figures[Measure.CAMERAS] = float(sum(camera.ok for camera in record.cameras))
    for name, value in figures.items():
        least = facts.least(name, record)
        if value >= least:
            continue
        amount = _amount_text(name, value)
        typical = baseline.figures.get(name)
        if facts.expected.limit(name) > 1:  # the site file expects a number, not a share of the usual one
            yield _fewer_finding(name, value, least, f"{amount}; at least {least:,.0f} are expected")
        elif typical is not None:  # of earlier nights, or of the reference
            text = f"{amount}, {100 * value / typical:.0f} % of {source} {typical:,.0f}"
            yield _fewer_finding(name, value, typical, text)
        else:
            planned = float(len(record.pairs))
            text = f"only {value:.0f} of {planned:.0f} pairs could be used; most of the others: {_why_few(record)}"
            yield _fewer_finding(name, value, planned, text)


def _amount_text(name: str, value: float) -> str:
    """Return a figure with its unit: "9 pairs", or what the stage of this name says that it measures."""
    for stage in STAGES:
        if stage.name == name and stage.summary and issubclass(stage.summary, SiteSummary):
            return f"{value:,.0f} {' '.join(stage.summary.AMOUNT)}"
    things: dict[str, str] = {Measure.POINTS: "point", Measure.PAIRS: "pair", Measure.CAMERAS: "camera"}
    return counted(value, things[name])


def _fewer_finding(name: str, value: float, base: float, text: str) -> Finding:
    return finding(f"fewer-{name}", (), {name: round(value)}, {name: round(base)}, reason=text)


def _why_few(record: RunRecord) -> str:
    """Return what most unusable pairs have in common: cameras that are left out, else their most common reason."""
    unused = [pair for pair in record.pairs if not pair.ok]
    left_out = {camera.id for camera in record.cameras if not camera.ok}
    with_left_out = [pair for pair in unused if left_out.intersection(pair.cameras)]
    if 2 * len(with_left_out) > len(unused):
        return f"include cameras that are left out ({listed(sorted(left_out))})"
    return most_common_reason(unused)
