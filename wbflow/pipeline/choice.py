"""Which pairs make a good graph: all hangs together, no single pair holds it, and views have as many good ones as they take."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

from ..task import camera_of

if TYPE_CHECKING:
    import networkx as nx
if TYPE_CHECKING:
    import numpy as np

Pair = tuple[str, str]
Known = tuple[float, float, float]
"""Of a pair: angle in degrees, nan where it is unknown; share; how much it promises."""
Evidence = Mapping[Pair, Known]

MOST_CANDIDATES = 96
"""So many of a view's pairs are thought over, the most promising first: a view takes a third of them at most."""
ALL_KNOWN = 32
"""Of so many views each pair has a row; of more, those that share nothing may have none."""
_LESS_ALIKE, _AIM_DEG = 0.047, 12.0
"""Share by which views look less alike for each degree between them, and the angle that is best where only looks are known."""
MOST_DROPPED = 24
"""So many of a camera's dropped pairs are told of, the most promising first."""


def cameras_of(pair: Pair) -> frozenset[str]:
    """The cameras whose views make a pair."""
    return frozenset(map(camera_of, pair))


def worth(angle: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """(m,) how much pairs promise: what they share, best at 10 to 25 degrees: wide enough to be exact, narrow enough to match."""
    import numpy as np

    off = np.maximum(0.0, (10 - angle) / 10) ** 2 + np.maximum(0.0, (angle - 25) / 15) ** 2
    promise: np.ndarray = shared / (1 + np.nan_to_num(off))
    return promise


def unfit(angle: float, shared: float, angles: tuple[float, float]) -> str | None:
    """Why a pair is not worth matching, if it is not; angles: between which it is."""
    min_angle, max_angle = angles
    if shared <= 0:
        return "they share nothing"
    if not math.isnan(angle) and not min_angle <= angle <= max_angle:
        side, bound = ("below", min_angle) if angle < min_angle else ("above", max_angle)
        return f"views {angle:.0f} degrees apart, {side} {bound:g}"
    return None


def evidence_of(overlap: Any, angles: tuple[float, float], asked: Collection[frozenset[str]]) -> tuple[dict[Pair, Known], int]:
    """The evidence of pairs that may be chosen or told of, and how many pairs there are.

    Two views of one camera tell no depth and are no pair.  Where views have more pairs than can be thought over, each has its
    most promising ones, and as many more as it takes that all hang together that can.

    Parameters
    ----------
    overlap : Overlap
        Angle and shared share by pair.
    angles : (float, float)
        Degrees between which pairs are fit.
    asked : collection of frozenset of str
        Pairs of cameras that the site file names: theirs are all looked at.
    """
    import numpy as np

    names = overlap.cameras
    camera_names = [camera_of(name) for name in names]
    number = {camera: k for k, camera in enumerate(dict.fromkeys(camera_names))}
    camera = np.array([number[name] for name in camera_names], np.int64)
    rows = np.flatnonzero(camera[overlap.pairs[:, 0]] != camera[overlap.pairs[:, 1]])
    count, promise = len(rows), worth(overlap.angle_deg, _apart_enough(overlap))
    if count > len(names) * MOST_CANDIDATES // 2:
        wanted = {tuple(sorted(number[name] for name in pair)) for pair in asked if pair <= number.keys()}
        rows = _promising(overlap, rows, promise, camera, angles, wanted)
    columns = (x[rows].tolist() for x in (overlap.pairs, overlap.angle_deg, overlap.shared, promise))
    return {(names[i], names[j]): tuple(known) for (i, j), *known in zip(*columns, strict=True)}, count


def _apart_enough(overlap: Any) -> np.ndarray:
    """(m,) shares; of many views without poses less where two are too much alike: they look from one place, and tell no depth.

    How alike views look falls with the angle between them, on two photographed sites by the same 4.7 % for each degree.  What the
    views' best have is taken for views from one place, and a pair counts as if it were as much farther from 12 degrees as it is
    nearer.
    """
    import numpy as np

    shared: np.ndarray = overlap.shared.copy()
    alike = np.isnan(overlap.angle_deg) & (shared > 0)
    if len(overlap.cameras) > ALL_KNOWN and alike.any():
        best = np.zeros(len(overlap.cameras))
        for side in overlap.pairs[alike].T:
            np.maximum.at(best, side, shared[alike])
        aim = math.exp(-_LESS_ALIKE * _AIM_DEG) * float(np.median(best[best > 0]))
        shared[alike] = np.minimum(shared[alike], aim**2 / shared[alike])
    return shared


def _promising(
    overlap: Any,
    rows: np.ndarray,
    promise: np.ndarray,
    camera: np.ndarray,
    angles: tuple[float, float],
    wanted: Collection[tuple[int, ...]],
) -> np.ndarray:
    """Those of the rows that are worth thinking over, in their order.

    Parameters
    ----------
    overlap, angles
        As of `evidence_of`.
    rows
        Of the overlap, that are pairs of two cameras.
    promise
        What each row of the overlap promises.
    camera
        The number of each view's camera.
    wanted
        Pairs of these numbers that are all looked at.
    """
    import numpy as np

    pairs, angle, promise = overlap.pairs[rows], overlap.angle_deg[rows], promise[rows]
    fit = (promise > 0) & (np.isnan(angle) | ((angle >= angles[0]) & (angle <= angles[1])))
    keep = _among_best(pairs, promise, MOST_DROPPED)
    fits = np.flatnonzero(fit)
    keep[fits[_among_best(pairs[fits], promise[fits], MOST_CANDIDATES)]] = True
    ends = np.sort(camera[pairs], axis=1)
    for one, other in wanted:
        keep |= (ends[:, 0] == one) & (ends[:, 1] == other)
    groups = list(range(int(camera.max()) + 1))

    def group(at: int) -> int:
        while groups[at] != at:
            groups[at] = at = groups[groups[at]]
        return at

    best_first = fits[np.argsort(-promise[fits], kind="stable")]
    kept_first = np.concatenate([best_first[keep[best_first]], best_first[~keep[best_first]]])
    for row, (one, other) in zip(kept_first.tolist(), ends[kept_first].tolist(), strict=True):
        if (a := group(one)) != (b := group(other)):
            groups[a] = b
            keep[row] = True
    promising: np.ndarray = rows[keep]
    return promising


def _among_best(pairs: np.ndarray, promise: np.ndarray, most: int) -> np.ndarray:
    """(m,) bool: is a pair among the most promising of one of its views?"""
    import numpy as np

    order = np.argsort(-promise, kind="stable")
    ends = pairs[order].ravel()  # of the most promising first
    by_view = np.argsort(ends, kind="stable")
    starts = np.searchsorted(ends[by_view], ends[by_view], side="left")
    place = np.empty(len(ends), np.int64)
    place[by_view] = np.arange(len(ends)) - starts
    found = np.zeros(len(pairs), bool)
    found[order] = (place.reshape(-1, 2) < most).any(axis=1)
    return found


MOST_AT_A_CAMERA = 32
"""Pairs of one view: its depth is fused from no more."""

_LEAST_OF_VIEWS = 0.04
"""A pair with one of several views must promise so much, unless cameras hang together by it: the other views show the rest."""
_LEAST_OF_BEST = 0.5
"""Where only looks are known, or so much of what the best views of the same two cameras do: how alike views look is no share
of what they see, and right pairs of wide views have a likeness of a few hundredths."""


def of_little_use(evidence: Evidence) -> set[Pair]:
    """Pairs with one of several views, of which others promise more."""
    of_views = {pair: cameras for pair in evidence if (cameras := cameras_of(pair)) != {*pair}}
    best: dict[frozenset[str], float] = {}
    for pair, cameras in of_views.items():
        best[cameras] = max(best.get(cameras, 0.0), evidence[pair][2])
    found = set()
    for pair, cameras in of_views.items():
        angle, _, worth = evidence[pair]
        least = min(_LEAST_OF_VIEWS, _LEAST_OF_BEST * best[cameras]) if math.isnan(angle) else _LEAST_OF_VIEWS
        if worth < least:
            found.add(pair)
    return found


def choose(candidates: nx.Graph, degree: int, forced: list[Pair], little: Collection[Pair]) -> dict[Pair, str]:
    """Reasons by chosen pair: forced ones, the spanning tree, cover for weak cuts, then the best up to `degree`.

    Parameters
    ----------
    candidates
        Views, and pairs with their `weight` and `order`.
    degree
        Pairs wanted at each view.
    forced
        Pairs that are always chosen.
    little
        Pairs that are chosen only where cameras hang together by them.
    """
    import networkx as nx

    position = {node: i for i, node in enumerate(candidates.nodes)}
    graph, whole = nx.Graph(), nx.Graph()  # of views, and of the cameras that these are of: they hang together anyhow
    graph.add_nodes_from(candidates.nodes)
    whole.add_nodes_from(map(camera_of, candidates.nodes))
    chosen: dict[Pair, str] = {}

    def take(u: str, v: str, why: str) -> None:
        pair = (u, v) if position[u] < position[v] else (v, u)
        if pair not in chosen:
            chosen[pair] = why
            graph.add_edge(u, v)
            whole.add_edge(camera_of(u), camera_of(v))

    def has_room(u: str, v: str, most: int = MOST_AT_A_CAMERA) -> bool:
        return bool(max(graph.degree(u), graph.degree(v)) < most)

    for pair in forced:
        if has_room(*pair):
            take(*pair, "included by the site file")
    groups = nx.utils.UnionFind(whole.nodes)
    ranked = sorted(candidates.edges(data=True), key=lambda e: (-e[2]["weight"], e[2]["order"]))
    for u, v, _ in ranked:  # Kruskal (1956), where there is room
        ends = camera_of(u), camera_of(v)
        if groups[ends[0]] != groups[ends[1]] and (graph.has_edge(u, v) or has_room(u, v)):
            groups.union(*ends)
            take(u, v, "in the spanning tree")
    weight: dict[frozenset[str], float] = {}
    views: dict[str, list[str]] = {}
    for u, v, data in ranked:
        weight.setdefault(cameras_of((u, v)), data["weight"])
    for node in candidates.nodes:
        views.setdefault(camera_of(node), []).append(node)
    weakest = sorted(nx.bridges(whole), key=lambda b: (weight.get(frozenset(b), 0.0), b))
    for bridge in weakest:
        side = _side(whole, *bridge)
        across = (
            (-data["weight"], data["order"], u, v)
            for camera in side
            for u in views[camera]
            for v, data in candidates[u].items()
            if camera_of(v) not in side and groups[camera] == groups[camera_of(v)]
            if not graph.has_edge(u, v) and has_room(u, v)
        )
        if best := min(across, default=None):
            take(best[2], best[3], f"covers the weak cut {bridge[0]}--{bridge[1]}")
    for u, v, _ in ranked:
        useful = (u, v) not in little and (v, u) not in little
        if not graph.has_edge(u, v) and useful and has_room(u, v, min(degree, MOST_AT_A_CAMERA)):
            closes = len(set(graph[u]) & set(graph[v]))
            take(u, v, f"closes {closes} triangle{'s' * (closes != 1)}" if closes else "among the best of its cameras")
    return chosen


def _side(graph: nx.Graph, u: str, v: str) -> set[str]:
    """What hangs on one end of a bridge, the smaller side; nothing where it is none any more, since another edge covers it."""
    sides, edges = ({u}, {v}), ([u], [v])
    while True:
        for own, other, edge in zip(sides, reversed(sides), edges, strict=True):
            if not edge:
                return own
            node = edge.pop()
            for near in graph[node]:
                if near not in own and {node, near} != {u, v}:
                    if near in other:
                        return set()
                    own.add(near)
                    edge.append(near)
