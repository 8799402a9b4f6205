"""The pair graph: which pairs of cameras are worth matching, and why each was kept or dropped.

Nodes are cameras; edges carry the evidence of `Overlap`.  The graph is kept connected (maximum spanning tree), then made
robust (edges across weak cuts), then filled with the best edges up to `degree` at each camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import networkx as nx

Pair = tuple[str, str]


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
    """The decision about each."""
    components: tuple[tuple[str, ...], ...]
    """Cameras that the kept pairs connect, largest group first."""


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
        Pairs wanted at each camera; the spanning tree, edges that cover weak cuts and `include` may exceed it.
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
    full = f"both cameras have better pairs already (degree {degree})"
    edges = []
    for pair, (angle, shared) in evidence.items():
        kept = pair in chosen
        reason = chosen[pair] if kept else reasons.get(pair, full)
        edges.append(Edge(*pair, kept=kept, reason=reason, angle_deg=angle, shared=shared))
    graph = nx.Graph(list(chosen))
    graph.add_nodes_from(overlap.cameras)
    position = {camera: i for i, camera in enumerate(overlap.cameras)}
    components = [tuple(sorted(c, key=position.__getitem__)) for c in nx.connected_components(graph)]
    kept_pairs = tuple((edge.left, edge.right) for edge in edges if edge.kept)
    return PairGraph(kept_pairs, tuple(edges), tuple(sorted(components, key=lambda c: (-len(c), position[c[0]]))))


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

    for pair in forced:
        take(*pair, "included by the site file")
    for u, v in nx.maximum_spanning_edges(candidates, data=False):
        take(u, v, "in the spanning tree")
    ranked = sorted(candidates.edges(data=True), key=lambda e: (-e[2]["weight"], e[2]["order"]))
    while covered := _cover(graph, candidates, ranked):
        (u, v), bridge = covered
        take(u, v, f"covers the weak cut {bridge[0]}--{bridge[1]}")
    for u, v, _ in ranked:
        if not graph.has_edge(u, v) and max(graph.degree(u), graph.degree(v)) < degree:
            closes = len(set(graph[u]) & set(graph[v]))
            take(u, v, f"closes {closes} triangle{'s' * (closes != 1)}" if closes else "among the best of its cameras")
    return chosen


def _cover(graph: nx.Graph, candidates: nx.Graph, ranked: list[Any]) -> tuple[Pair, Pair] | None:
    """The best edge across the weakest cut that is a single edge so far, and that edge; None when no cut can be covered."""
    import networkx as nx

    weight = {frozenset((u, v)): d["weight"] for u, v, d in ranked}
    for bridge in sorted(nx.bridges(graph), key=lambda b: (weight.get(frozenset(b), 0.0), b)):
        rest = nx.restricted_view(graph, [], [bridge])
        side = nx.node_connected_component(rest, bridge[0])
        for u, v, _ in ranked:
            if (u in side) != (v in side) and not graph.has_edge(u, v) and nx.has_path(graph, u, v):
                return (u, v), bridge
    return None
