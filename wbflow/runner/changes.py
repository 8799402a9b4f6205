"""Files from outside that change while a night is worked on."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from .context import Night
from .journal import Journal
from .state import Cause, State
from .worker import Done

MOST_LOOKS = 3
"""How often a file that changes is looked at again in one run."""


@dataclass
class Changes:
    """Looks again at captures, masks and models that have been replaced since their digests were taken: what they hold now is
    planned with, and nothing is kept under what they held before."""

    night: Night
    journal: Journal
    _looks: Counter[Path] = field(default_factory=Counter)

    def look_again(self, done: Done) -> None:
        """A task has found a file changed: the plan goes on with what it holds now.

        Parameters
        ----------
        done : Done
            With the file.
        """
        assert done.changed is not None
        self._looks[done.changed] += 1
        if self._looks[done.changed] > MOST_LOOKS:
            why = f"{done.changed} keeps changing: is it still being written?"
            self.night.plan.settle(done.task, State("failed", why, Cause.BAD_INPUT))
            return
        self.journal.warn(f"{done.reason}; what it holds now is used", task=done.task)
        self.night.look_again(done.changed)
