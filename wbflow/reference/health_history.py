"""What earlier nights found of the cameras, from their records."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..cache.layout import WorkFolder
from ..records.record import Health, RunRecord
from ..records.run_folder import NoSuchRun, RunFolder

SHIFTS_TYPE = "wbflow_stages.types:Usual"
"""What the shifts of earlier nights are handed to a stage as; its fields are lists, one number for each night, oldest first..."""
SHIFTS = ("shift_x_px", "shift_y_px", "roll_deg")
"""...and their names, which are those of the figures of the camera's health."""
MOST_NIGHTS = 30


@dataclass
class ShiftHistory:
    """The nights before tonight that were compared with the same reference."""

    work: WorkFolder | None = None
    """Where their runs are; None: there is no past."""
    night: str = ""
    """Tonight's date: only what is older counts, so that a night that is run again finds the same past."""
    reference: str = ""
    """Id of the reference's run."""
    _read: dict[str, dict[str, Health]] | None = field(default=None, repr=False)

    def figures(self, camera: str, names: tuple[str, ...], nights: int) -> dict[str, list[float]]:
        """Figures of a camera's health by name, one for each of the last nights that has all of them, oldest first.

        Parameters
        ----------
        camera : str
            Its id.
        names : tuple of str
            Which figures.
        nights : int
            So many at most.
        """
        healths = [by_camera[camera] for _, by_camera in sorted(self._healths().items()) if camera in by_camera]
        told = [health.figures for health in healths if all(name in health.figures for name in names)]
        return {name: [float(figures[name]) for figures in told[-nights:]] for name in names} if told else {}

    def _healths(self) -> dict[str, dict[str, Health]]:
        """Of each night's newest run, by date and camera."""
        if self._read is None:
            self._read = {}
            for run in self.work.run_ids() if self.work else ():
                record = self._record(run)
                if record and record.date < self.night and record.reference == self.reference:
                    self._read[record.date] = {camera.id: camera.health for camera in record.cameras if camera.health}
        return self._read

    def _record(self, run: str) -> RunRecord | None:
        assert self.work is not None
        try:
            return RunFolder.of(self.work, run).record()
        except NoSuchRun:  # taken away, or not to be read: one night less is known
            return None
