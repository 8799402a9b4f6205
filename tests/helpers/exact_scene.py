"""A yard with exact truth: ground, a wall and a box, seen by cameras on an arc; disparities are computed, not matched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbflow_stages.core.cameras import backproject, project
from wbflow_stages.depth import view_depth
from wbflow_stages.rectification.warping import Side, from_rectified, rectified_size, to_rectified
from wbflow_stages.types import INVALID, Camera, DepthMap, Disparity, Frame, Pair, Rectification, Rejected, View

BOX = (np.array([-1.5, -1.0, 0.0]), np.array([0.5, 1.0, 1.6]))  # two corners, metres at scale 1
WALL_Y = 4.0


@dataclass(frozen=True)
class Yard:
    """The inputs of `fuse`, for a yard `scale` times larger than the basic yard and moved by `shift`."""

    frames: dict[str, Frame]
    cameras: dict[str, Camera]
    rectifications: dict[Pair, Rectification]
    disparities: dict[Pair, Disparity]
    scale: float
    shift: np.ndarray

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance of points from the nearest surface, in units of the basic yard."""
        X = (points.astype(np.float64) - self.shift) / self.scale
        low, high = BOX
        outside = np.linalg.norm(np.maximum(np.maximum(low - X, X - high), 0), axis=1)
        inside = np.minimum(X - low, high - X).min(axis=1)
        box = np.where(outside > 0, outside, np.abs(inside))
        return np.asarray(np.minimum(np.minimum(np.abs(X[:, 2]), np.abs(X[:, 1] - WALL_Y)), box))

    def depths(self, **parameters: float) -> dict[str, DepthMap]:
        """Depth maps of all views that get one from their pairs."""
        found = {name: self.depth(name, **parameters) for name in self.cameras}
        return {name: depth for name, depth in found.items() if isinstance(depth, DepthMap)}

    def depth(self, name: str, **parameters: float) -> DepthMap | Rejected:
        """Depth map of one view from its pairs."""
        others = {other: camera for other, camera in self.cameras.items() if other != name}
        pairs = {pair: disparity for pair, disparity in self.disparities.items() if name in pair}
        return view_depth(self.cameras[name], others, {pair: self.rectifications[pair] for pair in pairs}, pairs, **parameters)

    def colour(self, points: np.ndarray) -> np.ndarray:
        """Colours (n, 3) that a camera of exposure 1 sees at points."""
        return _colour((points.astype(np.float64) - self.shift) / self.scale)


def make_yard(
    degrees: tuple[float, ...] = (-20, 0, 20),
    *,
    scale: float = 1.0,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    width: int = 240,
    exposures: tuple[float, ...] | None = None,
    max_angle: float = 45.0,
    noise_px: float = 0.0,
    wrong: float = 0.0,
) -> Yard:
    """Make a yard.  noise_px: sigma of Gaussian noise on every disparity; wrong: share of disparities up to 20 px off."""
    cameras, frames = {}, {}
    exposures = exposures or (1.0,) * len(degrees)
    for angle, exposure in zip(degrees, exposures, strict=True):
        a = np.radians(angle)
        camera = _looking(np.array([8 * np.sin(a), -8 * np.cos(a), 3.0]), np.array([0.0, 0.5, 0.8]), width)
        image = np.clip(_colour(_hit(camera)) * exposure, 0, 255).astype(np.uint8)
        name = f"cam{angle:+d}"
        cameras[name] = Camera(camera.K, camera.R, camera.C * scale + shift, camera.width, camera.height)
        frames[name] = Frame(image, np.ones(image.shape[:2], bool), View(camera.width, camera.height, camera.K))
    names = list(cameras)
    basic = {name: Camera(c.K, c.R, (c.C - shift) / scale, c.width, c.height) for name, c in cameras.items()}
    rectifications, disparities = {}, {}
    rng = np.random.default_rng(0)
    for i, left in enumerate(names):
        for j in range(i + 1, len(names)):
            if degrees[j] - degrees[i] <= max_angle:
                pair = left, names[j]
                rectifications[pair] = rectified = _calibrated(basic[left], basic[names[j]])
                disparities[pair] = _exact(basic[left], basic[names[j]], rectified, rng, noise_px, wrong)
    return Yard(frames, cameras, rectifications, disparities, scale, np.array(shift))


def true_depth(camera: Camera) -> np.ndarray:
    """Depth (h, w), along the optical axis, of a camera in the basic yard."""
    return project(camera, _hit(camera).reshape(-1, 3))[1].reshape(camera.height, camera.width)


