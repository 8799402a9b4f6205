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
"""Number of random samples of two patches."""
_INLIER_PX = 1.5
"""Largest distance of an inlier from the position that the rotation predicts, in pixels."""
_FEWEST_INLIERS = 10
"""Fewest patches that must agree on a rotation: chance agreement stays below this."""
_FEWEST_CELLS = 8
"""Fewest grid cells that must hold the agreeing patches: a clock burnt into the picture covers fewer."""
_LEAST_SHARE = 0.1
"""Smallest share of all patches that must agree."""
_ROUNDS = 5
"""Rounds of least squares, each with the inliers of the one before."""


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
    usable[:margin] = 0
    usable[-margin:] = 0
    usable[:, :margin] = 0
    usable[:, -margin:] = 0
    strength = np.asarray(cv2.cornerMinEigenVal(cv2.GaussianBlur(image, (0, 0), 1.0), 5), dtype=np.float32)
    strength[usable == 0] = 0
    positions = []
    for row in range(GRID_ROWS):
        for column in range(GRID_COLUMNS):
            y0 = h * row // GRID_ROWS
            y1 = h * (row + 1) // GRID_ROWS
            x0 = w * column // GRID_COLUMNS
            x1 = w * (column + 1) // GRID_COLUMNS
            cell = strength[y0:y1, x0:x1].copy()
            # the strongest corners, each of which suppresses those around it
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
    # 1. At half size around the old positions.
    half1 = _padded(_halved(image1), radius)
    half2 = _padded(_halved(image2), radius + reach)
    coarse, _ = _search(half1, half2, points / 2, points / 2, radius, reach)
    # 2. At full size, within 3 pixels of what was found.
    positions, score = _search(_padded(image1, radius), _padded(image2, radius + 3), points, coarse * 2, radius, 3)
    is_inside = (positions >= 0).all(axis=1) & (positions < [image1.shape[1], image1.shape[0]]).all(axis=1)
    keep = (score >= _LEAST_CORRELATION) & is_inside
    return Found(points[keep], positions[keep])


def _halved(image: Uint8s) -> Uint8s:
    """The image at half size."""
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _padded(image: Uint8s, margin: int) -> tuple[Float32s, int]:
    """The image with its edge repeated around it, and the width of this margin in pixels."""
    padded = cv2.copyMakeBorder(image, margin, margin, margin, margin, cv2.BORDER_REPLICATE)
    return np.asarray(padded, dtype=np.float32), margin


def _search(
    source: tuple[Float32s, int], target: tuple[Float32s, int], points: Float64s, near: Float64s, radius: int, reach: int
) -> tuple[Float64s, Float64s]:
    """Best position (n, 2) and correlation (n,) of each patch within `reach` of `near`; nan and -1 if there is none."""
    image1, pad1 = source
    image2, pad2 = target
    half_window = radius + reach
    side = 2 * radius + 1
    positions = np.full(points.shape, np.nan)
    scores = np.full(len(points), -1.0)
    for k, (point, centre) in enumerate(zip(points, near, strict=True)):
        if not np.isfinite(centre).all():
            continue
        x, y = np.rint(point).astype(int) + pad1
        u, v = np.rint(centre).astype(int) + pad2
        left = max(u - half_window, 0)
        top = max(v - half_window, 0)
        patch = image1[y - radius : y + radius + 1, x - radius : x + radius + 1]
        window = image2[top : v + half_window + 1, left : u + half_window + 1]
        if min(window.shape) < side or patch.shape != (side, side) or patch.std() < _LEAST_STD:
            continue
        surface = np.asarray(cv2.matchTemplate(window, patch, cv2.TM_CCOEFF_NORMED), dtype=np.float32)
        row, column = np.unravel_index(int(surface.argmax()), surface.shape)
        peak = np.array([_peak(surface[row], column), _peak(surface[:, column], row)])
        # from the window to the picture, with the part of a pixel by which the patch is off its point
        positions[k] = np.array([left, top]) + radius + peak - pad2 + (point - np.rint(point))
        scores[k] = surface[row, column]
    return positions, scores


