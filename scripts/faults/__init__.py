"""The faults of the campaign, and the bench that they are tried on."""

from __future__ import annotations

from collections.abc import Callable

from .bench import Bench as Bench
from .bench import Row as Row
from .damage import damage, exchanges
from .kills import kills, parents, workers
from .others import clocks, full_disks, overlaps, signals

CAMPAIGN: dict[str, Callable[[Bench, bool], Row]] = {
    "kills": kills,
    "parents": parents,
    "workers": workers,
    "damage": damage,
    "exchanges": exchanges,
    "disks": full_disks,
    "overlaps": overlaps,
    "signals": signals,
    "clocks": clocks,
}
"""By name: the bench, and whether a few tries are enough."""
