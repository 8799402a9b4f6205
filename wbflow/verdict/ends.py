"""How a run ended: completely or not, with what it was meant to make or without."""

from __future__ import annotations

from collections.abc import Iterator

from ..records.findings import Finding, finding
from ..records.record import RunRecord
from ..words import counted, format_size
from .facts import Facts, has_no_captures
from .wording import shortened


def check_end(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Did the run complete, did it make what it was meant to make, and does the object store have everything?"""
    if facts.stopped:
        count = len(facts.stopped)
        yield finding("stopped", (), {"tasks": count}, reason=facts.stopped[0].reason, tasks=counted(count, "task"))
    if facts.interrupted:
        yield finding("interrupted")
    elif facts.missing:
        stage, reason = facts.missing
        yield finding("no-result", stage=stage, reason=shortened(reason))
    elif facts.product and not record.cloud and not facts.disk_full:
        remedy = None
        if has_no_captures(record) and record.dated:
            remedy = "check that the cameras deliver, or name another night: wbflow run SITE.yaml --date DAY"
        yield finding("no-cloud", remedy=remedy, reason=shortened(record.reason or "reason unknown"))
    if facts.disk_full:
        yield _disk_finding(record, facts)
    if facts.upload_finding:
        yield facts.upload_finding


def _disk_finding(record: RunRecord, facts: Facts) -> Finding:
    """The one finding about a full disk: what failed because of it is its consequence, and has none of its own."""
    count = len(facts.disk_full)
    reason = f"the disk is full: {format_size(facts.free_bytes)} free, a night of this site takes about"
    reason += f" {format_size(facts.night_bytes)}; {counted(count, 'task')} could not write"
    figures = {"tasks": count, "free_bytes": facts.free_bytes}
    expected = {"free_bytes": facts.night_bytes}
    code = "disk-short" if record.cloud else "disk-full"
    return finding(code, (), figures, expected, reason=reason)
