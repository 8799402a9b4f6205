"""The night before: tonight's changes go on from those of the newest earlier night that was compared with the same reference.

It is the night before by its date, whatever the order of the runs: the rerun of an old night goes on from the night before it,
and does so again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from ..cache.receipt import Receipt
from ..cache.store import Cache
from ..pipeline.stages import CHANGES
from ..records.record import RunRecord
from ..records.run_folder import NoSuchRun, RunFolder, compared_before
from ..task import Task

_TASK = Task(CHANGES)


class _Candidate(NamedTuple):
    record: RunRecord
    key: str
    """Cache key of its changes; "" if its log is gone: no receipt has this key."""


@dataclass
class PreviousNight:
    """The night that tonight's changes go on from."""

    cache: Cache
    date: str
    """Tonight, ISO 8601."""
    reference: str
    """Id of the run that tonight is compared with."""
    lost: list[str] = field(default_factory=list)
    """Nights whose changes would be gone on from, if the cache still had them."""

    def __post_init__(self) -> None:
        self._earlier = self._earlier_nights()
        self._candidate = next(self._earlier, None)

    def receipt(self) -> Receipt | None:
        """Return the receipt of the changes of that night; None if there is no such night.

        If they are gone (cleaned up, or in quarantine), those of the night before it are taken.
        """
        while self._candidate:
            receipt = self.cache.by_key(_TASK, self._candidate.key)
            if receipt and receipt.file:
                return receipt
            self.lost.append(self._candidate.record.date)
            self._candidate = next(self._earlier, None)
        return None

    def record(self) -> RunRecord | None:
        """Return the run of that night; None if there is no such night."""
        if self._candidate is None or self.receipt() is None:
            return None
        return self._candidate.record

    @cached_property
    def highest_id(self) -> int:
        """The highest number that an id has on any earlier night, whatever its reference; 0 if there was none."""
        for _, record in compared_before(self.cache.work, self.date):
            return record.compared.highest_id if record.compared else 0
        return 0

    def _earlier_nights(self) -> Iterator[_Candidate]:
        for folder, record in compared_before(self.cache.work, self.date, self.reference):
            yield _Candidate(record, _key_of(folder))


def _key_of(folder: RunFolder) -> str:
    try:
        event = folder.tasks().get(_TASK)
    except NoSuchRun:
        return ""
    if event is None or not event.usable:
        return ""
    return event.key or ""
