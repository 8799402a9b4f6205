"""Deviation of a cloud from a scan or model of the same place: robust registration, then distances along the normals.

References: Chen, Medioni, Object modelling by registration of multiple range images, Image and Vision Computing 10, 1992 (point
to plane); for distances and their level of detection see `cloud_distance`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import open3d

from ..io.clouds import point_cloud
from ..types import Cloud, Float64s
from .cloud_distance import MeasuredCloud, cloud_distances, one_of_each_cell, spacing_of

LEAST_OVERLAP = 0.5
"""Smallest share of the cloud that a scan must cover for a comparison."""
_MOST_MISALIGNMENT = 0.05
"""Largest misalignment of a scan before its registration, as a share of the site's size."""
_STEP_SHARES = (1.0, 0.25, 0.06)
"""Largest distance of corresponding points in each step of the registration, as shares of the largest misalignment."""
_MOST_DEVIATION = 0.02
"""Largest deviation that is measured, as a share of the site's size."""
_RADIUS_SPACINGS = 5.0
"""Radius of a cylinder, in spacings of the coarser of the two clouds."""
_MOST_POINTS = 200_000
"""Points of each cloud that the registration uses: fewer than twice this number."""


@dataclass(frozen=True)
class ScanDeviation:
    """Deviation of a cloud from a scan."""

    distance: Float64s
    """(n,) metres from the scan to the cloud along the cloud's normal; nan where the scan has no points."""
    sigma: Float64s
    """(n,) standard deviation of `distance`."""
    transform: Float64s
    """(4, 4) rigid transform that registers the scan to the cloud."""
    overlap: float
    """Share of the cloud's points at which the scan has points, 0 to 1."""
    residual_m: float
    """Median absolute deviation where both agree: within two standard deviations."""
    agreeing: float
    """Of the points with a scan, the share where both agree."""
    registration_m: float
    """Standard deviation of the registration: the offsets that remain between parts of the site."""


def deviation_from_scan(cloud: Cloud, scan: Float64s) -> ScanDeviation:
    """Register a scan (m, 3), in the cloud's world, to the cloud, and measure the deviations.

    The scan is taken as exact.  Raises ValueError if it is far from the site, or covers less than `LEAST_OVERLAP` of the cloud.
    """
    # 1. Keep what lies near the site: scans often cover much more.
    points = cloud.points.astype(np.float64)
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    size = float(np.linalg.norm(high - low))
    misalignment = _MOST_MISALIGNMENT * size
    near = np.all((scan > low - 2 * misalignment) & (scan < high + 2 * misalignment), axis=1)
    if not near.any():
        centre = " ".join(f"{value:,.0f}" for value in np.median(scan, axis=0))
        raise ValueError(f"the scan has no point near the site: its centre is at {centre} in the site's world")
    scan = scan[near]

    # 2. Register it, and measure along the cloud's normals.
    transform = _register(cloud, scan, misalignment)
    scan = scan @ transform[:3, :3].T + transform[:3, 3]
    radius = _RADIUS_SPACINGS * max(spacing_of(points), spacing_of(scan))
    first = MeasuredCloud(scan, np.zeros(len(scan)))
    second = MeasuredCloud(points, cloud.sigma_mm.astype(np.float64) / 1000)
    normals = cloud.normals.astype(np.float64)
    measured = cloud_distances(points, normals, first, second, radius=radius, reach=_MOST_DEVIATION * size)
    covered = np.isfinite(measured.distance)
    # 3. Judge the overlap, and add the error of the registration.
    overlap = float(covered.mean())
    if overlap < LEAST_OVERLAP:
        remedy = "align it with the site first, to within some metres (CloudCompare: Align)"
        raise ValueError(f"the scan covers {overlap:.0%} of the cloud, {LEAST_OVERLAP:.0%} are needed: {remedy}")
    registration = _unevenness(points[covered], measured.distance[covered], measured.detectable[covered])
    sigma = np.sqrt(measured.sigma**2 + registration**2)
    agree = covered & (np.abs(measured.distance) <= 2 * sigma)
    residual = float("nan")
    if agree.any():
        residual = float(np.median(np.abs(measured.distance[agree])))
    return ScanDeviation(
        distance=measured.distance,
        sigma=sigma,
        transform=transform,
        overlap=overlap,
        residual_m=residual,
        agreeing=float(agree.sum() / covered.sum()),
        registration_m=registration,
    )


def _register(cloud: Cloud, scan: Float64s, misalignment: float) -> Float64s:
    """Return the rigid transform (4, 4) that registers a scan to the cloud: point to plane, with ever stricter Tukey weights."""
    target = point_cloud(cloud)
    target = target.uniform_down_sample(max(1, len(target.points) // _MOST_POINTS))
    sample = one_of_each_cell(scan, max(spacing_of(scan), misalignment / 200))
    sample = sample[:: max(1, len(sample) // _MOST_POINTS)]
    source = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(scan[sample]))
    icp = open3d.pipelines.registration
    transform = np.eye(4)
    for step in _STEP_SHARES:
        distance = misalignment * step
        method = icp.TransformationEstimationPointToPlane(icp.TukeyLoss(k=distance / 2))
        result = icp.registration_icp(source, target, distance, transform, method, icp.ICPConvergenceCriteria(max_iteration=60))
        transform = np.asarray(result.transformation, np.float64)
    return np.round(transform, 9)  # multithreaded sums differ in the last digits


def _unevenness(points: Float64s, distance: Float64s, detectable: Float64s) -> float:
    """Return the root mean square, over the eight octants of the site, of the median deviation of unchanged points."""
    octant = (points > np.median(points, axis=0)) @ np.array([1, 2, 4])  # 0 to 7: a bit for each axis
    unchanged = np.abs(distance - np.median(distance)) <= np.maximum(detectable, np.median(np.abs(distance)))
    medians = []
    for k in range(8):
        chosen = unchanged & (octant == k)
        if chosen.any():
            medians.append(float(np.median(distance[chosen])))
    return float(np.sqrt(np.mean(np.square(medians))))
