"""What has changed since the last good night: tonight's differences from the reference, compared with those of that night."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..records.record import RunRecord
from .sources import Sources

Thing = Mapping[str, Any]
"""Something that a site-wide stage tells of: its kind, where it is (x, y, z), how large."""

_NEAR = 0.5
"""Two things of one kind are one where their middles are nearer than this share of the larger one's length."""


@dataclass(frozen=True)
class Since:
    """Tonight and the last good night before, both compared with one reference."""

    date: str
    """Of that night."""
    then: Mapping[str, str]
    """Of tonight's things that were there then: what they were called."""
    over: Mapping[str, Thing]
    """Things of then that are no more: what differed from the reference does so no longer."""


def since_last_good(record: RunRecord, sources: Sources, stage: str) -> Since | None:
    """What a site-wide stage's things were on the last good night; None where there is none that can be compared.

    Parameters
    ----------
    record : RunRecord
        Tonight's.
    sources : Sources
        Which knows the nights before.
    stage : str
        Whose things.
    """
    good = next((night for night in sources.before if night.verdict and night.verdict.good), None)
    if good is None or record.reference is None or record.reference not in {good.reference, good.run}:
        return None
    before = things_of(good.later.get(stage)) if good.run != record.reference else {}
    then: dict[str, str] = {}
    for name, thing in things_of(record.later.get(stage)).items():
        same = next((n for n, other in before.items() if n not in then.values() and _one(thing, other)), None)
        if same is not None:
            then[name] = same
    over = {name: thing for name, thing in before.items() if name not in then.values()}
    return Since(good.date, then, over)


def things_of(told: Any) -> dict[str, Thing]:
    """All things that have a place, by name."""
    found = {}
    for value in told.values() if isinstance(told, Mapping) else ():
        for name, thing in value.items() if isinstance(value, Mapping) else ():
            if isinstance(thing, Mapping) and {"x", "y", "z"} <= set(thing):
                found[str(name)] = thing
    return found


def _one(a: Thing, b: Thing) -> bool:
    size = max(float(thing.get("length") or 0) for thing in (a, b))
    apart = math.dist(*((thing["x"], thing["y"], thing["z"]) for thing in (a, b)))
    return a.get("kind") == b.get("kind") and apart <= _NEAR * size
