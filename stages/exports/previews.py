"""Small pictures of every stage's result for the report, by which a person judges whether a night is sound.

Each picture is the bytes of a JPEG file, (n,) uint8, at most 480 pixels wide unless stated otherwise; the same result gives the
same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from ..io.rasters import jpeg
from ..types import (
    Camera,
    Cloud,
    DepthMap,
    Disparity,
    Features,
    Float32s,
    Float64s,
    Frame,
    Geometry,
    Int64s,
    Matches,
    Rectification,
    Uint8s,
    View,
)

WIDTH = 480
"""Largest width of a picture, pixels, unless its caller asks for more."""
QUALITY = 80
"""JPEG quality of the pictures, per cent."""
LARGE = 1600
"""Largest width of a large picture of a frame, pixels."""
_MOST_LINES = 60
"""Largest number of matches that are drawn: more would hide the images."""
_CELLS = (10, 6)
"""Columns and rows of the cells of which each shows one match."""
_MOST_DOTS = 500_000
"""About the largest number of points of a cloud that are drawn."""
_BACKGROUND = 24
"""Grey level behind pictures."""
_GAP_PX = 4
"""Distance between pictures on one canvas, pixels."""
_MARGIN_PX = 10
"""Margin around the plan of a cloud, pixels."""


def frame_preview(frame: Frame) -> Uint8s:
    """The frame, with its masked pixels dimmed."""
    return jpeg(_fit(_dimmed(frame), WIDTH), QUALITY)


def frame_large(frame: Frame) -> Uint8s:
    """The frame, with its masked pixels dimmed, at most `LARGE` pixels wide."""
    return jpeg(_fit(_dimmed(frame), LARGE), QUALITY)


def _dimmed(frame: Frame) -> Uint8s:
    """The image, with masked pixels darker and of little contrast."""
    return np.where(frame.mask[..., None], frame.image, frame.image // 4 + 32).astype(np.uint8)


def matches_preview(
    matches: Matches | Geometry, left: Frame | None = None, right: Frame | None = None, *, width: int = WIDTH
) -> Uint8s:
    """Both views side by side, with lines between matches that are spread evenly, each in its own colour.

    Parameters
    ----------
    matches : of the pair.
    left, right : frames of both views; None: a plain background.
    width : of the picture, at most.
    """
    image1 = _image_or_plain(left, matches.view1)
    image2 = _image_or_plain(right, matches.view2)
    canvas, scale, offset = _side_by_side(image1, image2, width)
    # pixel centres are whole numbers, so that the corner of the image lies at -0.5
    pixels1 = (matches.x1 + 0.5) * scale - 0.5
    pixels2 = (matches.x2 + 0.5) * scale - 0.5 + [offset, 0]
    # the first match in each cell of the left image
    cells = np.floor(matches.x1 / (matches.view1.width, matches.view1.height) * _CELLS).astype(int)
    _, first_in_cell = np.unique(cells[:, 1] * 1000 + cells[:, 0], return_index=True)
    chosen = first_in_cell[:_MOST_LINES]
    for k, n in enumerate(chosen):
        colour = _hue(k / max(1, len(chosen)))
        start = _whole_pixel(pixels1[n])
        end = _whole_pixel(pixels2[n])
        cv2.line(canvas, start, end, colour, 1, cv2.LINE_AA)
        cv2.circle(canvas, start, 2, colour, -1, cv2.LINE_AA)
        cv2.circle(canvas, end, 2, colour, -1, cv2.LINE_AA)
    return jpeg(canvas, QUALITY)


def _image_or_plain(frame: Frame | None, view: View) -> Uint8s:
    if frame is not None:
        return frame.image
    return np.full((view.height, view.width, 3), 48, np.uint8)


def _whole_pixel(x: Float64s) -> tuple[int, int]:
    column, row = np.round(x)
    return int(column), int(row)


def rectified_preview(rectification: Rectification, left: Frame, right: Frame, *, width: int = WIDTH) -> Uint8s:
    """Both rectified images with a few rows drawn across both: matching points lie on the same row.

    Parameters
    ----------
    rectification, left, right : rectification and frames of the pair.
    width : of the picture, at most.
    """
    return jpeg(_rectified(rectification, left, right, width), QUALITY)


def disparity_preview(
    disparity: Disparity,
    left: Frame | None = None,
    right: Frame | None = None,
    rectification: Rectification | None = None,
    *,
    width: int = WIDTH,
) -> Uint8s:
    """Disparity of both views, near in warm colours, black where unknown, with a colour scale below and, if given, the rectified
    images above.

    Parameters
    ----------
    disparity : of both rectified views.
    left, right, rectification : frames and rectification of the pair; the images need all three.
    width : of the picture, at most.
    """
    picture = _disparities(disparity, width)
    if left is None or right is None or rectification is None:
        return jpeg(picture, QUALITY)
    rectified = _rectified(rectification, left, right, width)
    top = rectified.shape[0] + _GAP_PX
    canvas = _canvas(top + picture.shape[0], max(rectified.shape[1], picture.shape[1]))
    canvas[: rectified.shape[0], : rectified.shape[1]] = rectified
    canvas[top:, : picture.shape[1]] = picture
    return jpeg(canvas, QUALITY)


def depth_preview(depth: DepthMap) -> Uint8s:
    """Depth of one view, near in warm colours, black where unknown, with a colour scale below."""
    # colours by inverse depth, as in a disparity map: near things show more detail
    coloured, low, high = _coloured((1.0 / depth.depth).astype(np.float32))
    picture = _fit(coloured[0], WIDTH)
    if high > low > 0:
        picture = _with_scale(picture, f"{1 / low:.3g} away", f"{1 / high:.3g} away")
    return jpeg(picture, QUALITY)


def cloud_preview(cloud: Cloud, cameras: Mapping[str, Camera]) -> Uint8s:
    """The cloud from above, and the cameras as red triangles that open in the viewing direction."""
    up, east, north = _view_axes(cameras)
    axes = np.stack([east, north])
    step = 1 + len(cloud.points) // _MOST_DOTS
    scene = cloud.points[::step].astype(np.float64)
    colors = cloud.colors[::step]
    points = scene @ axes.T
    centres = np.array([camera.C for camera in cameras.values()]).reshape(-1, 3) @ axes.T
    plan = _plan(points, centres)

    canvas = _canvas(plan.height, plan.width)
    order = np.argsort(scene @ up, kind="stable")  # the highest is drawn last
    x, y = np.round(plan.pixels(points[order])).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < plan.width) & (y < plan.height)
    canvas[y[inside], x[inside]] = colors[order][inside]
    for centre, camera in zip(centres, cameras.values(), strict=True):
        ahead = axes @ camera.R[2]
        across = np.array([-ahead[1], ahead[0]])
        offsets_px = np.array([np.zeros(2), 14 * ahead + 7 * across, 14 * ahead - 7 * across])
        corners = plan.pixels(centre + offsets_px / plan.scale)
        cv2.polylines(canvas, [np.round(corners).astype(np.int32)], True, (255, 70, 50), 1, cv2.LINE_AA)
    return jpeg(canvas, QUALITY)


@dataclass(frozen=True)
class _Plan:
    """Where a plan shows places, (n, 2) to the right and ahead."""

    low: Float64s
    """(2,) the place at the lower left corner, inside the margin."""
    scale: float
    """Pixels per unit of length."""
    width: int
    height: int
    """Pixels."""

    def pixels(self, places: Float64s) -> Float64s:
        """(n, 2) pixels of places (n, 2)."""
        column = (places[:, 0] - self.low[0]) * self.scale + _MARGIN_PX
        row = self.height - _MARGIN_PX - (places[:, 1] - self.low[1]) * self.scale
        return np.column_stack([column, row])


def _plan(points: Float64s, centres: Float64s) -> _Plan:
    """The plan that holds the points (n, 2) without the outermost per cent at each end, and all cameras (m, 2)."""
    corners = centres
    if len(points):
        corners = np.vstack([np.percentile(points, [1, 99], axis=0), centres])
    elif not len(centres):
        corners = np.zeros((1, 2))
    low = corners.min(axis=0)
    size = np.maximum(corners.max(axis=0) - low, 1e-9)
    inner_px = WIDTH - 2 * _MARGIN_PX
    scale = min(inner_px / size[0], inner_px / size[1])
    width, height = (np.floor(size * scale).astype(int) + 2 * _MARGIN_PX).tolist()
    return _Plan(low, scale, width, height)


def _canvas(height: int, width: int) -> Uint8s:
    return np.full((height, width, 3), _BACKGROUND, np.uint8)


def _fit(image: Uint8s, width: int) -> Uint8s:
    """The image, reduced to `width` pixels if it is wider."""
    h, w = image.shape[:2]
    if w <= width:
        return image
    height = max(1, round(h * width / w))
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _side_by_side(left: Uint8s, right: Uint8s, width: int) -> tuple[Uint8s, float, int]:
    """Two images on one canvas at a common scale, that scale, and the column at which the right one begins."""
    widest = max(left.shape[1], right.shape[1])
    scale = min(1.0, (width - _GAP_PX) / 2 / widest)
    small1 = _fit(left, max(1, round(left.shape[1] * scale)))
    small2 = _fit(right, max(1, round(right.shape[1] * scale)))
    offset = small1.shape[1] + _GAP_PX
    canvas = _canvas(max(small1.shape[0], small2.shape[0]), offset + small2.shape[1])
    canvas[: small1.shape[0], : small1.shape[1]] = small1
    canvas[: small2.shape[0], offset:] = small2
    return canvas, scale, offset


def _rectified(rectification: Rectification, left: Frame, right: Frame, width: int) -> Uint8s:
    """Both rectified images side by side, with rows drawn across both."""
    from ..rectification.warping import warp  # imported here: frames alone need no compiled kernels

    canvas, _, _ = _side_by_side(warp(rectification, 1, left.image), warp(rectification, 2, right.image), width)
    for row in np.linspace(0, canvas.shape[0] - 1, 9)[1:-1]:
        cv2.line(canvas, (0, round(row)), (canvas.shape[1] - 1, round(row)), (255, 210, 60), 1)
    return canvas


def _disparities(disparity: Disparity, width: int) -> Uint8s:
    """Disparity of both views side by side, with a colour scale if any is known."""
    from ..rectification.warping import disparity_px  # imported here, as above

    coloured, low, high = _coloured(disparity_px(disparity, 1), disparity_px(disparity, 2))
    picture, _, _ = _side_by_side(coloured[0], coloured[1], width)
    if high > low:
        picture = _with_scale(picture, f"{low:.1f} px", f"{high:.1f} px")
    return picture


def _with_scale(picture: Uint8s, low: str, high: str) -> Uint8s:
    """The image with a strip below that shows the colour scale between its end values."""
    width = picture.shape[1]
    font_size = max(0.35, 0.4 * width / WIDTH)
    strip = _canvas(round(42 * font_size), width)
    # label, bar, label, each with 6 pixels on either side; the bar takes a third of the width where there is room
    start = _text_width(low, font_size) + 12
    end = min(width - _text_width(high, font_size) - 12, start + width // 3)
    if end > start:
        ramp = np.linspace(0, 255, end - start).astype(np.uint8)[None]
        strip[len(strip) // 4 : 3 * len(strip) // 4, start:end] = _turbo(ramp)
        baseline = round(0.7 * len(strip))
        for label, x in ((low, 6), (high, end + 6)):
            cv2.putText(strip, label, (x, baseline), cv2.FONT_HERSHEY_SIMPLEX, font_size, (225, 225, 225), 1, cv2.LINE_AA)
    return np.concatenate([picture, strip])


def _text_width(label: str, font_size: float) -> int:
    (width, _), _ = cv2.getTextSize(label, cv2.FONT_HERSHEY_SIMPLEX, font_size, 1)
    return width


def _turbo(levels: Uint8s) -> Uint8s:
    """Levels (h, w) as colours (h, w, 3), red for the highest."""
    return np.asarray(cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _hue(share: float) -> tuple[int, int, int]:
    """A colour of the rainbow, red, green, blue; share: 0 to 1."""
    pixel = np.array([[[round(179 * share), 200, 255]]], np.uint8)
    red, green, blue = np.asarray(cv2.cvtColor(pixel, cv2.COLOR_HSV2RGB))[0, 0]
    return int(red), int(green), int(blue)


def _coloured(*maps: Float32s) -> tuple[list[Uint8s], float, float]:
    """Each map as (h, w, 3) uint8, coloured over the common 2nd to 98th percentile, black where unknown; and these two values."""
    known = np.concatenate([values[np.isfinite(values)] for values in maps])
    low = 0.0
    high = 0.0
    if known.size:
        low, high = np.percentile(known, [2, 98])
    pictures = []
    for values in maps:
        level = np.nan_to_num((values - low) / max(high - low, 1e-12)).clip(0, 1) * 255
        coloured = _turbo(level.astype(np.uint8))
        pictures.append(np.where(np.isfinite(values)[..., None], coloured, 0).astype(np.uint8))
    return pictures, float(low), float(high)


def _view_axes(cameras: Mapping[str, Camera]) -> tuple[Float64s, Float64s, Float64s]:
    """Unit vectors up (against the cameras' mean y axis), right, and ahead (their mean viewing direction), as seen from above."""
    if not cameras:
        return np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    up = -np.sum([camera.R[1] for camera in cameras.values()], axis=0)
    first = next(iter(cameras.values()))
    if np.linalg.norm(up) > 1e-6:
        up = up / np.linalg.norm(up)
    else:
        up = -first.R[1]  # the axes cancel out
    ahead = np.sum([camera.R[2] for camera in cameras.values()], axis=0)
    ahead = ahead - (ahead @ up) * up
    if np.linalg.norm(ahead) < 1e-6:  # cameras all around, or looking down
        ahead = np.cross(up, first.R[0])
    ahead = ahead / np.linalg.norm(ahead)
    return up, np.cross(ahead, up), ahead


MOST_KEYPOINTS = 3000
"""Largest number of keypoints that are shown in an image: more would hide it."""
MOST_MATCHES = 400
"""Largest number of inliers that are shown in a pair of images."""


def keypoint_marks(features: Features) -> bytes:
    """Evenly sampled keypoints of a camera: shares of width and height as little-endian uint16."""
    return _packed_pixels(features.xy[_sample(len(features.xy), MOST_KEYPOINTS)], features.view)


def inlier_marks(geometry: Geometry) -> bytes:
    """Evenly sampled inliers of a pair: positions in the left image, then as many in the right one, as in `keypoint_marks`."""
    sample = _sample(len(geometry.x1), MOST_MATCHES)
    return _packed_pixels(geometry.x1[sample], geometry.view1) + _packed_pixels(geometry.x2[sample], geometry.view2)


def _sample(count: int, most: int) -> Int64s:
    """Indices of at most `most` of `count` items, evenly spaced."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).astype(np.int64)


def _packed_pixels(xy: Float64s, view: View) -> bytes:
    shares = (xy + 0.5) / (view.width, view.height)  # pixel centres are whole numbers
    return bytes(np.rint(shares.clip(0, 1) * 65535).astype("<u2").tobytes())
