"""A night whose tasks have all ended: what the record and the verdict of a run are made from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from wbflow_stages.contracts.camera_figures import Health

from ..pipeline.stages import FRAMES
from ..runner.night import Night
from ..runner.state import State
from ..task import Task


@dataclass(frozen=True)
class EndedNight:
    """A night, and how its tasks have ended."""

    night: Night
    states: Mapping[Task, State]
    health_of: Callable[[str], Health | None]
    """The health of a camera, or of the camera of a view; None if it was not examined."""
    upstreams: Callable[[Task], list[Task]]
    """The tasks that provide the inputs of a task."""

    def is_usable(self, stage: str) -> bool:
        """Has a site-wide stage left a result?"""
        state = self.states.get(Task(stage))
        return state is not None and state.usable

    def root_cause(self, task: Task) -> str | None:
        """Return why a task made nothing; if it was skipped because others were skipped, the original cause.

        If there are several causes, the one that most tasks share.
        """
        state = self.states[task]
        if state.outcome != "skipped" or "skipped" not in (state.reason or ""):
            return state.reason
        queue, visited, roots = [task], {task}, []
        while queue:
            current = queue.pop(0)
            causes = [upstream for upstream in self.upstreams(current) if (s := self.states.get(upstream)) and not s.usable]
            if self.states[current].outcome != "skipped" or not causes:
                roots.append(current)
                continue
            unvisited = [upstream for upstream in dict.fromkeys(causes) if upstream not in visited]
            visited.update(unvisited)
            queue += unvisited
        kinds = Counter((root.stage, self.states[root].code) for root in roots)
        kind, count = kinds.most_common(1)[0]
        if kind[0] == FRAMES:  # too few cameras: the reason has their number
            return state.reason
        example = next(root for root in roots if (root.stage, self.states[root].code) == kind)
        suffix = f" (and {count - 1} more like it)" if count > 1 else ""
        return f"{example}: {self.states[example].reason}{suffix}"
