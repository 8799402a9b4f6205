"""Photographed pairs with the project's own geometry, and errors of rectification and dense matching against the truth.

The benches of rectification and dense matching use them.  Geometry is estimated from keypoints at `FEATURE_WIDTH` and scaled to
the requested width.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pairs_with_truth import TrueView, photographed, true_correspondences

from wbflow_stages.fusion.pair_depth import sample_disparity
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.rectification.warping import disparity_px, from_rectified, to_rectified
from wbflow_stages.types import Disparity, Float64s, Geometry, Matches, Rectification

FEATURE_WIDTH = 1536
SWEEP = "5-4 5-3 5-2 5-1 5-6 5-7 5-8 5-9"


@dataclass(frozen=True)
class TruePair:
    """Two views at working width, their geometry, and exact correspondences x1, x2 (n, 2) of points that both see."""

    name: str
    left: TrueView
    right: TrueView
    geometry: Geometry
    x1: Float64s
    x2: Float64s


def true_pairs(names: list[str], width: int, scene: str = "fountain") -> list[TruePair]:
    """Pairs such as "5-4" that have a geometry; for the others, the reason is printed."""
    chosen = [tuple(name.split("-")) for name in names]
    numbers = sorted({number for pair in chosen for number in pair})
    views, sharp = photographed(scene, width, numbers), photographed(scene, FEATURE_WIDTH, numbers)
    pairs = []
    for a, b in chosen:
        matches = match(sharp[a].features, sharp[b].features)
        geometry = estimate_geometry(matches, sharp[a].features, sharp[b].features) if isinstance(matches, Matches) else matches
        if isinstance(geometry, Geometry):
            geometry = scaled(geometry, views[a], views[b])
            truth = true_correspondences(views[a], views[b], width // 2)
            pairs.append(TruePair(f"{a}-{b}", views[a], views[b], geometry, *truth))
        else:
            print(f"{a}-{b} has no geometry: {geometry.reason}")
    return pairs


def scaled(geometry: Geometry, left: TrueView, right: TrueView) -> Geometry:
    """The geometry of the same pair at another width."""
    s1, s2 = left.camera.width / geometry.view1.width, right.camera.width / geometry.view2.width
    T1, T2 = (np.array([[s, 0, 0.5 * s - 0.5], [0, s, 0.5 * s - 0.5], [0, 0, 1]]) for s in (s1, s2))
    F = np.linalg.inv(T2).T @ geometry.F @ np.linalg.inv(T1)
    x1, x2 = ((x + 0.5) * s - 0.5 for x, s in ((geometry.x1, s1), (geometry.x2, s2)))
    noise = None if geometry.noise_px is None else geometry.noise_px * np.float32(s1)
    lens1, lens2 = (None if K is None else T @ K for K, T in ((geometry.lens1, T1), (geometry.lens2, T2)))
    F /= np.linalg.norm(F)
    view1, view2 = left.frame.view, right.frame.view
    return replace(geometry, F=F, x1=x1, x2=x2, noise_px=noise, lens1=lens1, lens2=lens2, view1=view1, view2=view2)


def row_errors(rectification: Rectification, pair: TruePair) -> Float64s:
    """(n,) row offsets in pixels of the true correspondences that lie within both rectified images."""
    y1, y2 = to_rectified(rectification, 1, pair.x1), to_rectified(rectification, 2, pair.x2)
    shown = np.ones(len(y1), dtype=bool)
    for y, size in ((y1, rectification.size1), (y2, rectification.size2)):
        shown &= (y >= -0.5).all(axis=1) & (y <= np.array(size) - 0.5).all(axis=1)
    return np.asarray(np.abs(y1[shown, 1] - y2[shown, 1]))


def dense_errors(rectification: Rectification, disparity: Disparity, pair: TruePair) -> Float64s:
    """(n,) pixels in image 2 between a true point and the point that the left disparity gives; nan without a disparity."""
    at = to_rectified(rectification, 1, pair.x1)
    d = sample_disparity(disparity_px(disparity, 1), at)
    found = from_rectified(rectification, 2, np.column_stack([at[:, 0] - d, at[:, 1]]))
    return np.asarray(np.linalg.norm(found - pair.x2, axis=1))
