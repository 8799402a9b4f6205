"""The ground: the plane on which most of a site stands, found in all views together.

Fixed cameras hang upright, with level rows: the up direction follows from the cameras alone.  Planes at many heights below the
lowest camera are tried: a plane is likely the ground if patches of one view look the same in another view when the plane maps
them there.  Repeated tiles fit at many heights in one pair of views, but at one height only in all of them.

How similar a patch looks by chance follows from the patch itself, over all heights that were tried.  A plane is the ground if its
patches look significantly more similar than by chance, and than on any other plane.

References
----------
Collins, A space-sweep approach to true multi-image matching, CVPR 1996.
Vovk & Wang, E-values: calibration, combination and applications, Annals of Statistics 2021 (from a p-value to an odds ratio).
Vuong, Likelihood ratio tests for model selection and non-nested hypotheses, Econometrica 1989.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ..core.cameras import rays, relative_pose, scaled_intrinsics
from ..core.jit import helper, kernel
from ..core.luminance import block_means
from ..core.parallel import parallel_map
from ..types import Camera, Float32s, Float64s

View = tuple[Float32s, Camera]
"""A grey image (h, w), and its camera."""

_HEIGHTS = 200
"""Number of heights that are tried, in a geometric sequence: neighbours differ by 2 %."""

_LOWEST = 0.02
"""Least height of the lowest camera above a plane that is tried, as a share of the longest baseline."""

_HIGHEST = 1.5
"""Largest such height, as a share of the longest baseline."""

_PATCHES = 28
"""Patches across the wider side of a view."""

_RADIUS = 4
"""Radius of a patch, pixels of the halved view."""

_LARGE_RADIUS = 8
"""Radius of the large patches of `count_similar_patches`, pixels."""

_LEAST_CORRELATION = 0.9
"""Correlation above which large patches look the same."""

_CANDIDATES = 4
"""Number of planes that are fitted after the sweep."""

_MOST_PAIRS = 8
"""Largest number of pairs of views that are compared: the nearest ones, which look most similar."""

_LEAST_SPREAD = 0.15
"""Lower limit of the standard deviation of Fisher-transformed correlations over the heights: without texture they hardly vary."""

_LEAST_CHANCE = 1e-6
"""Lower limit of the probability that a patch is this similar by chance: no single patch decides."""

_SHARES = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.7])
"""Shares of the patches that may lie on the ground."""

_SIGNIFICANT = 2.0
"""Standard errors by which the ground must be more likely than chance, and than any other plane."""

_MOST_TILT_DEG = 3.0
"""Largest tilt, in degrees, of the change that fits a plane."""

_MOST_LIFT = 0.05
"""Largest lift of the change that fits a plane, as a share of its height below the cameras.  Below the outermost camera the tilt
moves it by at most twice that share."""

_SAME_HEIGHT = 0.06
"""Planes whose heights differ by no more than this share are the same."""

_LEVEL_DEG = 5.0
"""World axes are assumed to have z up if z is within this angle of the cameras' up direction."""

_NOISE_VARIANCE = 4.0
"""Added to the variances in a patch's correlation, grey levels squared: patches with less contrast than noise match nothing."""


