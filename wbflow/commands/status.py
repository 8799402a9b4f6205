"""What would run tonight, and why: the plan of a night explained task by task, for `wbflow status`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from statistics import fmean

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
    cause: str = ""
    """Why the first of the tasks was skipped that this one was skipped for; `why` of any other task."""
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
    lines: dict[Task, Line] = {}
    # 1. tasks that need nothing done
    costs: dict[str, list[float]] = {}
    for task, state in plan.states.items():
        lines[task] = Line(str(task), state.outcome, state.reason or "", _cause(plan, task))
        if state.receipt:
            costs.setdefault(task.stage, []).append(state.receipt.cpu)
    # 2. tasks that would run; one that never has is expected to cost what others of its stage did
    mean_costs = {stage: fmean(values) for stage, values in costs.items()}
    for task in (*plan.ready, *plan.waiting):
        last = plan.night.cache.newest(task)
        seconds = mean_costs.get(task.stage)
        if last:
            seconds = last.cpu
        why = _why(plan, task, last)
        lines[task] = Line(str(task), "would run", why, why, seconds)
    # 3. all of them, in the order of the pipeline
    names = [stage.name for stage in plan.night.stages]
    ordered = tuple(lines[task] for task in sorted(lines, key=lambda task: names.index(task.stage)))
    expected = [line.seconds for line in ordered if line.seconds is not None]
    unknown_pairs = None in (plan.subjects.pairs(), plan.subjects.pairs(dense=True))
    return Status(
        site=plan.night.site.name,
        night=str(plan.night.date),
        tasks=ordered,
        totals=dict(Counter(line.state for line in ordered)),
        cpu_seconds=sum(expected) if expected else None,
        pairs_to_come=plan.night.takes_part(PAIRS) and unknown_pairs,
    )


def _cause(plan: Plan, task: Task) -> str:
    """Return why a task has ended as it has; one that was skipped because others were has their reason."""
    reason = plan.states[task].reason or ""
    if plan.states[task].outcome != "skipped":
        return reason
    for upstream in plan.upstreams(task):
        state = plan.states.get(upstream)
        # a reason that is handed on is the end of the next one
        if state and state.outcome == "skipped" and state.reason and reason.endswith(state.reason):
            return _cause(plan, upstream)
    return reason


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
    # those that may change: if they give the same bytes again, the task is not run
    pending = sum(upstream not in plan.states for upstream in upstreams)
    if not pending:
        return "once the pair graph is known"
    if pending == 1:
        return "an input may change"
    return f"{pending} of {len(upstreams)} inputs will change"


def difference(last: Receipt, now: Preimage) -> str:
    """What has changed since a receipt, in words."""
    previous = last.preimage
    parts = []
    if previous.code != now.code:
        what = "its code, or a library's version, changed"
        if previous.function != now.function:
            what = f"function {previous.function} → {now.function}"
        parts.append(what)
    names = previous.parameters.keys() | now.parameters.keys()
    if previous.function != now.function:  # each has parameters of its own
        names = previous.parameters.keys() & now.parameters.keys()
    for name in sorted(names):
        old, new = previous.parameters.get(name), now.parameters.get(name)
        if old != new:
            parts.append(f"parameter {now.stage}.{name} {old} → {new}")
    inputs = previous.inputs.keys() | now.inputs.keys()
    changed = [name for name in sorted(inputs) if previous.inputs.get(name) != now.inputs.get(name)]
    if len(changed) == 1:
        parts.append(f"input {changed[0]} changed")
    elif changed:
        named = changed[:_MOST_NAMED_INPUTS]
        if len(changed) > len(named):
            named.append("...")
        parts.append(f"{len(changed)} of {len(inputs)} inputs changed: {', '.join(named)}")
    return "; ".join(parts)
