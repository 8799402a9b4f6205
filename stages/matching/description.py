"""Description of a keypoint's surroundings: its main direction, and SIFT's histograms of gradients (Lowe, IJCV 2004).

Histograms are made from a small patch, resampled in the keypoint's own scale and direction: the share of each sample in each
histogram is then known beforehand, and a large keypoint has as many samples as a small one.
"""

from __future__ import annotations

import numpy as np

from ..core.jit import helper, kernel
from ..types import Float32s, Float64s, Int32s, Int64s
from .scale_space import Blobs, Pyramid, in_octave

BINS = 36
"""Bins of the histogram of directions."""
WINDOW = 1.5
"""Sigma of the Gaussian weight in the histogram of directions, in sigmas of the keypoint (Lowe, section 5)."""
REACH = 3.0
"""Half width of the window of that weight, in its own sigmas: what lies beyond weighs less than 1.2 %."""
STRONG_SHARE = 0.8
"""Peaks of at least this share of the strongest one are main directions, too (Lowe, section 5)."""
CELLS = 4
"""Histograms along each side of the patch."""
DIRECTIONS = 8
"""Directions in each histogram."""
CELL_SIGMAS = 3.0
"""Width of a histogram's cell in sigmas of the keypoint.  Wider cells forgive more distortion, and tell less apart."""
SAMPLES = 20
"""Samples along each side of the patch, which reaches half a cell beyond the histograms."""
LENGTH = CELLS * CELLS * DIRECTIONS
"""Elements of a descriptor."""
CLIP = 0.2
"""Upper limit of an element of a descriptor of unit length, so that no single edge decides (Lowe, section 6.1)."""
_LONGEST_ROW = 64
"""Room for the gradients of one row of the window, pixels.  Rows have at most 34: 9 sigmas, of at most 3.7 px in an octave."""


def main_directions(octaves: Pyramid, blobs: Blobs, seam: float) -> Float64s:
    """(n,) main direction of each blob, radians from x to y: the first one from the angle `seam` on."""
    angle = np.empty(len(blobs.x))
    for octave, levels in enumerate(octaves):
        rows = np.flatnonzero(blobs.octave == octave)
        directions = np.empty(len(rows))
        _directions(levels, blobs.level[rows], in_octave(octave, blobs.at(rows)), seam, directions)
        angle[rows] = directions
    return angle


def describe(octaves: Pyramid, blobs: Blobs, angle: Float64s) -> Float32s:
    """(n, 128) descriptors of unit length, of blobs with main directions `angle`."""
    out = np.empty((len(blobs.x), LENGTH), np.float32)
    weight, first, share = _sample_weights()
    for octave, levels in enumerate(octaves):
        rows = np.flatnonzero(blobs.octave == octave)
        descriptors = np.empty((len(rows), out.shape[1]), np.float32)
        points = np.column_stack([in_octave(octave, blobs.at(rows)), angle[rows]])
        _histograms(levels, blobs.level[rows], points, weight, first, share, descriptors)
        out[rows] = descriptors
    return out


def _sample_weights() -> tuple[Float32s, Int64s, Float32s]:
    """For each sample along a side: Gaussian weight, the first of the two cells that it contributes to (0: before the patch), and
    the share of the second."""
    # samples in units of cells from the patch's middle; the patch is CELLS + 1 cells wide
    position = (np.arange(SAMPLES) + 0.5) * (CELLS + 1) / SAMPLES - 0.5 * (CELLS + 1)
    # the two cells whose centres lie on both sides of a sample; cell 0 is the margin before the patch
    cell = position + 0.5 * CELLS + 0.5
    first = np.floor(cell).astype(np.int64)
    share = (cell - first).astype(np.float32)
    weight = np.exp(-0.5 * (position / (0.5 * CELLS)) ** 2).astype(np.float32)
    return weight, first, share


