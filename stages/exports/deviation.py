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

_SPACING = 0.02
"""Spacing in metres of points that are sampled on a mesh."""
_FULL = 0.9
"""Quantile of the absolute deviations from which on the colour is full."""


def scan_files(cloud: Cloud, poses: Poses, path: Path) -> tuple[dict[str, bytes | Columns], dict[str, Any]]:
    """Compare a cloud with the scan in a file; returns deviation.ply and deviation.json by name, and the figures in the latter.

    deviation.ply (as columns) is red in front of the scan, blue behind it, grey without a scan.  Raises ValueError if the site
    has no scale, the file cannot be read, the scan is elsewhere, or it covers too little of the site.
    """
    if not poses.metric:
        raise ValueError("the site has no scale: state one distance, or positions of cameras")
    found = deviation_from_scan(cloud, _in_the_world(read_scan(path, _SPACING), poses))
    known = np.isfinite(found.distance)
    deviation = np.abs(found.distance[known])
    beyond = deviation > 2 * found.sigma[known]
    figures = {
        "unit": "m",
        "scan": path.name,
        "overlap": round(found.overlap, 4),
        "residual": round(found.residual_m, 5),
        "agreeing": round(found.agreeing, 4),
        "registration_sigma": round(found.registration_m, 5),
        "median_deviation": round(float(np.median(found.distance[known])), 5),
        "median_unsigned": round(float(np.median(deviation)), 5),
        "p90_unsigned": round(float(np.quantile(deviation, 0.9)), 5),
        "beyond_detection": round(float(beyond.mean()), 4),
        "transform_of_scan": np.round(found.transform, 9).tolist(),
    }
    columns = {
        **cloud_columns(cloud),
        **dict(zip(("red", "green", "blue"), _colours(found.distance).T, strict=True)),
        "deviation": found.distance.astype(np.float32),
        "deviation_sigma": found.sigma.astype(np.float32),
    }
    data = (json.dumps(figures, indent=1) + "\n").encode()
    return {"deviation.ply": columns, "deviation.json": data}, figures


def _in_the_world(scan: Scan, poses: Poses) -> Float64s:
    """Return a scan's points (n, 3) in the site's world; those in map coordinates are converted by its georeference."""
    if not poses.crs:
        return scan.points
    from .world import georeference

    place = georeference(poses.crs)
    return place.local(scan.points, scan.epsg) if scan.epsg or place.is_on_map(scan.points) else scan.points


def _colours(distance: Float64s) -> Uint8s:
    """Return (n, 3) uint8: white without deviation, red in front, blue behind, grey where unknown."""
    known = np.isfinite(distance)
    most = max(float(np.quantile(np.abs(distance[known]), _FULL)), 1e-9)
    share: Float32s = np.clip(np.nan_to_num(distance) / most, -1, 1).astype(np.float32)[:, None]
    white, front, behind = (np.array(c, np.float32) for c in ((235, 235, 235), (200, 30, 30), (30, 70, 200)))
    shown = np.where(share > 0, white + share * (front - white), white - share * (behind - white))
    return np.where(known[:, None], shown, 110).astype(np.uint8)