def _peak(values: Float32s, index: np.intp) -> float:
    """Position of the vertex of the parabola through a maximum and its two neighbours."""
    k = int(index)
    if not 0 < k < len(values) - 1:
        return float(k)
    before = float(values[k - 1])
    after = float(values[k + 1])
    curvature = before - 2 * float(values[k]) + after
    if not curvature < 0:
        return k + 0.0
    return k + 0.5 * (before - after) / curvature


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
    # 1. Fit rotation vector and log zoom by Gauss-Newton, from the patches that agree on a similarity.
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

    # 2. Uncertainty from the residuals.
    residual, jacobian = _residuals(parameters, rays[inliers], found.x2[inliers], K)
    # errors within a cell are correlated (a shadow, one object that moved): its patches count as one
    variance = float(np.mean(residual**2)) * max(len(residual) / cells, 1.0)
    covariance = variance * np.linalg.pinv(jacobian.T @ jacobian)
    sigmas = np.sqrt(np.diag(covariance)[:3])

    # 3. What it does to the picture: H = K' R K^-1, where K' has the new focal length.
    R = np.asarray(cv2.Rodrigues(parameters[:3])[0], dtype=np.float64)
    zoom = float(np.exp(parameters[3]))
    H = np.diag([zoom, zoom, 1.0]) @ K
    H[:2, 2] = K[:2, 2]
    H = H @ R @ np.linalg.inv(K)
    middle = np.array([(width - 1) / 2, (height - 1) / 2, 1.0])
    shifted = H @ middle
    _, middle_jacobian = _residuals(parameters, (np.linalg.inv(K) @ middle)[None], middle[None, :2], K)
    shift_covariance = middle_jacobian @ covariance @ middle_jacobian.T
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 7), [1.0]), axis=-1).reshape(-1, 3)
    moved = grid @ H.T
    motion = np.linalg.norm(moved[:, :2] / moved[:, 2:] - grid[:, :2], axis=1)
    return Turn(
        R=R,
        zoom=zoom,
        homography=H / H[2, 2],
        shift=shifted[:2] / shifted[2] - middle[:2],
        shift_sigma=np.sqrt(np.diag(shift_covariance)),
        roll_deg=float(np.degrees(parameters[2])),
        roll_sigma_deg=float(np.degrees(sigmas[2])),
        angle_deg=float(np.degrees(np.linalg.norm(parameters[:3]))),
        angle_sigma_deg=float(np.degrees(np.linalg.norm(sigmas))),
        motion_px=float(np.median(motion)),
        inliers=inliers,
    )


def _similarity_inliers(found: Found) -> Bools:
    """The inliers of the best of many similarities, each through two random patches."""
    n = len(found.x1)
    rng = np.random.default_rng(0)
    pairs = rng.integers(0, n, (_TRIALS, 2))
    # points as complex numbers x + i y: a similarity is then z -> a z + b, its rotation the angle of a, its scale |a|
    z1 = found.x1 @ np.array([1, 1j])
    z2 = found.x2 @ np.array([1, 1j])
    base = z1[pairs[:, 1]] - z1[pairs[:, 0]]
    usable = np.abs(base) > 0.05 * np.abs(z1 - z1.mean()).max()
    pairs = pairs[usable]
    base = base[usable]
    similarity = (z2[pairs[:, 1]] - z2[pairs[:, 0]]) / base
    plausible = (np.abs(np.abs(similarity) - 1) < 0.05) & (np.abs(np.angle(similarity)) < 0.2)
    if not plausible.any():
        return np.zeros(n, dtype=bool)
    similarity = similarity[plausible]
    first = pairs[plausible, 0]
    # (samples, n) distance of each patch from where each similarity puts it
    errors = np.abs(similarity[:, None] * (z1[None] - z1[first][:, None]) + z2[first][:, None] - z2[None])
    agrees = errors <= _INLIER_PX
    return np.asarray(agrees[int(agrees.sum(axis=1).argmax())])


def _residuals(parameters: Float64s, rays: Float64s, x2: Float64s, K: Float64s) -> tuple[Float64s, Float64s]:
    """Residuals (n, 2) in pixels of rotated rays (n, 3), and their derivatives (2 n, 4) by rotation vector and log zoom."""
    R = cv2.Rodrigues(parameters[:3])[0]
    zoom = float(np.exp(parameters[3]))
    X = rays @ R.T
    f = np.array([K[0, 0], K[1, 1]]) * zoom
    plane = X[:, :2] / X[:, 2:]
    projected = plane * f + K[:2, 2]
    # derivatives of the image plane's coordinates by small rotations about x, y and z; by log zoom they are u and v themselves
    u, v = plane.T
    ones = np.ones_like(u)
    du = f[0] * np.stack([-u * v, ones + u * u, -v, u], axis=1)
    dv = f[1] * np.stack([-(ones + v * v), u * v, u, v], axis=1)
    return projected - x2, np.stack([du, dv], axis=1).reshape(-1, 4)