@helper
def _gradient_directions(gx: Float32s, gy: Float32s, direction: Float32s, magnitude: Float32s, factor: float) -> None:
    """Write the direction of each gradient, 0 to 2 pi, times `factor`, and its magnitude."""
    for k in range(len(gx)):
        x = gx[k]
        y = gy[k]
        # the angle within an eighth of a turn, from a ratio of at most 1 (0 for a gradient of 0)
        ax = abs(x)
        ay = abs(y)
        low = min(ax, ay)
        high = max(ax, ay)
        r = low / max(high, np.float32(1e-12))
        q = r * r
        # arctangent as odd powers, fitted by least squares: wrong by 0.0002 rad at most
        t = r * (np.float32(0.999215) + q * (np.float32(-0.3211819) + q * (np.float32(0.1462766) - q * np.float32(0.0389929))))
        # unfolded: to a quarter (pi / 2 - t), to a half (pi - t), and to the whole turn (2 pi - t)
        t = np.float32(1.5707964) - t if ay > ax else t
        t = np.float32(3.1415927) - t if x < 0 else t
        t = np.float32(6.2831853) - t if y < 0 else t
        direction[k] = t * np.float32(factor)
        magnitude[k] = np.sqrt(x * x + y * y)


@kernel
def _directions(levels: Float32s, level: Int32s, points: Float64s, seam: float, out: Float64s) -> None:
    """Write the first main direction of each blob; points: (n, 3) x, y and sigma in pixels of the octave."""
    _, h, w = levels.shape
    gradients = np.empty((4, _LONGEST_ROW), np.float32)
    column_weight = np.empty(_LONGEST_ROW, np.float32)
    histogram = np.empty(BINS)
    smooth = np.empty(BINS)
    for n in range(len(points)):
        # 1. the window, cut one pixel inside the image, where central differences end
        image = levels[level[n]]
        x = points[n, 0]
        y = points[n, 1]
        window = WINDOW * points[n, 2]
        left = max(int(np.ceil(x - REACH * window)), 1)
        right = min(int(np.floor(x + REACH * window)), w - 2)
        top = max(int(np.ceil(y - REACH * window)), 1)
        bottom = min(int(np.floor(y + REACH * window)), h - 2)
        count = max(min(right - left + 1, _LONGEST_ROW), 0)
        gx = gradients[0, :count]
        gy = gradients[1, :count]
        direction = gradients[2, :count]
        magnitude = gradients[3, :count]

        # 2. the histogram; the Gaussian is the product of one weight for the row and one for the column
        falloff = -0.5 / window**2
        for k in range(count):
            column_weight[k] = np.exp(falloff * (left + k - x) ** 2)
        histogram[:] = 0.0
        for row in range(top, bottom + 1):
            for k in range(count):
                gx[k] = image[row, left + k + 1] - image[row, left + k - 1]
                gy[k] = image[row + 1, left + k] - image[row - 1, left + k]
            _gradient_directions(gx, gy, direction, magnitude, BINS / (2 * np.pi))
            row_weight = np.exp(falloff * (row - y) ** 2)
            for k in range(count):
                # nearest bin: bin b is centred on angle b, and the last half bin belongs to bin 0
                b = int(direction[k] + np.float32(0.5))
                histogram[b - BINS if b >= BINS else b] += row_weight * column_weight[k] * magnitude[k]

        # 3. smoothed around the circle by the binomial 1 4 6 4 1; negative indices count from the end
        for b in range(BINS):
            outer = histogram[b - 2] + histogram[(b + 2) % BINS]
            inner = histogram[b - 1] + histogram[(b + 1) % BINS]
            smooth[b] = (outer + 4 * inner + 6 * histogram[b]) / 16
        out[n] = _first_peak(smooth, seam)


@helper
def _first_peak(smooth: Float64s, seam: float) -> float:
    """Angle of the first strong peak from the seam on, interpolated between bins by a parabola."""
    least_offset = 7.0  # more than a turn
    peak = seam
    threshold = STRONG_SHARE * smooth.max()
    for b in range(BINS):
        v = smooth[b]
        left = smooth[b - 1]
        right = smooth[(b + 1) % BINS]
        if v > left and v > right and v >= threshold:
            angle = (b + 0.5 * (left - right) / (left - 2 * v + right)) * (2 * np.pi / BINS)
            offset = (angle - seam) % (2 * np.pi)
            if offset < least_offset:
                least_offset = offset
                peak = angle
    return peak


