"""A night whose tasks have all ended: what the record and the verdict of a run are made from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from wbflow_stages.contracts.camera_figures import Health

from ..pipeline.stages import FRAMES
from ..records.record import RunRecord
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
    previous: RunRecord | None = None
    """The run whose changes tonight's go on from; None if there is none."""

    def is_usable(self, stage: str) -> bool:
        """Has a site-wide stage left a result?"""
        state = self.states.get(Task(stage))
        return state is not None and state.usable

    def root_cause(self, task: Task) -> str | None:
        """Return why a task made nothing; if it was skipped because others were skipped, the original cause.

        If there are several causes, the one that most tasks share.
        """
        state = self.states[task]
        if state.outcome != "skipped":
            return state.reason
        for upstream in self._unusable_upstreams(task):
            reason = self.states[upstream].reason
            if not upstream.subject and self.states[upstream].outcome == "rejected" and reason and reason in (state.reason or ""):
                return reason  # of the site as a whole: whoever reads it need not know which stage found it
        if "skipped" not in (state.reason or ""):
            return state.reason
        # tasks with one stage and one code have the same cause; of the most common one, the first task is the example
        by_cause: dict[tuple[str, str | None], list[Task]] = {}
        for root in self._roots(task):
            by_cause.setdefault((root.stage, self.states[root].code), []).append(root)
        (stage, _), roots = max(by_cause.items(), key=lambda item: len(item[1]))
        if stage == FRAMES:  # too few cameras: the reason has their number
            return state.reason
        example = roots[0]
        text = f"{example}: {self.states[example].reason}"
        if len(roots) > 1:
            text += f" (and {len(roots) - 1} more like it)"
        return text

    def _roots(self, task: Task) -> list[Task]:
        """Return the tasks that a skipped task lacks and that were not skipped themselves, the nearest first."""
        roots: list[Task] = []
        queue = [task]
        visited = {task}
        while queue:
            current = queue.pop(0)
            causes = self._unusable_upstreams(current)
            if self.states[current].outcome != "skipped" or not causes:
                roots.append(current)
                continue
            for cause in causes:
                if cause not in visited:
                    visited.add(cause)
                    queue.append(cause)
        return roots

    def _unusable_upstreams(self, task: Task) -> list[Task]:
        unusable = []
        for upstream in self.upstreams(task):
            state = self.states.get(upstream)
            if state and not state.usable:
                unusable.append(upstream)
        return unusable
