"""How well the cameras see the ground: how many, at what angle, with what error; and what the loss of one camera would cost.

The surface is tonight's: the lowest height found in each cell, else the ground plane.  A camera sees a place if it projects
into the image, is not masked, and is not occluded according to the camera's depth map.  A camera without a depth map tonight
sees nothing: it is down, or none of its pairs could be used.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from .contracts.defaults import NOISE_PX, VIEW_ANGLE_DEG
from .contracts.reasons import Reason, Rejected
from .core.cameras import backproject, camera_id, project
from .core.ground_grid import cell_centres, cells_of, grid_over, ground_axes, preferred_above, quantile_by_cell
from .core.jit import kernel
from .core.residual_distortion import undistorted_frames
from .types import Bools, Camera, Coverage, DepthMap, Float64s, Frame, GroundGrid, Poses, Scene

_LEAST_SAMPLES = 320
"""Smallest number of samples per row of a depth map from which the surface is made."""
_FILL_CELLS = 1.5
"""A cell without points takes the height of the nearest cell with points, up to this distance in cells."""
_CELLS = 250
"""Approximate number of cells along the longer side of the ground."""
_LOWEST_QUANTILE = 0.1
"""Quantile of the heights in a cell that counts as its lowest: a single wrong point must not make a pit."""
_LOW_SHARE = 0.2
"""Share of the heights that may lie below the fitted ground plane."""
_FIT_STEPS = 30
"""Steps of the iteratively reweighted fit of that plane."""
_OCCLUDED_SIGMAS = 3.0
"""A camera does not see a place if its depth there is nearer by more than this many standard deviations, plus a cell's edge, plus
`_OCCLUDED_SHARE` of the place's depth."""
_OCCLUDED_SHARE = 0.02
"""Part of this tolerance that grows with depth, no unit: the ground of a cell is not exactly where the camera saw it."""


def find_coverage(
    poses: Poses,
    frames: Mapping[str, Frame],
    depths: Mapping[str, DepthMap],
    refined: Mapping[str, DepthMap] | None = None,
    scene: Scene | None = None,
    *,
    cell_m: float | None = None,
    noise_px: float = NOISE_PX,
    min_angle_deg: float = VIEW_ANGLE_DEG,
    max_angle_deg: float = 60.0,
) -> Coverage | Rejected:
    """Count, for each cell of the ground, the cameras that see it.

    Parameters
    ----------
    poses : camera poses; only cameras of the main component that have a depth map count.
    frames : the cameras' frames, for their masks; loaded one at a time.
    depths, refined : depth maps of the views from their pairs, and refined ones, which are preferred where they exist.
    scene : the ground plane, if it is known.
    cell_m : edge of a cell in metres; None: 1, 2 or 5 times a power of ten, for about 250 cells along the longer side.
    noise_px : expected error of a match in pixels, standard deviation.
    min_angle_deg, max_angle_deg : two cameras measure depth where their rays meet at an angle between these limits.
    """
    preferred = refined or {}
    posed = poses.main_cameras()
    cameras = {name: camera for name, camera in posed.items() if name in preferred or name in depths}
    frames = undistorted_frames(frames, cameras)

    def depth_of(name: str) -> DepthMap:
        return preferred[name] if name in preferred else depths[name]

    # 1. The surface that was seen, and a grid over it; its outermost points do not decide the size of the cells.
    surfaces = [_surface(camera, depth_of(name)) for name, camera in cameras.items()]
    surface = np.concatenate([np.zeros((0, 3)), *surfaces])
    if not len(surface):
        return Rejected(Reason.NO_DEPTH, {"cameras": float(len(posed))})
    plane = scene.ground if scene is not None else None
    axes = ground_axes(cameras.values(), plane)
    low_and_high = np.percentile(surface @ axes[:2].T, [1, 99], axis=0)
    extent = float(np.ptp(low_and_high, axis=0).max())
    grid = grid_over(surface, axes, cell_m or preferred_above(extent / _CELLS))
    heights = _heights(grid, surface, plane)
    X = cell_centres(grid, heights)
    known: Bools = np.asarray(np.isfinite(X).all(axis=1))

    # 2. Which cells does each camera see?  Most cameras have one view; those with several see what any of these sees.
    seen_by: dict[str, Bools] = {}
    first_view: dict[str, Camera] = {}
    for name, camera in cameras.items():
        visible = _sees(camera, frames.get(name), depth_of(name), X[known], grid.cell)
        whole = camera_id(name, camera)
        seen_by[whole] = seen_by[whole] | visible if whole in seen_by else visible
        first_view.setdefault(whole, camera)

    # 3. The best pair of cameras for each cell.
    centres = np.stack([camera.C for camera in first_view.values()])
    focals = np.array([camera.K[0, 0] for camera in first_view.values()]) / noise_px
    seen = np.stack(list(seen_by.values()))
    cos_min_angle, cos_max_angle = np.cos(np.radians([min_angle_deg, max_angle_deg]))
    angle, error = _best_pairs(X[known], seen, centres, focals, cos_min_angle, cos_max_angle)
    return _coverage(poses, grid, heights, known.reshape(heights.shape), seen_by, angle, error)


