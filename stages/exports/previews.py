"""Small pictures of every stage's result for the report, by which a person judges whether a night is sound.

Each picture is the bytes of a JPEG file, (n,) uint8, at most 480 pixels wide unless stated otherwise; the same result gives the
same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping

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
QUALITY = 80
LARGE = 1600
_MOST_LINES = 60
_MOST_DOTS = 500_000


def frame_preview(frame: Frame) -> Uint8s:
    """The frame, with its masked pixels dimmed."""
    return jpeg(_fit(_dimmed(frame), WIDTH), QUALITY)


def frame_large(frame: Frame) -> Uint8s:
    """The frame, with its masked pixels dimmed, at most `LARGE` pixels wide."""
    return jpeg(_fit(_dimmed(frame), LARGE), QUALITY)


def _dimmed(frame: Frame) -> Uint8s:
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
    images = [
        np.full((view.height, view.width, 3), 48, np.uint8) if frame is None else frame.image
        for frame, view in ((left, matches.view1), (right, matches.view2))
    ]
    canvas, scale, offset = _side_by_side(images[0], images[1], width)
    pixels1, pixels2 = (matches.x1 + 0.5) * scale - 0.5, (matches.x2 + 0.5) * scale - 0.5 + [offset, 0]
    cells = np.floor(matches.x1 / (matches.view1.width, matches.view1.height) * [10, 6]).astype(int)
    chosen = np.unique(cells[:, 1] * 1000 + cells[:, 0], return_index=True)[1][:_MOST_LINES]  # the first in each cell
    for k, n in enumerate(chosen):
        colour = _hue(k / max(1, len(chosen)))
        start, end = (tuple(int(v) for v in np.round(p[n])) for p in (pixels1, pixels2))
        cv2.line(canvas, start, end, colour, 1, cv2.LINE_AA)
        cv2.circle(canvas, start, 2, colour, -1, cv2.LINE_AA)
        cv2.circle(canvas, end, 2, colour, -1, cv2.LINE_AA)
    return jpeg(canvas, QUALITY)


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
    canvas = np.full((rectified.shape[0] + 4 + picture.shape[0], max(rectified.shape[1], picture.shape[1]), 3), 24, np.uint8)
    canvas[: rectified.shape[0], : rectified.shape[1]] = rectified
    canvas[rectified.shape[0] + 4 :, : picture.shape[1]] = picture
    return jpeg(canvas, QUALITY)


def depth_preview(depth: DepthMap) -> Uint8s:
    """Depth of one view, near in warm colours, black where unknown, with a colour scale below."""
    coloured, low, high = _coloured((1.0 / depth.depth).astype(np.float32))
    picture = _fit(coloured[0], WIDTH)
    return jpeg(_with_scale(picture, f"{1 / low:.3g} away", f"{1 / high:.3g} away") if high > low > 0 else picture, QUALITY)


def cloud_preview(cloud: Cloud, cameras: Mapping[str, Camera]) -> Uint8s:
    """The cloud from above, and the cameras as red triangles that open in the viewing direction."""
    up, east, north = _view_axes(cameras)
    plan = np.stack([east, north])
    sample = slice(None, None, 1 + len(cloud.points) // _MOST_DOTS)
    scene, colors = cloud.points[sample].astype(np.float64), cloud.colors[sample]
    points = scene @ plan.T
    centres = np.array([camera.C for camera in cameras.values()]).reshape(-1, 3) @ plan.T
    bounds = [np.percentile(points, [1, 99], axis=0)] if len(points) else []  # without the outermost percent at each end
    corners = np.vstack([*bounds, centres]) if len(centres) or bounds else np.zeros((1, 2))
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = np.maximum(high - low, 1e-9)
    scale = min((WIDTH - 20) / size[0], (WIDTH - 20) / size[1])
    width, height = (np.floor(size * scale).astype(int) + 20).tolist()

    def pixel(p: Float64s) -> Float64s:
        return np.column_stack([(p[:, 0] - low[0]) * scale + 10, height - 10 - (p[:, 1] - low[1]) * scale])

    canvas = np.full((height, width, 3), 24, np.uint8)
    order = np.argsort(scene @ up, kind="stable")  # the highest is drawn last
    x, y = np.round(pixel(points[order])).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    canvas[y[inside], x[inside]] = colors[order][inside]
    for centre, camera in zip(centres, cameras.values(), strict=True):
        ahead = plan @ camera.R[2]
        across = np.array([-ahead[1], ahead[0]])
        corners = centre + np.array([np.zeros(2), 14 * ahead + 7 * across, 14 * ahead - 7 * across]) / scale
        cv2.polylines(canvas, [np.round(pixel(corners)).astype(np.int32)], True, (255, 70, 50), 1, cv2.LINE_AA)
    return jpeg(canvas, QUALITY)


def _fit(image: Uint8s, width: int) -> Uint8s:
    h, w = image.shape[:2]
    if w <= width:
        return image
    return np.asarray(cv2.resize(image, (width, max(1, round(h * width / w))), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _side_by_side(left: Uint8s, right: Uint8s, width: int) -> tuple[Uint8s, float, int]:
    """Two images on one canvas at a common scale, that scale, and the column at which the right one begins."""
    gap, widest = 4, max(left.shape[1], right.shape[1])
    scale = min(1.0, (width - gap) / 2 / widest)
    small = [_fit(image, max(1, round(image.shape[1] * scale))) for image in (left, right)]
    canvas = np.full((max(s.shape[0] for s in small), small[0].shape[1] + gap + small[1].shape[1], 3), 24, np.uint8)
    offset = small[0].shape[1] + gap
    canvas[: small[0].shape[0], : small[0].shape[1]] = small[0]
    canvas[: small[1].shape[0], offset:] = small[1]
    return canvas, scale, offset


def _rectified(rectification: Rectification, left: Frame, right: Frame, width: int) -> Uint8s:
    from ..rectification.warping import warp  # imported here: frames alone need no compiled kernels

    canvas, _, _ = _side_by_side(warp(rectification, 1, left.image), warp(rectification, 2, right.image), width)
    for row in np.linspace(0, canvas.shape[0] - 1, 9)[1:-1]:
        cv2.line(canvas, (0, round(row)), (canvas.shape[1] - 1, round(row)), (255, 210, 60), 1)
    return canvas


def _disparities(disparity: Disparity, width: int) -> Uint8s:
    from ..rectification.warping import disparity_px  # imported here, as above

    coloured, low, high = _coloured(disparity_px(disparity, 1), disparity_px(disparity, 2))
    picture = _side_by_side(coloured[0], coloured[1], width)[0]
    return _with_scale(picture, f"{low:.1f} px", f"{high:.1f} px") if high > low else picture


def _with_scale(picture: Uint8s, low: str, high: str) -> Uint8s:
    """The image with a strip below that shows the colour scale between its end values."""
    width = picture.shape[1]
    font_size = max(0.35, 0.4 * width / WIDTH)
    text_widths = [cv2.getTextSize(label, cv2.FONT_HERSHEY_SIMPLEX, font_size, 1)[0][0] for label in (low, high)]
    strip: Uint8s = np.full((round(42 * font_size), width, 3), 24, np.uint8)
    start, end = text_widths[0] + 12, min(width - text_widths[1] - 12, text_widths[0] + 12 + width // 3)
    if end > start:
        ramp = np.linspace(0, 255, end - start).astype(np.uint8)[None]
        bar = cv2.cvtColor(cv2.applyColorMap(ramp, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
        strip[len(strip) // 4 : 3 * len(strip) // 4, start:end] = bar
        for label, x in ((low, 6), (high, end + 6)):
            cv2.putText(
                strip, label, (x, round(0.7 * len(strip))), cv2.FONT_HERSHEY_SIMPLEX, font_size, (225, 225, 225), 1, cv2.LINE_AA
            )
    return np.concatenate([picture, strip])


def _hue(share: float) -> tuple[int, int, int]:
    pixel = np.array([[[round(179 * share), 200, 255]]], np.uint8)
    red, green, blue = np.asarray(cv2.cvtColor(pixel, cv2.COLOR_HSV2RGB))[0, 0]
    return int(red), int(green), int(blue)


def _coloured(*maps: Float32s) -> tuple[list[Uint8s], float, float]:
    """Each map as (h, w, 3) uint8, coloured over the common 2nd to 98th percentile, black where unknown; and these two values."""
    known = np.concatenate([values[np.isfinite(values)] for values in maps])
    low, high = np.percentile(known, [2, 98]) if known.size else (0.0, 0.0)
    pictures = []
    for values in maps:
        level = np.nan_to_num((values - low) / max(high - low, 1e-12)).clip(0, 1) * 255
        coloured = cv2.cvtColor(cv2.applyColorMap(level.astype(np.uint8), cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
        pictures.append(np.where(np.isfinite(values)[..., None], coloured, 0).astype(np.uint8))
    return pictures, float(low), float(high)


def _view_axes(cameras: Mapping[str, Camera]) -> tuple[Float64s, Float64s, Float64s]:
    """Unit vectors up (against the cameras' mean y axis), right, and ahead (their mean viewing direction), as seen from above."""
    if not cameras:
        return np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    up = -np.sum([camera.R[1] for camera in cameras.values()], axis=0)
    first = next(iter(cameras.values()))
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-6 else -first.R[1]
    ahead = np.sum([camera.R[2] for camera in cameras.values()], axis=0)
    ahead = ahead - (ahead @ up) * up
    if np.linalg.norm(ahead) < 1e-6:
        ahead = np.cross(up, first.R[0])
    ahead = ahead / np.linalg.norm(ahead)
    return up, np.cross(ahead, up), ahead


MOST_KEYPOINTS = 3000
"""Largest number of keypoints that are shown in an image: more would hide it."""
MOST_MATCHES = 400


def keypoint_marks(features: Features) -> bytes:
    """Evenly sampled keypoints of a camera: shares of width and height as little-endian uint16."""
    return _packed_pixels(features.xy[_sample(len(features.xy), MOST_KEYPOINTS)], features.view)


def inlier_marks(geometry: Geometry) -> bytes:
    """Evenly sampled inliers of a pair: positions in the left image, then as many in the right one, as in `keypoint_marks`."""
    sample = _sample(len(geometry.x1), MOST_MATCHES)
    return _packed_pixels(geometry.x1[sample], geometry.view1) + _packed_pixels(geometry.x2[sample], geometry.view2)


def _sample(count: int, most: int) -> Int64s:
    return np.arange(count) if count <= most else np.linspace(0, count - 1, most).astype(np.int64)


def _packed_pixels(xy: Float64s, view: View) -> bytes:
    shares = (xy + 0.5) / (view.width, view.height)  # pixel centres are whole numbers
    return bytes(np.rint(shares.clip(0, 1) * 65535).astype("<u2").tobytes())