def _looking(position: np.ndarray, target: np.ndarray, width: int) -> Camera:
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    height = width * 3 // 4
    K = np.array([[1.1 * width, 0, (width - 1) / 2], [0, 1.1 * width, (height - 1) / 2], [0, 0, 1]])
    return Camera(K, np.stack([right, np.cross(forward, right), forward]), position, width, height)


def _hit(camera: Camera) -> np.ndarray:
    """First surface point (h, w, 3) along every pixel's ray."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width].reshape(2, -1).astype(np.float64)
    return _first(camera.C, backproject(camera, np.column_stack([x, y]), np.ones(len(x)))).reshape(camera.height, camera.width, 3)


def _first(origin: np.ndarray, through: np.ndarray) -> np.ndarray:
    direction = through - origin
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = -origin[2] / direction[:, 2]
        wall = (WALL_Y - origin[1]) / direction[:, 1]
        enter = ((BOX[0] - origin) / direction, (BOX[1] - origin) / direction)
        near, far = np.minimum(*enter).max(axis=1), np.maximum(*enter).min(axis=1)
    ts = np.stack([ground, wall, np.where((near <= far) & (near > 0), near, np.inf)])
    return np.asarray(origin + direction * np.where(ts > 1e-9, ts, np.inf).min(axis=0)[:, None])


def _colour(X: np.ndarray) -> np.ndarray:
    waves = [np.sin(X @ np.array(k) + p) for k, p in (((3, 2, 5), 0), ((-4, 3, 2), 1), ((2, -5, 3), 2))]
    return np.asarray(128 + 60 * np.stack(waves, axis=-1) * np.cos(X @ np.array([1.3, 0.7, 2.1]))[..., None])


def _calibrated(left: Camera, right: Camera) -> Rectification:
    """Rectification: both cameras are rotated about their centres until the baseline is their common x axis."""
    x = (right.C - left.C) / np.linalg.norm(right.C - left.C)
    y = np.cross(left.R[2] + right.R[2], x)
    y /= np.linalg.norm(y)
    R = np.stack([x, y, np.cross(x, y)])
    H = [left.K @ R @ c.R.T @ np.linalg.inv(c.K) for c in (left, right)]
    corners = np.array([[0, 0], [left.width - 1, 0], [0, left.height - 1], [left.width - 1, left.height - 1]], float)
    mapped = [np.column_stack([corners, np.ones(4)]) @ h.T for h in H]
    mapped = [m[:, :2] / m[:, 2:] for m in mapped]
    top = min(m[:, 1].min() for m in mapped)
    height = int(np.ceil(max(m[:, 1].max() for m in mapped) - top)) + 1
    shifted = [np.array([[1, 0, -m[:, 0].min()], [0, 1, -top], [0, 0, 1.0]]) @ h for h, m in zip(H, mapped, strict=True)]
    sizes = [(int(np.ceil(np.ptp(m[:, 0]))) + 1, height) for m in mapped]
    return Rectification("calibrated", "exact", shifted[0], shifted[1], sizes[0], sizes[1], -100, 100, 0.0, 0.0, 20.0)


def _exact(
    left: Camera, right: Camera, rectified: Rectification, rng: np.random.Generator, noise: float, wrong: float
) -> Disparity:
    views = []
    sides: tuple[tuple[Side, Side, Camera, Camera], ...] = ((1, 2, left, right), (2, 1, right, left))
    for side, opposite, camera, other in sides:
        w, h = rectified_size(rectified, side)
        v, u = np.mgrid[0:h, 0:w].reshape(2, -1).astype(np.float64)
        at = np.column_stack([u, v])
        pixel = from_rectified(rectified, side, at)
        X = _first(camera.C, backproject(camera, pixel, np.ones(len(at))))
        partner, _ = project(other, X)
        seen = np.linalg.norm(_first(other.C, X) - X, axis=1) < 1e-6
        for p, c in ((pixel, camera), (partner, other)):
            seen &= (p >= 0).all(axis=1) & (p[:, 0] <= c.width - 1) & (p[:, 1] <= c.height - 1)
        moved = to_rectified(rectified, opposite, partner)
        d = (u - moved[:, 0]) * (1 if side == 1 else -1)
        d += noise * rng.normal(size=len(d)) + np.where(rng.random(len(d)) < wrong, rng.uniform(-20, 20, len(d)), 0)
        views.append(np.where(seen, np.round(np.clip(d, -1000, 1000) * 16), INVALID).astype(np.int16).reshape(h, w))
    sure1, sure2 = (np.where(view != INVALID, 255, 0).astype(np.uint8) for view in views)
    return Disparity(views[0], views[1], sure1, sure2, 0, float((views[0] != INVALID).mean()))
