"""The pair graph: which pairs of cameras are worth matching, and why each was kept or dropped.

Nodes are cameras; edges carry the evidence of `Overlap`.  The graph is kept connected (maximum spanning tree), then made
robust (edges across weak cuts), then filled with the best edges up to `degree` at each camera.  No camera gets more than
`MOST_AT_A_CAMERA`, whatever asks for them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import networkx as nx

Pair = tuple[str, str]

MOST_AT_A_CAMERA = 32
"""Pairs of one camera: the depth of a view is fused from no more."""
MOST_DROPPED = 24
"""So many of a camera's dropped pairs are told of, the most promising first."""


@dataclass(frozen=True)
class Edge:
    """A pair and the decision about it."""

    left: str
    right: str
    kept: bool
    reason: str
    """In words."""
    angle_deg: float
    """Between the views; nan where unknown."""
    shared: float
    """How much both see, 0 to 1."""


@dataclass(frozen=True)
class PairGraph:
    """All pairs that were looked at."""

    pairs: tuple[Pair, ...]
    """Those to match, in the order of the site file."""
    edges: tuple[Edge, ...]
    """The decision about each; of many that were dropped, the most promising of each camera."""
    components: tuple[tuple[str, ...], ...]
    """Cameras that the kept pairs connect, largest group first."""
    untold: int = 0
    """Dropped pairs that are not among the edges."""


def select_pairs(
    overlap: Any,
    *,
    degree: int = 6,
    min_angle: float = 4.0,
    max_angle: float = 60.0,
    include: list[list[str]] = [],  # noqa: B006 (a literal, so that the site file is checked without importing; never changed)
    exclude: list[list[str]] = [],  # noqa: B006
) -> PairGraph:
    """Choose pairs from the evidence.

    Parameters
    ----------
    overlap : Overlap
        Angle and shared share of every pair of cameras.
    degree : int
        Pairs wanted at each camera; the spanning tree, edges that cover weak cuts and `include` may exceed it, up to 32.
    min_angle, max_angle : float
        Degrees; pairs whose views converge outside of this are dropped (where the angle is known).
    include, exclude : list of [id, id]
        Pairs that are always, or never, matched.

    Returns
    -------
    PairGraph
    """
    import networkx as nx  # here, so that a report that only shows the graph does not wait for it

    forced, banned = {frozenset(p) for p in include}, {frozenset(p) for p in exclude}
    evidence = _evidence(overlap)
    candidates = nx.Graph()
    candidates.add_nodes_from(overlap.cameras)
    reasons: dict[Pair, str] = {}
    for pair, (angle, shared) in evidence.items():
        if frozenset(pair) in banned:
            reasons[pair] = "excluded by the site file"
        elif frozenset(pair) not in forced and (why := _unfit(angle, shared, min_angle, max_angle)):
            reasons[pair] = why
        else:
            candidates.add_edge(*pair, weight=_worth(angle, shared), order=len(candidates.edges))
    chosen = _choose(candidates, degree, [p for p in evidence if frozenset(p) in forced and frozenset(p) not in banned])
    counts = Counter(camera for pair in chosen for camera in pair)
    full = f"both cameras have better pairs already (degree {degree})"
    told = _told(evidence, chosen)
    edges = []
    for pair, (angle, shared) in evidence.items():
        if pair in told:
            kept = pair in chosen
            crowded = next((camera for camera in pair if counts[camera] >= MOST_AT_A_CAMERA), None)
            why = f"{crowded} has {MOST_AT_A_CAMERA} better pairs, and no view takes more" if crowded else full
            reason = chosen[pair] if kept else reasons.get(pair, why)
            edges.append(Edge(*pair, kept=kept, reason=reason, angle_deg=angle, shared=shared))
    graph = nx.Graph(list(chosen))
    graph.add_nodes_from(overlap.cameras)
    position = {camera: i for i, camera in enumerate(overlap.cameras)}
    components = [tuple(sorted(c, key=position.__getitem__)) for c in nx.connected_components(graph)]
    kept_pairs = tuple((edge.left, edge.right) for edge in edges if edge.kept)
    groups = tuple(sorted(components, key=lambda c: (-len(c), position[c[0]])))
    return PairGraph(kept_pairs, tuple(edges), groups, len(evidence) - len(edges))


