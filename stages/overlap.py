"""Which views share ground: judged from poses where they are known, from appearance where they aren't.

With poses, rays of each view are sampled out to the distance at which the cameras' axes pass nearest each other, and projected
into the other view.  No length enters but ratios, so a desk and a quarry are treated alike.

Without, the descriptors of each view's *largest* keypoints are compared: a few hundred of them rank the pairs better than twice
as many of the strongest, since what is large survives a change of viewpoint (rank correlation with the angle between views on two
photographed sites: .98 and .91 against .91 and .89).  What counts is not how many resemble each other, since some always do, but
how many of those resemblances are mutual and distinctive.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from math import radians

import numpy as np

from .core.cameras import backproject, project, ray_angles, same_camera
from .types import Bools, Camera, Features, Float32s, Float64s, Int32s, Overlap, Placement, View


def estimate_overlap(
    views: Mapping[str, View],
    placements: Mapping[str, Placement],
    features: Mapping[str, Features],
    *,
    descriptors: int = 800,
    ratio: float = 0.85,
) -> Overlap:
    """Estimate for every pair of cameras how much of one view the other sees.

    Parameters
    ----------
    views
        The pinhole of every camera that has a frame, in the order of the site.
    placements
        Poses where known.
    features
        Keypoints of each camera; looked at for pairs in which a pose or the intrinsics are missing.
    descriptors
        So many of a view's largest keypoints are compared.
    ratio
        A resemblance counts when its distance is below this share of the second nearest's, both ways.

    Returns
    -------
    Overlap
        A row for each pair of cameras about which something is known; none for two views of one camera.  `source` is "poses",
        "appearance" or "mixed".
    """
    names = tuple(views)
    cameras = {name: camera for name in names if (camera := _camera(views[name], placements.get(name))) is not None}
    posed = _pose_evidence(names, cameras)
    seen = {name: _largest(features[name], descriptors) for name in names if name in features}
    rows: list[tuple[int, int, float, float]] = []
    sources = set()
    for i, j in combinations(range(len(names)), 2):
        left, right = names[i], names[j]
        if same_camera(views[left], views[right]):
            continue
        if left in cameras and right in cameras:
            rows.append((i, j, *posed[i, j]))
            sources.add("poses")
        elif left in seen and right in seen:
            rows.append((i, j, np.nan, _resemblance(seen[left], seen[right], ratio)))
            sources.add("appearance")
    pairs = np.array([row[:2] for row in rows], np.int32).reshape(-1, 2)
    angle, shared = np.array([row[2:] for row in rows], np.float64).reshape(-1, 2).T
    source = sources.pop() if len(sources) == 1 else "mixed" if sources else "appearance"
    return Overlap(names, pairs, np.degrees(angle), shared, source)


def _camera(view: View, placement: Placement | None) -> Camera | None:
    """The camera of a frame, or None where pose or intrinsics are missing."""
    if placement is None or placement.R is None or placement.C is None or view.K is None:
        return None
    return Camera(view.K, placement.R, placement.C, view.width, view.height)


def _pose_evidence(names: tuple[str, ...], cameras: Mapping[str, Camera]) -> dict[tuple[int, int], tuple[float, float]]:
    """(convergence angle in radians, shared part) of each pair of posed cameras, by positions in `names`."""
    index = [i for i, name in enumerate(names) if name in cameras]
    posed = [cameras[names[i]] for i in index]
    n = len(posed)
    if n < 2:
        return {}
    distances = _scene_distances(posed)
    angle, seen = np.full((n, n), np.nan), np.zeros((n, n))
    for i, camera in enumerate(posed):
        points = _probes(camera, distances[i])
        for j, other in enumerate(posed):
            if i != j:
                visible = _visible(other, points)
                seen[i, j] = visible.mean()
                angle[i, j] = _median_angle(points[visible] if visible.any() else points, camera.C, other.C)
    return {
        (index[i], index[j]): (float(0.5 * (angle[i, j] + angle[j, i])), float(0.5 * (seen[i, j] + seen[j, i])))
        for i, j in combinations(range(n), 2)
    }


def _scene_distances(cameras: list[Camera]) -> Float64s:
    """(n,) how far along each optical axis the scene lies: the median of where other axes pass nearest in front of both.

    Cameras whose axis meets no other take the others' median; if no axes meet at all (a row of parallel cameras, or cameras that
    look outward) five times the median distance to the nearest camera: the angle between neighbours is then about 11 degrees.
    """
    C = np.stack([camera.C for camera in cameras])
    axes = np.stack([camera.R[2] for camera in cameras])
    between = C[None, :, :] - C[:, None, :]
    cosine = axes @ axes.T
    along = np.einsum("ijk,ik->ij", between, axes)
    along_other = np.einsum("ijk,jk->ij", between, axes)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (along - cosine * along_other) / (1.0 - cosine**2)
        at_other = (cosine * along - along_other) / (1.0 - cosine**2)
    meets = (at > 0) & (at_other > 0) & (np.abs(cosine) < np.cos(radians(2.0)))
    distances = np.array([np.median(at[i, meets[i]]) if meets[i].any() else np.nan for i in range(len(cameras))])
    baseline = np.linalg.norm(between, axis=2)
    nearest = np.where(baseline > 0, baseline, np.inf).min(axis=1)
    nearest = nearest[np.isfinite(nearest)]
    fallback = 5.0 * float(np.median(nearest)) if nearest.size else 1.0
    known = np.isfinite(distances)
    return np.where(known, distances, float(np.median(distances[known])) if known.any() else fallback)


def _probes(camera: Camera, distance: float) -> Float64s:
    """(n, 3) world points on a grid of rays, at depths from half to twice the scene's distance."""
    x = (np.arange(8) + 0.5) / 8 * camera.width - 0.5
    y = (np.arange(6) + 0.5) / 6 * camera.height - 0.5
    depths = distance * 2.0 ** np.linspace(-1, 1, 5)
    u, v, z = (axis.ravel() for axis in np.meshgrid(x, y, depths, indexing="ij"))
    return backproject(camera, np.column_stack([u, v]), z)


