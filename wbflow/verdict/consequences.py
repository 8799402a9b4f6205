"""Which findings of a night follow from others: a cloud is smaller because cameras are left out, and these have findings."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from ..records.findings import Finding
from ..records.record import PairRecord, RunRecord
from ..site.models import Measure
from .facts import Facts, has_no_captures

_AMOUNTS = "fewer-"
"""Beginning of the codes of findings on amounts that are lower than usual."""
_NOTHING = frozenset({"no-cloud", "no-result"})
"""Codes of findings on a night that has made nothing."""


def with_causes(findings: Iterable[Finding], record: RunRecord, facts: Facts) -> tuple[Finding, ...]:
    """Return the findings of a night; those that follow from the loss of cameras name these cameras.

    A pair gives nothing if one of its cameras does.  A night has lost an amount with its cameras if what the other pairs gave on
    the last good night would, by itself, be a finding that is no worse.
    """
    reported = _without_false_moves(list(findings))
    lost = tuple(camera.id for camera in record.cameras if not camera.ok)
    with_finding: set[str] = set()
    for finding in reported:
        if finding.kind.startswith("camera-"):
            with_finding.update(finding.subject)
    if not lost or not with_finding.issuperset(lost):
        return tuple(reported)
    return tuple(replace(finding, follows=lost) if _follows(finding, lost, record, facts) else finding for finding in reported)


def _without_false_moves(findings: list[Finding]) -> list[Finding]:
    """Return the findings without moves of cameras that deliver the picture of another one: that contradicts their poses, too."""
    alike: set[str] = set()
    for finding in findings:
        if finding.kind == "cameras-alike":
            alike.update(finding.subject)
    return [finding for finding in findings if finding.kind != "camera-moved" or not alike.issuperset(finding.subject)]


def _follows(finding: Finding, lost: Collection[str], record: RunRecord, facts: Facts) -> bool:
    """Does a finding follow from the loss of cameras?"""
    if finding.kind in _NOTHING:
        if has_no_captures(record):  # the night is at fault, not each camera
            return False
        too_few = len(record.cameras) - len(lost) < 2
        return too_few or (bool(record.pairs) and not _without(lost, record.pairs))
    if not finding.kind.startswith(_AMOUNTS):
        return False
    name = finding.kind.removeprefix(_AMOUNTS)
    if name == Measure.CAMERAS:
        return True
    amount = float(finding.figures[name])
    return amount >= _share_without(lost, name, record, facts) * facts.least(name, record)


def _share_without(lost: Collection[str], name: str, record: RunRecord, facts: Facts) -> float:
    """Return the share of an amount that the pairs without these cameras gave on the last good night.

    Each pair counts by the part of its picture for which it gave depth, if that is known; all count the same for the number of
    pairs, and without such a night, when all that are planned count.
    """
    good = next((night for night in facts.earlier if _is_good(night) and night.settings == record.settings), None)
    pairs = [pair for pair in good.pairs if pair.ok] if good else list(record.pairs)
    if not pairs:
        return 1.0
    others = _without(lost, pairs)
    depth = sum(pair.figures.density or 0.0 for pair in pairs)
    if name == Measure.PAIRS or good is None or not depth:
        return len(others) / len(pairs)
    return sum(pair.figures.density or 0.0 for pair in others) / depth


def _is_good(night: RunRecord) -> bool:
    return night.verdict is not None and night.verdict.good and night.cloud is not None


def _without(cameras: Collection[str], pairs: Iterable[PairRecord]) -> list[PairRecord]:
    """Return the pairs that have none of these cameras."""
    return [pair for pair in pairs if not set(cameras) & set(pair.cameras)]
