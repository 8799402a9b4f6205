"""Rotation of a camera between two of its pictures, from small patches found again near their old positions.

Patches around corners of the first picture are searched in the second by normalised cross-correlation (Lewis 1995), which is
insensitive to local brightness.  The rotation that most patches agree on (random samples of two, Fischler & Bolles 1981) is
fitted by least squares as a rotation about the camera's centre with a zoom.  This works between noon and lamplight, where
keypoint descriptors fail; cameras that turned farther than the search radius are left to keypoints (`global_search`).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..types import Bools, Float32s, Float64s, Uint8s
from .image_grid import GRID_COLUMNS, GRID_ROWS, covered_cells

REACH_PX = 40
"""Search radius around a patch's old position, in pixels."""
_PER_CELL = 4
"""Largest number of patches in a grid cell."""
_LEAST_CORRELATION = 0.6
"""Patches with a lower correlation count as not found."""
_LEAST_STD = 2.0
"""Patches with a lower standard deviation, in grey levels, are not searched."""
_TRIALS = 400
_INLIER_PX = 1.5
"""Largest distance of an inlier from the position that the rotation predicts, in pixels."""
_FEWEST_INLIERS, _FEWEST_CELLS, _LEAST_SHARE = 10, 8, 0.1
"""Fewest inliers, fewest grid cells that hold them, and their smallest share of all patches.  Chance agreement, or a clock burnt
into the picture, stays below these."""
_ROUNDS = 5


@dataclass(frozen=True)
class Found:
    """Patches of one picture and their positions in another."""

    x1: Float64s
    """(n, 2) old positions, pixels."""
    x2: Float64s
    """(n, 2) new positions, pixels."""


@dataclass(frozen=True)
class Turn:
    """Rotation and zoom of a camera between two pictures."""

    R: Float64s
    """(3, 3) rotation from the old camera axes to the new ones."""
    zoom: float
    """New focal length over the old one."""
    homography: Float64s
    """(3, 3) transform from old pixels to new ones."""
    shift: Float64s
    """(2,) motion of the picture's centre, pixels."""
    shift_sigma: Float64s
    """(2,) standard deviation of `shift`, pixels."""
    roll_deg: float
    """Rotation about the optical axis, positive from x to y."""
    roll_sigma_deg: float
    angle_deg: float
    """Angle of the whole rotation."""
    angle_sigma_deg: float
    motion_px: float
    """Median motion of pixels on a grid over the picture."""
    inliers: Bools
    """(n,) which patches agree with the rotation."""


