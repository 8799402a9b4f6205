"""Which pairs make a good graph: all hangs together, no single pair holds it, and views have as many good ones as they take."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import TYPE_CHECKING

from ..task import camera_of
from .evidence import Evidence, Pair, cameras_of

if TYPE_CHECKING:
    import networkx as nx

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
