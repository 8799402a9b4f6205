"""Matches that a third camera confirms.

Among three cameras that are all matched with each other, a match is confirmed if the chain of matches through the third camera
ends at the same place.  If things repeat along a row, a pair's look-alikes agree with a geometry of their own, but few of them
close such loops.

References: Zach, Klopschitz, Pollefeys, Disambiguating Visual Relations Using Loop Constraints, CVPR 2010.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from ..types import Geometry, at_rows
from .loops import triangles_of
from .rotation_averaging import View

SAME_PX, ELSEWHERE_PX = 3.0, 12.0
"""Chains around three cameras confirm a match if they end within the first distance, and contradict it beyond the second."""


def consistent_matches(geometries: Mapping[tuple[View, View], Geometry], fewest: int = 0) -> dict[tuple[View, View], Geometry]:
    """Matches of each pair that more third cameras confirm than contradict; all its matches if fewer than `fewest` remain."""
    votes = {edge: np.zeros(len(geometry.x1), np.int64) for edge, geometry in geometries.items()}

    @cache
    def tree(edge: tuple[View, View]) -> cKDTree:
        return cKDTree(geometries[edge].x1)

    for a, b, c in triangles_of([edge for edge, geometry in geometries.items() if len(geometry.x1)]):
        ab, bc, ac = (a, b), (b, c), (a, c)
        distance_b, k = tree(bc).query(geometries[ab].x2)
        distance_a, m = tree(ac).query(geometries[ab].x1)
        is_chained = (distance_b < SAME_PX) & (distance_a < SAME_PX)
        gap = np.linalg.norm(geometries[bc].x2[k] - geometries[ac].x2[m], axis=1)
        for rows, vote in ((is_chained & (gap < SAME_PX), 1), (is_chained & (gap > ELSEWHERE_PX), -1)):
            np.add.at(votes[ab], np.flatnonzero(rows), vote)
            np.add.at(votes[bc], k[rows], vote)
            np.add.at(votes[ac], m[rows], vote)
    kept = {edge: vote > 0 if (vote > 0).sum() >= fewest else np.ones(len(vote), bool) for edge, vote in votes.items()}
    return {edge: at_rows(geometry, kept[edge]) for edge, geometry in geometries.items()}
