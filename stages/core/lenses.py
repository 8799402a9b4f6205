"""Lens models: projection of rays to pixels, and of pixels back to rays, for every supported model.

Each model maps a ray to *normalised* coordinates, which K turns into pixels; the inverse uses Newton's method from a table of
the radial profile.  Rays are directions (x, y, z) in camera axes, of any length; beyond 90 degrees off the axis z < 0.

References
----------
pinhole, brown, rational, fisheye: OpenCV, calib3d (Brown 1971; Kannala & Brandt 2006)
division: Fitzgibbon 2001; fov: Devernay & Faugeras 2001; eucm: Khomutenko 2016; omni: Mei & Rives 2007;
double-sphere: Usenko 2018; thin-prism-fisheye, rad-tan-thin-prism-fisheye, equirectangular: COLMAP, Project Aria
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..contracts.stated import LensModel
from ..types import Float64s, Lens

WIDEST_DEG = 110.0
"""Largest field of view of a pinhole image, degrees: a pixel at its border covers a third of the angle of a central one."""


@dataclass(frozen=True)
class Projection:
    """How a lens model maps rays."""

    project: Callable[[Float64s, Float64s], Float64s]
    """Maps coefficients and unit rays (n, 3) to normalised coordinates (n, 2); nan for rays that the lens does not see."""
    farthest: float = np.pi
    """Largest usable angle off the axis, in radians: the model, or its inverse, ends there."""


def lens_pixels(lens: Lens, rays: Float64s) -> Float64s:
    """Pixels (n, 2) of the capture on which rays (n, 3) in camera axes fall; nan where the lens does not see them."""
    if lens.K is None:
        raise ValueError("a lens without intrinsics has no rays")
    # models end within the field of view: nan and infinity there are no fault
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    with np.errstate(all="ignore"):
        x = _projection(lens).project(_coefficients(lens), unit)
    x[off_axis(unit) > usable_angle(lens)] = np.nan
    return np.asarray(x @ lens.K[:2, :2].T + lens.K[:2, 2], dtype=np.float64)


def lens_rays(lens: Lens, x: Float64s) -> Float64s:
    """Unit rays (n, 3), in camera axes, of pixels (n, 2) of the capture; nan for pixels to which the model maps no ray."""
    if lens.K is None:
        raise ValueError("a lens without intrinsics has no rays")
    target = (x - lens.K[:2, 2]) @ np.linalg.inv(lens.K[:2, :2]).T
    if lens.model == "equirectangular":  # the only model whose inverse is written down, and whose rays reach the poles
        longitude, latitude = target.T
        return np.column_stack([np.sin(longitude) * np.cos(latitude), np.sin(latitude), np.cos(longitude) * np.cos(latitude)])
    coefficients = _coefficients(lens)
    project = _projection(lens).project
    limit = usable_angle(lens)
    # models end within the range of the search: nan and infinity there are no fault
    with np.errstate(all="ignore"):
        angle_xy = _start(coefficients, project, limit, target)
        for _ in range(_MOST_STEPS):
            step = _newton_step(coefficients, project, angle_xy, target)
            angle_xy = angle_xy - step
            if not (np.abs(step) > _LEAST_STEP).any():
                break
        rays = _ray(angle_xy)
        # a pixel counts only if its ray comes back to it, and lies where the model is still one to one
        error = np.linalg.norm(project(coefficients, rays) - target, axis=1)
        is_solved = (error < _MOST_ERROR) & (off_axis(rays) <= limit + _LEAST_STEP)
        rays[~is_solved] = np.nan
    return rays


def usable_angle(lens: Lens) -> float:
    """Angle off the axis, in radians, up to which image radii grow with the angle: beyond it the model folds over or ends."""
    if lens.model == "equirectangular":
        return np.pi
    projection = _projection(lens)
    coefficients = _coefficients(lens)
    angles = np.arange(_PROFILE_STEP, projection.farthest, _PROFILE_STEP)
    limit = float(angles[-1])
    with np.errstate(all="ignore"):
        for radius in _radii(coefficients, projection.project, angles):
            # written so that a radius that is nan does not grow either
            not_growing = ~(np.diff(radius, prepend=0.0) > _PROFILE_STEP * 1e-3)
            if not_growing.any():
                last_growing = max(int(not_growing.argmax()) - 1, 0)
                limit = min(limit, float(angles[last_growing]))
    return limit


def off_axis(rays: Float64s) -> Float64s:
    """(n,) radians between rays (n, 3) and the optical axis."""
    return np.asarray(np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2]), dtype=np.float64)


def sides_deg(lens: Lens, width: int, height: int) -> Float64s:
    """(4,) degrees from the axis to the left, right, upper and lower side through the principal point; at most `usable_angle`."""
    if lens.K is None:
        raise ValueError("a lens without intrinsics has no rays")
    x, y = lens.K[:2, 2]
    # pixel centres are at integers: the image ends half a pixel beyond them
    edges = np.array([[-0.5, y], [width - 0.5, y], [x, -0.5], [x, height - 0.5]])
    angles = np.nan_to_num(off_axis(lens_rays(lens, edges)), nan=usable_angle(lens))
    return np.asarray(np.rad2deg(angles), dtype=np.float64)


_PROFILE_STEP = np.deg2rad(0.25)
"""Step of the radial profile, radians."""
_MOST_STEPS = 30
"""Most steps of Newton's method."""
_LEAST_STEP = 1e-13
"""Newton's method ends when no step is larger than this, radians."""
_LARGEST_STEP = 0.2
"""Steps are cut to this, radians: near the end of a model the slope says little about the next place."""
_MOST_ERROR = 1e-10
"""Largest error of a solution, in normalised coordinates: far below a thousandth of a pixel."""
_DIFFERENCE = 1e-6
"""Angle to each side, in radians, of the central differences that give the derivatives."""