def find_ground(images: Mapping[str, Float32s], cameras: Mapping[str, Camera]) -> Float64s | None:
    """The ground plane (4,): n, d with n X + d = 0, n of unit length and pointing up; None if no plane is significant.

    images: (h, w) float32 grey frame of each camera.
    """
    views = [halved(images[name], cameras[name]) for name in cameras if name in images]
    pairs = _pairs(views)
    ups = _ups(views)
    if not pairs or not ups:
        return None

    # 1. The best planes for each up direction, each fitted, with the odds of every patch.
    directed = _directed_pairs(views, pairs, ups[0])
    candidates: list[tuple[Float64s, Float64s]] = []
    for up in ups:
        planes, chance = _sweep(views, pairs, directed, up)
        for plane in parallel_map(lambda plane: _fit_nearby(views, directed, plane), planes):
            odds = _odds(_similarities(directed, plane), chance)
            candidates.append((odds, plane))

    # 2. The likeliest of them.
    odds, ground = max(candidates, key=lambda candidate: float(_gains(candidate[0]).max()))
    share = _SHARES[int(np.argmax(_gains(odds)))]

    # 3. It must be significantly likelier than chance (odds of 1 for all patches), and than every plane of another height.
    centre = np.mean([camera.C for _, camera in views], axis=0)
    height = float(ground[:3] @ centre + ground[3])
    alternatives = [np.ones_like(odds)]
    for other_odds, plane in candidates:
        if abs((plane[:3] @ centre + plane[3]) / height - 1) > _SAME_HEIGHT:
            alternatives.append(other_odds)
    if all(_significance(odds, other_odds, share) >= _SIGNIFICANT for other_odds in alternatives):
        return ground
    return None


def likely_planes(views: list[View]) -> list[Float64s]:
    """A few level planes (4,) on which most patches look similar, for views that may be some pixels off."""
    pairs = _pairs(views)
    ups = _ups(views)
    if not pairs or not ups:
        return []
    planes, _ = _sweep(views, pairs, _directed_pairs(views, pairs, ups[0]), ups[0])
    return planes


def fit_nearby_plane(views: list[View], plane: Float64s) -> tuple[float, Float64s]:
    """Mean square of the correlations on the best plane near a given one, and that plane."""
    directed = _directed_pairs(views, _pairs(views), plane[:3])
    fitted = _fit_nearby(views, directed, plane)
    patch_count = sum(len(pair.patches) for pair in directed)
    return _score(directed, fitted) / patch_count, fitted


def count_similar_patches(views: list[View], plane: Float64s) -> int:
    """Number of large patches that look the same in two views if they lie on the plane: one stone looks like another, but not
    together with its surroundings."""
    count = 0
    for pair in _directed_pairs(views, _pairs(views), plane[:3]):
        count += int(np.sum(_similarity(pair, plane, _LARGE_RADIUS) > _LEAST_CORRELATION))
    return count


@dataclass(frozen=True)
class _DirectedPair:
    """One view compared with another, in this direction."""

    one: View
    two: View
    patches: Float64s
    """(n, 2) whole pixels of the first view."""


class _Chance(NamedTuple):
    """How similar patches look by chance: Fisher-transformed correlations over all heights, (n,) each, nan for a patch that is
    rarely in view."""

    mean: Float64s
    spread: Float64s
    """Standard deviation."""


def halved(image: Float32s, camera: Camera) -> View:
    """A view at half its size: planes that are slightly wrong still fit there, so that fewer have to be tried."""
    small = block_means(image, 2)
    return small, replace(camera, K=scaled_intrinsics(camera.K, 0.5, 0.5), width=small.shape[1], height=small.shape[0])


def _ups(views: list[View]) -> list[Float64s]:
    """Possible up directions: perpendicular to all views' rows, and the world's z axis if it agrees or the rows leave it open."""
    cameras = [camera for _, camera in views]
    row_axes = np.stack([camera.R[0] for camera in cameras])
    # the direction to which the rows are most nearly perpendicular; its sign is that against which the columns point
    values, vectors = np.linalg.eigh(row_axes.T @ row_axes)
    up = vectors[:, 0] * np.sign(-sum(camera.R[1] @ vectors[:, 0] for camera in cameras))
    z = np.array([0.0, 0.0, 1.0])
    is_level = float(up @ z) > np.cos(np.radians(_LEVEL_DEG))
    tilt_known = values[1] > 0.02 * len(cameras)  # views that all face the same way do not determine their tilt
    is_upright = all(-camera.R[1] @ z > 0.5 for camera in cameras)
    ups = []
    if is_level or (is_upright and not tilt_known):
        ups.append(z)
    if tilt_known:
        ups.append(up)
    return ups


