"""Selection of the pairs to match: first connected, then robust, then the best; and every decision has a reason."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import networkx as nx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from wbflow.pipeline.pairs import MOST_PAIRS_PER_VIEW, PairGraph, select_pairs
from wbflow_stages.types import Overlap


def overlap(n: int, shared: dict[tuple[int, int], float], angles: dict[tuple[int, int], float] | None = None) -> Overlap:
    pairs = list(combinations(range(n), 2))
    names = tuple(f"c{i}" for i in range(n))
    angle = np.array([(angles or {}).get(p, math.nan) for p in pairs])
    return Overlap(names, np.array(pairs, np.int32), angle, np.array([shared.get(p, 0.0) for p in pairs]), "appearance")


def graph(result: PairGraph) -> Any:
    g = nx.Graph(list(result.pairs))
    g.add_nodes_from(camera for component in result.components for camera in component)
    return g


@settings(deadline=None)  # on a busy machine loading networkx alone is slow
@given(st.integers(2, 12), st.integers(1, 5), st.randoms(use_true_random=False))
def test_all_views_that_can_be_connected_are_connected(n: int, degree: int, random: Any) -> None:
    shared = {p: random.uniform(0.01, 1.0) for p in combinations(range(n), 2) if random.random() < 0.6}
    candidates = nx.Graph()
    candidates.add_nodes_from(range(n))
    candidates.add_edges_from(shared)
    result = select_pairs(overlap(n, shared), degree=degree)
    assert nx.number_connected_components(graph(result)) == nx.number_connected_components(candidates)
    assert len(result.edges) == n * (n - 1) // 2
    assert all(edge.reason for edge in result.edges)
    tree = sum(edge.reason == "in the spanning tree" for edge in result.edges)
    assert tree == n - nx.number_connected_components(candidates)


def test_a_weak_cut_is_covered_before_strong_neighbours_are_added() -> None:
    """Two groups of four with strong edges inside, and two weak edges between them; one of these alone would be a bridge."""
    shared = {p: 0.9 for p in combinations(range(8), 2) if (p[0] < 4) == (p[1] < 4)}
    shared |= {(0, 4): 0.10, (1, 5): 0.09}
    result = select_pairs(overlap(8, shared), degree=3)
    assert not list(nx.bridges(graph(result)))
    reasons = {(e.left, e.right): e.reason for e in result.edges}
    assert reasons["c0", "c4"] == "in the spanning tree"
    assert reasons["c1", "c5"] == "covers the weak cut c0--c4"


def test_pairs_with_angles_out_of_bounds_are_dropped_with_a_reason() -> None:
    full = dict.fromkeys(combinations(range(3), 2), 0.5)
    result = select_pairs(overlap(3, full, {(0, 1): 2.0, (0, 2): 71.0, (1, 2): 20.0}), min_angle=4.0, max_angle=60.0)
    reasons = {(e.left, e.right): e.reason for e in result.edges}
    assert result.pairs == (("c1", "c2"),)
    assert reasons["c0", "c1"] == "views 2 degrees apart, below 4"
    assert reasons["c0", "c2"] == "views 71 degrees apart, above 60"
    assert result.components == (("c1", "c2"), ("c0",))


def test_include_and_exclude_override_the_selection() -> None:
    full = dict.fromkeys(combinations(range(4), 2), 0.5)
    result = select_pairs(overlap(4, full, {(0, 3): 100.0}), include=[["c3", "c0"]], exclude=[["c0", "c1"]])
    reasons = {(e.left, e.right): (e.kept, e.reason) for e in result.edges}
    assert reasons["c0", "c3"] == (True, "included by the site file")
    assert reasons["c0", "c1"] == (False, "excluded by the site file")


def test_degree_limits_the_pairs_that_are_added_to_the_tree() -> None:
    full = {p: 0.5 + 0.01 * p[0] for p in combinations(range(10), 2)}
    result = select_pairs(overlap(10, full), degree=4)
    needed = nx.Graph([(e.left, e.right) for e in result.edges if e.kept and ("tree" in e.reason or "weak cut" in e.reason)])
    assert all(d <= max(4, needed.degree[c]) for c, d in dict(graph(result).degree).items())
    assert any("have better pairs" in e.reason for e in result.edges if not e.kept)


def test_a_hub_gets_a_limited_number_of_pairs_and_names_those_left_out() -> None:
    """Sixty cameras that share something with the hub only, and `degree: 40` where all of 45 cameras share something."""
    hub = select_pairs(overlap(61, {(0, k): 0.5 for k in range(1, 61)}), degree=40)
    assert len(hub.pairs) == MOST_PAIRS_PER_VIEW
    assert any("the most that a view can have" in edge.reason for edge in hub.edges if not edge.kept)
    assert set(hub.crowded) == {"c0"} and "those with c33, c34," in hub.crowded["c0"] and "and 20 more" in hub.crowded["c0"]
    crowd = select_pairs(overlap(45, dict.fromkeys(combinations(range(45), 2), 0.5)), degree=40)
    assert max(dict(graph(crowd).degree).values()) == MOST_PAIRS_PER_VIEW
    assert len(crowd.components) == 1
    assert crowd.unlisted + len(crowd.edges) == 45 * 44 // 2
    assert crowd.crowded


def test_preselecting_among_very_many_pairs_keeps_the_graph_connected() -> None:
    """Two dense groups of 110 views, connected only by one weak pair that ranks low at both of its cameras."""
    n, half = 220, 110
    pairs = np.array([(i, j) for i, j in combinations(range(n), 2) if (i < half) == (j < half)] + [(3, 200)], np.int32)
    apart = np.abs(pairs[:, 0] - pairs[:, 1])
    shared = np.where(apart > half, 1e-4, 1 / (1.0 + apart))
    evidence = Overlap(tuple(f"c{k}" for k in range(n)), pairs, np.full(len(pairs), math.nan), shared, "appearance")
    result = select_pairs(evidence, degree=4, include=[["c0", "c109"], ["c1", "c219"]])
    assert len(result.components) == 1 and ("c3", "c200") in result.pairs
    assert {("c0", "c109"), ("c1", "c219")} <= set(result.pairs), "asked for, though little or nothing is known of them"
    assert ("c50", "c53") in result.pairs and ("c50", "c51") not in result.pairs, "what looks most alike is seen from one place"
    assert result.unlisted + len(result.edges) == len(pairs) + 1


def test_views_of_a_camera_are_never_paired_and_can_be_named_by_the_camera() -> None:
    names = ("gate@1", "gate@2", "gate@3", "roof", "mast@1", "mast@2")
    pairs = list(combinations(range(6), 2))
    shared = np.array([0.9 if {names[i], names[j]} in ({"gate@2", "roof"}, {"gate@1", "mast@1"}) else 0.3 for i, j in pairs])
    evidence = Overlap(names, np.array(pairs, np.int32), np.full(len(pairs), math.nan), shared, "appearance")
    chosen = select_pairs(evidence, degree=6).pairs
    assert not any(left.split("@")[0] == right.split("@")[0] for left, right in chosen)
    assert ("gate@2", "roof") in chosen
    without = select_pairs(evidence, degree=6, exclude=[["mast", "gate"]]).pairs
    assert {left.split("@")[0] + "--" + right.split("@")[0] for left, right in without} == {"gate--roof", "roof--mast"}
    reasons = {(e.left, e.right): e.reason for e in select_pairs(evidence, degree=1, include=[["roof", "gate"]]).edges}
    assert reasons["gate@2", "roof"] == "included by the site file"
    assert reasons["gate@1", "roof"] != "included by the site file"


def test_weakly_similar_wide_views_are_matched_unless_their_poses_are_known() -> None:
    """Correct pairs of wide views have similarities of a few hundredths: here 0.035 between first views, 0.01 between others."""
    cameras, views = ("a", "b", "c", "d", "e"), 3
    names = tuple(f"{camera}@{k}" for camera in cameras for k in range(1, views + 1))
    pairs = [(i, j) for i, j in combinations(range(len(names)), 2) if i // views != j // views]
    first = [i % views == 0 and j % views == 0 for i, j in pairs]
    shared = np.where(first, 0.035, 0.01)

    def cameras_paired(angle: float) -> list[frozenset[str]]:
        evidence = Overlap(names, np.array(pairs, np.int32), np.full(len(pairs), angle), shared, "appearance")
        chosen = select_pairs(evidence, degree=4).pairs
        assert all(left.endswith("@1") and right.endswith("@1") for left, right in chosen), "others of theirs look far less alike"
        return [frozenset(view.split("@")[0] for view in pair) for pair in chosen]

    alike = cameras_paired(math.nan)
    assert len(alike) == len(set(alike)) == 10, "every two cameras, once each"
    assert len(cameras_paired(20.0)) < 8, "a tree and what covers its cuts"
