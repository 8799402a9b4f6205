"""Rotations of all views from the relative rotations of pairs, which exposes pairs that contradict the rest.

The maximum spanning tree of the pairs gives initial rotations, and robust averaging (Chatterjee & Govindu, PAMI 2018: L1, then
Geman-McClure) spreads the error over all pairs.  A pair that is then off by more than a few degrees is wrong, however many
inliers it has: look-alikes agree with each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import networkx as nx
import numpy as np

from ..core.rotations import rotation_matrix, rotation_vector
from ..types import Float64s, Int64s
from .tracks import Edge

ROUNDS = 40
"""Most rounds of averaging: the first quarter with L1 weights, the others with Geman-McClure weights of a shrinking scale."""
FIRST_SCALE_DEG = 30.0
"""Scale of the Geman-McClure weights before the first round, degrees; each round shrinks it by a fifth."""
LAST_SCALE_DEG = 3.0
"""Smallest scale of the Geman-McClure weights, degrees: pairs that are off by more hardly count."""

View = TypeVar("View", int, str)
"""A view by number or by id."""


def average_rotations(relative: Mapping[Edge, Float64s], weights: Mapping[Edge, float]) -> dict[int, Float64s]:
    """R of each view (world to camera) from `cam2_R_cam1` of the pairs; the first view of each connected part is the identity.

    weights: only their order matters; the spanning tree takes the largest first.  Without pairs the result is empty.
    """
    if not relative:
        return {}
    R = rotations_along_tree(relative, weights)
    views = sorted(R)
    number = {view: k for k, view in enumerate(views)}
    edges = list(relative)
    # positions of the two views of each pair in `views`
    i = np.array([number[first] for first, _ in edges], np.int64)
    j = np.array([number[second] for _, second in edges], np.int64)
    measured = np.array([relative[edge] for edge in edges]).reshape(-1, 3, 3)
    rotations = np.array([R[view] for view in views])
    for k in range(ROUNDS):
        # the rotation that remains for each pair, in the axes of its second view
        residuals = rotation_vector(measured @ rotations[i] @ np.swapaxes(rotations[j], 1, 2))
        angles = np.linalg.norm(residuals, axis=1)
        if k < ROUNDS // 4:
            weight = 1 / np.maximum(angles, np.radians(0.1))  # bounded where a residual is almost 0
        else:
            scale = np.radians(max(LAST_SCALE_DEG, FIRST_SCALE_DEG * 0.8**k))
            weight = (scale**2 / (scale**2 + angles**2)) ** 2
        steps = _least_squares(i, j, measured, residuals, weight, len(views))
        rotations = np.array([rotation_matrix(v) @ R_view for v, R_view in zip(steps, rotations, strict=True)])
        if np.abs(steps).max(initial=0) < 1e-10:
            break
    return dict(zip(views, rotations, strict=True))


def components(edges: list[Edge]) -> list[list[int]]:
    """Views that the edges connect; largest part first, then by the number of its first view."""
    parts = nx.connected_components(nx.Graph(edges))
    return sorted((sorted(part) for part in parts), key=lambda part: (-len(part), part[0]))


def rotations_along_tree(
    relative: Mapping[tuple[View, View], Float64s], weights: Mapping[tuple[View, View], float]
) -> dict[View, Float64s]:
    """R of each view along the maximum spanning tree of the pairs; the first view of each connected part is the identity.

    relative: `cam2_R_cam1` of each pair; weights: only their order matters.
    """
    graph = nx.Graph()
    for a, b in sorted(relative):  # so that equal weights always give the same tree
        graph.add_edge(a, b, weight=weights[a, b])
    tree = nx.maximum_spanning_tree(graph)
    world: dict[View, Float64s] = {}
    for root in sorted(tree.nodes):
        if root in world:
            continue
        world[root] = np.eye(3)
        for a, b in nx.bfs_edges(tree, root):
            R = relative[a, b] if (a, b) in relative else relative[b, a].T  # the edge may be traversed backward
            world[b] = R @ world[a]
    return world


def _least_squares(i: Int64s, j: Int64s, measured: Float64s, residuals: Float64s, weight: Float64s, count: int) -> Float64s:
    """(count, 3) small rotations of the views that best satisfy `step_j - measured step_i = residual`."""
    H = np.zeros((count, 3, count, 3))
    g = np.zeros((count, 3))
    for a, b, M, r, w in zip(i, j, measured, residuals, weight, strict=True):
        H[a, :, a] += w * np.eye(3)
        H[b, :, b] += w * np.eye(3)
        H[a, :, b] -= w * M.T
        H[b, :, a] -= w * M
        g[b] += w * r
        g[a] -= w * M.T @ r
    # the common rotation of a connected part is free: the regularisation selects the smallest solution
    steps = np.linalg.solve(H.reshape(3 * count, 3 * count) + 1e-9 * np.eye(3 * count), g.ravel())
    return np.asarray(steps.reshape(count, 3), dtype=np.float64)
