"""Tracks: keypoints of several views that show the same scene point, chained from the inliers of the pairs.

Matches are joined in the order of their probability, and a match that would put two keypoints of one view into one track is
skipped: a wrong match then costs only itself, and does not merge two tracks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from ..core.jit import kernel
from ..core.residual_distortion import without_distortion
from ..types import Bools, Camera, Float64s, Geometry, Int32s, Int64s

Edge = tuple[int, int]
"""Two views by number, in the order of the pair."""
SAME_PX = 1.5
"""Points of one view that are not keypoints count as one observation within this distance, pixels."""
FIELDS = (16, 12)
"""Columns and rows of the grid in which the coverage of a view is measured."""


@dataclass(frozen=True)
class Tracks:
    """Observations, sorted by track and then by view."""

    track: Int32s
    """(n,) int32, 0 to count - 1."""
    view: Int32s
    """(n,) int32."""
    xy: Float64s
    """(n, 2) float64 pixels."""
    count: int
    """Number of tracks."""


def undistort_tracks(tracks: Tracks, cameras: Mapping[int, Camera]) -> Tracks:
    """The tracks with the radial distortion of the cameras removed."""
    xy = tracks.xy.copy()
    for view, camera in cameras.items():
        if any(camera.radial):
            rows = tracks.view == view
            xy[rows] = without_distortion(camera, xy[rows])
    return replace(tracks, xy=xy)


def build_tracks(geometries: Mapping[Edge, Geometry], views: int) -> Tracks:
    """Chain the inliers of all pairs.

    Keypoints of one view at the same place (several orientations) count as one, and so do other points within `SAME_PX`.
    """
    if not geometries:
        return Tracks(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 2)), 0)
    # 1. Join the two nodes of each match, the most probable matches first.
    nodes, xy, view = _nodes(geometries, views)
    ends = np.concatenate([np.column_stack(nodes[edge]) for edge in geometries])
    probability = np.concatenate([geometry.probability for geometry in geometries.values()])
    root = _join(ends[np.argsort(-probability, kind="stable")], view, len(xy))

    # 2. Keep sets of two nodes or more, and number them anew.
    _, set_of_node, sizes = np.unique(root, return_inverse=True, return_counts=True)
    rows = np.flatnonzero(sizes[set_of_node] >= 2)
    _, track = np.unique(set_of_node[rows], return_inverse=True)

    # 3. Sort by track, then by view.
    order = np.lexsort((view[rows], track))
    rows = rows[order]
    track = track[order]
    return Tracks(track.astype(np.int32), view[rows].astype(np.int32), xy[rows], int(track.max(initial=-1)) + 1)


def spread_tracks(tracks: Tracks, use: Bools, wanted: int) -> Bools:
    """(count,) a subset of the tracks that still covers each view: where a field of a view has more than `wanted` observations,
    only tracks that another field needs remain.  Longest tracks first.
    """
    low = tracks.xy.min(axis=0, initial=0)
    high = tracks.xy.max(axis=0, initial=1)
    # one grid over all views, since the sizes of the images are not known here
    column, row = np.minimum(((tracks.xy - low) / (high - low) * FIELDS).astype(np.int64), np.array(FIELDS) - 1).T
    field = (tracks.view * FIELDS[1] + row) * FIELDS[0] + column
    length = np.bincount(tracks.track[use], minlength=tracks.count)
    first = np.searchsorted(tracks.track, np.arange(tracks.count + 1))
    return _needed(np.argsort(-length, kind="stable"), first, field, use, wanted)


@kernel
def _needed(order: Int64s, first: Int64s, field: Int64s, use: Bools, wanted: int) -> Bools:
    """The tracks that some field needs, chosen in the given order."""
    counts = np.zeros(field.max() + 1, np.int64)
    needed = np.zeros(len(order), np.bool_)
    for t in order:
        for k in range(first[t], first[t + 1]):
            needed[t] |= use[k] and counts[field[k]] < wanted
        for k in range(first[t], first[t + 1]):
            counts[field[k]] += needed[t] and use[k]
    return needed


def _nodes(geometries: Mapping[Edge, Geometry], views: int) -> tuple[dict[Edge, list[Int64s]], Float64s, Int64s]:
    """For each pair the node numbers of its matches in both images; pixels and view of each node."""
    nodes: dict[Edge, list[Int64s]] = {edge: [np.zeros(0, np.int64)] * 2 for edge in geometries}
    positions = [np.zeros((0, 2))]
    node_views = [np.zeros(0, np.int64)]
    start = 0
    for view in range(views):
        # the view's points in all its pairs, one pair after the other; side: 0 if it is the first of a pair, else 1
        sides = [(edge, edge.index(view)) for edge in geometries if view in edge]
        if not sides:
            continue
        points = np.concatenate([geometries[edge].x1 if side == 0 else geometries[edge].x2 for edge, side in sides])
        _, first_row, node = np.unique(np.round(points, 3), axis=0, return_index=True, return_inverse=True)
        node = node.ravel()
        if any(geometries[edge].i1 is None for edge, _ in sides):
            kept_rows, merged_into = joined_places(points[first_row], SAME_PX)
            first_row = first_row[kept_rows]
            node = merged_into[node]
        node = node + start
        # hand each pair its part of the numbers
        for edge, side in sides:
            count = len(geometries[edge].x1)
            nodes[edge][side] = node[:count]
            node = node[count:]
        positions.append(points[first_row])
        node_views.append(np.full(len(first_row), view, np.int64))
        start += len(first_row)
    return nodes, np.concatenate(positions), np.concatenate(node_views)


def joined_places(points: Float64s, reach: float) -> tuple[Int64s, Int64s]:
    """Merge points (n, d) within reach of an earlier one, since without keypoints none is found twice at exactly the same place.
    Returns the rows (k,) of the points that stay, and which of these (n,) each point belongs to."""
    owner = np.full(len(points), -1)
    neighbours = cKDTree(points).query_ball_point(points, reach, return_sorted=True)
    kept_rows: list[int] = []
    for k, nearby in enumerate(neighbours):
        if owner[k] < 0:
            free_rows = np.array([row for row in nearby if owner[row] < 0])
            owner[free_rows] = len(kept_rows)
            kept_rows.append(k)
    return np.array(kept_rows, dtype=np.int64), owner


def same_places(x: Float64s, y: Float64s) -> tuple[Int64s, Int64s]:
    """Rows of points x (n, 2) and y (m, 2) of one view that show the same point: mutual nearest neighbours within `SAME_PX`."""
    if min(len(x), len(y)) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    distance, nearest_y = cKDTree(y).query(x)
    _, nearest_x = cKDTree(x).query(y)
    rows = np.flatnonzero((distance <= SAME_PX) & (nearest_x[nearest_y] == np.arange(len(x))))
    return rows, nearest_y[rows]


@kernel
def _join(ends: Int64s, view: Int64s, count: int) -> Int64s:
    """Union-find over nodes that never joins two nodes of one view.  Returns the root of each node."""
    parent = np.arange(count)
    following = np.full(count, -1)  # the members of a set form a chain that begins at its root
    last = np.arange(count)
    for k in range(len(ends)):
        a, b = ends[k, 0], ends[k, 1]
        while parent[a] != a:
            a = parent[a]
        while parent[b] != b:
            b = parent[b]
        if a == b:
            continue
        # two members of one view cannot be one point: walk both chains
        clash = False
        i = a
        while i >= 0 and not clash:
            j = b
            while j >= 0 and not clash:
                clash = view[i] == view[j]
                j = following[j]
            i = following[i]
        if not clash:
            if b < a:
                a, b = b, a  # the smaller root stays, so that the result does not depend on the order within a match
            parent[b] = a
            following[last[a]] = b
            last[a] = last[b]
    for i in range(count):
        root = i
        while parent[root] != root:
            root = parent[root]
        parent[i] = root
    return parent
