"""What a run publishes beside its cloud: maps and lists that site-wide stages make files of, and their figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..cache import artifact
from ..cache.atomic import write_atomic
from ..cache.ply import ply_bytes
from ..cache.signed import Damaged, read_signed, write_signed
from ..cache.untrusted import read_outside
from ..errors import WbflowError
from ..pipeline.stages import STAGES, Stage
from ..pipeline.summaries import MEANINGS, meaning
from ..runner.journal import Journal
from ..runner.planner import Plan
from ..task import Task
from .artifacts import function

_MOST_NAMED = 8
"""So many of a figure's parts are named, the largest first."""
_KEPT = ".beside"
"""Ends the names of these files in the cache, where .json would be a receipt."""


def files_beside(plan: Plan, journal: Journal) -> dict[str, dict[str, bytes]]:
    """Name and content of the files that stages make of their results, by stage.

    They are kept beside the artifact, so that nothing is made again of one that has not changed.  What cannot be made (a library
    is not installed, no map has the place) is told to the journal: the night is not lost for it.
    """
    return {stage.name: dict(_files(plan, stage, journal)) for stage in STAGES if stage.products.files and _usable(plan, stage)}


def _usable(plan: Plan, stage: Stage) -> bool:
    state = plan.states.get(Task(stage.name))
    return state is not None and state.usable and state.receipt is not None


def _files(plan: Plan, stage: Stage, journal: Journal) -> Iterator[tuple[str, bytes]]:
    task = Task(stage.name)
    receipt = plan.states[task].receipt
    assert receipt is not None
    work, code = plan.cache.work, plan.site.reader.read(stage.products.files).code
    memo = work.published(task, receipt.key)
    try:
        known = read_signed(memo, work.place(memo)) or {}
        if known.get("code") == code:
            kept = {name: work.artifact(task, receipt.key, f".{name}{_KEPT}") for name in known["files"]}
            yield from [(name, _intact(path, known["files"][name])) for name, path in kept.items()]
            return
    except (Damaged, OSError) as damage:
        journal.repaired(f"{damage}: made again", task=task)
    made = {}
    try:
        for name, content in function(stage.products.files)(plan.cache.load(task, receipt)):
            data = content if isinstance(content, bytes) else bytes(ply_bytes(content, comments=("made by wbflow",)))
            write_atomic(work.artifact(task, receipt.key, f".{name}{_KEPT}"), data, ours=True)
            made[name] = artifact.digest(data)
            yield name, data
    except (WbflowError, ValueError, ImportError) as error:
        journal.warn(f"not all of its files could be made: {error}", task=task)
        return  # tried again by the next run
    write_signed(memo, work.place(memo), {"code": code, "files": made})
    plan.site.reader.save()


def _intact(path: Path, digest: str) -> bytes:
    data = read_outside(path)
    if artifact.digest(data) != digest:
        raise Damaged(f"{path.name} is not as it was written")
    return data


def shown(figures: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Figures of a stage for people: name and value."""
    for name, value in figures.items():
        title, written = titled(name), _percent if meaning(name).share else spoken
        if isinstance(value, Mapping) and value and all(isinstance(entry, int | float) for entry in value.values()):
            ordered = sorted(value.items(), key=lambda entry: -entry[1])
            less = f"; {len(ordered) - _MOST_NAMED} others less" if len(ordered) > _MOST_NAMED else ""
            yield title, ", ".join(f"{key} {written(number)}" for key, number in ordered[:_MOST_NAMED]) + less
        elif value is not None and not isinstance(value, Mapping | list | tuple | str):
            yield title, written(value)


def titled(name: str) -> str:
    """What a figure is called."""
    if name in MEANINGS:
        return MEANINGS[name].title
    words, _, unit = name.rpartition("_")
    return (f"{words} ({'degrees' if unit == 'deg' else unit})" if unit in {"m", "m2", "deg"} else name).replace("_", " ")


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if 0 < share < 0.1 else f"{100 * share:.0f} %"


def spoken(value: Any) -> str:
    """A number, yes or no, or a word, as people read it."""
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "yes" if value else "no"
    return number(value) if isinstance(value, float) else f"{value:,}"


def number(value: float) -> str:
    """As people read it: three digits that count, thousands apart."""
    if value == 0 or abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:.3g}"
