"""Which pairs are made dense, once the cameras are placed: those that would have been chosen had their poses been known."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection
from typing import Any

from .choice import MOST_AT_A_CAMERA, Pair, worth
from .pairs import Edge, PairGraph, groups, select_pairs


def select_dense_pairs(
    shared: Any,
    pairs: PairGraph,
    *,
    degree: int = 6,
    min_angle: float = 4.0,
    max_angle: float = 60.0,
    include: list[list[str]] = [],  # noqa: B006 (a literal, so that the site file is checked without importing; never changed)
    exclude: list[list[str]] = [],  # noqa: B006
) -> PairGraph:
    """Choose pairs among placed cameras by the rules of the pair graph; further ones that were matched where there is room.

    A pair that was matched comes in beside what the rules choose where both cameras have fewer than `degree`, or one has none:
    its matches show what it sees.  Pairs with a camera that is not placed stay as they were matched.

    Parameters
    ----------
    shared : Overlap
        Angle and shared share of the pairs of placed cameras; no row where the cameras contradict a pair.
    pairs : PairGraph
        What was matched.
    degree, min_angle, max_angle, include, exclude
        As of `select_pairs`.

    Returns
    -------
    PairGraph
    """
    rules = select_pairs(shared, degree=degree, min_angle=min_angle, max_angle=max_angle, include=include, exclude=exclude)
    counts = Counter(view for pair in rules.pairs for view in pair)
    taken: dict[Pair, Edge] = {}

    def take(pair: Pair, angle: float, share: float, reason: str) -> None:
        counts.update(pair)
        taken[pair] = Edge(*pair, kept=True, reason=reason, angle_deg=angle, shared=share)

    placed, others = _matched_too(shared, pairs, set(rules.pairs))
    for pair, angle, share in placed:
        if max(counts[view] for view in pair) < min(degree, MOST_AT_A_CAMERA):
            take(pair, angle, share, "matched, and there is room for it")
    for pair, angle, share in placed:
        fewest, most = sorted(counts[view] for view in pair)
        if not fewest and most < MOST_AT_A_CAMERA and pair not in taken:
            take(pair, angle, share, "matched, and all that a camera has")
    for pair in others:
        if max(counts[view] for view in pair) < MOST_AT_A_CAMERA:
            take(pair, math.nan, 0.0, "matched; its cameras are not both placed")
    edges = [taken.get((edge.left, edge.right), edge) for edge in rules.edges]
    told = {(edge.left, edge.right) for edge in edges}
    edges += [edge for pair, edge in taken.items() if pair not in told]
    kept = tuple((edge.left, edge.right) for edge in edges if edge.kept)
    views = dict.fromkeys([*shared.cameras, *(view for pair in kept for view in pair), *(c for g in pairs.components for c in g)])
    return PairGraph(kept, tuple(edges), groups(list(views), kept), rules.untold, rules.crowded)


def _matched_too(shared: Any, pairs: PairGraph, chosen: Collection[Pair]) -> tuple[list[tuple[Pair, float, float]], list[Pair]]:
    """Pairs that were matched and not chosen: those of placed cameras with angle and shared share, the most promising first, and
    those with a camera that is not placed."""
    names = [(shared.cameras[i], shared.cameras[j]) for i, j in shared.pairs.tolist()]
    columns = (column.tolist() for column in (shared.angle_deg, shared.shared, worth(shared.angle_deg, shared.shared)))
    known = dict(zip(names, zip(*columns, strict=True), strict=True))
    left = [pair for pair in pairs.pairs if pair not in chosen]
    best_first = sorted((pair for pair in left if pair in known), key=lambda pair: -known[pair][2])
    placed = set(shared.cameras)
    return [(pair, *known[pair][:2]) for pair in best_first], [pair for pair in left if not placed.issuperset(pair)]
