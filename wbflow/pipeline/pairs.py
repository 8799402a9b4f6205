"""The pair graph: which pairs of cameras are worth matching, and why each was kept or dropped.

Nodes are cameras; edges carry the evidence of `Overlap`.  The graph is kept connected (maximum spanning tree), then made
robust (edges across weak cuts), then filled with the best edges up to `degree` at each camera.  No camera gets more than
`MOST_AT_A_CAMERA`, whatever asks for them.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..task import camera_of
from .choice import (
    ALL_KNOWN,
    MOST_AT_A_CAMERA,
    MOST_DROPPED,
    Evidence,
    Known,
    Pair,
    cameras_of,
    choose,
    evidence_of,
    of_little_use,
    unfit,
)

if TYPE_CHECKING:
    import networkx as nx


MOST_NAMED = 8
"""So many cameras are named of those that a camera has to do without."""


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
    """Pairs that share something, were dropped, and are not among the edges."""
    crowded: Mapping[str, str] = field(default_factory=dict)
    """What cameras that take no more pairs have to do without, in words, by camera."""


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

    wanted, banned = {frozenset(p) for p in include}, {frozenset(p) for p in exclude}
    evidence, count = evidence_of(overlap, (min_angle, max_angle), wanted | banned)
    unseen = count - len(evidence)
    forced = _best_of(wanted, overlap.cameras, evidence)
    candidates = nx.Graph()
    candidates.add_nodes_from(overlap.cameras)
    reasons: dict[Pair, str] = {}
    orders = itertools.count()  # to count the edges each time would be quadratic
    for pair, (angle, shared, promise) in evidence.items():
        if cameras_of(pair) in banned:
            reasons[pair] = "excluded by the site file"
        elif pair not in forced and (why := unfit(angle, shared, (min_angle, max_angle))):
            reasons[pair] = why
        else:
            candidates.add_edge(*pair, weight=promise, order=next(orders))
    little = of_little_use(evidence)
    chosen = choose(candidates, degree, [p for p in evidence if p in forced and cameras_of(p) not in banned], little)
    counts = Counter(camera for pair in chosen for camera in pair)
    told = _told(evidence, chosen)
    edges = []
    for pair, (angle, shared, _) in evidence.items():
        if pair in told:
            reason = chosen.get(pair) or reasons.get(pair) or _why_not(pair, little, counts, degree)
            edges.append(Edge(*pair, kept=pair in chosen, reason=reason, angle_deg=angle, shared=shared))
    kept = tuple((edge.left, edge.right) for edge in edges if edge.kept)
    full = {view: _left_out(view, candidates, chosen) for view in candidates if counts[view] >= MOST_AT_A_CAMERA}
    crowded = {view: note for view, note in full.items() if note}
    return PairGraph(kept, tuple(edges), groups(overlap.cameras, kept), unseen + len(evidence) - len(edges), crowded)


def _why_not(pair: Pair, little: Collection[Pair], counts: Mapping[str, int], degree: int) -> str:
    """Why a pair that is fit is not matched."""
    if pair in little:
        return "other views of their cameras share more"
    if crowded := next((view for view in pair if counts[view] >= MOST_AT_A_CAMERA), None):
        return f"{crowded} has {MOST_AT_A_CAMERA} better pairs, and no view takes more"
    return f"both cameras have better pairs already (degree {degree})"


def _left_out(view: str, candidates: nx.Graph, chosen: Collection[Pair]) -> str:
    """What a view that takes no more has to do without, in words."""
    better_first = sorted(candidates[view].items(), key=lambda other: (-other[1]["weight"], other[1]["order"]))
    missed = [other for other, _ in better_first if (view, other) not in chosen and (other, view) not in chosen]
    if not missed:
        return ""
    named = ", ".join(missed[:MOST_NAMED]) + (f" and {len(missed) - MOST_NAMED} more" if len(missed) > MOST_NAMED else "")
    return f"it has {MOST_AT_A_CAMERA} pairs, and no view takes more; left out: those with {named}"


def groups(views: Sequence[str], pairs: Collection[Pair]) -> tuple[tuple[str, ...], ...]:
    """Cameras that pairs connect, largest group first."""
    import networkx as nx

    graph = nx.Graph((camera_of(left), camera_of(right)) for left, right in pairs)
    position = {camera: i for i, camera in enumerate(dict.fromkeys(map(camera_of, views)))}
    graph.add_nodes_from(position)
    components = [tuple(sorted(c, key=position.__getitem__)) for c in nx.connected_components(graph)]
    return tuple(sorted(components, key=lambda c: (-len(c), position[c[0]])))


def _told(evidence: Evidence, chosen: Collection[Pair]) -> set[Pair]:
    """The pairs that are told of: all chosen ones, and of the others those that are among the first of one of their cameras."""
    told, counts = set(chosen), Counter[str]()
    dropped = [pair for pair in evidence if pair not in told]
    for pair in sorted(dropped, key=lambda pair: -evidence[pair][2]):
        if min(counts[camera] for camera in pair) < MOST_DROPPED:
            told.add(pair)
            counts.update(pair)
    return told


def _best_of(wanted: Collection[frozenset[str]], views: Sequence[str], evidence: dict[Pair, Known]) -> set[Pair]:
    """The pairs that are always matched: of two cameras with several views, those views that promise most.

    Of many views those that share nothing are not among the evidence; asked for they are, and told of as such.
    """
    found = dict[frozenset[str], Pair]()
    for pair in evidence if wanted else ():
        cameras = cameras_of(pair)
        if cameras in wanted and (cameras not in found or evidence[pair][2] > evidence[found[cameras]][2]):
            found[cameras] = pair
    for cameras in [cameras for cameras in wanted if cameras not in found] if len(views) > ALL_KNOWN else ():
        first = {camera_of(view): view for view in reversed(views) if camera_of(view) in cameras}
        if len(first) == 2:
            left, right = sorted(first.values(), key=views.index)
            found[cameras] = left, right
            evidence[left, right] = math.nan, 0.0, 0.0
    return set(found.values())