def _visible(camera: Camera, points: Float64s) -> Bools:
    x, depth = project(camera, points)
    inside = (x[:, 0] >= -0.5) & (x[:, 1] >= -0.5) & (x[:, 0] < camera.width - 0.5) & (x[:, 1] < camera.height - 0.5)
    return np.asarray(inside & (depth > 0))


def _median_angle(points: Float64s, C1: Float64s, C2: Float64s) -> float:
    """Median angle in radians at which two centres see the points."""
    return float(np.median(ray_angles(points - C1, points - C2)))


def _largest(features: Features, count: int) -> Float32s:
    """(m, d) descriptors of the largest keypoints of the untilted view."""
    plain = np.flatnonzero(features.tilts == 0)
    area = np.abs(np.linalg.det(features.frames[plain]))
    best = plain[np.argsort(-area, kind="stable")[:count]]
    return features.descriptors[best]


def _resemblance(left: Float32s, right: Float32s, ratio: float) -> float:
    """Share of the descriptors with a mutual and distinctive nearest neighbour, 0 to 1."""
    if min(len(left), len(right)) < 3:
        return 0.0
    similarity = left @ right.T
    forward, ok_forward = _distinctive(similarity, ratio)
    backward, ok_backward = _distinctive(similarity.T, ratio)
    mutual = backward[forward] == np.arange(len(left))
    return float((mutual & ok_forward & ok_backward[forward]).sum() / min(len(left), len(right)))


def _distinctive(similarity: Float32s, ratio: float) -> tuple[Int32s, Bools]:
    """Per row the best column, and whether its distance is below `ratio` times the second's."""
    rows = np.arange(len(similarity))
    best = similarity.argmax(axis=1)
    first = similarity[rows, best]
    rest = similarity.copy()
    rest[rows, best] = -1.0
    second = rest.max(axis=1)
    return best.astype(np.int32), np.asarray((2 - 2 * first) < ratio**2 * (2 - 2 * second))
