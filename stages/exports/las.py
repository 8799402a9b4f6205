"""A cloud as LAZ 1.4: point format 7 (RGB), with normals, confidence, views and sigma as extra dimensions.

References: ASPRS, LAS Specification 1.4 R15, 2019.
"""

from __future__ import annotations

import datetime
import io

import laspy
import numpy as np
import pyproj

from ..io.clouds import coordinate_step
from ..types import Cloud
from .world import Georeference

EXTRA = {
    "nx": (np.float32, "normal, x"),
    "ny": (np.float32, "normal, y"),
    "nz": (np.float32, "normal, z"),
    "confidence": (np.float32, "0 to 1"),
    "views": (np.uint16, "cameras that support it"),
    "sigma_mm": (np.float32, "standard deviation"),
}
"""Extra dimensions by name: type, and the description that the file carries."""


def laz_bytes(cloud: Cloud, day: datetime.date, georeference: Georeference | None = None) -> bytes:
    """LAZ of a cloud, in map coordinates with their CRS if there is a georeference.  day: for the file's header."""
    points = cloud.points.astype(np.float64)
    normals = cloud.normals.astype(np.float64)

    # 1. The header: what is in the file, and in which coordinates.
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.creation_date = day
    header.generating_software = "wbflow"
    header.system_identifier = "stereo"
    header.global_encoding.wkt = True  # the specification requires it for point formats above 5
    header.scales = np.full(3, coordinate_step(points))  # in the site's coordinates, whose extent decides the step
    if georeference is not None:
        normals = georeference.directions(points, normals)  # at the world points, so before these are converted
        points = georeference.points(points)
        header.add_crs(pyproj.CRS.from_epsg(georeference.epsg))
    header.offsets = np.floor(points.min(axis=0))
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind, description) for name, (kind, description) in EXTRA.items()])

    # 2. The points.
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.red, las.green, las.blue = cloud.colors.T.astype(np.uint16) * 257  # 255 becomes 65535
    # the specification counts returns from 1
    las.return_number = las.number_of_returns = np.ones(len(points), np.uint8)
    las.nx, las.ny, las.nz = normals.T.astype(np.float32)
    las.confidence = cloud.confidence
    las.views = cloud.views
    las.sigma_mm = cloud.sigma_mm
    buffer = io.BytesIO()
    # one thread keeps the order of chunks, and so the bytes, reproducible
    las.write(buffer, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    return buffer.getvalue()
