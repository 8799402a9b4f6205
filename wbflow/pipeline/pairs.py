"""The pair graph: which pairs of cameras are worth matching, and why each was kept or dropped.

Nodes are views; edges carry the evidence from `Overlap`.  The graph is first connected (maximum spanning tree), then made
robust (edges across weak cuts), then filled with the best edges up to `degree` at each view.  No view gets more than
`MOST_PAIRS_PER_VIEW` pairs, not even by `include`.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..task import camera_of

if TYPE_CHECKING:
    import networkx as nx
    import numpy as np

Pair = tuple[str, str]
Known = tuple[float, float, float]
"""Evidence of a pair: angle between the views in degrees (nan if unknown), shared part 0 to 1, and `worth`."""
Evidence = Mapping[Pair, Known]

MOST_CANDIDATES = 96
"""Largest number of candidate pairs per view, by descending worth; at most a third of them are taken (`MOST_PAIRS_PER_VIEW`)."""
MOST_VIEWS_ALL_PAIRS = 32
"""Up to this number of views, `Overlap` has a row for each pair; with more views, pairs that share nothing may have none."""
_SIMILARITY_LOSS, _BEST_ANGLE_DEG = 0.047, 12.0
"""Relative loss of similarity per degree between two views, and the best angle (degrees) if only similarity is known."""
MOST_DROPPED = 24
"""Largest number of dropped pairs per view that are listed with their reason, by descending worth."""


def cameras_of(pair: Pair) -> frozenset[str]:
    """The cameras whose views make a pair."""
    return frozenset(map(camera_of, pair))


def worth(angle: np.ndarray, shared: np.ndarray) -> np.ndarray:
    """(m,) worth of pairs: the shared part, reduced outside 10 to 25 degrees: wide enough to be exact, narrow enough to match."""
    import numpy as np

    penalty = np.maximum(0.0, (10 - angle) / 10) ** 2 + np.maximum(0.0, (angle - 25) / 15) ** 2
    reduced: np.ndarray = shared / (1 + np.nan_to_num(penalty))
    return reduced


def unfit_reason(angle: float, shared: float, angles: tuple[float, float]) -> str | None:
    """Why a pair is not worth matching; None if it is.  angles: smallest and largest permitted angle, degrees."""
    min_angle, max_angle = angles
    if shared <= 0:
        return "they see nothing in common"
    if not math.isnan(angle) and not min_angle <= angle <= max_angle:
        side, bound = ("below", min_angle) if angle < min_angle else ("above", max_angle)
        return f"views {angle:.0f} degrees apart, {side} {bound:g}"
    return None


def evidence_of(overlap: Any, angles: tuple[float, float], named: Collection[frozenset[str]]) -> tuple[dict[Pair, Known], int]:
    """Return the evidence of the pairs that may be chosen or listed, and the number of all pairs.

    If views have more than `MOST_CANDIDATES` pairs on average, each keeps its best ones, and further pairs are kept to connect
    all cameras that can be connected.

    angles: smallest and largest permitted angle, degrees.  named: camera pairs in the site file; all their view pairs are kept.
    """
    all_evidence = _all_evidence(overlap)
    if len(all_evidence) <= len(overlap.cameras) * MOST_CANDIDATES // 2:
        return all_evidence, len(all_evidence)
    import networkx as nx

    best_first = sorted(all_evidence, key=lambda pair: -all_evidence[pair][2])
    fit = [pair for pair in best_first if not unfit_reason(*all_evidence[pair][:2], angles)]
    kept_pairs = _among_best(best_first, MOST_DROPPED) | _among_best(fit, MOST_CANDIDATES)
    kept_pairs |= {pair for pair in all_evidence if cameras_of(pair) in named}
    groups = nx.utils.UnionFind()
    for left, right in sorted(fit, key=lambda pair: pair not in kept_pairs):
        cameras = camera_of(left), camera_of(right)
        if groups[cameras[0]] != groups[cameras[1]]:
            groups.union(*cameras)
            kept_pairs.add((left, right))
    return {pair: evidence for pair, evidence in all_evidence.items() if pair in kept_pairs}, len(all_evidence)


def _all_evidence(overlap: Any) -> dict[Pair, Known]:
    """The evidence of all pairs.  Two views of one camera have no baseline, and are not a pair."""
    names = overlap.cameras
    columns = overlap.pairs, overlap.angle_deg, overlap.shared, worth(overlap.angle_deg, _shared_with_baseline(overlap))
    rows = zip(*(column.tolist() for column in columns), strict=True)
    evidence: dict[Pair, Known] = {(names[i], names[j]): tuple(values) for (i, j), *values in rows}
    return {pair: values for pair, values in evidence.items() if len(cameras_of(pair)) == 2}


def _among_best(best_first: Iterable[Pair], most: int) -> set[Pair]:
    """The pairs that are among the best `most` of at least one of their views."""
    best_pairs, counts = set[Pair](), Counter[str]()
    for pair in best_first:
        if min(counts[view] for view in pair) < most:
            best_pairs.add(pair)
            counts.update(pair)
    return best_pairs


def _shared_with_baseline(overlap: Any) -> np.ndarray:
    """Return shared parts (m,).  Among many views without poses, pairs that are too similar get less: they may have no baseline.

    The similarity of views falls with the angle between them, by 4.7 % per degree on two photographed sites.  The median of the
    views' best similarities is taken as the one at 0 degrees; a pair at 12 - a degrees then counts like one at 12 + a degrees.
    """
    import numpy as np

    shared: np.ndarray = overlap.shared.copy()
    only_similarity = np.isnan(overlap.angle_deg) & (shared > 0)
    if len(overlap.cameras) > MOST_VIEWS_ALL_PAIRS and only_similarity.any():
        best = np.zeros(len(overlap.cameras))
        for side in overlap.pairs[only_similarity].T:
            np.maximum.at(best, side, shared[only_similarity])
        target = math.exp(-_SIMILARITY_LOSS * _BEST_ANGLE_DEG) * float(np.median(best[best > 0]))
        shared[only_similarity] = np.minimum(shared[only_similarity], target**2 / shared[only_similarity])
    return shared


MOST_PAIRS_PER_VIEW = 32
"""Largest number of pairs per view: its depth map is fused from no more."""

_LEAST_WORTH = 0.04
"""Pairs with a view of a multi-view camera are dropped below this worth, unless they connect cameras: other views see more."""
_LEAST_SHARE_OF_BEST = 0.5
"""If only similarity is known, this share of the best worth among the views of the same two cameras suffices, too: similarity is
not the shared part of the views, and correct pairs of wide views have a similarity of a few hundredths."""


def low_worth_pairs(evidence: Evidence) -> set[Pair]:
    """Pairs with a view of a multi-view camera whose worth is too low (`_LEAST_WORTH`, `_LEAST_SHARE_OF_BEST`)."""
    multi_view = {pair: cameras for pair in evidence if (cameras := cameras_of(pair)) != {*pair}}
    best: dict[frozenset[str], float] = {}
    for pair, cameras in multi_view.items():
        best[cameras] = max(best.get(cameras, 0.0), evidence[pair][2])
    low_worth = set()
    for pair, cameras in multi_view.items():
        angle, _, worth = evidence[pair]
        least = min(_LEAST_WORTH, _LEAST_SHARE_OF_BEST * best[cameras]) if math.isnan(angle) else _LEAST_WORTH
        if worth < least:
            low_worth.add(pair)
    return low_worth


def choose(candidates: nx.Graph, degree: int, forced: list[Pair], low_worth: Collection[Pair]) -> dict[Pair, str]:
    """Choose forced pairs, a spanning tree, cover for weak cuts, then the best up to `degree`; returns reasons by chosen pair.

    Parameters
    ----------
    candidates
        Graph of views; its edges are pairs with `weight` (worth) and `order` (position in the evidence, which breaks ties).
    degree
        Pairs to choose at each view.
    forced
        Pairs that are always chosen.
    low_worth
        Pairs that are chosen only to connect cameras.
    """
    import networkx as nx

    position = {node: i for i, node in enumerate(candidates.nodes)}
    view_graph, camera_graph = nx.Graph(), nx.Graph()  # of views, and of cameras: views of one camera are connected by definition
    view_graph.add_nodes_from(candidates.nodes)
    camera_graph.add_nodes_from(map(camera_of, candidates.nodes))
    chosen: dict[Pair, str] = {}

    def take(u: str, v: str, reason: str) -> None:
        pair = (u, v) if position[u] < position[v] else (v, u)
        if pair not in chosen:
            chosen[pair] = reason
            view_graph.add_edge(u, v)
            camera_graph.add_edge(camera_of(u), camera_of(v))

    def has_room(u: str, v: str, most: int = MOST_PAIRS_PER_VIEW) -> bool:
        return bool(max(view_graph.degree(u), view_graph.degree(v)) < most)

    for pair in forced:
        if has_room(*pair):
            take(*pair, "included by the site file")
    groups = nx.utils.UnionFind(camera_graph.nodes)
    ranked = sorted(candidates.edges(data=True), key=lambda e: (-e[2]["weight"], e[2]["order"]))
    for u, v, _ in ranked:  # Kruskal (1956), as long as both views have room
        cameras = camera_of(u), camera_of(v)
        if groups[cameras[0]] != groups[cameras[1]] and (view_graph.has_edge(u, v) or has_room(u, v)):
            groups.union(*cameras)
            take(u, v, "in the spanning tree")
    best_weight = {cameras_of((u, v)): data["weight"] for u, v, data in reversed(ranked)}
    views: dict[str, list[str]] = {}
    for node in candidates.nodes:
        views.setdefault(camera_of(node), []).append(node)
    weakest = sorted(nx.bridges(camera_graph), key=lambda b: (best_weight.get(frozenset(b), 0.0), b))
    for bridge in weakest:
        camera_graph.remove_edge(*bridge)
        side = min((nx.node_connected_component(camera_graph, end) for end in bridge), key=len)
        camera_graph.add_edge(*bridge)
        crossing_pairs = (
            (-data["weight"], data["order"], u, v)
            for camera in side
            for u in views[camera]
            for v, data in candidates[u].items()
            if camera_of(v) not in side and groups[camera] == groups[camera_of(v)]
            if not view_graph.has_edge(u, v) and has_room(u, v)
        )
        if best := min(crossing_pairs, default=None):
            take(best[2], best[3], f"covers the weak cut {bridge[0]}--{bridge[1]}")
    for u, v, _ in ranked:
        is_useful = (u, v) not in low_worth and (v, u) not in low_worth
        if not view_graph.has_edge(u, v) and is_useful and has_room(u, v, min(degree, MOST_PAIRS_PER_VIEW)):
            triangles = len(set(view_graph[u]) & set(view_graph[v]))
            take(u, v, f"closes {triangles} triangle{'s' * (triangles != 1)}" if triangles else "among the best of its cameras")
    return chosen


MOST_NAMED = 8
"""Largest number of left-out views named in the note about a view with `MOST_PAIRS_PER_VIEW` pairs."""


@dataclass(frozen=True)
class Edge:
    """A pair and the decision about it."""

    left: str
    right: str
    kept: bool
    reason: str
    """Why it was kept or dropped, as text."""
    angle_deg: float
    """Between the views; nan if unknown."""
    shared: float
    """Shared part of the views, 0 to 1."""


@dataclass(frozen=True)
class PairGraph:
    """The kept pairs, and the decisions about all that were considered."""

    pairs: tuple[Pair, ...]
    """The kept pairs, in the order of the site file."""
    edges: tuple[Edge, ...] = field(metadata={"figure": False})
    """The decisions: about all kept pairs, and about the best `MOST_DROPPED` dropped ones of each view."""
    components: tuple[tuple[str, ...], ...]
    """Groups of cameras that the kept pairs connect, largest group first."""
    untold: int = 0
    """Number of dropped pairs that are not among the edges."""
    crowded: Mapping[str, str] = field(default_factory=dict)
    """By view with `MOST_PAIRS_PER_VIEW` pairs: a note that names candidates which were left out."""


def select_pairs(
    overlap: Any,
    *,
    degree: int = 6,
    min_angle: float = 4.0,
    max_angle: float = 60.0,
    include: list[list[str]] = [],  # noqa: B006 (a literal, so that the site file is checked without importing; never changed)
    exclude: list[list[str]] = [],  # noqa: B006
) -> PairGraph:
    """Choose the pairs of cameras to match from evidence of their overlap.

    Parameters
    ----------
    overlap : Overlap
        Angle and shared part of the pairs of views.
    degree : int
        Pairs to choose at each camera; the spanning tree, edges that cover weak cuts and `include` may exceed it, up to 32.
    min_angle, max_angle : float
        Smallest and largest angle between the views of a pair, degrees; pairs outside are dropped, if their angle is known.
    include, exclude : list of [id, id]
        Pairs of cameras that are always, or never, matched; if cameras have several views: the best pair of these, or all.

    Returns
    -------
    PairGraph
    """
    import networkx as nx  # here, so that a report that only shows the graph need not import it

    included, excluded = {frozenset(p) for p in include}, {frozenset(p) for p in exclude}
    evidence, count = evidence_of(overlap, (min_angle, max_angle), included | excluded)
    unlisted_count = count - len(evidence)
    forced = _forced_pairs(included, overlap.cameras, evidence)
    candidates = nx.Graph()
    candidates.add_nodes_from(overlap.cameras)
    reasons: dict[Pair, str] = {}
    orders = itertools.count()  # counting the edges each time would be quadratic
    for pair, (angle, shared, pair_worth) in evidence.items():
        if cameras_of(pair) in excluded:
            reasons[pair] = "excluded by the site file"
        elif pair not in forced and (why := unfit_reason(angle, shared, (min_angle, max_angle))):
            reasons[pair] = why
        else:
            candidates.add_edge(*pair, weight=pair_worth, order=next(orders))
    low_worth = low_worth_pairs(evidence)
    chosen = choose(candidates, degree, [p for p in evidence if p in forced and cameras_of(p) not in excluded], low_worth)
    counts = Counter(camera for pair in chosen for camera in pair)
    listed = _pairs_to_list(evidence, chosen)
    edges = []
    for pair, (angle, shared, _) in evidence.items():
        if pair in listed:
            reason = chosen.get(pair) or reasons.get(pair) or _drop_reason(pair, low_worth, counts, degree)
            edges.append(Edge(*pair, kept=pair in chosen, reason=reason, angle_deg=angle, shared=shared))
    kept = tuple((edge.left, edge.right) for edge in edges if edge.kept)
    notes = {view: _left_out_note(view, candidates, chosen) for view in candidates if counts[view] >= MOST_PAIRS_PER_VIEW}
    crowded = {view: note for view, note in notes.items() if note}
    return PairGraph(kept, tuple(edges), groups(overlap.cameras, kept), unlisted_count + len(evidence) - len(edges), crowded)


def _drop_reason(pair: Pair, low_worth: Collection[Pair], counts: Mapping[str, int], degree: int) -> str:
    if pair in low_worth:
        return "other views of their cameras share more"
    if crowded := next((view for view in pair if counts[view] >= MOST_PAIRS_PER_VIEW), None):
        return f"{crowded} has {MOST_PAIRS_PER_VIEW} better pairs, the most that a view can have"
    return f"both cameras have better pairs already (degree {degree})"


def _left_out_note(view: str, candidates: nx.Graph, chosen: Collection[Pair]) -> str:
    """A note that names the candidates left out at a full view; "" if there are none."""
    best_first = sorted(candidates[view].items(), key=lambda other: (-other[1]["weight"], other[1]["order"]))
    left_out = [other for other, _ in best_first if (view, other) not in chosen and (other, view) not in chosen]
    if not left_out:
        return ""
    names = ", ".join(left_out[:MOST_NAMED]) + (f" and {len(left_out) - MOST_NAMED} more" if len(left_out) > MOST_NAMED else "")
    return f"it has {MOST_PAIRS_PER_VIEW} pairs, the most that a view can have; left out: those with {names}"


def groups(views: Sequence[str], pairs: Collection[Pair]) -> tuple[tuple[str, ...], ...]:
    """Groups of cameras that pairs connect, largest group first."""
    import networkx as nx

    graph = nx.Graph((camera_of(left), camera_of(right)) for left, right in pairs)
    position = {camera: i for i, camera in enumerate(dict.fromkeys(map(camera_of, views)))}
    graph.add_nodes_from(position)
    components = [tuple(sorted(c, key=position.__getitem__)) for c in nx.connected_components(graph)]
    return tuple(sorted(components, key=lambda c: (-len(c), position[c[0]])))


def _pairs_to_list(evidence: Evidence, chosen: Collection[Pair]) -> set[Pair]:
    """Return the pairs to list: all chosen ones, and the best dropped ones of each view."""
    dropped = (pair for pair in evidence if pair not in chosen)
    return {*chosen, *_among_best(sorted(dropped, key=lambda pair: -evidence[pair][2]), MOST_DROPPED)}


def _forced_pairs(included: Collection[frozenset[str]], views: Sequence[str], evidence: dict[Pair, Known]) -> set[Pair]:
    """The pairs that are always matched: one for each two cameras in `included`, the best if they have several views.

    With many views, pairs that share nothing may be missing from the evidence; included ones are added to it.
    """
    forced = dict[frozenset[str], Pair]()
    for pair in evidence if included else ():
        cameras = cameras_of(pair)
        if cameras in included and (cameras not in forced or evidence[pair][2] > evidence[forced[cameras]][2]):
            forced[cameras] = pair
    for cameras in [cameras for cameras in included if cameras not in forced] if len(views) > MOST_VIEWS_ALL_PAIRS else ():
        first_views = {camera_of(view): view for view in reversed(views) if camera_of(view) in cameras}
        if len(first_views) == 2:
            left, right = sorted(first_views.values(), key=views.index)
            forced[cameras] = left, right
            evidence[left, right] = math.nan, 0.0, 0.0
    return set(forced.values())


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
    """Choose the pairs for dense matching among placed cameras, by the rules of the pair graph, and add matched pairs.

    A matched pair that the rules do not choose is added if both cameras have fewer than `degree` pairs, or if one has none: its
    matches show that the views overlap.  Matched pairs with a camera that is not placed are kept.

    Parameters
    ----------
    shared : Overlap
        Angle and shared part of the pairs of placed cameras; without the pairs that the cameras contradict.
    pairs : PairGraph
        The pairs that were matched.
    degree, min_angle, max_angle, include, exclude
        As in `select_pairs`.

    Returns
    -------
    PairGraph
    """
    rule_graph = select_pairs(shared, degree=degree, min_angle=min_angle, max_angle=max_angle, include=include, exclude=exclude)
    counts = Counter(view for pair in rule_graph.pairs for view in pair)
    added: dict[Pair, Edge] = {}

    def add(pair: Pair, angle: float, share: float, reason: str) -> None:
        counts.update(pair)
        added[pair] = Edge(*pair, kept=True, reason=reason, angle_deg=angle, shared=share)

    placed, unplaced = _other_pairs(shared, pairs, set(rule_graph.pairs))
    for pair, angle, share in placed:
        if max(counts[view] for view in pair) < min(degree, MOST_PAIRS_PER_VIEW):
            add(pair, angle, share, "matched, and both cameras have room for it")
    for pair, angle, share in placed:
        fewest, most = sorted(counts[view] for view in pair)
        if not fewest and most < MOST_PAIRS_PER_VIEW and pair not in added:
            add(pair, angle, share, "matched, and the only pair of a camera")
    for pair in unplaced:
        if max(counts[view] for view in pair) < MOST_PAIRS_PER_VIEW:
            add(pair, math.nan, 0.0, "matched; its cameras are not both placed")
    edges = [added.get((edge.left, edge.right), edge) for edge in rule_graph.edges]
    listed = {(edge.left, edge.right) for edge in edges}
    edges += [edge for pair, edge in added.items() if pair not in listed]
    kept = tuple((edge.left, edge.right) for edge in edges if edge.kept)
    views = dict.fromkeys([*shared.cameras, *(view for pair in kept for view in pair), *(c for g in pairs.components for c in g)])
    return PairGraph(kept, tuple(edges), groups(list(views), kept), rule_graph.untold, rule_graph.crowded)


def _other_pairs(shared: Any, pairs: PairGraph, chosen: Collection[Pair]) -> tuple[list[tuple[Pair, float, float]], list[Pair]]:
    """Matched pairs that are not among `chosen`: first pairs of placed cameras, with angle and shared part, by descending worth;
    then pairs with a camera that is not placed."""
    evidence = _all_evidence(shared)
    left = [pair for pair in pairs.pairs if pair not in chosen]
    best_first = sorted((pair for pair in left if pair in evidence), key=lambda pair: -evidence[pair][2])
    placed = set(shared.cameras)
    return [(pair, *evidence[pair][:2]) for pair in best_first], [pair for pair in left if not placed.issuperset(pair)]
