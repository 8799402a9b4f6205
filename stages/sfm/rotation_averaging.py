"""Rotations of all views at once from those of the pairs, so that pairs which contradict the rest can be told.

The spanning tree of the pairs that are believed most gives a start, and robust averaging (Chatterjee & Govindu, PAMI 2018: L1,
then Geman-McClure) spreads the error over all pairs.  A pair that then is off by more than a few degrees is wrong, however many
inliers it has: look-alikes agree among themselves.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..twoview.epipolar import skew
from ..types import Float64s, Int64s
from .tracks import Edge

ROUNDS = 40


def rotation_vector(R: Float64s) -> Float64s:
    """(..., 3) axis times angle (radians) of rotations (..., 3, 3)."""
    v = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    sine = np.linalg.norm(v, axis=-1, keepdims=True)
    cosine = 0.5 * (R[..., 0, 0] + R[..., 1, 1] + R[..., 2, 2] - 1)[..., None]
    angle = np.arctan2(sine, cosine)
    # near half a turn the axis comes from the symmetric part, cos I + (1 - cos) a a^T
    S = 0.5 * (R + np.swapaxes(R, -1, -2))
    k = np.argmax(np.diagonal(S, axis1=-2, axis2=-1), axis=-1)
    column = np.take_along_axis(S - cosine[..., None] * np.eye(3), k[..., None, None], axis=-1)[..., 0]
    column /= np.linalg.norm(column, axis=-1, keepdims=True)
    sign = np.where((column * v).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        plain = np.where(sine > 1e-9, v * angle / np.maximum(sine, 1e-300), v)
    return np.asarray(np.where(cosine < -0.99, sign * column * angle, plain), dtype=np.float64)


def rotation_matrix(v: Float64s) -> Float64s:
    """(3, 3) the rotation about v by |v| radians."""
    angle = float(np.linalg.norm(v))
    W = skew(v)
    if angle < 1e-12:
        return np.eye(3) + W
    return np.asarray(np.eye(3) + np.sin(angle) / angle * W + (1 - np.cos(angle)) / angle**2 * (W @ W), dtype=np.float64)


def angle_between(A: Float64s, B: Float64s) -> float:
    """Radians between two rotations."""
    return float(np.linalg.norm(rotation_vector(A.T @ B)))


def average_rotations(relative: Mapping[Edge, Float64s], weights: Mapping[Edge, float]) -> dict[int, Float64s]:
    """R of each view (world to camera) from `cam2_R_cam1` of the pairs; each connected part has its first view at identity.

    weights: only the order matters; the spanning tree takes the largest first.
    """
    R = _along_tree(relative, weights)
    views = sorted(R)
    number = {view: k for k, view in enumerate(views)}
    edges = list(relative)
    i = np.array([number[edge[0]] for edge in edges], np.int64)
    j = np.array([number[edge[1]] for edge in edges], np.int64)
    given = np.array([relative[edge] for edge in edges]).reshape(-1, 3, 3)
    found = np.array([R[view] for view in views])
    for k in range(ROUNDS):
        # what each pair says is left to turn, in the axes of its second view
        off = rotation_vector(given @ found[i] @ np.swapaxes(found[j], 1, 2))
        size = np.linalg.norm(off, axis=1)
        scale = np.radians(max(3.0, 30.0 * 0.8**k))
        weight = 1 / np.maximum(size, np.radians(0.1)) if k < ROUNDS // 4 else (scale**2 / (scale**2 + size**2)) ** 2
        turn = _least_squares(i, j, given, off, weight, len(views))
        found = np.array([rotation_matrix(v) @ R_view for v, R_view in zip(turn, found, strict=True)])
        if np.abs(turn).max(initial=0) < 1e-10:
            break
    return dict(zip(views, found, strict=True))


def components(edges: list[Edge], views: list[int]) -> list[list[int]]:
    """Views that the edges connect; largest part first, then by the number of its first view."""
    parent = {view: view for view in views}

    def root(view: int) -> int:
        while parent[view] != view:
            parent[view] = view = parent[parent[view]]
        return view

    for i, j in edges:
        a, b = sorted((root(i), root(j)))
        parent[b] = a
    parts: dict[int, list[int]] = {}
    for view in views:
        parts.setdefault(root(view), []).append(view)
    return sorted(parts.values(), key=lambda part: (-len(part), part[0]))


def _along_tree(relative: Mapping[Edge, Float64s], weights: Mapping[Edge, float]) -> dict[int, Float64s]:
    """Rotations along the maximum spanning tree (Prim: the strongest pair that leads to a new view)."""
    R: dict[int, Float64s] = {}
    for start in sorted({view for edge in relative for view in edge}):
        if start in R:
            continue
        R[start] = np.eye(3)
        while border := [edge for edge in relative if (edge[0] in R) != (edge[1] in R)]:
            i, j = max(border, key=lambda edge: weights[edge])
            if i in R:
                R[j] = relative[i, j] @ R[i]
            else:
                R[i] = relative[i, j].T @ R[j]
    return R


def _least_squares(i: Int64s, j: Int64s, given: Float64s, off: Float64s, weight: Float64s, count: int) -> Float64s:
    """(count, 3) small turns of the views that satisfy `turn_j - given turn_i = off` best."""
    H, g = np.zeros((count, 3, count, 3)), np.zeros((count, 3))
    for a, b, M, r, w in zip(i, j, given, off, weight, strict=True):
        H[a, :, a] += w * np.eye(3)
        H[b, :, b] += w * np.eye(3)
        H[a, :, b] -= w * M.T
        H[b, :, a] -= w * M
        g[b] += w * r
        g[a] -= w * M.T @ r
    # the common turn of a connected part is free: the smallest solution leaves it alone
    turns = np.linalg.solve(H.reshape(3 * count, 3 * count) + 1e-9 * np.eye(3 * count), g.ravel())
    return np.asarray(turns.reshape(count, 3), dtype=np.float64)
