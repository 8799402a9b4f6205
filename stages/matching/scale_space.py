"""Blobs of all sizes in a grey image: extrema of differences of Gaussians (Lowe, IJCV 2004).

The image is doubled first, since blobs of a pixel's size cannot be located on a grid of whole pixels.  Each extremum is located
by Newton steps on differences interpolated around the current estimate (cubic convolution; Keys, 1981), not by moving from pixel
to pixel.  Directions and descriptors are computed elsewhere, since most blobs are never described.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import ceil
from typing import Self

import cv2
import numpy as np

from ..core.jit import helper, kernel
from ..types import Bools, Float32s, Float64s, Int32s, Int64s, Uint8s, Uint64s

LEVELS = 3
"""Scales per octave (Lowe, section 3.2: more find more blobs, which are found again less often)."""
FINEST_SIGMA = 1.6
"""Blur of the finest level, as sigma in pixels of the doubled photograph."""
CAMERA_SIGMA = 1.0
"""Blur that the doubled photograph is assumed to have, as sigma in its pixels."""
REACH = 3.5
"""Radius of a smoothing kernel, in standard deviations."""
LEAST_SIDE = 12
"""Smallest side of an octave's image, pixels; octaves below it are not built."""
BORDER = 4
"""Pixels of an octave's border without extrema: room for the cube around an estimate that has moved by `FAR_PX`, and its taps."""
MOST_CURVED = 10.0
"""Largest ratio of a blob's principal curvatures (Lowe, section 4.1); extrema above it are edges."""
STEPS = 5
"""Most Newton steps; extrema that have not settled by then are dropped."""
NEAR = 0.6
"""Newton's iteration ends at a step of at most this, in pixels and levels: above a half, so that it does not jump to and fro
between two levels."""
FAR_PX = 1.5
"""Distance from its start at which an iteration is given up, pixels of the octave: another extremum starts there."""
WHITE = 255.0
"""The grey range."""
_PIXELS_PER_EXTREMUM = 64
"""Memory for extrema is allocated first for one in this many pixels."""


