"""Which camera's stated pose explains that pairs are refused: the one that most of these have in common."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from ..records.record import PairRecord, RunRecord

_FEWEST = 2
"""One pair never tells which of its cameras is at fault."""


def at_fault(record: RunRecord) -> Mapping[str, tuple[str, ...]]:
    """Cameras whose stated poses pairs speak against, each with the other cameras that need no explanation besides.

    A pair speaks against its poses where it matches better beside the rows that they give than on them; where neither matches, it
    says nothing.  Of the cameras that have no usable pair the one with most of these pairs explains them, then the one with most
    of the rest.  Where two have as many, neither is more likely, and both stay as they are.
    """
    useful = {name for pair in record.pairs if pair.ok for name in pair.cameras}
    left = [pair for pair in record.pairs if _against(pair)]
    against = {name: {pair.name for pair in left if name in pair.cameras} for name in _names(left) if name not in useful}
    found: dict[str, set[str]] = {}
    while (name := _commonest(left, against)) is not None:
        found[name] = {pair.name for pair in left if name in pair.cameras}
        left = [pair for pair in left if name not in pair.cameras]
    explained = set().union(*found.values())
    excused = {name for name, pairs in against.items() if name not in found and pairs <= explained}
    return {name: tuple(sorted(n for n in excused if against[n] & pairs)) for name, pairs in found.items()}


def _against(pair: PairRecord) -> bool:
    given, beside = pair.figures.get("row_share"), pair.figures.get("row_chance")
    return not pair.ok and pair.figures.get("known") == "stated" and given is not None and beside is not None and beside > given


def _names(pairs: Iterable[PairRecord]) -> Counter[str]:
    return Counter(name for pair in pairs for name in pair.cameras)


def _commonest(pairs: Iterable[PairRecord], cameras: Iterable[str]) -> str | None:
    """The one of these cameras that is in most pairs, None where these are too few or another is in as many."""
    among = set(cameras)
    counts = [(name, count) for name, count in _names(pairs).most_common() if name in among]
    if not counts or counts[0][1] < _FEWEST or (len(counts) > 1 and counts[1][1] == counts[0][1]):
        return None
    return counts[0][0]
