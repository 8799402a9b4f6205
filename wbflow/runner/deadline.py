"""The time that a run is given: when it is over, only what is there already is put together."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

from ..pipeline.stages import DEPTH, stage_named
from ..task import Task
from .planner import Plan
from .spec import TaskSpec
from .state import Cause, State


@dataclass
class Deadline:
    """When a run stops beginning work that can wait for another night."""

    at: datetime.datetime | None = None
    """Local time; None: never."""
    struck: bool = False
    """Has it been noticed that it is over?"""

    @property
    def over(self) -> bool:
        """Is it later than that?"""
        return self.at is not None and datetime.datetime.now() >= self.at

    def settle(self, plan: Plan) -> bool:
        """Give up what is ready and adds to the night; is there such?"""
        given_up = [task for task in plan.ready if not _puts_together(task)]
        assert self.at is not None
        for task in given_up:
            plan.settle(task, State("skipped", f"the run was to stop at {self.at:%H:%M}", Cause.STOPPED))
        return bool(given_up)

    def shortened(self, lane: list[TaskSpec]) -> list[TaskSpec]:
        """What of a lane is still done."""
        if not self.struck:
            return lane
        wanted = [spec for spec in lane if _puts_together(spec.task) and not spec.redraw]
        return wanted if wanted[:1] == lane[:1] else []


def _puts_together(task: Task) -> bool:
    """Does a task join what others have made into what is published?"""
    stage = stage_named(task.stage)
    return stage.scope == "site" or stage.name == DEPTH
