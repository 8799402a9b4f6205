"""The pair graph: which pairs of cameras are worth matching, and why each was kept or dropped.

Nodes are views; edges carry the evidence from `Overlap`.  The graph is first connected (maximum spanning tree), then made
robust (edges across weak cuts), then filled with the best edges up to `degree` at each view.  No view gets more than
`MOST_PAIRS_PER_VIEW` pairs, not even by `include`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from wbflow_stages.contracts.defaults import PAIR_DEGREE, PAIR_MAX_ANGLE_DEG, PAIR_MIN_ANGLE_DEG
from wbflow_stages.contracts.pair_figures import PairsFigures

from ..task import camera_of

if TYPE_CHECKING:
    import numpy as np

Pair = tuple[str, str]
"""Two views, in the order of the site file."""

MOST_CANDIDATES = 96
"""Largest number of candidate pairs per view, by descending worth; at most a third of them are taken (`MOST_PAIRS_PER_VIEW`)."""
MOST_VIEWS_ALL_PAIRS = 32
"""Up to this number of views, `Overlap` has a row for each pair; with more views, pairs that share nothing may have none."""
MOST_PAIRS_PER_VIEW = 32
"""Largest number of pairs per view: its depth map is fused from no more."""
MOST_DROPPED = 24
"""Largest number of dropped pairs per view that are listed with their reason, by descending worth."""
MOST_NAMED = 8
"""Largest number of left-out views named in the note about a view with `MOST_PAIRS_PER_VIEW` pairs."""
_SIMILARITY_LOSS = 0.047
"""Relative loss of similarity per degree between two views; measured on two photographed sites."""
_BEST_ANGLE_DEG = 12.0
"""Best angle between two views in degrees, if only similarity is known."""
_NARROW_DEG = 10.0
"""Angle in degrees below which a pair loses worth, since its depths become inexact."""
_WIDE_DEG = 25.0
"""Angle in degrees above which a pair loses worth, since it becomes hard to match."""
_WIDE_SCALE_DEG = 15.0
"""A pair this many degrees wider than `_WIDE_DEG` has half its worth."""
_LEAST_WORTH = 0.04
"""Pairs with a view of a multi-view camera are dropped below this worth, unless they connect cameras: other views see more."""
_LEAST_SHARE_OF_BEST = 0.5
"""If only similarity is known, this share of the best worth among the views of the same two cameras suffices, too: similarity is
not the shared part of the views, and correct pairs of wide views have a similarity of a few hundredths."""


class Evidence(NamedTuple):
    """What is known of a pair before it is matched."""

    angle_deg: float
    """Between the views; nan if unknown."""
    shared: float
    """Shared part of the views, 0 to 1."""
    worth: float
    """The shared part, reduced outside 10 to 25 degrees: wide enough to be exact, narrow enough to match."""


_NOTHING_KNOWN = Evidence(math.nan, 0.0, 0.0)


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
    unlisted: int = 0
    """Number of dropped pairs that are not among the edges."""
    crowded: Mapping[str, str] = field(default_factory=dict)
    """By view with `MOST_PAIRS_PER_VIEW` pairs: a note that names candidates which were left out."""

    @property
    def figures(self) -> PairsFigures:
        """What the engine reports of it."""
        angles = {}
        for edge in self.edges:
            if edge.kept and not math.isnan(edge.angle_deg):
                angles[f"{edge.left}--{edge.right}"] = round(edge.angle_deg, 1)
        return PairsFigures(self.pairs, self.crowded, angles)


def select_pairs(
    overlap: Any,
    *,
    degree: int = PAIR_DEGREE,
    min_angle: float = PAIR_MIN_ANGLE_DEG,
    max_angle: float = PAIR_MAX_ANGLE_DEG,
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
    # 1. The evidence, and the pairs that it, or the site file, rules out.
    included = dict.fromkeys(map(frozenset, include))
    excluded = set(map(frozenset, exclude))
    all_evidence = _evidence_of(overlap)
    unfit = _unfit_pairs(all_evidence, min_angle, max_angle)
    evidence = _preselected(all_evidence, len(overlap.cameras), unfit, included.keys() | excluded)
    forced = _forced_pairs(included, overlap.cameras, evidence)
    evidence = dict(evidence)
    for pair in forced:
        evidence.setdefault(pair, _NOTHING_KNOWN)
        unfit.pop(pair, None)  # the site file overrules the evidence, but `exclude` overrules `include`
    for pair in evidence:
        if _cameras_of(pair) in excluded:
            unfit[pair] = "excluded by the site file"

    # 2. The choice, among the others by descending worth.
    best_first = _by_worth(evidence, evidence)
    candidates = {pair: evidence[pair].worth for pair in best_first if pair not in unfit}
    forced_candidates = [pair for pair in evidence if pair in forced and pair in candidates]
    low_worth = _low_worth_pairs(evidence)
    chosen = _choose(overlap.cameras, candidates, forced_candidates, low_worth, degree)

    # 3. The reasons: for all chosen pairs, and for the best of the others.
    counts = _pair_counts(chosen)
    dropped = [pair for pair in best_first if pair not in chosen]
    listed = chosen.keys() | _among_best(dropped, MOST_DROPPED)
    edges = []
    for pair, known in evidence.items():
        if pair in listed:
            reason = chosen.get(pair) or unfit.get(pair) or _drop_reason(pair, low_worth, counts, degree)
            edges.append(Edge(*pair, pair in chosen, reason, known.angle_deg, known.shared))
    kept = tuple(pair for pair in evidence if pair in chosen)
    crowded = _left_out_notes(overlap.cameras, counts, [pair for pair in candidates if pair not in chosen])
    unlisted = len(all_evidence.keys() | evidence.keys()) - len(edges)
    return PairGraph(kept, tuple(edges), _groups(overlap.cameras, kept), unlisted, crowded)


def select_dense_pairs(
    shared: Any,
    pairs: PairGraph,
    *,
    degree: int = PAIR_DEGREE,
    min_angle: float = PAIR_MIN_ANGLE_DEG,
    max_angle: float = PAIR_MAX_ANGLE_DEG,
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
    graph = select_pairs(shared, degree=degree, min_angle=min_angle, max_angle=max_angle, include=include, exclude=exclude)
    evidence = _evidence_of(shared)
    by_rules = set(graph.pairs)
    placed_views = set(shared.cameras)
    others = [pair for pair in pairs.pairs if pair not in by_rules]
    placed = _by_worth([pair for pair in others if pair in evidence], evidence)
    counts = _pair_counts(graph.pairs)
    added: dict[Pair, str] = {}

    def add(pair: Pair, reason: str) -> None:
        added[pair] = reason
        counts.update(pair)

    # 1. Matched pairs that the rules leave out, best first, where there is room.
    for pair in placed:
        if max(counts[view] for view in pair) < min(degree, MOST_PAIRS_PER_VIEW):
            add(pair, "matched, and both cameras have room for it")
    # a pair added above leaves no view without one, so none is added twice
    for pair in placed:
        fewest, most = sorted(counts[view] for view in pair)
        if fewest == 0 and most < MOST_PAIRS_PER_VIEW:
            add(pair, "matched, and the only pair of a camera")
    for pair in others:
        if not placed_views.issuperset(pair) and max(counts[view] for view in pair) < MOST_PAIRS_PER_VIEW:
            add(pair, "matched; its cameras are not both placed")

    # 2. The graph with these pairs; cameras of matched pairs that are not placed are part of it, too.
    edges = {(edge.left, edge.right): edge for edge in graph.edges}
    for pair, reason in added.items():
        known = evidence.get(pair, _NOTHING_KNOWN)
        edges[pair] = Edge(*pair, True, reason, known.angle_deg, known.shared)
    kept = tuple(pair for pair, edge in edges.items() if edge.kept)
    views = list(shared.cameras)
    for pair in kept:
        views += pair
    for component in pairs.components:
        views += component
    return PairGraph(kept, tuple(edges.values()), _groups(views, kept), graph.unlisted, graph.crowded)


def _cameras_of(pair: Pair) -> frozenset[str]:
    """The cameras whose views make a pair."""
    return frozenset(map(camera_of, pair))


def _evidence_of(overlap: Any) -> dict[Pair, Evidence]:
    """The evidence of all pairs.  Two views of one camera have no baseline, and are not a pair."""
    import numpy as np

    angle = overlap.angle_deg
    shared = _shared_with_baseline(overlap)
    too_narrow = np.maximum(0.0, (_NARROW_DEG - angle) / _NARROW_DEG)
    too_wide = np.maximum(0.0, (angle - _WIDE_DEG) / _WIDE_SCALE_DEG)
    penalty = too_narrow**2 + too_wide**2
    worth = shared / (1 + np.nan_to_num(penalty))  # an unknown angle costs nothing

    names = overlap.cameras
    evidence = {}
    rows = zip(overlap.pairs.tolist(), angle.tolist(), overlap.shared.tolist(), worth.tolist(), strict=True)
    for (i, j), *figures in rows:
        pair = (names[i], names[j])
        if len(_cameras_of(pair)) == 2:
            evidence[pair] = Evidence(*figures)
    return evidence


def _shared_with_baseline(overlap: Any) -> np.ndarray:
    """Return shared parts (m,).  Among many views without poses, pairs that are too similar get less: they may have no baseline.

    The similarity of views falls with the angle between them, by 4.7 % per degree on two photographed sites.  The median of the
    views' best similarities is taken as the one at 0 degrees; a pair at 12 - a degrees then counts like one at 12 + a degrees.
    """
    import numpy as np

    shared: np.ndarray = overlap.shared.copy()
    only_similarity = np.isnan(overlap.angle_deg) & (shared > 0)
    if len(overlap.cameras) <= MOST_VIEWS_ALL_PAIRS or not only_similarity.any():
        return shared
    # the best similarity of each view
    best = np.zeros(len(overlap.cameras))
    for side in overlap.pairs[only_similarity].T:
        np.maximum.at(best, side, shared[only_similarity])
    # similarity at the best angle; mirrored there in its logarithm, in which it falls evenly with the angle
    target = math.exp(-_SIMILARITY_LOSS * _BEST_ANGLE_DEG) * float(np.median(best[best > 0]))
    shared[only_similarity] = np.minimum(shared[only_similarity], target**2 / shared[only_similarity])
    return shared


def _unfit_pairs(evidence: Mapping[Pair, Evidence], min_angle: float, max_angle: float) -> dict[Pair, str]:
    """The pairs that are not worth matching, and why.  Angles in degrees."""
    unfit = {}
    for pair, known in evidence.items():
        reason = _unfit_reason(known, min_angle, max_angle)
        if reason is not None:
            unfit[pair] = reason
    return unfit


def _unfit_reason(known: Evidence, min_angle: float, max_angle: float) -> str | None:
    """Why a pair is not worth matching; None if it is.  Angles in degrees."""
    if known.shared <= 0:
        return "they see nothing in common"
    if known.angle_deg < min_angle:
        return f"views {known.angle_deg:.0f} degrees apart, below {min_angle:g}"
    if known.angle_deg > max_angle:
        return f"views {known.angle_deg:.0f} degrees apart, above {max_angle:g}"
    return None


def _preselected(
    evidence: dict[Pair, Evidence], view_count: int, unfit: Collection[Pair], named: Collection[frozenset[str]]
) -> dict[Pair, Evidence]:
    """The pairs that may be chosen or listed.

    If views have more than `MOST_CANDIDATES` pairs on average, each keeps its best ones, and further pairs are kept to connect
    all cameras that can be connected.  named: camera pairs in the site file; all their view pairs are kept.
    """
    if len(evidence) <= view_count * MOST_CANDIDATES // 2:
        return evidence
    import networkx as nx

    # 1. The best pairs of each view, to be chosen or at least to be listed, and those that the site file names.
    best_first = _by_worth(evidence, evidence)
    fit = [pair for pair in best_first if pair not in unfit]
    kept_pairs = _among_best(best_first, MOST_DROPPED) | _among_best(fit, MOST_CANDIDATES)
    kept_pairs |= {pair for pair in evidence if _cameras_of(pair) in named}

    # 2. Further pairs that connect what these leave apart: the kept ones come first, and each part best first (a stable sort).
    connected = nx.utils.UnionFind()
    for pair in sorted(fit, key=lambda pair: pair not in kept_pairs):
        left, right = map(camera_of, pair)
        if connected[left] != connected[right]:
            connected.union(left, right)
            kept_pairs.add(pair)
    return {pair: known for pair, known in evidence.items() if pair in kept_pairs}


def _by_worth(pairs: Iterable[Pair], evidence: Mapping[Pair, Evidence]) -> list[Pair]:
    """Pairs by descending worth; those of equal worth keep their order."""
    return sorted(pairs, key=lambda pair: -evidence[pair].worth)


def _pair_counts(pairs: Iterable[Pair]) -> Counter[str]:
    """Number of pairs of each view."""
    counts: Counter[str] = Counter()
    for pair in pairs:
        counts.update(pair)
    return counts


def _among_best(best_first: Iterable[Pair], most: int) -> set[Pair]:
    """The pairs that are among the best `most` of at least one of their views."""
    best_pairs: set[Pair] = set()
    counts: Counter[str] = Counter()
    for pair in best_first:
        if min(counts[view] for view in pair) < most:
            best_pairs.add(pair)
            counts.update(pair)
    return best_pairs


def _forced_pairs(included: Iterable[frozenset[str]], views: Sequence[str], evidence: Mapping[Pair, Evidence]) -> list[Pair]:
    """The pairs that are always matched: one for each two cameras in `included`, the best if they have several views.

    With many views, pairs that share nothing may be missing from the evidence: then it is the pair of their first views.
    """
    best_pairs = _best_pairs(evidence)
    forced = []
    for cameras in included:
        # the first view of each camera: the last assignment wins, so the views are taken in reverse
        first_views = {camera_of(view): view for view in reversed(views) if camera_of(view) in cameras}
        if cameras in best_pairs:
            forced.append(best_pairs[cameras])
        elif len(first_views) == 2 and len(views) > MOST_VIEWS_ALL_PAIRS:
            left, right = sorted(first_views.values(), key=views.index)
            forced.append((left, right))
    return forced


def _best_pairs(evidence: Mapping[Pair, Evidence]) -> dict[frozenset[str], Pair]:
    """The best pair of views of each two cameras."""
    best: dict[frozenset[str], Pair] = {}
    for pair in evidence:
        best_so_far = best.get(_cameras_of(pair), pair)
        best[_cameras_of(pair)] = max(best_so_far, pair, key=lambda pair: evidence[pair].worth)
    return best


def _low_worth_pairs(evidence: Mapping[Pair, Evidence]) -> set[Pair]:
    """Pairs with a view of a multi-view camera whose worth is too low (`_LEAST_WORTH`, `_LEAST_SHARE_OF_BEST`)."""
    best_pairs = _best_pairs(evidence)
    low_worth = set()
    for pair, known in evidence.items():
        cameras = _cameras_of(pair)
        least = _LEAST_WORTH
        if math.isnan(known.angle_deg):
            least = min(least, _LEAST_SHARE_OF_BEST * evidence[best_pairs[cameras]].worth)
        has_multi_view_camera = cameras != {*pair}  # the id of a camera's only view is the camera's own
        if has_multi_view_camera and known.worth < least:
            low_worth.add(pair)
    return low_worth


def _choose(
    views: Sequence[str], candidates: dict[Pair, float], forced: Iterable[Pair], low_worth: Collection[Pair], degree: int
) -> dict[Pair, str]:
    """Choose forced pairs, a spanning tree, cover for weak cuts, then the best up to `degree`; returns reasons by chosen pair.

    candidates: worth by pair, best first.  forced: pairs that are always chosen, if their views have room.  low_worth: pairs that
    are chosen only to connect cameras.  degree: pairs to choose at each view.
    """
    selection = _Selection(views)
    for pair in forced:
        if selection.has_room(pair):
            selection.take(pair, "included by the site file")
    _span(selection, candidates)
    _cover_weak_cuts(selection, candidates)
    for pair in candidates:
        if pair in low_worth or not selection.has_room(pair, min(degree, MOST_PAIRS_PER_VIEW)):
            continue
        triangles = selection.common_partners(pair)
        if triangles == 0:
            selection.take(pair, "among the best of its cameras")
        elif triangles == 1:
            selection.take(pair, "closes 1 triangle")
        else:
            selection.take(pair, f"closes {triangles} triangles")
    return selection.chosen


class _Selection:
    """The pairs chosen so far."""

    def __init__(self, views: Sequence[str]) -> None:
        import networkx as nx  # here, so that a report that only shows the graph need not import it

        self.chosen: dict[Pair, str] = {}
        """The reason for each chosen pair."""
        self.camera_graph = nx.Graph()
        """Cameras, joined if any of their views make a chosen pair."""
        self.camera_graph.add_nodes_from(map(camera_of, views))
        self._partners: dict[str, set[str]] = {view: set() for view in views}

    def take(self, pair: Pair, reason: str) -> None:
        """Choose a pair."""
        left, right = pair
        self.chosen[pair] = reason
        self._partners[left].add(right)
        self._partners[right].add(left)
        self.camera_graph.add_edge(camera_of(left), camera_of(right))

    def has_room(self, pair: Pair, most: int = MOST_PAIRS_PER_VIEW) -> bool:
        """Has neither view `most` pairs yet, and is the pair not chosen already?"""
        left, right = pair
        return pair not in self.chosen and len(self._partners[left]) < most and len(self._partners[right]) < most

    def common_partners(self, pair: Pair) -> int:
        """Number of views that are partners of both."""
        left, right = pair
        return len(self._partners[left] & self._partners[right])


def _span(selection: _Selection, candidates: Iterable[Pair]) -> None:
    """Choose a maximum spanning tree of the cameras (Kruskal, 1956), as long as both views of a pair have room."""
    import networkx as nx

    connected = nx.utils.UnionFind()
    for pair in candidates:
        left, right = map(camera_of, pair)
        if connected[left] == connected[right]:
            continue
        # a forced pair is part of the tree where it comes up
        if pair in selection.chosen:
            connected.union(left, right)
        elif selection.has_room(pair):
            connected.union(left, right)
            selection.take(pair, "in the spanning tree")


def _cover_weak_cuts(selection: _Selection, candidates: dict[Pair, float]) -> None:
    """Choose a second pair across each cut that only one pair crosses (a bridge), so that one failure does not split the site."""
    import networkx as nx

    graph = selection.camera_graph
    # the best worth of each two cameras: the last assignment wins, so the best comes last
    best_worth = {_cameras_of(pair): worth for pair, worth in reversed(candidates.items())}
    weakest_first = sorted(nx.bridges(graph), key=lambda bridge: (best_worth[frozenset(bridge)], bridge))
    for bridge in weakest_first:
        graph.remove_edge(*bridge)
        near = nx.node_connected_component(graph, bridge[0])
        far = nx.node_connected_component(graph, bridge[1])
        graph.add_edge(*bridge)
        if near == far:  # a pair that covers a weaker cut covers this one, too
            continue
        for pair in candidates:
            cameras = _cameras_of(pair)
            if near & cameras and far & cameras and selection.has_room(pair):
                selection.take(pair, f"covers the weak cut {bridge[0]}--{bridge[1]}")
                break


def _drop_reason(pair: Pair, low_worth: Collection[Pair], counts: Mapping[str, int], degree: int) -> str:
    """Why a candidate was not chosen; counts: pairs of each view."""
    if pair in low_worth:
        return "other views of their cameras share more"
    for view in pair:
        if counts[view] >= MOST_PAIRS_PER_VIEW:
            return f"{view} has {MOST_PAIRS_PER_VIEW} better pairs, the most that a view can have"
    return f"both cameras have better pairs already (degree {degree})"


def _left_out_notes(views: Iterable[str], counts: Mapping[str, int], left_out: Collection[Pair]) -> dict[str, str]:
    """A note for each view with the most pairs possible that names the candidates left out there.

    counts: pairs of each view.  left_out: candidates that were not chosen, best first.
    """
    notes = {}
    for view in views:
        if counts[view] < MOST_PAIRS_PER_VIEW:
            continue
        others = []
        for left, right in left_out:
            if left == view:
                others.append(right)
            elif right == view:
                others.append(left)
        if others:
            names = ", ".join(others[:MOST_NAMED])
            if len(others) > MOST_NAMED:
                names += f" and {len(others) - MOST_NAMED} more"
            most = f"it has {MOST_PAIRS_PER_VIEW} pairs, the most that a view can have"
            notes[view] = f"{most}; left out: those with {names}"
    return notes


def _groups(views: Iterable[str], pairs: Collection[Pair]) -> tuple[tuple[str, ...], ...]:
    """Groups of cameras that pairs connect, largest group first."""
    import networkx as nx

    graph = nx.Graph()
    for left, right in pairs:
        graph.add_edge(camera_of(left), camera_of(right))
    cameras = dict.fromkeys(map(camera_of, views))
    position = {camera: i for i, camera in enumerate(cameras)}
    graph.add_nodes_from(cameras)
    # sets of cameras; in the order of the site file within a group, and between groups of one size
    groups = [tuple(sorted(cameras, key=position.__getitem__)) for cameras in nx.connected_components(graph)]
    return tuple(sorted(groups, key=lambda group: (-len(group), position[group[0]])))
