"""Changes that somebody knows of: they stay in the report, greyed, and count no more.

A change has another number each night.  What is remembered of it is its kind and its place, as `is_same` compares them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from ..cache.layout import WorkFolder
from ..errors import UsageError
from ..pipeline.summaries import Change, ChangesSummary
from ..records.record import RunRecord
from ..records.run_folder import newest_runs

CHANGE = "change"
"""The word with which acknowledgements of changes begin."""
_NAME = re.compile(rf"{CHANGE} (\w+) at (-?\d+\.\d+),(-?\d+\.\d+),(-?\d+\.\d+)")


def name_of_change(change: Change) -> str:
    """Return kind and place of a change, as an acknowledgement has them: "change new at 9.2,15.3,1.3"."""
    return f"{CHANGE} {change.kind} at {change.x:.1f},{change.y:.1f},{change.z:.1f}"


def changes_of(record: RunRecord) -> Mapping[str, Change]:
    """Return the changes of a night by number."""
    found = (result.objects for result in record.results.values() if isinstance(result, ChangesSummary))
    return next(found, {})


def named_change(work: WorkFolder, words: str, known: Iterable[str]) -> str:
    """Return the name of a change that is given by its number in the newest run ("change 2"), or by its name.

    known: names that are remembered; one of the same change is returned.

    Raises
    ------
    UsageError
        The newest run has no such change.
    """
    if _change_named(words):
        return words
    newest = next((record for _, record in newest_runs(work)), None)
    there = changes_of(newest) if newest else {}
    number = words.removeprefix(CHANGE).strip()
    if number not in there:
        known = "; ".join(f"{CHANGE} {name}: {change.kind}" for name, change in there.items()) or "none"
        raise UsageError(f"the newest run has no change {number!r}", remedy=f"its changes: {known}")
    same = (name for name in known if (place := _change_named(name)) and there[number].is_same(place))
    return next(same, name_of_change(there[number]))


def with_known(record: RunRecord, known: Iterable[tuple[str, str]]) -> RunRecord:
    """Return the record with what is known of its changes.  known: names of changes, and the words about each."""
    places = [(place, words) for name, words in known if (place := _change_named(name))]

    def marked(changes: Mapping[str, Change]) -> Iterator[tuple[str, Change]]:
        for number, change in changes.items():
            words = next((words for place, words in places if change.is_same(place)), "")
            yield number, replace(change, acknowledged=words)

    results = {
        stage: replace(result, changes=dict(marked(result.changes)))
        for stage, result in record.results.items()
        if isinstance(result, ChangesSummary) and result.changes
    }
    return replace(record, results={**record.results, **results}) if places else record


def _change_named(name: str) -> Change | None:
    if not (found := _NAME.fullmatch(name)):
        return None
    return Change(found[1], float(found[2]), float(found[3]), float(found[4]))
