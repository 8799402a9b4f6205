"""What a verdict is based on, besides the record of the run."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..records.acknowledgement import Acknowledgement
from ..records.findings import Finding
from ..records.record import RunRecord
from ..runner.state import Cause, State
from ..site.models import Expected, Measure
from ..task import Task

PLANNED_PAIRS = 0.5
"""Smallest share of the planned pairs that must be usable on a night without earlier ones to compare with."""


@dataclass(frozen=True)
class Facts:
    """What the verdict is based on, besides the record."""

    failed: tuple[tuple[Task, State], ...] = ()
    product: bool = True
    """Was the run meant to make a cloud?"""
    missing: tuple[str, str] | None = None
    """The stage that the run was meant to end with, and why it made nothing; None if it made something."""
    interrupted: bool = False
    night_bytes: int = 0
    """Disk space that a night takes, bytes; 0 if no task found the disk full."""
    free_bytes: int = 0
    """Free disk space at the end of the run, bytes; 0 if no task found the disk full."""
    stopped: tuple[State, ...] = ()
    """States of the tasks that were not started before the time of --stop-at."""
    upload_finding: Finding | None = None
    """The finding if some results are not in the object store yet."""
    calibration_change: str = ""
    """How lenses and poses differ from those of the reference, which is therefore not used."""
    acknowledged: tuple[Acknowledgement, ...] = ()
    expected: Expected = field(default_factory=Expected)
    """What the site file expects of good nights."""
    still_zones: frozenset[str] = frozenset()
    """Names of the zones in which the site file expects no change."""
    sift_alone: bool = False
    """Does the site use no learned model, nor keypoints of its own?"""
    earlier: tuple[RunRecord, ...] = ()
    """The runs before this one, newest first, one for each night."""

    def least(self, name: str, record: RunRecord) -> float:
        """Return the smallest amount of a night that is no finding; 0 if there is nothing to compare it with."""
        limit = self.expected.limit(name)
        if limit > 1:  # the site file expects a number, not a share of the usual one
            return limit
        typical = record.usual.figures.get(name) if record.usual else None
        if typical is not None:
            return limit * typical
        if name == Measure.PAIRS:
            return PLANNED_PAIRS * len(record.pairs)
        return 0.0  # of cameras, too: each lost one has a finding of its own

    @property
    def disk_full(self) -> tuple[Task, ...]:
        """The tasks that found no space for their results."""
        return tuple(task for task, state in self.failed if state.code == Cause.DISK_FULL)


def has_no_captures(record: RunRecord) -> bool:
    """Has no camera a capture of the night?"""
    return all(camera.code == Cause.NO_CAPTURE for camera in record.cameras)
