"""Polar rectification (Pollefeys, Koch & Van Gool, ICCV 1999): half epipolar lines become rows, x is the distance to the epipole.

It works wherever the epipoles lie, inside the images too.  It needs F and the side of the epipole on which the matches lie, which
follows from the matches themselves.
"""

from __future__ import annotations

import numpy as np

from ..core.epipolar import epipoles, homogeneous
from ..types import Float64s, PolarRows
from .method import MatchedPair, PolarImages
from .placement import MARGIN_OF_WIDTH, MARGIN_SHARE, Size, frame_grid
from .quality import order_agreement

_MOST_DIAGONALS = 1e6
"""Farther epipoles are moved to this many image diagonals: their lines then differ from parallels by less than 1e-4 px."""
_SAMPLES_PER_PIXEL = 2
"""Directions sampled to lay out the rows, for each pixel of the frame's border: more of them would change only the first and the
last row of some pairs."""


def polar(pair: MatchedPair) -> PolarImages:
    """Half epipolar lines as rows.

    For a right F, the share of matches on one common side is 1: every match lies on the half line that corresponds to the half
    line in the other image.
    """
    F = pair.F
    size1 = pair.size1
    size2 = pair.size2
    x1, x2 = pair.shown()
    epipole1, epipole2 = epipoles(F)
    e1 = _finite(epipole1, size1)
    e2 = _finite(epipole2, size2)
    offset1 = x1 - e1
    offset2 = x2 - e2
    radius1 = np.hypot(*offset1.T)
    radius2 = np.hypot(*offset2.T)

    # 1. the side of the second epipole on which the matches lie
    lines = homogeneous(x1) @ F.T  # all have the sign of F, so that correct matches agree in `forward`
    line_direction = np.column_stack([lines[:, 1], -lines[:, 0]]) / np.hypot(lines[:, 0], lines[:, 1])[:, None]
    forward = np.sum(line_direction * offset2, axis=1) > 0
    side = 1.0 if forward.mean() >= 0.5 else -1.0
    agreement = float(np.mean(forward == (side > 0)))

    # 2. directions around the first epipole, from the middle of the widest gap on, so that the matches are not cut apart
    direction = np.arctan2(offset1[:, 1], offset1[:, 0])
    cut = _largest_gap(direction)
    angle = (direction - cut) % (2 * np.pi)
    pad = MARGIN_OF_WIDTH * max(size1[0], size2[0]) / float(np.median(radius1)) + MARGIN_SHARE * float(np.ptp(angle))
    first = max(angle.min() - pad, 0.0)
    last = min(angle.max() + pad, 2 * np.pi)
    theta = cut + np.linspace(first, last, _SAMPLES_PER_PIXEL * 2 * sum(size1))

    # 3. the rows
    radii1 = _radius_range(radius1, e1, size1)
    radii2 = _radius_range(radius2, e2, size2)
    angles1, angles2 = _rows(F, e1, e2, side, theta, size1, size2, radii1[1], radii2[1])

    # 4. x grows outwards or inwards, so that the images stay upright
    direction1 = 1 if float(np.median(offset1[:, 0])) >= 0 else -1
    opposed = order_agreement(np.column_stack([radius1, angle]), np.column_stack([radius2, angle])) < 0
    direction2 = -direction1 if opposed else direction1
    if direction1 < 0:  # keep the image's handedness: leftward rays go with descending angles
        angles1 = angles1[::-1]
        angles2 = angles2[::-1]
    rows1, width1 = _polar_rows(e1, angles1, direction1, radii1)
    rows2, width2 = _polar_rows(e2, angles2, direction2, radii2)
    return PolarImages(rows1, rows2, (width1, len(angles1)), (width2, len(angles2)), agreement)


def _finite(epipole: Float64s, size: Size) -> Float64s:
    """(2,) pixel of a homogeneous epipole (3,); one that is too far away is moved nearer, along its direction from the centre."""
    centre = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    offset = epipole[:2] - epipole[2] * centre
    limit = _MOST_DIAGONALS * float(np.hypot(*size))
    if np.hypot(*offset) > limit * abs(epipole[2]):
        return np.asarray(centre + limit * offset / np.hypot(*offset), dtype=np.float64)
    return np.asarray(epipole[:2] / epipole[2], dtype=np.float64)


