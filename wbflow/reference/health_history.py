"""How cameras shifted on earlier nights, from their records."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import islice

from ..cache.layout import WorkFolder
from ..records.findings import Health
from ..records.run_folder import newest_runs

SHIFTS_TYPE = "wbflow_stages.types:Usual"
"""The type that shifts are handed to a stage as; its fields are lists, one number for each night, oldest first..."""
SHIFTS = ("shift_x_px", "shift_y_px", "roll_deg")
"""...and their names, which are those of the figures of the camera's health."""
MOST_NIGHTS = 14
MOST_RUNS = 3 * MOST_NIGHTS
"""So many records are read at most: nights may be run several times."""


@dataclass
class ShiftHistory:
    """The nights before tonight that were compared with the same reference."""

    work: WorkFolder | None = None
    """Where their runs are; None: there are none."""
    night: str = ""
    """Tonight's date: only what is older counts, so that a night that is run again finds the same past."""
    reference: str = ""
    """Id of the reference's run."""

    def of_camera(self, camera: str) -> dict[str, list[float]]:
        """Return a camera's shifts by name, one for each night that has them, oldest first."""
        healths = [by_camera[camera] for _, by_camera in sorted(self._healths.items()) if camera in by_camera]
        found = [health.figures for health in healths if all(name in health.figures for name in SHIFTS)]
        return {name: [float(figures[name]) for figures in found] for name in SHIFTS} if found else {}

    @cached_property
    def _healths(self) -> dict[str, dict[str, Health]]:
        """Of each night's newest run, by date and camera."""
        found: dict[str, dict[str, Health]] = {}
        for _, record in islice(newest_runs(self.work, after=self.reference), MOST_RUNS) if self.work else ():
            if record.date < self.night and record.reference == self.reference and record.date not in found:
                found[record.date] = {camera.id: camera.health for camera in record.cameras if camera.health}
            if len(found) == MOST_NIGHTS:
                break
        return found