def _told(evidence: Mapping[Pair, tuple[float, float]], chosen: Collection[Pair]) -> set[Pair]:
    """The pairs that are told of: all chosen ones, and of the others those that are among the first of one of their cameras."""
    told, counts = set(chosen), Counter[str]()
    dropped = [pair for pair in evidence if pair not in told]
    for pair in sorted(dropped, key=lambda pair: -_worth(*evidence[pair])):
        if min(counts[camera] for camera in pair) < MOST_DROPPED:
            told.add(pair)
            counts.update(pair)
    return told


def _evidence(overlap: Any) -> dict[Pair, tuple[float, float]]:
    found = {}
    for (i, j), angle, shared in zip(overlap.pairs.tolist(), overlap.angle_deg.tolist(), overlap.shared.tolist(), strict=True):
        found[overlap.cameras[i], overlap.cameras[j]] = (angle, shared)
    return found


def _unfit(angle: float, shared: float, min_angle: float, max_angle: float) -> str | None:
    if shared <= 0:
        return "they share nothing"
    if not math.isnan(angle) and not min_angle <= angle <= max_angle:
        side, bound = ("below", min_angle) if angle < min_angle else ("above", max_angle)
        return f"views {angle:.0f} degrees apart, {side} {bound:g}"
    return None


def _worth(angle: float, shared: float) -> float:
    """How much a pair promises: what it shares, best at 10 to 25 degrees (wide enough to be precise, narrow enough to match)."""
    if math.isnan(angle):
        return shared
    return shared / (1 + max(0.0, (10 - angle) / 10) ** 2 + max(0.0, (angle - 25) / 15) ** 2)


def _choose(candidates: nx.Graph, degree: int, forced: list[Pair]) -> dict[Pair, str]:
    """Reasons by chosen pair: forced ones, the spanning tree, cover for weak cuts, then the best up to `degree`."""
    import networkx as nx

    position = {node: i for i, node in enumerate(candidates.nodes)}
    graph = nx.Graph()
    graph.add_nodes_from(candidates.nodes)
    chosen: dict[Pair, str] = {}

    def take(u: str, v: str, why: str) -> None:
        pair = (u, v) if position[u] < position[v] else (v, u)
        if pair not in chosen:
            chosen[pair] = why
            graph.add_edge(u, v)

    def has_room(u: str, v: str, most: int = MOST_AT_A_CAMERA) -> bool:
        return bool(max(graph.degree(u), graph.degree(v)) < most)

    for pair in forced:
        if has_room(*pair):
            take(*pair, "included by the site file")
    groups = nx.utils.UnionFind(candidates.nodes)
    ranked = sorted(candidates.edges(data=True), key=lambda e: (-e[2]["weight"], e[2]["order"]))
    for u, v, _ in ranked:  # Kruskal (1956), where there is room
        if groups[u] != groups[v] and (graph.has_edge(u, v) or has_room(u, v)):
            groups.union(u, v)
            take(u, v, "in the spanning tree")
    weight = {frozenset((u, v)): d["weight"] for u, v, d in ranked}
    weakest = sorted(nx.bridges(graph), key=lambda b: (weight.get(frozenset(b), 0.0), b))
    for bridge in weakest:
        side = _side(graph, *bridge)
        across = (
            (-data["weight"], data["order"], u, v)
            for u in side
            for v, data in candidates[u].items()
            if v not in side and groups[u] == groups[v] and not graph.has_edge(u, v) and has_room(u, v)
        )
        if best := min(across, default=None):
            take(best[2], best[3], f"covers the weak cut {bridge[0]}--{bridge[1]}")
    for u, v, _ in ranked:
        if not graph.has_edge(u, v) and has_room(u, v, min(degree, MOST_AT_A_CAMERA)):
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