def _pairs(views: list[View]) -> list[tuple[int, int]]:
    """Pairs of views that look in about the same direction, the nearest ones first; none from one place."""
    by_baseline = []
    for i, j in combinations(range(len(views)), 2):
        camera1 = views[i][1]
        camera2 = views[j][1]
        baseline = float(np.linalg.norm(camera1.C - camera2.C))
        if camera1.R[2] @ camera2.R[2] > -0.2 and baseline > 0:
            by_baseline.append((baseline, i, j))
    return [(i, j) for _, i, j in sorted(by_baseline)[:_MOST_PAIRS]]


def _sweep(
    views: list[View], pairs: list[tuple[int, int]], directed: list[_DirectedPair], up: Float64s
) -> tuple[list[Float64s], _Chance]:
    """The best level planes (4,), of different heights, the best one first; and how similar patches look by chance."""
    # 1. Correlation of every patch at every height.
    lowest = min(float(camera.C @ up) for _, camera in views)
    longest_baseline = max(float(np.linalg.norm(views[i][1].C - views[j][1].C)) for i, j in pairs)
    heights = longest_baseline * np.geomspace(_LOWEST, _HIGHEST, _HEIGHTS)

    def similarities_at(height: float) -> Float64s:
        return _similarities(directed, np.append(up, height - lowest))

    similarity = np.array(list(parallel_map(similarities_at, heights)))  # (heights, patches)

    # 2. What a patch gives by chance: most heights are wrong.
    often = np.isfinite(similarity).sum(axis=0) > 0.1 * _HEIGHTS
    often_transformed = _fisher(similarity[:, often])
    mean = np.full(similarity.shape[1], np.nan)
    mean[often] = np.nanmean(often_transformed, axis=0)
    spread = np.full(similarity.shape[1], np.nan)
    spread[often] = np.nanstd(often_transformed, axis=0)
    chance = _Chance(mean, spread)

    # 3. The likeliest heights, without those that are nearly the same as a likelier one.
    gain = np.array([_gains(_odds(row, chance)).max() for row in similarity])
    best_heights: list[float] = []
    for height in heights[np.argsort(-gain, kind="stable")]:
        is_new = all(abs(height / other - 1) > _SAME_HEIGHT for other in best_heights)
        if is_new and len(best_heights) < _CANDIDATES:
            best_heights.append(float(height))
    return [np.append(up, height - lowest) for height in best_heights], chance


def _fisher(correlation: Float64s) -> Float64s:
    """Fisher's transform of correlations, which is about normally distributed."""
    return np.asarray(np.arctanh(np.clip(correlation, -0.99, 0.99)), dtype=np.float64)


def _odds(similarity: Float64s, chance: _Chance) -> Float64s:
    """(n,) odds, ground to chance, of patches that look this similar on a plane; 1 where nothing is known."""
    from scipy.special import ndtr  # imported here, because many sites need no ground

    above = (_fisher(similarity) - chance.mean) / np.hypot(chance.spread, _LEAST_SPREAD)
    p = np.maximum(ndtr(-above), _LEAST_CHANCE)
    odds = 0.5 / np.sqrt(p)  # the calibrator of Vovk & Wang with kappa = 1/2
    return np.asarray(np.nan_to_num(odds, nan=1.0), dtype=np.float64)


def _gains(odds: Float64s) -> Float64s:
    """Log-likelihood ratio of a plane to chance, for each of `_SHARES`."""
    return np.asarray(np.log1p(_SHARES[:, None] * (odds - 1.0)).sum(axis=1), dtype=np.float64)


def _significance(odds: Float64s, other_odds: Float64s, share: float) -> float:
    """Standard errors by which one plane is more likely than another (Vuong).  The factor 2 is for pairs of views, which are
    compared in both directions and thus count twice."""
    gain = np.log1p(share * (odds - 1.0)) - np.log1p(share * (other_odds - 1.0))
    return float(gain.sum() / max(np.sqrt(2.0 * (gain**2).sum()), 1e-12))


