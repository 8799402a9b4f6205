"""How a task has ended: outcome, cause and receipt; and why a task cannot begin."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, TypeVar

from pydantic import ValidationError

from ..cache.receipt import Receipt
from ..json_dataclass import read_json
from ..task import Task

Outcome = Literal["cached", "ran", "rejected", "failed", "skipped"]


class Cause(StrEnum):
    """Why a task failed or was skipped, as one countable word; for a rejection, the stage defines the code."""

    NO_CAPTURE = "no-capture"
    """The camera has no file, or none that can be read."""
    TOO_FEW_CAMERAS = "too-few-cameras"
    """Fewer than two cameras have a usable capture."""
    NO_PAIRS = "no-pairs"
    """No two cameras share enough to be matched."""
    UPSTREAM = "upstream"
    """A task that it needs left no result, and has no code of its own."""
    UNSOLVED = "unsolved"
    """The camera could not be placed."""
    UNFIT = "camera-unfit"
    """The camera shows nothing of the site tonight: it is obscured, stale, or shows another scene."""
    BAD_INPUT = "bad-input"
    """The function refused its input, or a file could not be read or written."""
    FAULT = "fault"
    """The function has a bug."""
    OUT_OF_MEMORY = "out-of-memory"
    """An allocation failed, or the worker was ended because of its memory."""
    WORKER_LOST = "worker-lost"
    """The worker process was killed, or ended by the function, twice."""
    DISK_FULL = "disk-full"
    """There was no disk space for its result."""
    TOO_SLOW = "too-slow"
    """It exceeded its time limit, and was ended."""
    STOPPED = "stopped"
    """The run reached the time at which it was to stop."""
    DAMAGED = "damaged"
    """Its artifact was found damaged repeatedly."""


@dataclass(frozen=True)
class State:
    """How a task ended."""

    outcome: Outcome
    reason: str | None = None
    """Why, as text, for all outcomes but cached and ran."""
    code: str | None = None
    """The reason as one word: a `Cause`, or the stage's code for a rejection; for a skipped task, that of the upstream task."""
    receipt: Receipt | None = None
    trace: str | None = None
    """Traceback of an unexpected error."""
    fresh: bool = False
    """Has this run worked on the task?"""

    @property
    def usable(self) -> bool:
        """Did the task leave an artifact?"""
        return self.outcome in {"cached", "ran"}


_S = TypeVar("_S")


def summary_of(state: State | None, kind: type[_S]) -> _S:
    """Return the figures of a task's result or rejection; without any, if there is neither.

    kind: a dataclass of which each field has a default.  It is empty, too, if the figures do not fit: those of another version,
    or of a function of the site's own.
    """
    if state is None or state.receipt is None:
        return kind()
    # the receipt has the figures: the artifact is not read for them
    try:
        return read_json(kind, state.receipt.figures)
    except ValidationError:
        return kind()


def cached_state(receipt: Receipt) -> State:
    """The state of a task whose receipt was found in the cache."""
    return State("rejected" if receipt.outcome == "rejected" else "cached", receipt.reason, receipt.code, receipt)


class Waiting(Exception):
    """An input depends on `task`, which has not ended yet."""

    def __init__(self, task: Task | None) -> None:
        super().__init__(str(task))
        self.task = task


class Impossible(Exception):
    """An input cannot be made; the message and the code (one word) give the reason."""

    def __init__(self, why: str, code: str) -> None:
        super().__init__(why)
        self.code = code


def blocked_by(task: Task, state: State) -> Impossible:
    """The exception for a task that needs `task`, which has ended without an artifact in the given state."""
    text = f"{task} failed" if state.outcome == "failed" else f"{task} was {state.outcome}"
    if state.reason:
        text += f": {state.reason}"
    return Impossible(text, state.code or Cause.UPSTREAM)
