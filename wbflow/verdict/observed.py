"""Cameras that observations of things were to place."""

from __future__ import annotations

from collections.abc import Iterator

from ..pipeline.stages import OBSERVED
from ..records.findings import Finding, finding
from ..records.record import RunRecord
from .facts import Facts


def check_observed(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Have the observations placed any cameras?  Single ones that they have not placed are findings of these cameras."""
    result = record.results.get(OBSERVED)
    if result is not None and result.reason:
        yield finding("observations-unused", (), reason=result.reason)
