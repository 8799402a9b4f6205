"""Points for the report's 3-D view: thinned by voxels and packed in a compact stream that a browser can unpack by itself.

A stream is the length of a JSON header (uint32, little-endian), the header, and zlib-packed planes of `n` bytes: low bytes of
x, y and z, then their high bytes, of the difference from the previous point (points follow a space-filling curve, so that these
are small: Morton, A computer oriented geodetic data base, 1966); red, green, blue; and one plane for each of `layers`.  `low`
and `high` are the ends of a layer's colour scale.  Its bytes run linearly between these, or logarithmically between `least` and
`most` if it has them: colours need only the range of most values, measuring needs all of it.
"""

from __future__ import annotations

import json
import struct
import zlib
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ..types import NEW, SAME, VANISHED, Bools, Changes, Cloud, Float32s, Float64s, Int64s, ObservedPoses, Uint8s

MOST_POINTS = 600_000
"""Largest number of points in a stream: a browser can turn them without a graphics card."""
_SAMPLED_PER_POINT = 2
"""Larger clouds are sampled at regular steps, to about this many points for each one that is shown."""
_MOST_CODE = 65535
"""Largest coded coordinate: 16 bits."""
_FAR_SHARE = 0.5
"""Points outside the middle 99.9 percent by more than this share of its extent are not shown: they would make the rest coarse."""
_LEAST_EXTENT = 1e-9
"""Least extent of a cloud, in its units: keeps the coding of a single point from dividing by zero."""
_MOST_BYTE = 255
"""Largest coded value of a layer: 8 bits."""
_COMPRESSION = 5
"""Compression level of zlib: 6 takes half as long again and saves half a percent."""
_MOST_CHANGES = MOST_POINTS // 6
"""Largest number of points in the stream of changes, which is shown beside that of the cloud."""
_NEW = 0.0
_UNCHANGED = 1.0
_VANISHED = 2.0
"""Values of the layer `kind` of the stream of changes."""
_NEIGHBOURHOOD = 6.0
"""Unchanged points within this many spacings of a new one are in the stream of changes: the page looks for the nearest point
within three spacings of each point of the cloud, so that all which can be nearest are there."""
_SPACING_SAMPLE = 2000
"""Number of points from which the spacing of the stream of changes is estimated."""
_EARLY = np.array([60.0, 120.0, 255.0])
_LATE = np.array([255.0, 70.0, 40.0])
"""Colours of the beginning and the end of a track."""
_TRACK_WIDTH = 0.004
"""Width of a track, as a share of its extent."""
_MOST_SAMPLES = 600
"""Most points listed in the header, which show where the points are without unpacking."""


class Layer(NamedTuple):
    """A value of each point, besides its colour."""

    values: Float32s
    """(n,)"""
    unit: str
    in_ratios: bool = False
    """Coded logarithmically, from the least to the most."""
    ends: tuple[float, float] | None = None
    """Ends of the colour scale; None: those of most values."""


