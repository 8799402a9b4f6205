"""Changes where the site file expects none."""

from __future__ import annotations

from collections.abc import Iterator

from ..records.changes import open_changes
from ..records.findings import UNEXPECTED_CHANGE, Finding, finding
from ..records.record import RunRecord
from .facts import Facts


def check_changes(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Has something changed where nothing should, that nobody has acknowledged?  Elsewhere, a change is news, but no fault."""
    for change in open_changes(record):
        if facts.expected.changes == "none" or change.zone in facts.still_zones:
            zone = f" in {change.zone}" if change.zone else ""
            text = f"{change.id} {change.words(record.unit, record.date)}{zone}"
            figures = {"volume_least": change.volume_least, "volume_most": change.volume_most}
            yield finding(UNEXPECTED_CHANGE, (change.id,), figures, change=text)
