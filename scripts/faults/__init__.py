"""The faults of the campaign, and the bench that runs them."""

from __future__ import annotations

from collections.abc import Callable

from .bench import Bench as Bench
from .bench import Row as Row
from .damage import damage, exchanges, references
from .hostile import HOSTILE
from .kills import cleaning, first_night, kills_in, next_night, nothing_to_do, parents, pinning, workers
from .others import clocks, full_disks, overlaps, signals

CAMPAIGN: dict[str, Callable[[Bench, bool], Row]] = {
    "kills-first": kills_in(first_night, 3),
    "kills-idle": kills_in(nothing_to_do, 1),
    "kills-next": kills_in(next_night, 3),
    "kills-pin": kills_in(pinning, 1),
    "kills-clean": kills_in(cleaning, 1),
    "parents": parents,
    "workers": workers,
    "damage": damage,
    "exchanges": exchanges,
    "references": references,
    "disks": full_disks,
    "overlaps": overlaps,
    "signals": signals,
    "clocks": clocks,
    **HOSTILE,
}
"""Faults by name: functions of the bench and of whether the campaign is reduced to a few tries."""