def corners(image: Uint8s, mask: Bools) -> Float64s:
    """(n, 2) corners of a grey image, spread over cells, away from the border and from masked pixels."""
    h, w = image.shape
    margin = patch_radius(w) * 2 + 2
    usable = np.asarray(cv2.erode(mask.astype(np.uint8), np.ones((margin, margin), np.uint8)))
    usable[:margin], usable[-margin:], usable[:, :margin], usable[:, -margin:] = 0, 0, 0, 0
    strength = np.asarray(cv2.cornerMinEigenVal(cv2.GaussianBlur(image, (0, 0), 1.0), 5), dtype=np.float32)
    strength[usable == 0] = 0
    positions = []
    for row in range(GRID_ROWS):
        for column in range(GRID_COLUMNS):
            y0, y1 = h * row // GRID_ROWS, h * (row + 1) // GRID_ROWS
            x0, x1 = w * column // GRID_COLUMNS, w * (column + 1) // GRID_COLUMNS
            cell = strength[y0:y1, x0:x1].copy()
            spacing = max(min(cell.shape) // 5, 2)
            for _ in range(_PER_CELL):
                y, x = np.unravel_index(int(cell.argmax()), cell.shape)
                if cell[y, x] <= 0:
                    break
                positions.append((x0 + x, y0 + y))
                cell[max(y - spacing, 0) : y + spacing + 1, max(x - spacing, 0) : x + spacing + 1] = 0
    return np.array(positions, dtype=np.float64).reshape(-1, 2)


def patch_radius(width: int) -> int:
    """Half the side of a patch in pixels, for pictures of this width."""
    return int(np.clip(width // 100, 5, 12))


def find_again(image1: Uint8s, image2: Uint8s, points: Float64s) -> Found:
    """Search patches around points (n, 2) of one grey image (h, w) in another of the same size, at half size and then finely."""
    radius = patch_radius(image1.shape[1])
    reach = REACH_PX // 2
    half1, half2 = _padded(_halved(image1), radius), _padded(_halved(image2), radius + reach)
    coarse, _ = _search(half1, half2, points / 2, points / 2, radius, reach)
    positions, score = _search(_padded(image1, radius), _padded(image2, radius + 3), points, coarse * 2, radius, 3)
    inside = (positions >= 0).all(axis=1) & (positions < [image1.shape[1], image1.shape[0]]).all(axis=1)
    keep = (score >= _LEAST_CORRELATION) & inside
    return Found(points[keep], positions[keep])


def _halved(image: Uint8s) -> Uint8s:
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _padded(image: Uint8s, margin: int) -> tuple[Float32s, int]:
    return np.asarray(cv2.copyMakeBorder(image, margin, margin, margin, margin, cv2.BORDER_REPLICATE), dtype=np.float32), margin


def _search(
    source: tuple[Float32s, int], target: tuple[Float32s, int], points: Float64s, near: Float64s, radius: int, reach: int
) -> tuple[Float64s, Float64s]:
    """Best position (n, 2) and correlation (n,) of each patch within `reach` of `near`; nan and -1 if there is none."""
    image1, pad1 = source
    image2, pad2 = target
    positions, scores = np.full(points.shape, np.nan), np.full(len(points), -1.0)
    for k, (point, centre) in enumerate(zip(points, near, strict=True)):
        if not np.isfinite(centre).all():
            continue
        x, y = np.rint(point).astype(int) + pad1
        u, v = np.rint(centre).astype(int) + pad2
        half_window = radius + reach
        patch = image1[y - radius : y + radius + 1, x - radius : x + radius + 1]
        window = image2[max(v - half_window, 0) : v + half_window + 1, max(u - half_window, 0) : u + half_window + 1]
        if min(window.shape) < 2 * radius + 1 or patch.shape != (2 * radius + 1,) * 2 or patch.std() < _LEAST_STD:
            continue
        surface = np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED), dtype=np.float32)
        row, column = np.unravel_index(int(surface.argmax()), surface.shape)
        peak = np.array([_peak(surface[row], column), _peak(surface[:, column], row)])
        corner = np.array([max(u - half_window, 0), max(v - half_window, 0)])
        positions[k] = corner + radius + peak - pad2 + (point - np.rint(point))
        scores[k] = surface[row, column]
    return positions, scores


def _peak(values: Float32s, index: np.intp) -> float:
    """Position of the vertex of the parabola through a maximum and its two neighbours."""
    k = int(index)
    if not 0 < k < len(values) - 1:
        return float(k)
    a, b, c = float(values[k - 1]), float(values[k]), float(values[k + 1])
    curvature = a - 2 * b + c
    return k + (0.5 * (a - c) / curvature if curvature < 0 else 0.0)


def fit_turn(found: Found, K: Float64s, width: int, height: int) -> Turn | None:
    """The rotation and zoom that most patches agree on, or None if too few do.

    Parameters
    ----------
    found : old and new positions of the patches.
    K : (3, 3) intrinsics, pixels.
    width, height : size of the pictures.
    """
    if len(found.x1) < _FEWEST_INLIERS:
        return None
    inliers = _similarity_inliers(found)
    parameters = np.zeros(4)
    rays = np.column_stack([found.x1, np.ones(len(found.x1))]) @ np.linalg.inv(K).T
    for _ in range(_ROUNDS):
        if inliers.sum() < _FEWEST_INLIERS:
            return None
        residual, jacobian = _residuals(parameters, rays[inliers], found.x2[inliers], K)
        step = np.linalg.lstsq(jacobian, -residual.ravel(), rcond=None)[0]
        parameters = parameters + step
        residual = _residuals(parameters, rays, found.x2, K)[0]
        inliers = np.linalg.norm(residual, axis=1) <= _INLIER_PX
    cells = covered_cells(found.x1[inliers], (width, height))
    if inliers.sum() < max(_FEWEST_INLIERS, _LEAST_SHARE * len(inliers)) or cells < _FEWEST_CELLS:
        return None
    residual, jacobian = _residuals(parameters, rays[inliers], found.x2[inliers], K)
    # errors within a cell are correlated (a shadow, one object that moved): its patches count as one
    variance = float(np.mean(residual**2)) * max(len(residual) / cells, 1.0)
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian)
    R, zoom = np.asarray(cv2.Rodrigues(parameters[:3])[0], dtype=np.float64), float(np.exp(parameters[3]))
    H = np.diag([zoom, zoom, 1.0]) @ K
    H[:2, 2] = K[:2, 2]
    H = H @ R @ np.linalg.inv(K)
    middle = np.array([(width - 1) / 2, (height - 1) / 2, 1.0])
    _, middle_jacobian = _residuals(parameters, (np.linalg.inv(K) @ middle)[None], middle[None, :2], K)
    shift_covariance = middle_jacobian @ covariance @ middle_jacobian.T
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 7), [1.0]), axis=-1).reshape(-1, 3)
    moved = grid @ H.T
    motion = np.linalg.norm(moved[:, :2] / moved[:, 2:] - grid[:, :2], axis=1)
    shifted = H @ middle
    sigmas = np.sqrt(np.diag(covariance)[:3])
    return Turn(
        R,
        zoom,
        H / H[2, 2],
        shifted[:2] / shifted[2] - middle[:2],
        np.sqrt(np.diag(shift_covariance)),
        float(np.degrees(parameters[2])),
        float(np.degrees(sigmas[2])),
        float(np.degrees(np.linalg.norm(parameters[:3]))),
        float(np.degrees(np.linalg.norm(sigmas))),
        float(np.median(motion)),
        inliers,
    )


