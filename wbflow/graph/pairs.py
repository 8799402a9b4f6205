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

from ..task import camera_of

if TYPE_CHECKING:
    import networkx as nx

Pair = tuple[str, str]

MOST_AT_A_CAMERA = 32
"""Pairs of one camera: the depth of a view is fused from no more."""
MOST_DROPPED = 24
"""So many of a camera's dropped pairs are told of, the most promising first."""


_LEAST_OF_VIEWS = 0.04
"""A pair with one of several views must promise so much, unless cameras hang together by it: the other views show the rest."""


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
        Pairs of cameras that are always, or never, matched; of cameras with several views the best pair of these, or all.

    Returns
    -------
    PairGraph
    """
    import networkx as nx  # here, so that a report that only shows the graph does not wait for it

    evidence = _evidence(overlap)
    forced, banned = _best_of(include, evidence), {frozenset(p) for p in exclude}
    candidates = nx.Graph()
    candidates.add_nodes_from(overlap.cameras)
    reasons: dict[Pair, str] = {}
    for pair, (angle, shared) in evidence.items():
        if _cameras(pair) in banned:
            reasons[pair] = "excluded by the site file"
        elif pair not in forced and (why := _unfit(angle, shared, min_angle, max_angle)):
            reasons[pair] = why
        else:
            candidates.add_edge(*pair, weight=_worth(angle, shared), order=len(candidates.edges))
    chosen = _choose(candidates, degree, [p for p in evidence if p in forced and _cameras(p) not in banned])
    counts = Counter(camera for pair in chosen for camera in pair)
    full = f"both cameras have better pairs already (degree {degree})"
    told = _told(evidence, chosen)
    edges = []
    for pair, (angle, shared) in evidence.items():
        if pair in told:
            kept = pair in chosen
            crowded = next((camera for camera in pair if counts[camera] >= MOST_AT_A_CAMERA), None)
            why = f"{crowded} has {MOST_AT_A_CAMERA} better pairs, and no view takes more" if crowded else full
            why = "other views of their cameras share more" if _adds_little(pair, _worth(angle, shared)) else why
            reason = chosen[pair] if kept else reasons.get(pair, why)
            edges.append(Edge(*pair, kept=kept, reason=reason, angle_deg=angle, shared=shared))
    graph = nx.Graph((camera_of(left), camera_of(right)) for left, right in chosen)
    cameras = list(dict.fromkeys(map(camera_of, overlap.cameras)))
    graph.add_nodes_from(cameras)
    position = {camera: i for i, camera in enumerate(cameras)}
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
    """Angle and share by pair; two views of one camera tell no depth."""
    found = {}
    for (i, j), angle, shared in zip(overlap.pairs.tolist(), overlap.angle_deg.tolist(), overlap.shared.tolist(), strict=True):
        pair = overlap.cameras[i], overlap.cameras[j]
        if len(_cameras(pair)) == 2:
            found[pair] = (angle, shared)
    return found


def _cameras(pair: Pair) -> frozenset[str]:
    """The cameras whose views make a pair."""
    return frozenset(map(camera_of, pair))


def _adds_little(pair: Pair, worth: float) -> bool:
    """Is it a pair with one of several views, of which others promise more?"""
    return worth < _LEAST_OF_VIEWS and {*pair} != _cameras(pair)


def _best_of(include: list[list[str]], evidence: Mapping[Pair, tuple[float, float]]) -> set[Pair]:
    """The pairs that are always matched: of two cameras with several views, those views that promise most."""
    wanted, found = {frozenset(p) for p in include}, dict[frozenset[str], Pair]()
    for pair in evidence if wanted else ():
        cameras = _cameras(pair)
        if cameras in wanted and (cameras not in found or _worth(*evidence[pair]) > _worth(*evidence[found[cameras]])):
            found[cameras] = pair
    return set(found.values())


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
        weight.setdefault(_cameras((u, v)), data["weight"])
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
    for u, v, data in ranked:
        little = _adds_little((u, v), data["weight"])
        if not graph.has_edge(u, v) and not little and has_room(u, v, min(degree, MOST_AT_A_CAMERA)):
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