def _projection(lens: Lens) -> Projection:
    if lens.model not in PROJECTIONS:
        raise ValueError(f"lens model {lens.model!r} is not known: {', '.join(PROJECTIONS)}")
    return PROJECTIONS[lens.model]


def _coefficients(lens: Lens) -> Float64s:
    """The stated coefficients followed by zeros, so that every model finds those that are not stated as 0."""
    return np.concatenate([np.asarray(lens.distortion, dtype=np.float64), np.zeros(14)])


def _radii(coefficients: Float64s, project: Callable[[Float64s, Float64s], Float64s], angles: Float64s) -> list[Float64s]:
    """Normalised image radii (n,) of rays at angles (n,) off the axis, in each of eight directions."""
    radii = []
    for azimuth in np.arange(8) * (np.pi / 4):
        direction = np.array([np.cos(azimuth), np.sin(azimuth)])
        points = project(coefficients, _ray(angles[:, None] * direction))
        radii.append(np.linalg.norm(points, axis=1))
    return radii


def _ray(angle_xy: Float64s) -> Float64s:
    """Unit rays (n, 3) from angles off the axis times their direction in the image (n, 2)."""
    angle = np.linalg.norm(angle_xy, axis=1)
    sinc = np.sinc(angle / np.pi)  # sin(angle) / angle
    return np.column_stack([sinc * angle_xy[:, 0], sinc * angle_xy[:, 1], np.cos(angle)])


def _start(coefficients: Float64s, project: Callable[[Float64s, Float64s], Float64s], limit: float, target: Float64s) -> Float64s:
    """(n, 2) starting values of Newton's method, angle times direction, from the mean radial profile."""
    angles = np.linspace(0, limit, 400)
    profile = np.mean(_radii(coefficients, project, angles), axis=0)
    radius = np.linalg.norm(target, axis=1)
    angle_per_radius = np.interp(radius, profile, angles) / np.maximum(radius, 1e-300)
    return np.asarray(target * angle_per_radius[:, None], dtype=np.float64)


def _newton_step(
    coefficients: Float64s, project: Callable[[Float64s, Float64s], Float64s], angle_xy: Float64s, target: Float64s
) -> Float64s:
    """(n, 2) steps of Newton's method, to be subtracted; 0 where the model ends."""
    # derivatives by the two angles
    slopes = []
    for h in np.eye(2) * _DIFFERENCE:
        after = project(coefficients, _ray(angle_xy + h))
        before = project(coefficients, _ray(angle_xy - h))
        slopes.append((after - before) / (2 * _DIFFERENCE))
    # [[a, b], [c, d]] step = (e, f) by Cramer's rule
    a, c = slopes[0].T
    b, d = slopes[1].T
    e, f = (project(coefficients, _ray(angle_xy)) - target).T
    step = np.column_stack([d * e - b * f, a * f - c * e]) / (a * d - b * c)[:, None]
    step[~np.isfinite(step).all(axis=1)] = 0.0
    return np.asarray(np.clip(step, -_LARGEST_STEP, _LARGEST_STEP), dtype=np.float64)