def _angle_in_image2(F: Float64s, e1: Float64s, e2: Float64s, side: float, theta: Float64s, size1: Size, size2: Size) -> Float64s:
    """Angles (n,) at e2 of the half lines that correspond to the directions theta (n,) at e1, unwrapped."""
    centre1_x = (size1[0] - 1) / 2
    centre1_y = (size1[1] - 1) / 2
    centre2_x = (size2[0] - 1) / 2
    centre2_y = (size2[1] - 1) / 2
    # points on the half lines of image 1, as far from the epipole as the image, and their lines a x + b y + c = 0 in image 2
    distance = max(float(np.hypot(centre1_x - e1[0], centre1_y - e1[1])), float(np.hypot(*size1)))
    points = e1[:, None] + distance * np.stack([np.cos(theta), np.sin(theta)])
    a, b, c = F[:, :2] @ points + F[:, 2:]
    # phi is the direction of a point on each line: from the foot of the centre on it, two diagonals along the line
    norm = np.sqrt(a * a + b * b)
    foot = (a * centre2_x + b * centre2_y + c) / (norm * norm)
    step = side * 2 * np.hypot(*size2) / norm
    phi = np.arctan2(centre2_y - foot * b - step * a - e2[1], centre2_x - foot * a + step * b - e2[0])
    phi[1:] -= 2 * np.pi * np.cumsum(np.round(np.diff(phi) / (2 * np.pi)))
    return np.asarray(phi, dtype=np.float64)


def _rows(
    F: Float64s, e1: Float64s, e2: Float64s, side: float, theta: Float64s, size1: Size, size2: Size, far1: float, far2: float
) -> tuple[Float64s, Float64s]:
    """Angles (rows,) at both epipoles, at most one pixel of arc apart at the far end of either ray."""
    phi = _angle_in_image2(F, e1, e2, side, theta, size1, size2)
    end1 = _ray_end(e1, theta, size1)
    end2 = _ray_end(e2, phi, size2)
    # pixels of arc for each radian of theta, at the far end of either ray
    arc1 = np.minimum(end1, far1)
    arc2 = np.minimum(end2, far2) * np.abs(np.gradient(phi, theta))
    arc = np.fmax(arc1, arc2)
    arc = np.where((end1 > 0) & (end2 > 0), arc, 0.0)  # directions that one image doesn't see get no rows
    # fractional row of each direction: the integral of the arc, by the trapezoidal rule
    row = np.concatenate([[0.0], np.cumsum(0.5 * (arc[1:] + arc[:-1]) * np.diff(theta))])
    shown = np.flatnonzero(arc > 0)
    if len(shown) < 2:
        return theta[:2], phi[:2]
    whole_rows = np.arange(np.ceil(row[shown[0]]), np.floor(row[shown[-1]]) + 1)
    angles1 = np.interp(whole_rows, row[shown], theta[shown])
    return angles1, _angle_in_image2(F, e1, e2, side, angles1, size1, size2)


def _ray_end(epipole: Float64s, angle: Float64s, size: Size) -> Float64s:
    """Distance (n,) from the epipole at which each ray leaves the frame; 0 for rays that miss it."""
    enter = np.zeros(len(angle))
    leave = np.full(len(angle), np.inf)
    # rays parallel to a border give inf, or nan on it, which fmin and fmax ignore
    with np.errstate(divide="ignore", invalid="ignore"):
        for k, component in enumerate((np.cos(angle), np.sin(angle))):
            low = (-0.5 - epipole[k]) / component
            high = (size[k] - 0.5 - epipole[k]) / component
            enter = np.fmax(enter, np.fmin(low, high))
            leave = np.fmin(leave, np.fmax(low, high))
    return np.where(leave > enter, leave, 0.0)


def _radius_range(radius: Float64s, epipole: Float64s, size: Size) -> tuple[float, float]:
    """Nearest and farthest distance from the epipole that the rectified image shows."""
    margin = MARGIN_SHARE * float(np.ptp(radius)) + MARGIN_OF_WIDTH * size[0]
    offsets = frame_grid(size) - epipole
    farthest_in_frame = float(np.hypot(*offsets.T).max())
    nearest = max(float(radius.min()) - margin, 0.0)
    farthest = min(float(radius.max()) + margin, farthest_in_frame)
    return nearest, farthest


def _polar_rows(epipole: Float64s, angles: Float64s, direction: int, radii: tuple[float, float]) -> tuple[PolarRows, int]:
    """The rows of one image between two radii (nearest, farthest), and its width, pixels."""
    nearest, farthest = radii
    start = np.floor(nearest) if direction > 0 else np.floor(-farthest)
    width = int(np.ceil(farthest - nearest)) + 1
    return PolarRows(epipole, np.ascontiguousarray(angles), direction, float(start)), width


def _largest_gap(angles: Float64s) -> float:
    """The middle of the widest gap on the circle between angles (n,)."""
    ordered = np.sort(angles)
    gaps = np.diff(np.r_[ordered, ordered[0] + 2 * np.pi])  # the last one closes the circle
    k = int(np.argmax(gaps))
    return float(ordered[k] + gaps[k] / 2)
