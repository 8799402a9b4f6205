"""Which findings of a night follow from others: a cloud is smaller because cameras are left out, and these have findings."""

from __future__ import annotations

from ..records.findings import Finding
from ..records.record import RunRecord

_LEAST_OF_EXPECTED = 0.5
"""With n of N cameras, about (n / N)² of the pairs are left.  A figure below this share of that has some other cause as well."""
_AMOUNTS = "fewer-"
"""Beginning of the codes of findings on amounts that are lower than usual."""


def consequences(record: RunRecord) -> tuple[Finding, ...]:
    """Return the findings on low amounts (points, pairs, ground that is seen) that the cameras that are left out explain."""
    if record.verdict is None or not record.cameras:
        return ()
    reported: set[str] = set()
    for finding in record.verdict.findings:
        if finding.kind.startswith("camera-"):
            reported.update(finding.subject)
    used = sum(camera.ok for camera in record.cameras)
    left_out = {camera.id for camera in record.cameras if not camera.ok}
    if not left_out or not left_out <= reported:
        return ()
    least = _LEAST_OF_EXPECTED * (used / len(record.cameras)) ** 2
    return tuple(finding for finding in record.verdict.findings if finding.kind.startswith(_AMOUNTS) and _share(finding) >= least)


def _share(finding: Finding) -> float:
    """Return the amount of a finding as a share of the expected one."""
    name = finding.kind.removeprefix(_AMOUNTS)
    amount = finding.figures.get(name, 0.0)
    expected = finding.expected.get(name, 0.0)
    return float(amount / expected) if expected else 0.0
