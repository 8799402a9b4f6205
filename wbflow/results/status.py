"""What would run, and why: the plan, compared with the last receipts of each task."""

from __future__ import annotations

from dataclasses import dataclass

from ..graph.pipeline import Role, stage_with
from ..night.plan import Plan
from ..night.spec import TaskSpec
from ..store.cache import Preimage, Receipt
from ..task import Task


@dataclass(frozen=True)
class Line:
    """A task in the status of a site."""

    task: str
    """Its name."""
    state: str
    """Cached, rejected, failed, skipped, would run, or waits."""
    why: str
    """In words."""


def explain(plan: Plan) -> list[Line]:
    """A line for every task that is known of, in the order of the pipeline."""
    lines = {}
    for task, state in plan.states.items():
        lines[task] = Line(str(task), state.outcome, state.reason or "")
    for task, spec in plan.ready.items():
        lines[task] = Line(str(task), "would run", _why(plan, spec))
    for task in plan.waiting:
        lines[task] = Line(str(task), "would run", _pending(plan, task))
    order = {stage.name: i for i, stage in enumerate(plan.stages())}
    return [lines[task] for task in sorted(lines, key=lambda t: order[t.stage])]


def pairs_to_come(plan: Plan) -> bool:
    """Will pairs be matched that are not listed yet, because the pair graph is not there?"""
    return not plan.pairs_known() and stage_with(Role.PAIR_GRAPH) in plan.stages()


def _why(plan: Plan, spec: TaskSpec) -> str:
    if spec.force:
        return "forced"
    last = plan.cache.newest(spec.task)
    if last is None:
        return "never run"
    return difference(last, spec.preimage()) or "its artifact is gone"


def _pending(plan: Plan, task: Task) -> str:
    """How much of a waiting task's input is to be made anew (the same bytes may come out of it: then the task is not run)."""
    last = plan.cache.newest(task)
    upstreams = plan.upstreams(task)
    pending = sum(upstream not in plan.states for upstream in upstreams)
    if last is None or not pending:
        return "never run" if last is None else "once the pair graph is known"
    return f"{pending} of {len(upstreams)} inputs will change" if pending > 1 else "an input may change"


def difference(last: Receipt, now: Preimage) -> str:
    """What changed since a receipt, in words."""
    before = last.preimage
    found = []
    if before.code != now.code:
        renamed = before.function != now.function
        found.append(f"function {before.function} → {now.function}" if renamed else "its code, or a library's version, changed")
    for name in sorted(before.parameters.keys() | now.parameters.keys()):
        old, new = before.parameters.get(name), now.parameters.get(name)
        if old != new:
            found.append(f"parameter {now.stage}.{name} {old} → {new}")
    changed = [
        name for name in sorted(before.inputs.keys() | now.inputs.keys()) if before.inputs.get(name) != now.inputs.get(name)
    ]
    if len(changed) == 1:
        found.append(f"input {changed[0]} changed")
    elif changed:
        found.append(f"{len(changed)} of {len(now.inputs)} inputs changed")
    return "; ".join(found)
