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

SAME_PX = 3.0
"""A chain of matches through a third camera confirms a match if it ends within this distance, pixels."""
ELSEWHERE_PX = 12.0
"""A chain of matches through a third camera contradicts a match if it ends farther away than this, pixels; between both distances
it says nothing."""


def consistent_matches(geometries: Mapping[tuple[View, View], Geometry], fewest: int = 0) -> dict[tuple[View, View], Geometry]:
    """Matches of each pair that more third cameras confirm than contradict; all its matches if fewer than `fewest` remain."""
    votes = {edge: np.zeros(len(geometry.x1), np.int64) for edge, geometry in geometries.items()}

    @cache
    def tree(edge: tuple[View, View]) -> cKDTree:
        """The points of a pair in its first view: most pairs are in many triangles."""
        return cKDTree(geometries[edge].x1)

    matched = [edge for edge, geometry in geometries.items() if len(geometry.x1)]
    for a, b, c in triangles_of(matched):
        ab = (a, b)
        bc = (b, c)
        ac = (a, c)
        # for each match of a--b the nearest match of b--c, in b, and of a--c, in a; do these two meet in c?
        distance_b, k = tree(bc).query(geometries[ab].x2)
        distance_a, m = tree(ac).query(geometries[ab].x1)
        is_chained = (distance_b < SAME_PX) & (distance_a < SAME_PX)
        gap = np.linalg.norm(geometries[bc].x2[k] - geometries[ac].x2[m], axis=1)
        confirms = is_chained & (gap < SAME_PX)
        contradicts = is_chained & (gap > ELSEWHERE_PX)
        for rows, vote in ((confirms, 1), (contradicts, -1)):
            np.add.at(votes[ab], np.flatnonzero(rows), vote)
            np.add.at(votes[bc], k[rows], vote)
            np.add.at(votes[ac], m[rows], vote)

    consistent = {}
    for edge, geometry in geometries.items():
        keep = votes[edge] > 0
        if keep.sum() < fewest:
            keep = np.ones(len(geometry.x1), bool)
        consistent[edge] = at_rows(geometry, keep)
    return consistent
