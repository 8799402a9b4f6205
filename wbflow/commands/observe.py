"""Cameras placed by observations (`wbflow observe`), without a night's work: what a surveyor asks before going home."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..cache.artifact import result_of
from ..cache.atomic import write_atomic
from ..errors import ExitCode, UsageError
from ..pipeline.stages import OBSERVED
from ..pipeline.summaries import ObservedSummary
from ..plugins import load
from ..records.run_folder import hold_to_write
from ..runner.options import Options
from ..runner.plan import Plan
from ..runner.state import Impossible, Waiting, summary_of
from ..runner.tonight import read_night
from ..runner.worker import arguments_of, run_chain
from ..site.models import Site
from ..task import Task
from ..words import counted

_TASK = Task(OBSERVED)
_CAMERAS_FILE = "wbflow_stages.io.cameras:observed_calibration_file"


@dataclass(frozen=True)
class Placed:
    """How the observations of a site place its cameras."""

    summary: ObservedSummary
    """Empty but for its reason if they place none."""
    file: Path | None = None
    """The calibration file with the placed cameras; None without any."""

    @property
    def exit_code(self) -> ExitCode:
        """As of a run: failed if no camera is placed, degraded if one with observations is not."""
        if self.summary.reason:
            return ExitCode.FAILED
        if self.summary.unplaced:
            return ExitCode.DEGRADED
        return ExitCode.GOOD

    def to_json(self) -> dict[str, Any]:
        """The figures, the calibration file and the exit code."""
        data: dict[str, Any] = self.summary.to_json()
        del data["files"]
        data["calibration"] = None
        if self.file is not None:
            data["calibration"] = str(self.file)
        return {**data, "exit_code": int(self.exit_code)}


def place_cameras(site: Site, out: Path | None = None, wait: bool = False) -> Placed:
    """Place the cameras by the observations that the site file names.  A run takes the result from the cache.

    Raises UsageError if the site file names none, Locked if a run holds the work folder.

    Parameters
    ----------
    site : Site
        The site.
    out : Path, optional
        Folder for the calibration file; in the work folder, if not given.
    wait : bool
        Wait for a run that holds the work folder.
    """
    if site.observations is None:
        remedy = "give recordings of a lamp or board: wbflow observe SITE.yaml RECORDINGS...; or name a table: observations: FILE"
        raise UsageError(f"{site.file} names no observations", remedy=remedy)
    work = site.work_folder
    with hold_to_write(work, wait):
        # 1. the task as a run has it, so that its key is the same
        plan = Plan(read_night(site, Options()))
        plan.refresh()
        cache = plan.night.cache
        try:
            spec = plan.spec_of(_TASK)
        except (Waiting, Impossible):  # a function of the site's own takes more than what the site file states
            remedy = f"wbflow run {site.file} --until {OBSERVED}  makes what it needs"
            raise UsageError(f"'{_TASK}' needs results of other stages", remedy=remedy) from None
        # 2. its result, from the cache or made now, in this process
        (finished,) = run_chain([spec], cache)
        state = finished.state
        if not state.usable or state.receipt is None or state.receipt.file is None:
            return Placed(ObservedSummary(reason=state.reason))
        summary = summary_of(state, ObservedSummary)
        data = cache.read(_TASK, work.task(_TASK) / state.receipt.file, state.receipt.digest)
    # 3. the cameras as a calibration file
    result = result_of(data, OBSERVED)
    file = work.observed_cameras
    if out is not None:
        file = out / file.name
    write_atomic(file, load(_CAMERAS_FILE)(result, arguments_of(spec, cache)["lenses"]))
    return Placed(summary, file)


def report_lines(site: Site, summary: ObservedSummary) -> list[str]:
    """What a surveyor asks, as lines to print."""
    if summary.reason:
        return [f"{site.name}: no camera is placed: {summary.reason}"]
    count = len(summary.cameras) - len(summary.unplaced)
    cameras = counted(len(site.cameras), "camera")
    lines = [f"{site.name}: {count} of {cameras} placed by {counted(summary.things, 'moment')} of things"]
    lines += _aligned(summary.table)
    unobserved = []
    for camera in site.cameras:
        if camera.id not in summary.cameras:
            unobserved.append(camera.id)
    if unobserved:
        lines.append(f"without observations: {', '.join(unobserved)}")
    lines += summary.sentences
    return lines


def _aligned(rows: Sequence[tuple[str, ...]]) -> list[str]:
    """Rows as lines with columns of equal width: the first column to the left, numbers to the right."""
    widths = []
    for column in zip(*rows, strict=True):
        widths.append(max(map(len, column)))
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0])]
        cells += map(str.rjust, others, widths[1:])
        lines.append("  ".join(cells).rstrip())
    return lines
