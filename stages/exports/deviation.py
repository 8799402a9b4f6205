"""Deviation of a night's cloud from a scan or model of another program, as files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..change.scan_deviation import deviation_from_scan
from ..io.clouds import Columns, cloud_columns
from ..io.scans import Scan, read_scan
from ..types import Cloud, Float32s, Float64s, Poses, Uint8s

_SAMPLE_SPACING = 0.02
"""Spacing in metres of points that are sampled on a mesh."""
_FULL_QUANTILE = 0.9
"""Quantile of the absolute deviations from which on the colour is full."""
_DETECTABLE_SIGMAS = 2
"""A deviation counts as detected from this many of its standard deviations: 5 percent of points without one exceed it."""
_WHITE = (235, 235, 235)
"""Colour of no deviation, RGB."""
_IN_FRONT = (200, 30, 30)
"""Colour of a point far in front of the scan, RGB."""
_BEHIND = (30, 70, 200)
"""Colour of a point far behind the scan, RGB."""
_UNKNOWN = 110
"""Grey of a point without a scan."""


def scan_files(cloud: Cloud, poses: Poses, path: Path) -> tuple[dict[str, bytes | Columns], dict[str, Any]]:
    """Compare a cloud with the scan in a file; returns deviation.ply and deviation.json by name, and the figures in the latter.

    deviation.ply (as columns) is red in front of the scan, blue behind it, grey without a scan.  Raises ValueError if the site
    has no scale, the file cannot be read, the scan is elsewhere, or it covers too little of the site.
    """
    if not poses.metric:
        raise ValueError("the site has no scale: state one distance, or positions of cameras")
    scan_points = _in_site_world(read_scan(path, _SAMPLE_SPACING), poses)
    result = deviation_from_scan(cloud, scan_points)

    # 1. The figures, over all points that the scan covers.
    known = np.isfinite(result.distance)
    deviation = np.abs(result.distance[known])
    above_limit = deviation > _DETECTABLE_SIGMAS * result.sigma[known]
    figures = {
        "unit": "m",
        "scan": path.name,
        "overlap": round(result.overlap, 4),
        "residual": round(result.residual_m, 5),
        "agreeing": round(result.agreeing, 4),
        "registration_sigma": round(result.registration_m, 5),
        "median_deviation": round(float(np.median(result.distance[known])), 5),
        "median_unsigned": round(float(np.median(deviation)), 5),
        "p90_unsigned": round(float(np.quantile(deviation, 0.9)), 5),
        "beyond_detection": round(float(above_limit.mean()), 4),
        "transform_of_scan": np.round(result.transform, 9).tolist(),
    }

    # 2. The cloud, in the colours of the deviations.
    columns = dict(cloud_columns(cloud))
    columns["red"], columns["green"], columns["blue"] = _colours(result.distance).T
    columns["deviation"] = result.distance.astype(np.float32)
    columns["deviation_sigma"] = result.sigma.astype(np.float32)
    data = (json.dumps(figures, indent=1) + "\n").encode()
    return {"deviation.ply": columns, "deviation.json": data}, figures


def _in_site_world(scan: Scan, poses: Poses) -> Float64s:
    """Return a scan's points (n, 3) in the site's world; those in map coordinates are converted by its georeference."""
    if not poses.crs:
        return scan.points
    from .world import georeference  # imported here: sites without a georeference need no pyproj

    reference = georeference(poses.crs)
    # a file that names no map system may still be in the site's: its coordinates tell
    if scan.epsg or reference.is_on_map(scan.points):
        return reference.local(scan.points, scan.epsg)
    return scan.points


def _colours(distance: Float64s) -> Uint8s:
    """Return (n, 3) uint8: white without deviation, red in front, blue behind, grey where unknown."""
    known = np.isfinite(distance)
    full_deviation = max(float(np.quantile(np.abs(distance[known]), _FULL_QUANTILE)), 1e-9)
    share: Float32s = np.clip(np.nan_to_num(distance) / full_deviation, -1, 1).astype(np.float32)[:, None]
    white = np.array(_WHITE, np.float32)
    front = np.array(_IN_FRONT, np.float32)
    behind = np.array(_BEHIND, np.float32)
    # (n, 1) shares against (3,) colours
    colours = np.where(share > 0, white + share * (front - white), white - share * (behind - white))
    return np.where(known[:, None], colours, _UNKNOWN).astype(np.uint8)
