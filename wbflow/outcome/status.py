"""What would run, and why: the plan, compared with the last receipts of each task."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from ..cache.store import Preimage, Receipt
from ..pipeline.names import PAIRS
from ..pipeline.stages import stage_named
from ..runner.planner import Plan
from ..runner.spec import TaskSpec
from ..task import Task

_MOST_NAMED = 3
"""So many of the inputs that have changed are named."""


@dataclass(frozen=True)
class Line:
    """A task in the status of a site."""

    task: str
    """Its name."""
    state: str
    """Cached, rejected, failed, skipped, would run, or waits."""
    why: str
    """In words."""
    seconds: float | None = None
    """CPU time that it will take, by its last run or by the others of its stage; None where it won't run, or nobody knows."""


def explain(plan: Plan) -> list[Line]:
    """A line for every task that is known of, in the order of the pipeline."""
    lines: dict[Task, Line] = {}
    costs = _Costs(plan)
    for task, state in plan.states.items():
        lines[task] = Line(str(task), state.outcome, state.reason or "")
    for task, spec in plan.ready.items():
        lines[task] = Line(str(task), "would run", _why(plan, spec), costs.of(task))
    for task in plan.waiting:
        lines[task] = Line(str(task), "would run", _pending(plan, task), costs.of(task))
    order = {stage.name: i for i, stage in enumerate(plan.stages())}
    return [lines[task] for task in sorted(lines, key=lambda t: order[t.stage])]


def totals(lines: Iterable[Line]) -> dict[str, int]:
    """How many tasks are in each state."""
    return dict(Counter(line.state for line in lines))


def seconds_to_come(lines: Iterable[Line]) -> float | None:
    """CPU time of all that would run, as far as is known; None where nothing is."""
    known = [line.seconds for line in lines if line.seconds is not None]
    return sum(known) if known else None


class _Costs:
    """What tasks have cost the last time."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._of_stage: dict[str, list[float]] = {}
        for task, state in plan.states.items():
            if state.receipt:
                self._of_stage.setdefault(task.stage, []).append(state.receipt.cpu)

    def of(self, task: Task) -> float | None:
        """CPU seconds: its own last ones, else what others of its stage take; None where nobody knows."""
        if last := self._plan.cache.newest(task):
            return last.cpu
        others = self._of_stage.get(task.stage)
        return sum(others) / len(others) if others else None


def pairs_to_come(plan: Plan) -> bool:
    """Will pairs be matched that are not listed yet, because the pair graph is not there?"""
    return not plan.pairs_known() and stage_named(PAIRS) in plan.stages()


def _why(plan: Plan, spec: TaskSpec) -> str:
    if spec.force:
        return "forced"
    last = plan.cache.newest(spec.task)
    if last is None:
        return "never run"
    return difference(last, spec.preimage()) or "its artifact is gone"


def _pending(plan: Plan, task: Task) -> str:
    """How much of a waiting task's input is to be made anew (the same bytes may come out of it: then the task is not run)."""
    if plan.cache.newest(task) is None:
        return "never run"
    upstreams = plan.upstreams(task)
    pending = sum(upstream not in plan.states for upstream in upstreams)
    if not pending:
        return "once the pair graph is known"
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
        named = ", ".join(changed[:_MOST_NAMED])
        more = ", ..." if len(changed) > _MOST_NAMED else ""
        found.append(f"{len(changed)} of {len(now.inputs)} inputs changed: {named}{more}")
    return "; ".join(found)
