"""How a task ended: outcome, cause and receipt; and why one cannot begin."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, TypeVar

from ..cache.store import Receipt
from ..pipeline.summaries import Summary
from ..task import Task

Outcome = Literal["cached", "ran", "rejected", "failed", "skipped"]


class Cause(StrEnum):
    """Why a task failed or was skipped, as one word that can be counted; a rejection has the code that its stage gives."""

    NO_CAPTURE = "no-capture"
    """No file of the camera is there, or none can be read."""
    TOO_FEW_CAMERAS = "too-few-cameras"
    """Fewer than two cameras have a usable capture."""
    NO_PAIRS = "no-pairs"
    """No two cameras share enough to be matched."""
    UPSTREAM = "upstream"
    """A task that it needs left nothing, and gave no code of its own."""
    UNSOLVED = "unsolved"
    """The camera could not be placed."""
    UNFIT = "camera-unfit"
    """The camera shows nothing of the site tonight, or another place."""
    BAD_INPUT = "bad-input"
    """The function refused what it was given, or a file could not be read or written."""
    FAULT = "fault"
    """The function itself is wrong."""
    OUT_OF_MEMORY = "out-of-memory"
    """A request for memory was refused."""
    WORKER_LOST = "worker-lost"
    """The worker's process was killed, or ended by the function, twice."""
    DISK_FULL = "disk-full"
    """There was no room for what it made, or would have made."""
    TOO_SLOW = "too-slow"
    """It took far longer than such tasks do, and was ended."""
    STOPPED = "stopped"
    """The time that the run was given was over."""
    DAMAGED = "damaged"
    """What it had made was found damaged again and again."""


@dataclass(frozen=True)
class State:
    """How a task ended."""

    outcome: Outcome
    reason: str | None = None
    """Why, in words, for all but cached and ran."""
    code: str | None = None
    """The same as one word: a `Cause`, or the code of the stage that rejected; of a skipped task that of the task to blame."""
    receipt: Receipt | None = None
    trace: str | None = None
    """Traceback of an unforeseen fault."""
    fresh: bool = False
    """Has this run worked on it?"""

    @property
    def usable(self) -> bool:
        """Did it leave an artifact?"""
        return self.outcome in {"cached", "ran"}


_S = TypeVar("_S", bound=Summary)


def summary_of(state: State | None, kind: type[_S]) -> _S:
    """Return what the engine reads of a task's result, or of its rejection; an empty summary where there is neither."""
    return kind.from_json(state.receipt.figures) if state and state.receipt else kind()


def cached_state(receipt: Receipt) -> State:
    """The state of a task whose receipt was found."""
    return State("rejected" if receipt.outcome == "rejected" else "cached", receipt.reason, receipt.code, receipt)


class Waiting(Exception):
    """An input depends on `task`, which has not ended yet."""

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
