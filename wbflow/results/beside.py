"""What a run publishes beside its cloud: maps and lists that site-wide stages make files of, and their figures."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from ..errors import WbflowError
from ..graph.pipeline import STAGES, Stage
from ..night.plan import Plan
from ..store.atomic import write_atomic
from ..store.record import Figures
from ..task import Task
from .artifacts import function

Warn = Callable[[str], object]


def files_beside(plan: Plan, warn: Warn) -> dict[str, dict[str, bytes]]:
    """Name and content of the files that stages make of their results, by stage.

    They are kept beside the artifact, so that nothing is made again of one that has not changed.  What cannot be made (a library
    is not installed, no map has the place) is told to `warn`: the night is not lost for it.
    """
    return {stage.name: dict(_files(plan, stage, warn)) for stage in STAGES if stage.files and _usable(plan, stage)}


def told_beside(plan: Plan, files: Mapping[str, Mapping[str, bytes]]) -> dict[str, Figures]:
    """What run.json says of the results of site-wide stages, by stage: their figures, and the names of their files."""
    found: dict[str, Figures] = {}
    for stage in STAGES:
        if stage.scope == "site" and stage.reports and stage in plan.stages():
            state = plan.states.get(Task(stage.name))
            figures = state.receipt.figures if state and state.usable and state.receipt else {}
            told = {ours: figures.get(theirs) for ours, theirs in stage.reports.fields.items()} if figures else {}
            reason = state.reason if state and not state.usable else None
            found[stage.name] = {**told, "files": sorted(files.get(stage.name, ())), "reason": reason}
    return found


def _usable(plan: Plan, stage: Stage) -> bool:
    state = plan.states.get(Task(stage.name))
    return state is not None and state.usable and state.receipt is not None


def _files(plan: Plan, stage: Stage, warn: Warn) -> Iterator[tuple[str, bytes]]:
    task = Task(stage.name)
    receipt = plan.states[task].receipt
    assert receipt is not None
    work, code = plan.cache.work, plan.site.reader.read(stage.files).code
    memo = work.published(task, receipt.key)
    try:
        known = json.loads(memo.read_bytes())
        if known["code"] == code:
            yield from [(name, work.artifact(task, receipt.key, f".{name}").read_bytes()) for name in known["names"]]
            return
    except (OSError, ValueError, KeyError, TypeError):  # never made, or by another version
        pass
    names = []
    try:
        for name, content in function(stage.files)(plan.cache.load(task, receipt)):
            write_atomic(work.artifact(task, receipt.key, f".{name}"), content)
            names.append(name)
            yield name, content
    except (WbflowError, ValueError, ImportError) as error:
        warn(f"{task}: not all of its files could be made: {error}")
        return  # tried again by the next run
    write_atomic(memo, json.dumps({"code": code, "names": names}).encode())
    plan.site.reader.save()


def shown(figures: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Figures of a stage for people: name and value."""
    for name, value in figures.items():
        words, _, unit = name.rpartition("_")
        title = (f"{words} ({'degrees' if unit == 'deg' else unit})" if unit in {"m", "m2", "deg"} else name).replace("_", " ")
        if isinstance(value, Mapping):
            ordered = sorted(value.items(), key=lambda entry: -entry[1])
            yield title, ", ".join(f"{key} {_number(number)}" for key, number in ordered)
        elif value is not None and not isinstance(value, list | tuple | str):
            yield title, _number(value)


def _number(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else f"{value:,}"
