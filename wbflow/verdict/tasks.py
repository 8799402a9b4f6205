"""Tasks that failed."""

from __future__ import annotations

from collections.abc import Iterator

from ..records.findings import Finding, finding
from ..records.record import RunRecord
from ..runner.state import Cause, State
from ..task import Task, camera_of
from .facts import Facts
from .wording import shortened


def check_tasks(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Did tasks fail?  One finding for each stage and cause; failures of a camera that is left out belong to its finding."""
    left_out = {camera.id for camera in record.cameras if not camera.ok}
    groups: dict[tuple[str, str | None], list[tuple[Task, State]]] = {}
    for task, state in facts.failed:
        is_of_lost_camera = len(task.subject) == 1 and camera_of(task.subject[0]) in left_out
        if not is_of_lost_camera and state.code != Cause.DISK_FULL:  # a full disk has a finding of its own
            groups.setdefault((task.stage, state.code), []).append((task, state))
    for (_, code), tasks in groups.items():
        task, state = tasks[0]
        more = ""
        if len(tasks) > 1:
            more = f" (and {len(tasks) - 1} more tasks with the same cause)"
        # only for faults of the program does the table know what to do; other reasons say it themselves
        remedy = None if code == Cause.FAULT else ""
        reason = shortened(state.reason or "")
        yield finding("task-failed", task.subject, {"tasks": len(tasks)}, remedy=remedy, task=task, reason=reason, more=more)
