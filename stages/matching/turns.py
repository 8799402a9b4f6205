"""Quarter turns of pictures whose learned keypoints match: networks know what is upright, and some cameras lie on their sides."""

from __future__ import annotations

import numpy as np

from ..types import LEARNED, Features, Float64s, Int64s
from .local_consensus import local_consensus
from .neighbours import nearest_neighbours

QUARTER_TURNS = 4
_COMPARED = 500
"""Strongest keypoints of each turn that are compared.  At 81 degrees between the views (fountain) the right turn has 140 agreeing
ones among them, a wrong one at most 1."""
_RANKS = 2
"""Neighbours that are searched: the matches, and one more."""
_AGREEING = 7
"""Neighbours of a match that must agree with its local map, so that it counts for a turn."""


def turned_back(x: Float64s, turn: int, size: tuple[int, int]) -> Float64s:
    """Points (n, 2) of a picture that was turned anticlockwise by quarter turns, in the picture as it was.

    Parameters
    ----------
    x : pixels of the turned picture; pixel centres are at integers.
    turn : number of quarter turns.
    size : width and height of the picture as it was.
    """
    columns, rows = x[:, 0], x[:, 1]
    last_column, last_row = size[0] - 1, size[1] - 1
    if turn == 1:
        return np.column_stack([last_column - rows, columns])
    if turn == 2:
        return np.column_stack([last_column - columns, last_row - rows])
    if turn == 3:
        return np.column_stack([rows, last_row - columns])
    return x


def turned(x: Float64s, turn: int, size: tuple[int, int]) -> Float64s:
    """The reverse of `turned_back`: points (n, 2) of a picture of this width and height, in the turned one."""
    turned_size = size if turn % 2 == 0 else size[::-1]
    return turned_back(x, -turn % QUARTER_TURNS, turned_size)


def turned_axes(turn: int) -> Float64s:
    """(2, 2) axes x and y of a picture turned anticlockwise by quarter turns, as columns in the picture as it was."""
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    return np.asarray(np.linalg.matrix_power(quarter, turn))


def matching_turns(left: Features, right: Features) -> tuple[int, int]:
    """Values of `Features.tilts` of the learned keypoints that match: where most of the strongest agree with their neighbours.

    Both pictures upright agree best, since networks learn from upright ones; the first of equal choices is taken.
    """
    left_turns = _turns(left)
    right_turns = _turns(right)
    if max(len(left_turns), len(right_turns)) <= 1:
        return LEARNED, LEARNED
    best = (LEARNED, LEARNED)
    most = 0
    for kind1, rows1 in left_turns.items():
        for kind2, rows2 in right_turns.items():
            near = nearest_neighbours(left.descriptors[rows1], right.descriptors[rows2], _RANKS)
            i, j, _ = near.mutual()
            _, support = local_consensus(left.xy[rows1[i]], right.xy[rows2[j]])
            agreeing = int((support >= _AGREEING).sum())
            if agreeing > most:
                best = (kind1, kind2)
                most = agreeing
    return best


def _turns(features: Features) -> dict[int, Int64s]:
    """Rows of the strongest learned keypoints of each turn, by the value of `Features.tilts`."""
    rows = {}
    for kind in range(LEARNED, LEARNED + QUARTER_TURNS):
        of_kind = np.flatnonzero(features.tilts == kind)
        if len(of_kind) > _RANKS:
            rows[kind] = of_kind[:_COMPARED]
    return rows
