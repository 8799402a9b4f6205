"""Merge a list of the site file, as somebody drew it in the page, with the list that is in the file now (a three-way merge).

The list as it was when the page was opened shows who has changed what.  Where both have changed one item, the file's stays, and
the page's is handed back as not saved.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

CHANGED_TOO = "it was changed in the file, too; saving again replaces that"
REMOVED_TOO = "it was removed from the file meanwhile; saving again adds it again"
NOT_REMOVED = "it was changed in the file meanwhile, and is not removed"


@dataclass(frozen=True)
class Entry:
    """An item of the merged list."""

    value: Any
    was: int | None
    """Its index in the file's list; None if it is new."""
    drawn: int | None
    """Its index among the page's items; None if it stays as the file has it."""


@dataclass(frozen=True)
class Unsaved:
    """What somebody drew, and the merged list does not have."""

    drawn: int | None
    """Its index among the page's items; None if it is a removal."""
    was: int | None
    """Index in the file's list of the item that stays instead; None if none does."""
    why: str


@dataclass(frozen=True)
class MergedList:
    """The merged list, in the order in which it is written: what the file has, then what is new."""

    entries: tuple[Entry, ...]
    unsaved: tuple[Unsaved, ...]

    def without(self, faults: dict[int, str], file_items: Sequence[Any]) -> MergedList:
        """Return the list without the drawn entries that have a fault, by their index: the file's items stay instead."""
        kept: list[Entry] = []
        unsaved = list(self.unsaved)
        for k, entry in enumerate(self.entries):
            if k not in faults:
                kept.append(entry)
                continue
            unsaved.append(Unsaved(entry.drawn, entry.was, faults[k]))
            if entry.was is not None:
                kept.append(Entry(file_items[entry.was], entry.was, None))
        return MergedList(tuple(kept), tuple(unsaved))

    def keeping(self, faults: dict[int, str], file_items: Sequence[Any]) -> MergedList:
        """Return the list with items of the file that were removed and cannot be, by their index in the file."""
        entries = [*self.entries, *(Entry(file_items[was], was, None) for was in faults)]
        # in the order of the file, then what is new
        entries.sort(key=lambda entry: len(file_items) if entry.was is None else entry.was)
        removals = [Unsaved(None, was, why) for was, why in faults.items()]
        return MergedList(tuple(entries), (*self.unsaved, *removals))


def merge(
    opened: Sequence[Any], drawn: Sequence[tuple[int | None, Any]], file_items: Sequence[Any], name: Callable[[Any], Hashable]
) -> MergedList:
    """Return the file's list with what was drawn.

    Parameters
    ----------
    opened : Sequence
        The items when the page was opened.
    drawn : Sequence of tuples
        The page's items: index in `opened` (None: new), and value.
    file_items : Sequence
        The items in the file now.
    name : Callable
        Gives the name of an item, which it keeps when it is changed; None if it has none.
    """
    origins = _origins(opened, file_items, name)
    drawn_index = {was: k for k, (was, _) in enumerate(drawn) if was is not None}
    entries: list[Entry] = []
    unsaved: list[Unsaved] = []

    # 1. Items that the file has.
    for k, file_item in enumerate(file_items):
        as_in_file = Entry(file_item, k, None)
        origin = origins.get(k)
        if origin is None:
            # somebody else has added it
            entries.append(as_in_file)
            continue
        is_changed_in_file = file_item != opened[origin]
        at = drawn_index.get(origin)
        if at is None:
            # it was removed in the page
            if is_changed_in_file:
                entries.append(as_in_file)
                unsaved.append(Unsaved(None, k, NOT_REMOVED))
            continue
        value = drawn[at][1]
        if value in (opened[origin], file_item):
            entries.append(as_in_file)
        elif is_changed_in_file:
            entries.append(as_in_file)
            unsaved.append(Unsaved(at, k, CHANGED_TOO))
        else:
            entries.append(Entry(value, k, at))

    # 2. Items that the page has changed, and the file has no more.
    still_there = set(origins.values())
    for at, (was, value) in enumerate(drawn):
        if was is not None and was < len(opened) and was not in still_there and value != opened[was]:
            unsaved.append(Unsaved(at, None, REMOVED_TOO))

    # 3. New items, unless somebody else has added the same.
    added_in_file = [file_item for k, file_item in enumerate(file_items) if k not in origins]
    for at, (was, value) in enumerate(drawn):
        is_new = was is None or was >= len(opened)
        if is_new and value not in added_in_file:
            entries.append(Entry(value, None, at))
    return MergedList(tuple(entries), tuple(unsaved))


def _origins(opened: Sequence[Any], file_items: Sequence[Any], name: Callable[[Any], Hashable]) -> dict[int, int]:
    """Return, for items of the file, the index of the same item when the page was opened.

    Items are the same if they are equal, at the same place first; of the others, those with the same name.
    """
    origins: dict[int, int] = {}

    def take(is_same: Callable[[int, int], bool]) -> None:
        for k in range(len(file_items)):
            for origin in range(len(opened)):
                if k not in origins and origin not in origins.values() and is_same(k, origin):
                    origins[k] = origin

    take(lambda k, origin: k == origin and file_items[k] == opened[origin])
    take(lambda k, origin: bool(file_items[k] == opened[origin]))
    take(lambda k, origin: name(file_items[k]) is not None and name(file_items[k]) == name(opened[origin]))
    return origins
