"""Selection of the pairs for dense matching: by the rules of the pair graph, plus matched pairs where there is room."""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np

from wbflow.pipeline.pairs import PairGraph, select_dense_pairs, select_pairs
from wbflow_stages.types import Overlap


def shared(names: str, angle: float = 20.0, without: tuple[str, ...] = ()) -> Overlap:
    rows = [(i, j) for i, j in combinations(range(len(names)), 2) if names[i] + names[j] not in without]
    return Overlap(tuple(names), np.array(rows, np.int32), np.full(len(rows), angle), np.ones(len(rows)), "poses")


def matched(*pairs: str) -> PairGraph:
    return PairGraph(tuple((pair[0], pair[1]) for pair in pairs), (), (tuple(sorted({*"".join(pairs)})),))


def names(graph: PairGraph) -> set[str]:
    return {left + right for left, right in graph.pairs}


def test_dense_pairs_of_placed_cameras_are_those_of_select_pairs() -> None:
    evidence = shared("abcdef")
    found = select_dense_pairs(evidence, matched("ab", "bc", "cd", "de", "ef"), degree=3)
    assert found.pairs == select_pairs(evidence, degree=3).pairs


def test_a_matched_pair_that_shares_nothing_is_dropped_even_if_included() -> None:
    found = select_dense_pairs(shared("abc", without=("ac",)), matched("ab", "ac"), include=[["a", "c"]])
    assert names(found) == {"ab", "bc"}


def test_matched_pairs_are_added_where_there_is_room_at_any_angle() -> None:
    evidence = shared("abc", angle=80.0)
    assert names(select_dense_pairs(evidence, matched("ab", "bc"), max_angle=60.0)) == {"ab", "bc"}
    assert names(select_dense_pairs(evidence, matched("ab"), max_angle=60.0)) == {"ab"}


def test_adding_matched_pairs_does_not_exceed_the_degree() -> None:
    every = [a + b for a, b in combinations("abcdefgh", 2)]
    found = select_dense_pairs(shared("abcdefgh", angle=80.0), matched(*every), degree=3, max_angle=60.0)
    assert set(Counter("".join(names(found))).values()) <= {2, 3}


def test_matched_pairs_of_a_camera_without_a_pose_are_kept() -> None:
    found = select_dense_pairs(shared("abc"), matched("ab", "cd"))
    assert names(found) == {"ab", "ac", "bc", "cd"}
    assert next(edge.reason for edge in found.edges if edge.right == "d") == "matched; its cameras are not both placed"
    assert found.components == (("a", "b", "c", "d"),)