def _directed_pairs(views: list[View], pairs: list[tuple[int, int]], up: Float64s) -> list[_DirectedPair]:
    """Each pair in both directions, with the patches of the first view that look below the horizon."""
    directed = []
    for i, j in pairs:
        for one, two in ((views[i], views[j]), (views[j], views[i])):
            patches = below_horizon(one[1], up, _PATCHES)
            directed.append(_DirectedPair(one, two, patches))
    return directed


def _similarities(directed: list[_DirectedPair], plane: Float64s) -> Float64s:
    """(n,) correlations of the patches of all pairs on a plane, nan where not in view."""
    return np.concatenate([_similarity(pair, plane) for pair in directed])


def _score(directed: list[_DirectedPair], plane: Float64s) -> float:
    """Sum of the squares of all positive correlations."""
    return float(np.nansum(np.maximum(_similarities(directed, plane), 0.0) ** 2))


def _fit_nearby(views: list[View], directed: list[_DirectedPair], plane: Float64s) -> Float64s:
    """The plane near a given one, tilted and lifted a little, on which patches look most similar."""
    from scipy.optimize import minimize

    cameras = np.array([camera.C for _, camera in views])
    centre = cameras.mean(axis=0)
    height = float(plane[:3] @ centre + plane[3])
    radius = float(np.linalg.norm(cameras - centre, axis=1).max())
    tangents = np.linalg.svd(plane[None, :3])[2][1:]
    most_tilt = min(np.radians(_MOST_TILT_DEG), 2.0 * _MOST_LIFT * height / radius)

    def moved_plane(change: Float64s) -> Float64s:
        # tanh keeps the change within its limits, whatever the optimiser tries
        normal = plane[:3] + tangents.T @ (most_tilt * np.tanh(change[:2]))
        normal /= np.linalg.norm(normal)
        moved_height = height * (1.0 + _MOST_LIFT * np.tanh(change[2]))
        return np.append(normal, moved_height - normal @ centre)

    def minus_score(change: Float64s) -> float:
        return -_score(directed, moved_plane(change))

    simplex = np.vstack([np.zeros(3), np.eye(3) / 3])
    options = {"initial_simplex": simplex, "maxfev": 80, "xatol": 0.003}
    result = minimize(minus_score, np.zeros(3), method="Nelder-Mead", options=options)
    return moved_plane(np.asarray(result.x, dtype=np.float64))