def cloud_view(cloud: Cloud, most: int = MOST_POINTS) -> bytes:
    """The stream of a cloud: one mean point for each voxel, the smallest voxels that leave at most `most` points."""
    # 1. Sample, and leave out what lies far away.
    sampled = slice(None, None, max(1, len(cloud.points) // (_SAMPLED_PER_POINT * most)))
    columns = (cloud.colors, cloud.confidence, cloud.views, cloud.sigma_mm)
    # (n, 6): red, green, blue, confidence, views, sigma; voxels are averaged over all of them at once
    values = np.column_stack([column[sampled] for column in columns]).astype(np.float32)
    points = cloud.points[sampled]
    inside = _inside_extent(points)

    # 2. Thin to one point for each voxel.
    points, values, voxel = _thinned(points[inside].astype(np.float64), values[inside], most)
    layers = {
        "confidence": Layer(values[:, 3], ""),
        "views": Layer(values[:, 4], "cameras"),
        "sigma": Layer(values[:, 5], "mm", in_ratios=True),
    }
    return _stream(points, np.rint(values[:, :3]).astype(np.uint8), layers, voxel, len(cloud.points))


def changes_view(changes: Changes) -> bytes:
    """The stream of new and vanished points, and of the unchanged ones around new ones, so that each point of the night's cloud
    has a nearest neighbour that says whether it has changed.  The layer `kind` is 0 (new), 1 (unchanged) or 2 (vanished)."""
    new = (changes.label == NEW) & (changes.blob > 0)
    vanished = (changes.label == VANISHED) & (changes.blob > 0)
    spacing = _spacing(changes.points[new | vanished])
    unchanged = _near(changes.points, changes.label == SAME, new, _NEIGHBOURHOOD * spacing)

    chosen = new | vanished | unchanged
    kind = np.select([new[chosen], unchanged[chosen]], [_NEW, _UNCHANGED], _VANISHED)
    values = np.column_stack([changes.colors[chosen], kind]).astype(np.float32)
    points, values, voxel = _thinned(changes.points[chosen].astype(np.float64), values, _MOST_CHANGES)
    # what was thinned has the spacing of its voxels; otherwise it keeps its own
    spacing = max(voxel, spacing) if len(points) < int(chosen.sum()) else spacing
    layers = {"kind": Layer(np.rint(values[:, 3]), "", ends=(_NEW, _VANISHED))}
    return _stream(points, np.rint(values[:, :3]).astype(np.uint8), layers, spacing, int((new | vanished).sum()))


def track_view(observed: ObservedPoses) -> bytes:
    """The stream of the places of things by which cameras were placed, from blue to red in the order of time."""
    count = len(observed.track)
    late = np.linspace(0, 1, count)[:, None]
    colors = _EARLY * (1 - late) + _LATE * late
    points, values, _ = _thinned(observed.track, colors.astype(np.float32), _MOST_CHANGES)
    extent = float(np.ptp(points, axis=0).max()) if count else 1.0
    voxel = max(_TRACK_WIDTH * extent, _LEAST_EXTENT)
    return _stream(points, np.rint(values).astype(np.uint8), {}, voxel, count)


def _spacing(points: Float64s) -> float:
    """Median distance of points (n, 3) from their nearest neighbours; 1 if there are fewer than two."""
    if len(points) < 2:
        return 1.0
    sample = points[:: max(1, len(points) // _SPACING_SAMPLE)]
    distances, _ = cKDTree(points).query(sample, k=2)  # the nearest point of each is itself
    return max(float(np.median(distances[:, 1])), _LEAST_EXTENT)


def _near(points: Float64s, candidates: Bools, chosen: Bools, reach: float) -> Bools:
    """(n,) the candidates among points (n, 3) that have a chosen point within reach."""
    near = np.zeros(len(points), bool)
    if not chosen.any() or not candidates.any():
        return near
    distances, _ = cKDTree(points[chosen]).query(points[candidates], distance_upper_bound=reach)
    near[np.flatnonzero(candidates)[np.isfinite(distances)]] = True
    return near


def thinned_view(stream: bytes, most: int) -> bytes:
    """A stream of every second, third, ... point of another one, at most `most` of them, without layers."""
    length = struct.unpack_from("<I", stream)[0]
    header = json.loads(stream[4 : 4 + length])
    count = header["n"]
    stride = max(1, -(-count // most))  # rounded up
    # planes of n bytes: 3 low bytes, 3 high bytes, 3 colours, then the layers
    planes = np.frombuffer(zlib.decompress(stream[4 + length :]), np.uint8).reshape(9 + len(header["layers"]), count)
    # the sum of the differences overflows like the differences themselves: both are modulo 65536
    coded = np.cumsum(planes[:3] + (planes[3:6].astype(np.uint16) << 8), axis=1, dtype=np.uint16)
    points = np.array(header["low"]) + coded.T[::stride] * header["step"]
    # points lie on surfaces: a stride of n is like voxels whose edge is root n times as long
    return _stream(points, planes[6:9].T[::stride], {}, header["voxel"] * np.sqrt(stride), header["total"])


def _inside_extent(points: Float64s) -> Bools:
    """(n,) the points in or near the box of the middle 99.9 percent; all of a few, whose percentiles say nothing."""
    if len(points) < 100:
        return np.ones(len(points), bool)
    low, high = np.percentile(points[:: 1 + len(points) // 200_000], [0.05, 99.95], axis=0)
    margin = _FAR_SHARE * (high - low).max()
    return np.asarray(np.all((points >= low - margin) & (points <= high + margin), axis=1))


def _thinned(points: Float64s, values: Float32s, most: int) -> tuple[Float64s, Float32s, float]:
    """Mean point and values of each voxel, in curve order, and the voxel's edge; up to `most` points are only reordered."""
    if not len(points):
        return points, values, 1.0
    low = points.min(axis=0)
    extent = max(float(np.ptp(points, axis=0).max()), _LEAST_EXTENT)
    if len(points) <= most:
        order = _curve_order(points - low, extent / _MOST_CODE)[1]
        return points[order], values[order], extent / np.sqrt(len(points))
    edge = _voxel_edge(points - low, extent, most)
    codes, order = _curve_order(points - low, edge)
    # points of one voxel have one code, and follow each other
    starts = np.flatnonzero(np.concatenate([[True], codes[1:] != codes[:-1]]))
    count = np.diff(np.append(starts, len(codes)))[:, None]
    means = np.add.reduceat(points[order], starts) / count
    return means, np.asarray(np.add.reduceat(values[order], starts) / count, np.float32), edge


def _curve_order(points: Float64s, edge: float) -> tuple[Int64s, Int64s]:
    """Codes of points' voxels along the curve, ascending, and the indices that sort the points so (n,); the sort is stable."""
    codes = _curve_codes((points / edge).astype(np.int64))
    order = np.argsort(codes, kind="stable")
    return codes[order], order


def _voxel_edge(points: Float64s, extent: float, most: int) -> float:
    """Edge of a voxel that leaves nearly `most` voxels, and no more (on a surface their number falls with the edge's square)."""
    # a flat square of this extent would have 0.44 most voxels
    edge = 1.5 * extent / np.sqrt(most)
    for _ in range(12):
        occupied = _occupied_voxels(points, edge)
        if 0.9 * most <= occupied <= most:
            break
        # aim at the middle of the accepted range
        edge *= np.sqrt(occupied / (0.96 * most))
    # the steps above may end above the limit, which binds
    while occupied > most:
        edge *= 1.03
        occupied = _occupied_voxels(points, edge)
    return float(edge)


def _occupied_voxels(points: Float64s, edge: float) -> int:
    """Number of voxels that hold points (n, 3), none of which is negative."""
    cells = (points * (1.0 / edge)).astype(np.int64)
    # 21 bits for each axis
    codes = np.sort((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2])
    return 1 + int(np.count_nonzero(codes[1:] != codes[:-1]))


def _curve_codes(cells: Int64s) -> Int64s:
    """Position of cells (n, 3), 16 bits each, along the curve: their bits interleaved."""
    code = np.zeros(len(cells), np.int64)
    for axis in range(3):
        bits = np.clip(cells[:, axis], 0, _MOST_CODE)
        # each step halves the groups of neighbouring bits and moves them apart, until two zeros follow each bit
        for shift, mask in ((16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249)):
            bits = (bits | (bits << shift)) & mask
        code |= bits << axis
    return code


def _stream(points: Float64s, colors: Uint8s, layers: dict[str, Layer], voxel: float, total: int) -> bytes:
    """The stream of points (n, 3) with colours (n, 3), in the form that the module describes.

    Parameters
    ----------
    points, colors : of the points, in the order of the curve.
    layers : further values by name.
    voxel : distance of neighbouring points, in the points' unit.
    total : number of points before they were thinned.
    """
    low = np.zeros(3)
    extent = 1.0
    if len(points):
        low = points.min(axis=0)
        extent = float((points - low).max())
    step = max(extent, _LEAST_EXTENT) / _MOST_CODE
    coded = np.rint((points - low) / step).astype(np.uint16)
    differences = np.diff(coded, axis=0, prepend=np.zeros((1, 3), np.uint16))  # modulo 65536
    planes = [differences & 255, differences >> 8, colors]
    legends = []
    for name, layer in layers.items():
        coded_layer, legend = _coded(layer)
        planes.append(coded_layer[:, None])
        legends.append({"name": name, "unit": layer.unit, **legend})
    header = {
        "n": len(points),
        "total": total,
        "sample": np.round(points[:: 1 + len(points) // _MOST_SAMPLES], 3).tolist(),
        "low": low.tolist(),
        "step": step,
        "voxel": float(voxel),
        "layers": legends,
    }
    raw = b"".join(np.ascontiguousarray(plane.T.astype(np.uint8)).tobytes() for plane in planes)
    text = json.dumps(header).encode()
    return struct.pack("<I", len(text)) + text + zlib.compress(raw, _COMPRESSION)


def _coded(layer: Layer) -> tuple[Uint8s, dict[str, float]]:
    """(n,) bytes of a layer, and the ends of its scales; unknown values become the largest byte."""
    values = layer.values.astype(np.float64)
    known = values[np.isfinite(values)]

    # 1. The colour scale covers most values; if most are equal, all of them.
    low = 0.0
    high = 1.0
    if len(known):
        low, high = np.percentile(known, [1, 98]).tolist()
        if high <= low:
            low = float(known.min())
            high = float(known.max())
    if layer.ends is not None:
        low, high = layer.ends
    legend = {"low": round(low, 4), "high": round(high, 4)}

    # 2. A logarithmic layer codes all values instead, between ends that are rounded, as the browser reads them.
    if layer.in_ratios and len(known) and known.min() > 0:
        least = round(float(known.min()), 4) or 1e-4
        most = round(float(known.max()), 4)
        legend |= {"least": least, "most": most}
        values = np.log(np.maximum(values, least))
        low = float(np.log(least))
        high = float(np.log(max(most, least)))

    # 3. One byte for each value, clipped to the ends.
    share = np.nan_to_num((values - low) / max(high - low, 1e-12), nan=1.0).clip(0, 1)
    return np.rint(share * _MOST_BYTE).astype(np.uint8), legend
