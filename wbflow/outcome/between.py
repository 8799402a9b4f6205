"""What changed between any two runs, found anew as a night finds what changed since the reference."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..cache.plugins import load
from ..errors import WbflowError
from ..pipeline.exports import CHANGES_DATA
from ..pipeline.names import CHANGES, DEPTH, FRAMES, POSES, REFINE
from ..pipeline.summaries import CutFill
from ..task import Task
from .artifacts import FinishedRun, Gone


class NotComparable(WbflowError):
    """Two runs cannot be compared; the message says why."""


def changes_between(then: FinishedRun, tonight: FinishedRun) -> Any:
    """Return what changed (`wbflow_stages.types.Changes`), by the function and the parameters of the later run.

    Raises
    ------
    Gone
        The cache does not hold what one of them made any more.
    NotComparable
        One of them looked for no changes, or they lie in different worlds.
    """
    receipt = tonight.receipt(Task(CHANGES))
    if receipt is None:
        raise NotComparable(f"run {tonight.folder.id} did not look for changes", remedy="its log.jsonl says why")
    used = receipt.preimage
    found = load(used.function)(**_surface(tonight), **_surface(then, "reference_"), **used.parameters)
    if not found.compared:
        raise NotComparable(
            f"runs {then.folder.id} and {tonight.folder.id} have nothing in common", remedy="their cameras stand at other places"
        )
    return found


def _surface(run: FinishedRun, prefix: str = "") -> Mapping[str, Any]:
    """Return what the search for changes takes of a run, by argument name."""
    poses = run.made(POSES)
    if poses is None:
        raise Gone(f"run {run.folder.id} placed no cameras: {run.record.reason or 'it was not asked to'}")
    of_cameras = {"frames": FRAMES, "depths": DEPTH, "refined": REFINE}
    values = {"poses": poses, "cloud": run.cloud(), **{name: run.of_cameras(stage) for name, stage in of_cameras.items()}}
    return {prefix + name: value for name, value in values.items()}


def data_of(changes: Any) -> dict[str, Any]:
    """Return the same as changes.json has it."""
    data: dict[str, Any] = load(CHANGES_DATA)(changes)
    return data


def lines_of(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield volumes and changes for people."""
    unit = "m" if data["unit"] == "m" else "units"
    parts = {"": data.get("cut_fill"), **data["zones"]}
    for zone, part in ((zone, CutFill.from_json(part)) for zone, part in parts.items() if part):
        volumes = f"gained {part.gained:.2f} ± {part.gained_sigma:.2f}, lost {part.lost:.2f} ± {part.lost_sigma:.2f} {unit}³"
        ground = f"{part.area:,.0f} {unit}² seen on both, {part.unseen:,.0f} not; level of detection {part.level:.3f} {unit}"
        yield f"{zone or 'whole site'}: {volumes}; {ground}"
    for change in data["changes"]:
        place = ", ".join(f"{value:.1f}" for value in change["position"])
        yield f"{change['kind']} at {place}: {change['volume']:.2f} ± {change['volume_sigma']:.2f} {unit}³"
