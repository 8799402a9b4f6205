"""Coverage maps of lettering, spots and rows of stones on a surface; `rng`, `shape` and `texel_m` are as in `paint`."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.core.jit import kernel
from wbflow_stages.types import Float32s

from .paint import Rng, Shape, fractal_noise


def lettering(
    shape: Shape, texel_m: float, text: str, x_m: float, y_m: float, height_m: float, *, bold: float = 0.16
) -> Float32s:
    """Return coverage (h, w) float32, 0 to 1, of a line of text: top-left corner at (x_m, y_m), capitals `height_m` high."""
    cover = np.zeros(shape, np.uint8)
    height = max(height_m / texel_m, 3.0)
    # height of a capital at scale 1, measured at scale 4, since sizes are whole pixels
    unit = cv2.getTextSize("H", cv2.FONT_HERSHEY_DUPLEX, 4.0, 1)[0][1] / 4.0
    thickness = max(round(height * bold), 1)
    origin = (round(x_m / texel_m), round(y_m / texel_m + height))
    cv2.putText(cover, text, origin, cv2.FONT_HERSHEY_DUPLEX, height / unit, 255, thickness, cv2.LINE_AA)
    return cover.astype(np.float32) / np.float32(255)


def blobs(rng: Rng, shape: Shape, texel_m: float, *, count: int, radius_m: float) -> Float32s:
    """Return coverage (h, w) float32 of `count` soft-edged irregular spots (oil, lichen, repairs) of about `radius_m`."""
    cover = np.zeros(shape, np.uint8)
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    for _ in range(count):
        radius = radius_m / texel_m * rng.lognormal(0, 0.5)
        # 24 radii, smoothed around the outline: repeated three times so that its end meets its start
        outline = radius * (1 + 0.25 * np.convolve(np.tile(rng.standard_normal(24), 3), np.ones(3) / 3, "same")[24:48])
        centre = rng.uniform((0, 0), (shape[1], shape[0]))
        path = centre + np.column_stack([np.cos(angle), np.sin(angle)]) * outline[:, None]
        # positions in sixteenths of a texel
        cv2.fillPoly(cover, [np.round(path * 16).astype(np.int32)], int(rng.integers(90, 255)), cv2.LINE_AA, 4)
    return cover.astype(np.float32) / np.float32(255)


Maps = tuple[Float32s, Float32s, Float32s]
"""Three maps or tables that belong together; the docstring of a function that takes them says which."""


@kernel
def _lay_stones(laid: Maps, stones: Maps, warp: Float32s, texel: float, unit: tuple[float, float], joint: float) -> None:
    """Fill in rows of stones with jittered joints: coverage (0 in a joint), tone per stone, dome shading lit from top left."""
    cover, tone, relief = laid
    table, edges, shift = stones
    rows, cols = table.shape
    unit_w, unit_h = unit
    for i in range(cover.shape[0]):
        for j in range(cover.shape[1]):
            # 1. Which stone is here?  Joints are shifted by less than half a stone: the neighbour on either side may be it.
            y = (i + 0.5) * texel + warp[i, j]
            row = min(max(int(y / unit_h), 0), rows - 1)
            x = (j + 0.5) * texel + warp[i, j] + shift[row]
            col = min(max(int(x / unit_w), 1), cols - 2)
            if x < col * unit_w + edges[row, col]:
                col -= 1
            elif x > (col + 1) * unit_w + edges[row, col + 1]:
                col += 1
            # 2. The distance from its nearest edge gives the coverage, soft over one texel.
            left = col * unit_w + edges[row, col]
            right = (col + 1) * unit_w + edges[row, min(col + 1, cols - 1)]
            top = row * unit_h
            inside = min(min(x - left, right - x), min(y - top, top + unit_h - y))
            cover[i, j] = min(max((inside - 0.5 * joint) / texel + 0.5, 0.0), 1.0)
            tone[i, j] = table[row, col]
            # 3. Its shading: -1 to 1 across the stone, and cubes, so that only the edges are rounded.
            fx = 2 * (x - left) / (right - left) - 1
            fy = 2 * (y - top) / unit_h - 1
            relief[i, j] = -(0.45 * fx * fx * fx + 0.9 * fy * fy * fy)


def stones(
    rng: Rng, shape: Shape, texel_m: float, unit: tuple[float, float], joint: float, *, bond: float, jitter: float, warp: float
) -> Maps:
    """Return coverage, tone (unit variance, one per stone) and relief of rows of stones of `unit` = (width, height) metres."""
    # a little more than the surface needs, since joints are shifted and bent
    rows = int(shape[0] * texel_m / unit[1]) + 2
    cols = int(shape[1] * texel_m / unit[0]) + 4
    table = rng.standard_normal((rows, cols), dtype=np.float32)
    edges = (unit[0] * jitter * rng.uniform(-1, 1, (rows, cols))).astype(np.float32)
    # `bond` of a stone in every second row (0.5: a running bond)
    shift = (unit[0] * (1 + bond * (np.arange(rows) % 2) + 0.5 * jitter * rng.uniform(-1, 1, rows))).astype(np.float32)
    # courses that are not quite straight
    bend = np.float32(warp) * fractal_noise(rng, shape, texel_m, 2.0, octaves=4)
    laid = (np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32))
    _lay_stones(laid, (table, edges, shift), bend, texel_m, unit, joint)
    return laid