def _similarity_inliers(found: Found) -> Bools:
    """The inliers of the best of many similarities, each through two random patches."""
    n = len(found.x1)
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, n, (_TRIALS, 2))
    z1, z2 = found.x1 @ np.array([1, 1j]), found.x2 @ np.array([1, 1j])
    base = z1[pairs[:, 1]] - z1[pairs[:, 0]]
    usable = np.abs(base) > 0.05 * np.abs(z1 - z1.mean()).max()
    pairs, base = pairs[usable], base[usable]
    similarity = (z2[pairs[:, 1]] - z2[pairs[:, 0]]) / base
    plausible = (np.abs(np.abs(similarity) - 1) < 0.05) & (np.abs(np.angle(similarity)) < 0.2)
    if not plausible.any():
        return np.zeros(n, dtype=bool)
    similarity, first = similarity[plausible], pairs[plausible, 0]
    errors = np.abs(similarity[:, None] * (z1[None] - z1[first][:, None]) + z2[first][:, None] - z2[None])
    return np.asarray(errors[int((errors <= _INLIER_PX).sum(axis=1).argmax())] <= _INLIER_PX)


def _residuals(parameters: Float64s, rays: Float64s, x2: Float64s, K: Float64s) -> tuple[Float64s, Float64s]:
    """Residuals (n, 2) in pixels of rotated rays (n, 3), and their derivatives (2 n, 4) by rotation vector and log zoom."""
    R, zoom = cv2.Rodrigues(parameters[:3])[0], float(np.exp(parameters[3]))
    X = rays @ R.T
    f = np.array([K[0, 0], K[1, 1]]) * zoom
    plane = X[:, :2] / X[:, 2:]
    projected = plane * f + K[:2, 2]
    u, v = plane.T
    ones = np.ones_like(u)
    du = f[0] * np.stack([-u * v, ones + u * u, -v, u], axis=1)
    dv = f[1] * np.stack([-(ones + v * v), u * v, u, v], axis=1)
    return projected - x2, np.stack([du, dv], axis=1).reshape(-1, 4)