def _coverage(
    poses: Poses,
    grid: GroundGrid,
    heights: Float64s,
    known: Bools,
    seen_by: Mapping[str, Bools],
    angle: Float64s,
    error: Float64s,
) -> Coverage:
    """The result from arrays of the n cells with a height.

    known : (rows, columns) cells with a height.
    seen_by : (n,) cells that each camera sees, by its id.
    angle, error : (n,) of the best pair of cameras, nan without one.
    """
    views = np.sum(list(seen_by.values()), axis=0)  # number of cameras that see each cell

    def to_grid(values: np.ndarray, fill: float, dtype: type[np.generic]) -> np.ndarray:
        """(rows, columns) values, and `fill` in cells without a height."""
        cells: np.ndarray = np.full(heights.shape, fill, dtype)
        cells[known] = values
        return cells

    measured = np.isfinite(error)
    median_angle_deg = -1.0
    median_error = -1.0
    if measured.any():
        median_angle_deg = float(np.degrees(np.median(angle[measured])))
        median_error = float(np.median(error[measured]))
    # A cell that two cameras see is lost for depth without either of them.
    lost_without = {name: float(np.mean((views == 2) & seen)) for name, seen in seen_by.items()}
    return Coverage(
        grid,
        heights.astype(np.float32),
        to_grid(np.minimum(views, 255), 0, np.uint8),
        to_grid(np.degrees(angle), np.nan, np.float32),
        to_grid(error, np.nan, np.float32),
        area=float(np.count_nonzero(known) * grid.cell**2),
        seen_by_one=float(np.mean(views >= 1)),
        seen_by_two=float(np.mean(views >= 2)),
        median_angle_deg=median_angle_deg,
        median_error=median_error,
        lost_without=lost_without,
        metric=poses.metric,
        crs=poses.crs,
    )


