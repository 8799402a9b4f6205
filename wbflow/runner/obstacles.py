"""Why a task cannot be done now, or at all."""

from __future__ import annotations

from ..task import Task
from .state import Cause, State


class Waiting(Exception):
    """An input depends on `task`, which is not settled yet."""

    def __init__(self, task: Task | None) -> None:
        super().__init__(str(task))
        self.task = task


class Impossible(Exception):
    """An input will not come; the message says why, in one word the code."""

    def __init__(self, why: str, code: str) -> None:
        super().__init__(why)
        self.code = code


def because(task: Task, state: State) -> Impossible:
    """What a task ended with is why another that needs it cannot be done."""
    ended = state.outcome if state.outcome == "failed" else f"was {state.outcome}"
    return Impossible(f"{task} {ended}: {state.reason}" if state.reason else f"{task} {ended}", state.code or Cause.UPSTREAM)