# The projections: coefficients (padded with zeros) and unit rays (n, 3) to normalised coordinates (n, 2)


def _pinhole(_: Float64s, rays: Float64s) -> Float64s:
    """x / z, y / z; nan behind the camera."""
    x = rays[:, :2] / rays[:, 2:]
    x[rays[:, 2] <= 0] = np.nan
    return x


def _brown(c: Float64s, rays: Float64s) -> Float64s:
    """OpenCV's full model: k1 k2 p1 p2 k3, k4 k5 k6 (rational), s1..s4 (thin prism), and the tilt of the sensor."""
    x, y = _pinhole(c, rays).T
    r2 = x * x + y * y
    radial = (1 + r2 * (c[0] + r2 * (c[1] + r2 * c[4]))) / (1 + r2 * (c[5] + r2 * (c[6] + r2 * c[7])))
    u = x * radial + 2 * c[2] * x * y + c[3] * (r2 + 2 * x * x) + c[8] * r2 + c[9] * r2 * r2
    v = y * radial + c[2] * (r2 + 2 * y * y) + 2 * c[3] * x * y + c[10] * r2 + c[11] * r2 * r2
    if not c[12:14].any():
        return np.column_stack([u, v])
    # the tilted sensor: turned about x, then about y, and projected back along the axis
    sx = np.sin(c[12])
    cx = np.cos(c[12])
    sy = np.sin(c[13])
    cy = np.cos(c[13])
    turn = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    tilt = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]]) @ turn
    tilted = np.column_stack([u, v, np.ones_like(u)]) @ tilt.T
    return np.asarray(tilted[:, :2] / tilted[:, 2:], dtype=np.float64)


def _ideal_fisheye(rays: Float64s) -> Float64s:
    """(n, 2) angle off the axis times direction in the image: the projection of an ideal fisheye."""
    r = np.hypot(rays[:, 0], rays[:, 1])
    stretch = np.where(r > 0, off_axis(rays) / r, 1.0)  # angle / sin(angle), 1 on the axis
    return np.asarray(rays[:, :2] * stretch[:, None], dtype=np.float64)


def _fisheye(c: Float64s, rays: Float64s) -> Float64s:
    """k1..k4: theta (1 + k1 theta^2 + k2 theta^4 + ...)."""
    x = _ideal_fisheye(rays)
    t2 = (x * x).sum(axis=1)
    radial = 1 + t2 * (c[0] + t2 * (c[1] + t2 * (c[2] + t2 * c[3])))
    return np.asarray(x * radial[:, None], dtype=np.float64)


def _thin_prism_fisheye(c: Float64s, rays: Float64s) -> Float64s:
    """k1 k2 p1 p2 k3 k4 sx1 sy1, as COLMAP orders them."""
    x, y = _ideal_fisheye(rays).T
    r2 = x * x + y * y
    radial = 1 + r2 * (c[0] + r2 * (c[1] + r2 * (c[4] + r2 * c[5])))
    u = x * radial + 2 * c[2] * x * y + c[3] * (r2 + 2 * x * x) + c[6] * r2
    v = y * radial + c[2] * (r2 + 2 * y * y) + 2 * c[3] * x * y + c[7] * r2
    return np.column_stack([u, v])


def _rad_tan_thin_prism_fisheye(c: Float64s, rays: Float64s) -> Float64s:
    """k0..k5, p0 p1, s0..s3: Project Aria's Fisheye624."""
    x = _ideal_fisheye(rays)
    t2 = (x * x).sum(axis=1)
    radial = 1 + t2 * (c[0] + t2 * (c[1] + t2 * (c[2] + t2 * (c[3] + t2 * (c[4] + t2 * c[5])))))
    x = x * radial[:, None]
    r2 = (x * x).sum(axis=1)[:, None]
    tangential = 2 * (x @ c[6:8])[:, None] * x
    return np.asarray(x + tangential + r2 * c[6:8] + r2 * c[[8, 10]] + r2 * r2 * c[[9, 11]], dtype=np.float64)