def _surface(camera: Camera, depth: DepthMap) -> Float64s:
    """(n, 3) points of a depth map in the world, from every few pixels."""
    step = max(1, camera.width // _LEAST_SAMPLES)
    z = depth.depth[step // 2 :: step, step // 2 :: step]
    y, x = np.nonzero(np.isfinite(z))
    pixels = np.column_stack([x, y]).astype(np.float64) * step + step // 2
    return backproject(camera, pixels, z[y, x].astype(np.float64))


def _heights(grid: GroundGrid, surface: Float64s, plane: Float64s | None) -> Float64s:
    """(rows, columns) heights of the surface within its convex hull: the lowest in each cell, else the ground plane."""
    # 1. The lowest surface in each cell, which also fills cells beside it.
    cells = cells_of(grid, surface)
    lowest = quantile_by_cell(cells, surface @ grid.axes[2], grid.rows * grid.columns, _LOWEST_QUANTILE)
    heights = lowest.reshape(grid.rows, grid.columns)
    distance, nearest = distance_transform_edt(~np.isfinite(heights), return_indices=True)
    heights = np.where(distance <= _FILL_CELLS, heights[tuple(nearest)], np.nan)

    # 2. Cells without a height within the convex hull of the others.
    y, x = np.nonzero(np.isfinite(heights))
    area = np.zeros(heights.shape, np.uint8)
    hull = cv2.convexHull(np.column_stack([x, y]).astype(np.int32))
    cv2.fillConvexPoly(area, hull, 1)
    holes = (area > 0) & ~np.isfinite(heights)
    if not holes.any():
        return heights

    # 3. They take the height of the plane n X + d = 0 above their place p in the plane of height 0: n (p + level up) + d = 0.
    places = cell_centres(grid, np.zeros_like(heights))
    if plane is None:
        plane = _ground_plane(places, heights.ravel(), grid.axes[2])
    level = -(places @ plane[:3] + plane[3]) / float(plane[:3] @ grid.axes[2])
    heights[holes] = level.reshape(heights.shape)[holes]
    return heights


def _ground_plane(flat: Float64s, heights: Float64s, up: Float64s) -> Float64s:
    """(4,) the plane below most of the heights (n,) at the places `flat` (n, 3): things that stand on the ground are above it.

    Quantile regression at `_LOW_SHARE`, by iteratively reweighted least squares (Koenker & Bassett 1978).
    """
    known = np.isfinite(heights)
    count = int(known.sum())
    horizontal = np.linalg.svd(up[None])[2][1:]  # (2, 3) two axes across `up`
    A = np.column_stack([flat[known] @ horizontal.T, np.ones(count)])
    y = heights[known]
    weights = np.ones(count)
    for _ in range(_FIT_STEPS):
        coefficients = np.linalg.lstsq(A * weights[:, None], y * weights, rcond=None)[0]
        error = y - A @ coefficients
        # Weighted squares equal the quantile loss |error| times the share of its side; the limit avoids division by zero.
        size = np.maximum(np.abs(error), 1e-3 * np.ptp(y) + 1e-12)
        weights = np.sqrt(np.where(error > 0, _LOW_SHARE, 1 - _LOW_SHARE) / size)
    # y = a u + b v + c for horizontal coordinates u, v: the normal is up - a u_axis - b v_axis.
    normal = up - coefficients[:2] @ horizontal
    return np.append(normal, -coefficients[2])


def _sees(camera: Camera, frame: Frame | None, depth: DepthMap, X: Float64s, cell: float) -> Bools:
    """(n,) bool: which points X (n, 3) are in a camera's image, unmasked and not occluded?"""
    x, z = project(camera, X)
    inside = (z > 0) & (x > -0.5).all(axis=1) & (x[:, 0] < camera.width - 0.5) & (x[:, 1] < camera.height - 0.5)
    pixels = np.rint(x[inside]).astype(np.intp)
    visible = np.ones(len(pixels), bool)
    if frame is not None:
        visible &= frame.mask[pixels[:, 1], pixels[:, 0]]
    surface_z = depth.depth[pixels[:, 1], pixels[:, 0]]
    sigma = depth.sigma[pixels[:, 1], pixels[:, 0]]
    tolerance = _OCCLUDED_SIGMAS * sigma + _OCCLUDED_SHARE * z[inside] + cell
    visible &= ~(surface_z < z[inside] - tolerance)  # a pixel without depth (nan) occludes nothing
    seen = np.zeros(len(X), bool)
    seen[inside] = visible
    return seen


@kernel
def _best_pairs(
    X: Float64s, seen: Bools, centres: Float64s, focals: Float64s, cos_min_angle: float, cos_max_angle: float
) -> tuple[Float64s, Float64s]:
    """Radians between the rays of each point's best pair of cameras (n,), and the point's error (n,); nan without a pair.

    A camera locates a point across its ray to range / focal; the summed information of two rays has its smallest eigenvalue in
    the rays' plane: ((a + b) - sqrt((a - b)^2 + 4 a b cos^2)) / 2 for weights a and b.
    """
    n = len(X)
    count = len(centres)
    angle = np.full(n, np.nan)
    error = np.full(n, np.nan)
    # Unit rays and weights of the cameras that see the point at hand: the first `used` rows.
    rays = np.empty((count, 3))
    weights = np.empty(count)
    for k in range(n):
        used = 0
        for c in range(count):
            if not seen[c, k]:
                continue
            dx = X[k, 0] - centres[c, 0]
            dy = X[k, 1] - centres[c, 1]
            dz = X[k, 2] - centres[c, 2]
            r = np.sqrt(dx * dx + dy * dy + dz * dz)
            rays[used, 0] = dx / r
            rays[used, 1] = dy / r
            rays[used, 2] = dz / r
            weights[used] = (focals[c] / r) ** 2
            used += 1
        best = 0.0
        for i in range(used):
            for j in range(i + 1, used):
                cos = rays[i, 0] * rays[j, 0] + rays[i, 1] * rays[j, 1] + rays[i, 2] * rays[j, 2]
                if cos > cos_min_angle or cos < cos_max_angle:  # the cosine falls as the angle grows
                    continue
                a = weights[i]
                b = weights[j]
                information = 0.5 * (a + b - np.sqrt((a - b) ** 2 + 4.0 * a * b * cos * cos))
                if information > best:
                    best = information
                    angle[k] = np.arccos(cos)
                    error[k] = 1.0 / np.sqrt(information)
    return angle, error
