"""How a task ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..store.cache import Receipt

Outcome = Literal["cached", "ran", "rejected", "failed", "skipped"]


@dataclass(frozen=True)
class State:
    """How a settled task ended.  reason: why, for all but cached and ran."""

    outcome: Outcome
    reason: str | None = None
    receipt: Receipt | None = None

    @property
    def usable(self) -> bool:
        """Did it leave an artifact?"""
        return self.outcome in {"cached", "ran"}


def cached_state(receipt: Receipt) -> State:
    """The state of a task whose receipt was found."""
    return State("rejected" if receipt.outcome == "rejected" else "cached", receipt.reason, receipt)