@kernel
def _histograms(
    levels: Float32s, level: Int32s, points: Float64s, weight: Float32s, first: Int64s, share: Float32s, out: Float32s
) -> None:
    """Write the descriptors; points: (n, 4) x, y, sigma (octave pixels), direction; weight, first, share: `_sample_weights`."""
    patch = np.empty((SAMPLES + 2, SAMPLES + 2), np.float32)
    gx, gy, direction, magnitude = np.empty((4, SAMPLES), np.float32)
    # a margin of one cell on all sides, and of one direction, takes what lies outside, so that no sample is a special case
    row_sums = np.empty((CELLS + 2, DIRECTIONS + 1), np.float32)
    sums = np.empty((CELLS + 2, CELLS + 2, DIRECTIONS + 1), np.float32)
    for n in range(len(points)):
        # 1. the patch, upright in the keypoint's own direction, with a margin of one sample for the differences
        x = points[n, 0]
        y = points[n, 1]
        spacing = points[n, 2] * CELL_SIGMAS * (CELLS + 1) / SAMPLES
        angle = points[n, 3]
        _sample(levels[level[n]], x, y, spacing * np.cos(angle), spacing * np.sin(angle), patch)

        # 2. histograms, row by row: each row is shared between the cells above and below it
        sums[:] = 0
        for r in range(SAMPLES):
            for k in range(SAMPLES):
                gx[k] = patch[r + 1, k + 2] - patch[r + 1, k]
                gy[k] = patch[r + 2, k + 1] - patch[r, k + 1]
            _gradient_directions(gx, gy, direction, magnitude, DIRECTIONS / (2 * np.pi))
            _add_row(direction, magnitude, weight, first, share, row_sums)
            below = weight[r] * share[r]
            above = weight[r] - below
            c = first[r]
            for i in range(CELLS + 2):
                for o in range(DIRECTIONS + 1):
                    sums[c, i, o] += above * row_sums[i, o]
                    sums[c + 1, i, o] += below * row_sums[i, o]

        # 3. the vector
        _write_descriptor(sums, out[n])


@helper
def _add_row(direction: Float32s, magnitude: Float32s, weight: Float32s, first: Int64s, share: Float32s, sums: Float32s) -> None:
    """Histograms (CELLS + 2, DIRECTIONS + 1) of one row's gradients, each shared between two cells and two directions."""
    sums[:] = 0
    for k in range(SAMPLES):
        # rounding can carry an angle just below a whole turn to it
        o = min(int(direction[k]), DIRECTIONS - 1)
        fraction = direction[k] - np.float32(o)
        # between two cells ...
        value = magnitude[k] * weight[k]
        second = value * share[k]
        value -= second
        # ... and in each between two directions
        next_value = value * fraction
        next_second = second * fraction
        c = first[k]
        sums[c, o] += value - next_value
        sums[c, o + 1] += next_value
        sums[c + 1, o] += second - next_second
        sums[c + 1, o + 1] += next_second


@kernel
def _write_descriptor(sums: Float32s, out: Float32s) -> None:
    """Write the inner cells as a vector: scaled to unit length, clipped, and scaled again."""
    k = 0
    for i in range(1, CELLS + 1):
        for j in range(1, CELLS + 1):
            for o in range(DIRECTIONS):
                # the direction after the last one is the first again
                out[k] = sums[i, j, o] + (sums[i, j, DIRECTIONS] if o == 0 else np.float32(0))
                k += 1
    for pass_number in range(2):
        length = np.float32(0)
        for k in range(len(out)):
            length += out[k] * out[k]
        length = np.float32(1) / max(np.sqrt(length), np.float32(1e-12))
        for k in range(len(out)):
            out[k] *= length
            if pass_number == 0:
                out[k] = min(out[k], np.float32(CLIP))


@helper
def _sample(image: Float32s, x: float, y: float, c: float, s: float, patch: Float32s) -> None:
    """Write the patch around x, y by bilinear interpolation, in steps of (c, s) along a row; the image's edge is repeated."""
    h, w = image.shape
    side = len(patch)
    half = 0.5 * (side - 1)
    reach = half * (abs(c) + abs(s)) + 2
    inside = x - reach > 0 and y - reach > 0 and x + reach < w - 1 and y + reach < h - 1
    for r in range(side):
        # first sample of the row: the patch's rows run along (c, s), its columns along (-s, c)
        px = x - c * half - s * (r - half)
        py = y - s * half + c * (r - half)
        for k in range(side):
            u = px + c * k
            v = py + s * k
            if not inside:
                # 1.001: the pixel to the right, and the one below, must exist
                u = min(max(u, 0.0), w - 1.001)
                v = min(max(v, 0.0), h - 1.001)
            i = int(u)
            j = int(v)
            a = np.float32(u - i)
            b = np.float32(v - j)
            top = image[j, i]
            bottom = image[j + 1, i]
            top += a * (image[j, i + 1] - top)
            bottom += a * (image[j + 1, i + 1] - bottom)
            patch[r, k] = top + b * (bottom - top)
