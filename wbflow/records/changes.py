"""The changes that a night has found: their first and last nights, which of them are news, and what is said of them.

A change keeps its id ("C17") for life.  Its dates come from the record of the night that it goes on from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ..pipeline.summaries import ChangesSummary, RecordedChange
from ..words import counted
from .record import RunRecord

MOST_TOLD = 4
"""Most changes that a line tells of; further ones are counted."""


def with_nights(found: ChangesSummary, date: str, previous: RunRecord | None) -> ChangesSummary:
    """Return the changes of a night with their first and last nights, and with those that are gone.

    Parameters
    ----------
    found, date : ChangesSummary, str
        What has changed, and the night (ISO 8601).
    previous : RunRecord, optional
        The run of the night that the changes go on from.
    """
    if not found.compared or found.changes is None:
        return found
    earlier: Mapping[str, RecordedChange] = {}
    if previous:
        earlier = previous.changes
    changes = {}
    for name, change in found.changes.items():
        if name in earlier:
            changes[name] = _gone_on(change, date, earlier[name])
        else:
            changes[name] = replace(change, first=date, last=date, news_most=change.volume_most)
    gone = {name: change for name, change in earlier.items() if name not in changes}
    return replace(found, changes=changes, gone=gone)


def _gone_on(change: RecordedChange, date: str, earlier: RecordedChange) -> RecordedChange:
    """Return a change of tonight with what the night before knew of it."""
    change = replace(change, first=earlier.first, last=earlier.last, grown=earlier.grown, news_most=earlier.news_most)
    if change.seen:
        change = replace(change, last=date)
    # its volume has grown for certain once its interval lies above that of the night when it was last news
    if change.volume_least > earlier.news_most:
        change = replace(change, grown=date, news_most=change.volume_most)
    return change


def open_changes(record: RunRecord) -> list[RecordedChange]:
    """Return the changes that nobody has acknowledged: those that are new or have grown tonight, then the older ones."""
    unacknowledged = [change for change in record.changes.values() if not change.acknowledged]
    # sorting keeps the order of those that are alike
    return sorted(unacknowledged, key=lambda change: change.news != record.date)


def count_words(record: RunRecord) -> str:
    """Return how many changes of a night nobody has acknowledged, as in "2 changes"; "" if there are none."""
    count = len(open_changes(record))
    if not count:
        return ""
    return counted(count, "change")


def change_words(record: RunRecord) -> str:
    """Return the changes of a night that nobody has acknowledged, and those that are gone, in a line; "" if there are none.

    For example "2 changes: C17 new 2.0 x 1.4 x 2.6 m at 11.3, 15.0; C3 new since 2026-11-02, 6.1 x 2.4 x 2.6 m at 4.0, 7.5".
    """
    words = _words(record, open_changes(record))
    count = count_words(record)
    if count:
        return f"{count}: {words}"
    return words  # those that are gone, at most


def news_words(record: RunRecord) -> str:
    """Return the changes that are new or have grown on a night, and those that are gone, in a line; "" if there are none."""
    return _words(record, [change for change in open_changes(record) if change.news == record.date])


def _words(record: RunRecord, told: list[RecordedChange]) -> str:
    texts = []
    for change in told[:MOST_TOLD]:
        texts.append(f"{change.id} {change.words(record.unit, record.date)}")
    if len(told) > MOST_TOLD:
        texts.append(f"and {len(told) - MOST_TOLD} more")
    if record.compared and record.compared.gone:
        texts.append(f"{', '.join(record.compared.gone)} gone")
    return "; ".join(texts)
