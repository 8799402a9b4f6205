"""Which stated pose explains that pairs could not be used?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from ..records.record import PairRecord, RunRecord


def blame(record: RunRecord) -> Mapping[str, tuple[str, ...]]:
    """Return cameras whose stated poses are contradicted by pairs, each with the other cameras that it excuses.

    A pair contradicts its poses if it matches better on shifted rows than on those that they give; if it matches on neither, it
    contradicts nothing.  Of the cameras without a usable pair, the one with most of these pairs explains them, then the one
    with most of the remaining ones.  If two have equally many, neither is more likely, and neither is blamed.
    """
    # 1. suspects: cameras of contradicting pairs that have no usable pair
    remaining = [pair for pair in record.pairs if _contradicts_poses(pair)]
    pairs_of: dict[str, set[str]] = {}
    for pair in remaining:
        for name in pair.cameras:
            pairs_of.setdefault(name, set()).add(pair.name)
    for pair in record.pairs:
        if pair.ok:
            for name in pair.cameras:
                pairs_of.pop(name, None)
    # 2. blame the suspect that explains most, again and again, until that is undecided
    blamed: dict[str, set[str]] = {}
    while True:
        counts: Counter[str] = Counter()
        for pair in remaining:
            counts.update(name for name in pair.cameras if name in pairs_of)
        ranking = counts.most_common(2)
        if not ranking:
            break
        name, count = ranking[0]
        is_tied = len(ranking) > 1 and ranking[1][1] == count
        if count < 2 or is_tied:
            break
        blamed[name] = {pair.name for pair in remaining if name in pair.cameras}
        remaining = [pair for pair in remaining if name not in pair.cameras]
    # 3. excuse the suspects all of whose pairs are explained
    explained = set().union(*blamed.values())
    excused = sorted(name for name, pairs in pairs_of.items() if name not in blamed and pairs <= explained)
    excused_by: dict[str, tuple[str, ...]] = {}
    for name, pairs in blamed.items():
        excused_by[name] = tuple(other for other in excused if pairs_of[other] & pairs)
    return excused_by


def _contradicts_poses(pair: PairRecord) -> bool:
    """Does an unusable pair of stated cameras match better on shifted rows than on those of its poses?"""
    share = pair.figures.row_share
    chance = pair.figures.row_chance
    if pair.ok or pair.figures.known != "stated" or share is None or chance is None:
        return False
    return chance > share