@dataclass(frozen=True)
class Blobs:
    """Extrema of one image, (n,) each."""

    x: Float64s
    y: Float64s
    """Pixels of the image."""
    sigma: Float64s
    """Standard deviation of the Gaussian at which it is strongest, pixels."""
    response: Float64s
    """Absolute difference of Gaussians there, as a share of the grey range."""
    octave: Int32s
    level: Int32s
    """Nearest octave and level of the pyramid."""

    def at(self, rows: Int64s | Bools) -> Self:
        """The blobs of some rows."""
        return replace(self, **{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def lower_by(self, rows: int) -> Self:
        """The same blobs in an image that begins `rows` rows higher."""
        return replace(self, y=self.y + rows)

    @classmethod
    def joined(cls, parts: Sequence[Blobs]) -> Self:
        """The blobs of several parts in one."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


Pyramid = Sequence[Float32s]
"""For each octave its levels, (LEVELS + 3, h, w); the first octave is doubled."""


def pyramid(grey: Uint8s) -> Pyramid:
    """Levels of increasing blur, in octaves; each has half the width and height of the one before.

    grey: (h, w) uint8.
    """
    # blurs add up as squares: the blur that leads from each level to the next one
    step = 2 ** (1 / LEVELS)
    level_sigmas = [FINEST_SIGMA * step**i * (step**2 - 1) ** 0.5 for i in range(LEVELS + 2)]
    doubled = cv2.resize(grey.astype(np.float32), (2 * grey.shape[1], 2 * grey.shape[0]), interpolation=cv2.INTER_LINEAR)
    image = _smoothed(np.asarray(doubled, np.float32), (FINEST_SIGMA**2 - CAMERA_SIGMA**2) ** 0.5)
    octaves: list[Float32s] = []
    while True:
        levels = np.empty((LEVELS + 3, *image.shape), np.float32)
        levels[0] = image
        for i, sigma in enumerate(level_sigmas):
            _smoothed(levels[i], sigma, levels[i + 1])
        octaves.append(levels)
        if min(image.shape) < 2 * LEAST_SIDE:
            return octaves
        # this level has twice the blur of the first one; every second pixel of it has the same blur again, in its own pixels
        image = levels[LEVELS, ::2, ::2]


def _smoothed(image: Float32s, sigma: float, out: Float32s | None = None) -> Float32s:
    size = 2 * ceil(REACH * sigma) + 1
    return np.asarray(cv2.GaussianBlur(image, (size, size), sigma, dst=out), np.float32)


def in_octave(octave: int, blobs: Blobs) -> Float64s:
    """(n, 3) x, y and sigma in pixels of an octave."""
    # octave 0 is doubled: the centre of pixel 0 of the photograph is 0.5 there.  The later ones drop every second pixel, so that
    # pixel 0 keeps its place
    zoom = 2.0 ** (octave - 1)
    return np.column_stack([(blobs.x + 0.25) / zoom, (blobs.y + 0.25) / zoom, blobs.sigma / zoom])


def find_blobs(octaves: Pyramid, contrast: float) -> Blobs:
    """Extrema of the differences of neighbouring levels, of at least this contrast (as OpenCV defines it: a share of the grey
    range, divided by LEVELS)."""
    parts = []
    threshold = contrast * WHITE / LEVELS
    for octave, levels in enumerate(octaves):
        # an extremum between the points of the grid is lower on the grid
        start = _grid_extrema(levels, 0.75 * threshold)
        x, y, scale, value = _refined(start, levels, threshold).T
        zoom = 2.0 ** (octave - 1)
        sigma = zoom * FINEST_SIGMA * 2 ** (scale / LEVELS)
        level = np.clip(np.rint(scale), 1, LEVELS).astype(np.int32)
        octave_index = np.full(len(x), octave, np.int32)
        parts.append(Blobs(zoom * x - 0.25, zoom * y - 0.25, sigma, value / WHITE, octave_index, level))
    return Blobs.joined(parts)


def _grid_extrema(levels: Float32s, threshold: float) -> Int64s:
    """(n, 3) x, y, level of the extrema on the grid."""
    count, _, w = levels.shape
    out = np.empty((len(levels[0]) * w // _PIXELS_PER_EXTREMUM + 64, 3), np.int64)
    differences = np.empty((3, count - 1, w), np.float32)
    marks = np.zeros((w + 7) // 8, np.uint64)
    while True:
        n = _extrema(levels, threshold, differences, marks, marks.view(np.uint8), out)
        if n <= len(out):
            return out[:n]
        # more than there was room for: now their number is known
        out = np.empty((n, 3), np.int64)


@kernel
def _extrema(levels: Float32s, threshold: float, differences: Float32s, marks: Uint64s, mark_bytes: Uint8s, out: Int64s) -> int:
    """Write x, y, level of the extrema of at least `threshold` in absolute value, among neighbours in position and scale, while
    they fit, and return how many there are.

    `differences` keeps only three rows for each scale: all would take as much memory as the pyramid.  marks, mark_bytes: the same
    memory as groups of eight and as single bytes.
    """
    count, h, w = levels.shape
    limit = np.float32(threshold)
    n = 0
    for next_y in range(BORDER - 1, h - BORDER + 1):
        # the row below the one that is searched replaces the oldest of the three
        for s in range(count - 1):
            _subtract(levels[s + 1, next_y], levels[s, next_y], differences[next_y % 3, s])
        y = next_y - 1
        if y < BORDER:
            continue
        row = differences[y % 3]
        above = differences[(y - 1) % 3]
        below = differences[next_y % 3]
        for s in range(1, count - 2):
            _mark(row[s], above[s], below[s], row[s - 1], row[s + 1], limit, mark_bytes)
            # marks are rare: eight pixels are passed over at once
            for group in range(len(marks)):
                if marks[group] == 0:
                    continue
                for x in range(max(8 * group, BORDER), min(8 * group + 8, w - BORDER)):
                    if mark_bytes[x] == 0 or not _is_extremum(differences, row[s, x], s, x):
                        continue
                    if n < len(out):
                        out[n, 0] = x
                        out[n, 1] = y
                        out[n, 2] = s
                    n += 1
    return n


@helper
def _subtract(coarser: Float32s, finer: Float32s, out: Float32s) -> None:
    for x in range(len(out)):
        out[x] = coarser[x] - finer[x]


@helper
def _mark(
    row: Float32s, above: Float32s, below: Float32s, finer: Float32s, coarser: Float32s, threshold: np.float32, marks: Uint8s
) -> None:
    """Mark what may be an extremum, by its nearest neighbours in position and scale.

    Without branches and with unsigned indices (no wrapping of negative ones), so that the loop is vectorised.
    """
    for k in range(len(row) - 2):
        x = np.uint64(k + 1)
        v = row[x]
        left = row[np.uint64(k)]
        right = row[np.uint64(k + 2)]
        largest = max(max(max(left, right), max(above[x], below[x])), max(finer[x], coarser[x]))
        smallest = min(min(min(left, right), min(above[x], below[x])), min(finer[x], coarser[x]))
        marks[x] = np.uint8((v >= max(largest, threshold)) | (v <= min(smallest, -threshold)))


@helper
def _is_extremum(differences: Float32s, v: np.float32, s: int, x: int) -> bool:
    """Is v, in the middle of the three rows, an extremum among all 26 neighbours?"""
    sign = np.float32(1.0) if v > 0 else np.float32(-1.0)
    v = sign * v
    for j in range(3):
        for i in range(s - 1, s + 2):
            for k in range(x - 1, x + 2):
                if sign * differences[j, i, k] > v:
                    return False
    return True


@helper
def _cubic(t: float, taps: Float64s) -> None:
    """Weights of the four samples around a position `t` after the second (Keys' cubic convolution, a = -1/2)."""
    taps[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    taps[1] = (1.5 * t - 2.5) * t * t + 1.0
    taps[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    taps[3] = (0.5 * t - 0.5) * t * t


@helper
def _interpolate_cube(levels: Float32s, s: int, x: float, y: float, taps: Float64s, rows: Float64s, cube: Float64s) -> None:
    """Interpolate differences at x, y and one pixel around, in the scales around s: cube (3, 3, 3), by s, y, x.

    All samples of the cube have the same place between their pixels, and hence the same taps.  taps (2, 4), rows (3, 6): scratch.
    """
    left = int(np.floor(x)) - 2
    top = int(np.floor(y)) - 2
    x_taps = taps[0]
    y_taps = taps[1]
    _cubic(x - np.floor(x), x_taps)
    _cubic(y - np.floor(y), y_taps)
    for scale in range(3):
        # along x: three samples in each of the six rows that the taps along y need
        for r in range(6):
            coarser = levels[s + scale, top + r]
            finer = levels[s + scale - 1, top + r]
            for a in range(3):
                first = left + a
                v = x_taps[0] * (coarser[first] - finer[first]) + x_taps[1] * (coarser[first + 1] - finer[first + 1])
                v += x_taps[2] * (coarser[first + 2] - finer[first + 2]) + x_taps[3] * (coarser[first + 3] - finer[first + 3])
                rows[a, r] = v
        # along y
        for b in range(3):
            for a in range(3):
                v = y_taps[0] * rows[a, b] + y_taps[1] * rows[a, b + 1] + y_taps[2] * rows[a, b + 2] + y_taps[3] * rows[a, b + 3]
                cube[scale, b, a] = v


@helper
def _newton(c: Float64s, step: Float64s) -> bool:
    """Write the step (x, y, s) from the middle of the cube to the extremum; step[3]: the value there.  False if there is no
    extremum, or it is an edge."""
    # gradient and Hessian by central differences
    v = c[1, 1, 1]
    gx = 0.5 * (c[1, 1, 2] - c[1, 1, 0])
    gy = 0.5 * (c[1, 2, 1] - c[1, 0, 1])
    gs = 0.5 * (c[2, 1, 1] - c[0, 1, 1])
    xx = c[1, 1, 2] + c[1, 1, 0] - 2 * v
    yy = c[1, 2, 1] + c[1, 0, 1] - 2 * v
    ss = c[2, 1, 1] + c[0, 1, 1] - 2 * v
    xy = 0.25 * (c[1, 2, 2] - c[1, 2, 0] - c[1, 0, 2] + c[1, 0, 0])
    xs = 0.25 * (c[2, 1, 2] - c[2, 1, 0] - c[0, 1, 2] + c[0, 1, 0])
    ys = 0.25 * (c[2, 2, 1] - c[2, 0, 1] - c[0, 2, 1] + c[0, 0, 1])
    # step = -H^-1 g, with the inverse by cofactors; a, b, e: those of its first row
    det_xy = xx * yy - xy * xy
    a = yy * ss - ys * ys
    b = ys * xs - xy * ss
    e = xy * ys - yy * xs
    det = xx * a + xy * b + xs * e
    if abs(det) < 1e-12:
        step[0] = step[1] = step[2] = step[3] = np.inf
        return False
    step[0] = -(a * gx + b * gy + e * gs) / det
    step[1] = -(b * gx + (xx * ss - xs * xs) * gy + (xy * xs - xx * ys) * gs) / det
    step[2] = -(e * gx + (xy * xs - xx * ys) * gy + det_xy * gs) / det
    step[3] = v + 0.5 * (gx * step[0] + gy * step[1] + gs * step[2])
    # the ratio r of the curvatures: trace^2 / det = (r + 1)^2 / r, which grows with r (Lowe, section 4.1)
    return bool(det_xy > 0 and (xx + yy) ** 2 * MOST_CURVED < (MOST_CURVED + 1) ** 2 * det_xy)


def _refined(start: Int64s, levels: Float32s, threshold: float) -> Float64s:
    """(n, 4) x, y, scale in levels, and absolute value of the extrema that Newton steps reach near their start."""
    out = np.empty((len(start), 4))
    return out[: _refine(start, levels, threshold, out)]


@kernel
def _refine(start: Int64s, levels: Float32s, threshold: float, out: Float64s) -> int:
    """Write the rows of `_refined`, and return their number."""
    taps = np.empty((2, 4))
    rows = np.empty((3, 6))
    cube = np.empty((3, 3, 3))
    step = np.empty(4)
    count = len(levels) - 1
    n = 0
    for k in range(len(start)):
        x0 = float(start[k, 0])
        y0 = float(start[k, 1])
        x = x0
        y = y0
        s = start[k, 2]
        for _ in range(STEPS):
            _interpolate_cube(levels, s, x, y, taps, rows, cube)
            is_blob = _newton(cube, step)
            moved = max(abs(step[0]), abs(step[1]))
            if not moved < 4.0:  # nan too: there is no extremum near
                break
            if moved <= NEAR and abs(step[2]) <= NEAR:
                if is_blob and abs(step[3]) >= threshold:
                    out[n, 0] = x + step[0]
                    out[n, 1] = y + step[1]
                    out[n, 2] = s + step[2]
                    out[n, 3] = abs(step[3])
                    n += 1
                break
            # positions move by up to a pixel, but scales only from level to level: between levels nothing is interpolated
            x += min(max(step[0], -1.0), 1.0)
            y += min(max(step[1], -1.0), 1.0)
            if step[2] > NEAR:
                s += 1
            elif step[2] < -NEAR:
                s -= 1
            if s < 1 or s > count - 2 or max(abs(x - x0), abs(y - y0)) > FAR_PX:
                break
    return n
