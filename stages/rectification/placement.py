"""Placement of a pair of images by rectifying homographies: common scales and rows, own x offsets, crop around the matches."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..types import Float64s

MARGIN_SHARE = 0.35
"""Margin of the crop around the box of the matches, as a share of the box; larger values show more of the frame."""
MARGIN_OF_WIDTH = 0.05
"""Margin besides, as a share of the frame's width."""
LARGEST = 2.5
"""A rectified image is at most this many frame widths wide and frame heights high: near an epipole it would become huge."""
_NEAR_SIDE = 0.05
"""Points count as visible if their third coordinate is more than this share of the frame's median."""

Size = tuple[int, int]


def place(
    H1: Float64s, H2: Float64s, x1: Float64s, x2: Float64s, size1: Size, size2: Size
) -> tuple[Float64s, Float64s, Size, Size]:
    """H1, H2 scaled and shifted so that rectified pixels are about as wide and as high as the frames', and the rectified sizes.

    Both images have the same scale in x and the same scale in y, so that one may become narrower than its frame and one wider.

    Parameters
    ----------
    H1, H2 : (3, 3) homographies of images 1 and 2.
    x1, x2 : (n, 2) matches, pixels, on the near side of the line that H1, H2 send to infinity.
    size1, size2 : width and height of the images, pixels.
    """
    # 1. common scales, by the median pixel of both images
    box1, lengths1 = _mapped(H1, x1)
    box2, lengths2 = _mapped(H2, x2)
    widths, heights = np.concatenate([lengths1, lengths2], axis=1)
    scale = 1 / np.array([np.median(widths), np.median(heights)])
    S = np.diag([*scale, 1.0])
    H1 = S @ H1
    H2 = S @ H2
    # 2. crop each image around its matches; rows that only one of them shows are of no use
    margin = MARGIN_OF_WIDTH * max(size1[0], size2[0])
    low1, high1 = _crop(scale * box1, _visible_box(H1, size1), margin)
    low2, high2 = _crop(scale * box2, _visible_box(H2, size2), margin)
    top = max(low1[1], low2[1])
    bottom = min(high1[1], high2[1])
    height = _limited(bottom - top + 1, LARGEST * max(size1[1], size2[1]))
    width1 = _limited(high1[0] - low1[0] + 1, LARGEST * size1[0])
    width2 = _limited(high2[0] - low2[0] + 1, LARGEST * size2[0])
    # 3. common top row, own left columns
    return _shift(low1[0], top) @ H1, _shift(low2[0], top) @ H2, (width1, height), (width2, height)


def _limited(length: float, most: float) -> int:
    """A length of an image, pixels: at least 1, at most `most`."""
    return int(min(max(length, 1), most))


def _mapped(H: Float64s, x: Float64s) -> tuple[Float64s, Float64s]:
    """Smallest and largest coordinates (2, 2) of points x (n, 2) mapped by H, and width and height (2, n) that a pixel at each
    point gets, in rectified pixels."""
    # spelled out: faster than a matrix product with homogeneous points
    u, v, w = (a * x[:, 0] + b * x[:, 1] + c for a, b, c in H)
    mapped = np.stack([u, v]) * (1 / w)
    # row k of the Jacobian is (H[k, :2] - mapped[k] H[2, :2]) / w; its length is the size that a pixel gets along that axis
    along_x = H[:2, :1] - mapped * H[2, 0]
    along_y = H[:2, 1:2] - mapped * H[2, 1]
    lengths = np.sqrt(along_x**2 + along_y**2) * np.abs(1 / w)
    return np.stack([mapped.min(axis=1), mapped.max(axis=1)]), lengths


def _crop(box: Float64s, limits: Float64s, margin: float) -> tuple[Float64s, Float64s]:
    """Whole-pixel corners (2,), (2,) of a `box` with margins, no larger than the box `limits` (2, 2)."""
    margins = MARGIN_SHARE * (box[1] - box[0]) + margin
    low = np.floor(np.maximum(box[0] - margins, limits[0]))
    high = np.ceil(np.minimum(box[1] + margins, limits[1]))
    return low, high


@lru_cache(maxsize=8)
def frame_grid(size: Size, steps: int = 25) -> Float64s:
    """(steps^2, 2) points that cover a frame, its borders included; read-only."""
    x, y = np.meshgrid(np.linspace(-0.5, size[0] - 0.5, steps), np.linspace(-0.5, size[1] - 0.5, steps))
    grid = np.column_stack([x.ravel(), y.ravel()])
    grid.flags.writeable = False  # all callers get the same array
    return grid


def _visible_box(H: Float64s, size: Size) -> Float64s:
    """The box (2, 2) of the visible part of a frame: of points well on the near side of the line sent to infinity."""
    grid = frame_grid(size)
    z = grid @ H[2, :2] + H[2, 2]
    typical = np.median(z)
    visible = z * typical > _NEAR_SIDE * typical * typical  # z and its median have the same sign on the near side
    box, _ = _mapped(H, np.compress(visible, grid, axis=0))
    return box


def _shift(x: float, y: float) -> Float64s:
    """(3, 3) homography that moves the point (x, y) to the origin."""
    return np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
