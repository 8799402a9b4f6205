"""What fusion plans from views subsampled to every 4th pixel: neighbouring views, voxel size, and an exposure for each camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.cameras import same_camera, transfer
from ..types import Camera, DepthMap, Float32s, Float64s, Frame, Uint8s

STEP = 4
"""Pixels for each sample of a subsampled view, in both directions."""

_LEAST_SHARED = 0.01
"""Smallest share of a view's surface that another must see to be compared with it."""

_FEWEST_COMPARED = 50
"""Fewest pixels from which the ratio of two cameras' exposures is measured."""

_MOST_WEIGHED = 1000
"""Pixels beyond this number do not raise the weight of a ratio: the cameras then differ by more than noise."""

_SAME_DEPTH = 0.01
"""Relative difference up to which two views' depths are of one surface."""

_PREFERRED_STEPS = (1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0)
"""Renard's series R10: ten steps to a decade."""


@dataclass(frozen=True)
class Subsampled:
    """A view at a quarter of its size."""

    colors: Uint8s
    """(h / 4, w / 4, 3) uint8, means over blocks, which pixel noise and small depth errors hardly affect."""
    depth: Float32s
    """(h / 4, w / 4) float32, of the pixel next to each block's centre."""

    def points(self, step: int) -> tuple[Float64s, Float64s]:
        """Homogeneous pixels (n, 3) and depths (n, 1) of every `step`-th sample in x and y that has a depth."""
        depth = self.depth[::step, ::step]
        y, x = np.nonzero(np.isfinite(depth))
        pixels = np.column_stack([STEP * step * x + STEP // 2, STEP * step * y + STEP // 2, np.ones(len(x))])
        return pixels.astype(np.float64), depth[y, x].astype(np.float64)[:, None]


def subsample(frame: Frame, depth: DepthMap) -> Subsampled:
    """A view on every 4th pixel."""
    h, w = frame.image.shape[:2]
    colors = cv2.resize(frame.image, (max(1, w // STEP), max(1, h // STEP)), interpolation=cv2.INTER_AREA)
    centre_depth = depth.depth[STEP // 2 :: STEP, STEP // 2 :: STEP].copy()  # a view of the array would keep all of it in memory
    return Subsampled(np.asarray(colors, dtype=np.uint8), centre_depth)


def nearest_views(name: str, cameras: Mapping[str, Camera], small: Mapping[str, Subsampled], count: int) -> list[str]:
    """The views of other cameras that see most of one view's surface, the largest share first, and at least 1 % of it.

    Parameters
    ----------
    name : the view.
    cameras, small : cameras and subsampled views, by id.
    count : largest number of views.
    """
    pixels, z = small[name].points(2)
    if not len(z):
        return []
    shares = []
    for other in cameras:
        if other == name or same_camera(cameras[name], cameras[other]):  # no independent view
            continue
        camera = cameras[other]
        M, b = transfer(cameras[name], camera)
        with np.errstate(divide="ignore", invalid="ignore"):
            p = z * (pixels @ M.T) + b
            u = p[:, 0] / p[:, 2]
            v = p[:, 1] / p[:, 2]
        inside = (p[:, 2] > 0) & (u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1)
        shares.append((float(inside.mean()), other))
    # the sort is stable: of equal shares, the order of the cameras decides
    shares.sort(key=lambda entry: -entry[0])
    return [other for share, other in shares[:count] if share >= _LEAST_SHARED]


def natural_voxel(cameras: Mapping[str, Camera], small: Mapping[str, Subsampled]) -> float:
    """Edge of a pixel's footprint on the surface, median over all views.

    It is rounded down to a preferred number, so that the grid stays the same when cameras fail or surfaces change from night to
    night.
    """
    edges = []
    for name, view in small.items():
        footprint = view.depth / cameras[name].K[0, 0]
        edges.append(footprint[1::2, 1::2].ravel())
    median = float(np.nanmedian(np.concatenate(edges)))
    decade = 10.0 ** np.floor(np.log10(median))
    steps_below = [step for step in _PREFERRED_STEPS if step <= max(median / decade, 1.0)]
    return float(decade * max(steps_below))


def exposure_gains(
    cameras: Mapping[str, Camera], small: Mapping[str, Subsampled], neighbours: Mapping[str, Sequence[str]]
) -> dict[str, Float64s]:
    """Colour gain (3,) of each camera; the geometric mean over the cameras is one.

    The ratio of two cameras is the median over pixels whose depths agree.  The gains fit all ratios by least squares; a camera
    without ratios has gain one."""
    # 1. One equation for each two cameras with a ratio: log gain of one, minus that of the other, is minus their log ratio.
    names = list(small)
    rows = []
    ratios = []
    weights = []
    for i, name in enumerate(names):
        for other in neighbours[name]:
            ratio, count = _ratio(cameras[name], cameras[other], small[name], small[other])
            if count >= _FEWEST_COMPARED:
                row = np.zeros(len(names))
                row[i] = 1.0
                row[names.index(other)] = -1.0
                rows.append(row)
                ratios.append(ratio)
                weights.append(np.sqrt(min(count, _MOST_WEIGHED)))
    if not rows:
        return {name: np.ones(3) for name in names}

    # 2. Weighted least squares for all three colours at once.
    w = np.array(weights)[:, None]
    prior = 0.1 * np.eye(len(names))  # ties each set of connected cameras to a mean gain of one
    right_side = np.vstack([-np.array(ratios) * w, np.zeros((len(names), 3))])
    log_gains = np.linalg.lstsq(np.vstack([np.array(rows) * w, prior]), right_side, rcond=None)[0]
    return dict(zip(names, np.exp(log_gains), strict=True))


def _ratio(camera: Camera, other: Camera, view1: Subsampled, view2: Subsampled) -> tuple[Float64s, int]:
    """Median log ratio (3,) of two cameras' colours on surfaces that both see, and the number of pixels that it is from."""
    pixels, z = view1.points(2)
    M, b = transfer(camera, other)
    p = z * (pixels @ M.T) + b
    with np.errstate(divide="ignore", invalid="ignore"):
        xy2 = p[:, :2] / p[:, 2:]
    inside = (p[:, 2] > 0) & (xy2 >= 0).all(axis=1) & (xy2 < [other.width - 1, other.height - 1]).all(axis=1)
    pixels = pixels[inside]
    xy2 = xy2[inside]
    z2 = p[inside, 2]
    agrees = np.abs(_values(view2.depth, xy2) - z2) < _SAME_DEPTH * z2
    rgb1 = _values(view1.colors, pixels[agrees]).astype(np.float64)
    rgb2 = _values(view2.colors, xy2[agrees]).astype(np.float64)
    # neither nearly black nor clipped: there, the ratio of grey levels is not that of exposures
    usable = ((rgb1 > 10) & (rgb1 < 245) & (rgb2 > 10) & (rgb2 < 245)).all(axis=1)
    if usable.sum() < _FEWEST_COMPARED:
        return np.zeros(3), 0
    return np.median(np.log(rgb1[usable] / rgb2[usable]), axis=0), int(usable.sum())


def _values(values: Uint8s | Float32s, places: Float64s) -> np.ndarray:
    """(n, ...) values of a subsampled view at positions in pixels of the full size."""
    h, w = values.shape[:2]
    x, y = (places[:, :2].T + 0.5).astype(int) // STEP
    return np.asarray(values[np.minimum(y, h - 1), np.minimum(x, w - 1)])