def _division(c: Float64s, rays: Float64s) -> Float64s:
    """r_u = r_d / (1 + k r_d^2), solved for r_d."""
    z = rays[:, 2]
    root = np.sqrt(z * z - 4 * c[0] * (rays[:, :2] ** 2).sum(axis=1))
    return np.asarray(2 * rays[:, :2] / (z + root)[:, None], dtype=np.float64)


def _fov(c: Float64s, rays: Float64s) -> Float64s:
    """Coefficient: omega, with r_d = atan(2 r_u tan(omega / 2)) / omega; at omega = 0 this is a pinhole."""
    r = np.hypot(rays[:, 0], rays[:, 1])
    if c[0]:
        distorted = np.arctan2(2 * r * np.tan(c[0] / 2), rays[:, 2]) / c[0]
        slope = 2 * np.tan(c[0] / 2) / c[0]  # on the axis
    else:
        distorted = r / rays[:, 2]
        slope = 1.0
    stretch = np.where(r > 1e-12, distorted / r, slope)
    return np.asarray(rays[:, :2] * stretch[:, None], dtype=np.float64)


def _eucm(c: Float64s, rays: Float64s) -> Float64s:
    """Coefficients: alpha, beta."""
    alpha, beta = c[:2]
    z = rays[:, 2]
    distance = np.sqrt(beta * (rays[:, :2] ** 2).sum(axis=1) + z**2)
    divisor = alpha * distance + (1 - alpha) * z
    # rays beyond the cone of w are not seen, or share their pixel with others (Khomutenko 2016)
    w = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    is_seen = (divisor > 0) & (z > -w * distance)
    return np.asarray(rays[:, :2] / np.where(is_seen, divisor, np.nan)[:, None], dtype=np.float64)


def _omni(c: Float64s, rays: Float64s) -> Float64s:
    """Coefficients: xi, then k1 k2 p1 p2 k3 of the distortion that follows the projection by way of the unit sphere."""
    divisor = rays[:, 2] + c[0]
    sphere = np.column_stack([rays[:, :2], np.where(divisor > 0, divisor, np.nan)])
    return _brown(np.concatenate([c[1:6], np.zeros(9)]), sphere)


def _double_sphere(c: Float64s, rays: Float64s) -> Float64s:
    """Coefficients: xi, alpha."""
    xi, alpha = c[:2]
    z = xi + rays[:, 2]
    d2 = np.sqrt((rays[:, :2] ** 2).sum(axis=1) + z * z)
    divisor = alpha * d2 + (1 - alpha) * z
    # the cone of rays that are seen (Usenko 2018)
    w1 = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
    w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)
    is_seen = (divisor > 0) & (rays[:, 2] > -w2)
    return np.asarray(rays[:, :2] / np.where(is_seen, divisor, np.nan)[:, None], dtype=np.float64)


def _equirectangular(_: Float64s, rays: Float64s) -> Float64s:
    """Longitude and latitude, radians; y points down."""
    longitude = np.arctan2(rays[:, 0], rays[:, 2])
    latitude = np.arctan2(rays[:, 1], np.hypot(rays[:, 0], rays[:, 2]))
    return np.column_stack([longitude, latitude])


PROJECTIONS: Mapping[str, Projection] = {
    LensModel.PINHOLE: Projection(_pinhole, np.deg2rad(89.5)),
    LensModel.BROWN: Projection(_brown, np.deg2rad(89.5)),
    LensModel.RATIONAL: Projection(_brown, np.deg2rad(89.5)),
    LensModel.FISHEYE: Projection(_fisheye),
    LensModel.DIVISION: Projection(_division),
    LensModel.FOV: Projection(_fov),
    LensModel.EUCM: Projection(_eucm),
    LensModel.OMNI: Projection(_omni),
    LensModel.DOUBLE_SPHERE: Projection(_double_sphere),
    LensModel.THIN_PRISM_FISHEYE: Projection(_thin_prism_fisheye),
    LensModel.RAD_TAN_THIN_PRISM_FISHEYE: Projection(_rad_tan_thin_prism_fisheye),
    LensModel.EQUIRECTANGULAR: Projection(_equirectangular),
}
"""The projection of each lens model; the order of coefficients is OpenCV's where OpenCV has the model."""
