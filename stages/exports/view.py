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

from ..types import NEW, VANISHED, Bools, Changes, Cloud, Float32s, Float64s, Int64s, Uint8s

MOST_POINTS = 600_000
"""Largest number of points in a stream: a browser can turn them without a graphics card."""
_SAMPLED_PER_POINT = 2
"""Larger clouds are sampled at regular steps, to about this many points for each one that is shown."""
_MOST_CODE = 65535
"""Largest coded coordinate: 16 bits."""
_FAR_SHARE = 0.5
"""Points outside the middle 99.9 percent by more than this share of its extent are not shown: they would make the rest coarse."""
_MOST_BYTE = 255
_COMPRESSION = 5
"""Compression level of zlib: 6 takes half as long again and saves half a percent."""
_MOST_SAMPLES = 600
"""Most points listed in the header, which show where the points are without unpacking."""


class Layer(NamedTuple):
    """A value of each point, besides its colour."""

    values: Float32s
    """(n,)"""
    unit: str
    in_ratios: bool = False
    """Coded logarithmically, from the least to the most."""


def cloud_view(cloud: Cloud, most: int = MOST_POINTS) -> bytes:
    """The stream of a cloud: one mean point for each voxel, the smallest voxels that leave at most `most` points."""
    sampled = slice(None, None, max(1, len(cloud.points) // (_SAMPLED_PER_POINT * most)))
    columns = (cloud.colors, cloud.confidence, cloud.views, cloud.sigma_mm)
    values = np.column_stack([column[sampled] for column in columns]).astype(np.float32)
    points = cloud.points[sampled]
    inside = _inside_extent(points)
    points, values, voxel = _thinned(points[inside].astype(np.float64), values[inside], most)
    layers = {
        "confidence": Layer(values[:, 3], ""),
        "views": Layer(values[:, 4], "cameras"),
        "sigma": Layer(values[:, 5], "mm", in_ratios=True),
    }
    return _stream(points, np.rint(values[:, :3]).astype(np.uint8), layers, voxel, len(cloud.points))


def changes_view(changes: Changes) -> bytes:
    """The stream of new and vanished points; the layer `kind` is 1 for vanished ones."""
    chosen = np.isin(changes.label, (NEW, VANISHED)) & (changes.blob > 0)
    points = changes.points[chosen].astype(np.float64)
    kind = (changes.label[chosen] == VANISHED).astype(np.float32)
    values = np.column_stack([changes.colors[chosen], kind]).astype(np.float32)
    points, values, voxel = _thinned(points, values, MOST_POINTS // 6)
    return _stream(points, np.rint(values[:, :3]).astype(np.uint8), {"kind": Layer(values[:, 3], "")}, voxel, int(chosen.sum()))


def thinned_view(stream: bytes, most: int) -> bytes:
    """A stream of every second, third, ... point of another one, at most `most` of them, without layers."""
    length = struct.unpack_from("<I", stream)[0]
    header = json.loads(stream[4 : 4 + length])
    count, stride = header["n"], max(1, -(-header["n"] // most))
    planes = np.frombuffer(zlib.decompress(stream[4 + length :]), np.uint8).reshape(9 + len(header["layers"]), count)
    coded = np.cumsum(planes[:3] + (planes[3:6].astype(np.uint16) << 8), axis=1, dtype=np.uint16)
    points = np.array(header["low"]) + coded.T[::stride] * header["step"]
    return _stream(points, planes[6:9].T[::stride], {}, header["voxel"] * np.sqrt(stride), header["total"])


def _inside_extent(points: Float64s) -> Bools:
    if len(points) < 100:
        return np.ones(len(points), bool)
    low, high = np.percentile(points[:: 1 + len(points) // 200_000], [0.05, 99.95], axis=0)
    margin = _FAR_SHARE * (high - low).max()
    return np.asarray(np.all((points >= low - margin) & (points <= high + margin), axis=1))


def _thinned(points: Float64s, values: Float32s, most: int) -> tuple[Float64s, Float32s, float]:
    """Mean point and values of each voxel, in curve order, and the voxel's edge; up to `most` points are only reordered."""
    if not len(points):
        return points, values, 1.0
    low, extent = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-9)
    edge = _voxel_edge(points - low, extent, most) if len(points) > most else extent / _MOST_CODE
    codes = _curve_codes(((points - low) / edge).astype(np.int64))
    order = np.argsort(codes, kind="stable")
    if len(points) <= most:
        return points[order], values[order], extent / np.sqrt(len(points))
    codes = codes[order]
    starts = np.flatnonzero(np.concatenate([[True], codes[1:] != codes[:-1]]))
    count = np.diff(np.append(starts, len(codes)))[:, None]
    means = np.add.reduceat(points[order], starts) / count
    return means, np.asarray(np.add.reduceat(values[order], starts) / count, np.float32), edge


def _voxel_edge(points: Float64s, extent: float, most: int) -> float:
    """Edge of a voxel that leaves nearly `most` voxels, and no more (on a surface their number falls with the edge's square)."""
    edge = 1.5 * extent / np.sqrt(most)
    for _ in range(12):
        occupied = _occupied_voxels(points, edge)
        if 0.9 * most <= occupied <= most:
            break
        edge *= np.sqrt(occupied / (0.96 * most))
    while occupied > most:
        edge *= 1.03
        occupied = _occupied_voxels(points, edge)
    return float(edge)


def _occupied_voxels(points: Float64s, edge: float) -> int:
    cells = (points * (1.0 / edge)).astype(np.int64)
    codes = np.sort((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2])
    return 1 + int(np.count_nonzero(codes[1:] != codes[:-1]))


def _curve_codes(cells: Int64s) -> Int64s:
    """Position of cells (n, 3), 16 bits each, along the curve: their bits interleaved."""
    code = np.zeros(len(cells), np.int64)
    for axis in range(3):
        bits = np.clip(cells[:, axis], 0, _MOST_CODE)
        for shift, mask in ((16, 0xFF0000FF), (8, 0xF00F00F00F), (4, 0xC30C30C30C3), (2, 0x249249249249)):
            bits = (bits | (bits << shift)) & mask
        code |= bits << axis
    return code


def _stream(points: Float64s, colors: Uint8s, layers: dict[str, Layer], voxel: float, total: int) -> bytes:
    low = points.min(axis=0) if len(points) else np.zeros(3)
    step = max(float((points - low).max()) if len(points) else 1.0, 1e-9) / _MOST_CODE
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
    values = layer.values.astype(np.float64)
    known = values[np.isfinite(values)]
    low, high = (float(v) for v in np.percentile(known, [1, 98])) if len(known) else (0.0, 1.0)
    if len(known) and high <= low:
        low, high = float(known.min()), float(known.max())
    legend = {"low": round(low, 4), "high": round(high, 4)}
    if layer.in_ratios and len(known) and known.min() > 0:
        least, most = round(float(known.min()), 4) or 1e-4, round(float(known.max()), 4)
        legend |= {"least": least, "most": most}
        values, low, high = np.log(np.maximum(values, least)), float(np.log(least)), float(np.log(max(most, least)))
    share = np.nan_to_num((values - low) / max(high - low, 1e-12), nan=1.0).clip(0, 1)
    return np.rint(share * _MOST_BYTE).astype(np.uint8), legend
