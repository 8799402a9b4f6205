"""What a night still has before it, as those who watch are told."""

from __future__ import annotations

from ..graph.pipeline import ROUGH_SECONDS
from ..store.events import StageOutlook
from ..store.past import Past
from .plan import Plan


def outlook(plan: Plan, past: Past) -> tuple[StageOutlook, ...]:
    """How much there is of each stage, how much of it is settled, and what a task of it takes.

    Parameters
    ----------
    plan : Plan
        As it stands.
    past : Past
        What tasks took before.
    """
    found = []
    pairs = plan.likely_pairs()
    for stage in plan.stages():
        tasks = plan.tasks(stage)
        settled = sum(task in plan.states for task in tasks)
        known = stage.name in past.stages
        walls = [past.expected(stage.name, str(task)) for task in tasks if task not in plan.states] if known else []
        seconds = sum(walls) / len(walls) if walls else past.stages.get(stage.name, ROUGH_SECONDS[stage.name])
        found.append(StageOutlook(stage.name, pairs if stage.scope == "pair" and pairs else len(tasks), settled, seconds, known))
    return tuple(found)


def anything_left(plan: Plan) -> bool:
    """Is there a task that is not settled, or may there come one?"""
    return bool(plan.ready or plan.waiting or plan.busy)