def below_horizon(camera: Camera, up: Float64s, across: int) -> Float64s:
    """(n, 2) whole pixels of a grid that look below the horizon; across: points of the grid over the wider side."""
    step = max(camera.width, camera.height) / across
    x = np.arange(step / 2, camera.width, step)
    y = np.arange(step / 2, camera.height, step)
    pixels = np.floor(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    direction = rays(camera, pixels)
    return np.asarray(pixels[up @ direction < -0.03 * np.linalg.norm(direction, axis=0)])


def _similarity(pair: _DirectedPair, plane: Float64s, radius: int = _RADIUS) -> Float64s:
    """(n,) correlation of one view's patches with the other view, where the plane maps them; nan for patches not in view."""
    image1, camera1 = pair.one
    image2, camera2 = pair.two
    if plane[:3] @ camera1.C + plane[3] <= 0 or plane[:3] @ camera2.C + plane[3] <= 0:
        return np.full(len(pair.patches), np.nan)
    out = np.empty(len(pair.patches))
    H = ground_homography(camera1, camera2, plane)
    _correlate(image1, image2, pair.patches, H, radius, out)
    return out


def ground_homography(camera1: Camera, camera2: Camera, plane: Float64s) -> Float64s:
    """(3, 3): pixels of camera 1 to those of camera 2, of points on the plane n X + d = 0; its third coordinate, and that of its
    inverse, is positive for points in front of both cameras (Hartley & Zisserman, eq. 13.2)."""
    R, t = relative_pose(camera1, camera2)
    normal = camera1.R @ plane[:3]
    offset = float(plane[:3] @ camera1.C + plane[3])
    return np.asarray(camera2.K @ (R - np.outer(t, normal) / offset) @ np.linalg.inv(camera1.K), dtype=np.float64)


def inverse_depth_line(camera: Camera, plane: Float64s) -> Float64s:
    """(3,): its product with (x, y, 1) is the inverse depth of the plane n X + d = 0 in a camera, negative above the horizon."""
    line = -(plane[:3] @ camera.R.T @ np.linalg.inv(camera.K)) / (plane[:3] @ camera.C + plane[3])
    return np.asarray(line, dtype=np.float64)


@kernel
def _correlate(image1: Float32s, image2: Float32s, patches: Float64s, H: Float64s, radius: int, out: Float64s) -> None:
    """Write the correlation (n,) of each patch of image 1 with image 2, to which H maps it; nan if it is not in view."""
    for k in range(len(patches)):
        x = int(patches[k, 0])
        y = int(patches[k, 1])
        if _in_view(image1, image2, x, y, H, radius):
            out[k] = _correlation(image1, image2, x, y, H, radius)
        else:
            out[k] = np.nan


@helper
def _in_view(image1: Float32s, image2: Float32s, x: int, y: int, H: Float64s, radius: int) -> bool:
    """Do both images show the patch?  In front of the camera its projection is convex, so that its corners decide."""
    h1, w1 = image1.shape
    h2, w2 = image2.shape
    if x < radius or y < radius or x >= w1 - radius or y >= h1 - radius:
        return False
    for j in (y - radius, y + radius):
        for i in (x - radius, x + radius):
            z = H[2, 0] * i + H[2, 1] * j + H[2, 2]
            u = (H[0, 0] * i + H[0, 1] * j + H[0, 2]) / z
            v = (H[1, 0] * i + H[1, 1] * j + H[1, 2]) / z
            if not (z > 0 and u >= 0 and v >= 0 and u < w2 - 1 and v < h2 - 1):
                return False
    return True


@helper
def _correlation(image1: Float32s, image2: Float32s, x: int, y: int, H: Float64s, radius: int) -> float:
    """Correlation of the patch around (x, y) with its image under H, bilinearly interpolated; both lie in view."""
    # sums of the grey levels, of their squares and of their products
    s1 = 0.0
    s2 = 0.0
    s11 = 0.0
    s22 = 0.0
    s12 = 0.0
    for j in range(y - radius, y + radius + 1):
        for i in range(x - radius, x + radius + 1):
            z = H[2, 0] * i + H[2, 1] * j + H[2, 2]
            u = (H[0, 0] * i + H[0, 1] * j + H[0, 2]) / z
            v = (H[1, 0] * i + H[1, 1] * j + H[1, 2]) / z
            a = int(u)
            b = int(v)
            f = u - a
            g = v - b
            grey2 = (image2[b, a] * (1 - f) + image2[b, a + 1] * f) * (1 - g)
            grey2 += (image2[b + 1, a] * (1 - f) + image2[b + 1, a + 1] * f) * g
            grey1 = image1[j, i]
            s1 += grey1
            s2 += grey2
            s11 += grey1 * grey1
            s22 += grey2 * grey2
            s12 += grey1 * grey2
    n = (2 * radius + 1) ** 2
    variance1 = s11 / n - (s1 / n) ** 2
    variance2 = s22 / n - (s2 / n) ** 2
    covariance = s12 / n - s1 * s2 / n / n
    return float(covariance / np.sqrt((variance1 + _NOISE_VARIANCE) * (variance2 + _NOISE_VARIANCE)))
