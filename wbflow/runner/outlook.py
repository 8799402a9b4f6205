"""What a night still has before it, as those who watch are told."""

from __future__ import annotations

from ..pipeline.stages import ROUGH_SECONDS, Stage
from ..records.costs import Past
from ..records.events import StageOutlook
from .planner import Plan

_ACROSS, _ASPECT = 1600, 0.6
"""Pixels along a picture's longer side where nothing is stated, and the shorter side's share of it."""


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
    for stage in plan.stages():
        tasks = plan.tasks(stage)
        settled = sum(task in plan.states for task in tasks)
        known = stage.name in past.stages
        walls = [past.expected(stage.name, str(task)) for task in tasks if task not in plan.states] if known else []
        seconds = sum(walls) / len(walls) if walls else past.stages.get(stage.name, _rough(plan, stage))
        count = (plan.likely_pairs(stage.dense) if stage.scope == "pair" else None) or len(tasks)
        compiles = 0.0 if known else sum(ROUGH_SECONDS[stage.name][2:])
        found.append(StageOutlook(stage.name, count, settled, seconds, known, compiles))
    return tuple(found)


def _rough(plan: Plan, stage: Stage) -> float:
    """What a task of a stage takes that nobody has timed yet."""
    fixed, each, *_ = ROUGH_SECONDS[stage.name]
    stated = sorted(camera.lens.width for camera in plan.site.cameras if camera.lens.width)
    across = min(plan.site.resolution or _ACROSS, stated[len(stated) // 2] if stated else _ACROSS)
    return fixed + each * _ASPECT * across**2 / 1e6 * (len(plan.site.cameras) if stage.scope == "site" else 1)


def anything_left(plan: Plan) -> bool:
    """Is there a task that is not settled, or may there come one?"""
    return bool(plan.ready or plan.waiting or plan.busy)
