"""What would run tonight, and why: the plan of a night explained task by task, for `wbflow status`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from ..cache.receipt import Preimage, Receipt
from ..pipeline.stages import PAIRS
from ..runner.plan import Plan
from ..task import Task

_MOST_NAMED_INPUTS = 3
"""Number of changed inputs that are named."""


@dataclass(frozen=True)
class Line:
    """A task in the status of a site."""

    task: str
    state: str
    """The outcome of its `State` (cached, rejected, ...), or "would run"."""
    why: str
    seconds: float | None = None
    """Expected CPU time, from its last run or the mean of its stage; None if it won't run, or neither is known."""


@dataclass(frozen=True)
class Status:
    """What is cached and what would run."""

    site: str
    night: str
    tasks: tuple[Line, ...]
    """A line for every known task, in the order of the pipeline."""
    totals: dict[str, int]
    """How many tasks are in each state."""
    cpu_seconds: float | None
    """Expected CPU time of all tasks that would run, as far as it is known; None if none is."""
    pairs_to_come: bool
    """Further pairs will be matched that are not listed, because the pair graph is not known yet."""


def explain(plan: Plan) -> Status:
    """Return what would become of each task of a plan, and why."""
    costs: dict[str, list[float]] = {}
    lines: dict[Task, Line] = {}
    for task, state in plan.states.items():
        lines[task] = Line(str(task), state.outcome, state.reason or "")
        if state.receipt:
            costs.setdefault(task.stage, []).append(state.receipt.cpu)
    mean_costs = {stage: sum(values) / len(values) for stage, values in costs.items()}
    for task in (*plan.ready, *plan.waiting):
        last = plan.night.cache.newest(task)
        seconds = last.cpu if last else mean_costs.get(task.stage)
        lines[task] = Line(str(task), "would run", _why(plan, task, last), seconds)
    order = {stage.name: number for number, stage in enumerate(plan.night.stages)}
    ordered = tuple(lines[task] for task in sorted(lines, key=lambda task: order[task.stage]))
    expected = [line.seconds for line in ordered if line.seconds is not None]
    pairs_to_come = plan.night.takes_part(PAIRS) and None in (plan.subjects.pairs(), plan.subjects.pairs(dense=True))
    totals = dict(Counter(line.state for line in ordered))
    return Status(plan.night.site.name, str(plan.night.date), ordered, totals, sum(expected) if expected else None, pairs_to_come)


def _why(plan: Plan, task: Task, last: Receipt | None) -> str:
    """Return why a task that is ready or waiting would run.  last: its newest receipt."""
    spec = plan.ready.get(task)
    if spec and spec.force:
        return "forced"
    if last is None:
        return "never run"
    if spec:
        return difference(last, spec.preimage()) or "its artifact is gone"
    upstreams = plan.upstreams(task)
    pending = sum(upstream not in plan.states for upstream in upstreams)  # if they give the same bytes, the task is not run
    if not pending:
        return "once the pair graph is known"
    return f"{pending} of {len(upstreams)} inputs will change" if pending > 1 else "an input may change"


def difference(last: Receipt, now: Preimage) -> str:
    """What has changed since a receipt, in words."""
    previous = last.preimage
    parts = []
    if previous.code != now.code:
        renamed = previous.function != now.function
        parts.append(f"function {previous.function} → {now.function}" if renamed else "its code, or a library's version, changed")
    for name in sorted(previous.parameters.keys() | now.parameters.keys()):
        old, new = previous.parameters.get(name), now.parameters.get(name)
        if old != new:
            parts.append(f"parameter {now.stage}.{name} {old} → {new}")
    changed = [
        name for name in sorted(previous.inputs.keys() | now.inputs.keys()) if previous.inputs.get(name) != now.inputs.get(name)
    ]
    if len(changed) == 1:
        parts.append(f"input {changed[0]} changed")
    elif changed:
        named = ", ".join(changed[:_MOST_NAMED_INPUTS])
        suffix = ", ..." if len(changed) > _MOST_NAMED_INPUTS else ""
        parts.append(f"{len(changed)} of {len(now.inputs)} inputs changed: {named}{suffix}")
    return "; ".join(parts)
