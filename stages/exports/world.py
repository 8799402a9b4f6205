"""Conversion of a site's local east, north, up coordinates to its UTM zone.

The axes of a local frame are tangent to the ellipsoid at its origin.  Few programs support such a coordinate system, and those
that read its PROJ string place it at the centre of the earth.  UTM is supported everywhere; heights remain above the ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyproj

from ..types import Float64s

LOCAL = "+proj=topocentric"
"""Prefix of the `crs` of a local frame."""


@dataclass(frozen=True)
class Georeference:
    """A map coordinate system (EPSG code), and the PROJ pipelines from world points to it."""

    epsg: int
    steps: str
    """Pipeline to easting, northing and height above the ellipsoid, metres."""
    geographic: str
    """Pipeline to longitude, latitude (degrees) and height above the ellipsoid."""
    geocentric: str
    """Pipeline to geocentric coordinates (EPSG 4978)."""

    def degrees(self, x: Any) -> tuple[float, float, float]:
        """A world point as longitude, latitude (degrees, WGS 84) and height above the ellipsoid."""
        east, north, up = np.asarray(x, np.float64).tolist()
        longitude, latitude, height = pyproj.Transformer.from_pipeline(self.geographic).transform(east, north, up)
        return longitude, latitude, height

    def to_earth(self) -> Float64s:
        """(4, 4) transform from world points to geocentric coordinates (EPSG 4978), metres."""
        # a local frame is a rotation and a shift away: the images of its unit points and its origin tell it
        corners = np.vstack([np.eye(3), np.zeros(3)])
        geocentric_points = pyproj.Transformer.from_pipeline(self.geocentric).transform(*corners.T)
        *ends, origin = np.column_stack(geocentric_points)
        transform = np.eye(4)
        for axis, end in enumerate(ends):
            transform[:3, axis] = end - origin
        transform[:3, 3] = origin
        return transform

    def points(self, X: Float64s) -> Float64s:
        """(n, 3) float64 world points as easting, northing and height above the ellipsoid, metres."""
        map_points = pyproj.Transformer.from_pipeline(self.steps).transform(*np.asarray(X, np.float64).T)
        return np.column_stack(map_points).astype(np.float64)

    def local(self, X: Float64s, epsg: int | None = None) -> Float64s:
        """(n, 3) float64 world points of easting, northing and height; epsg: of another map system, whose heights are the same.

        Easting or longitude comes first, whatever that system's own order of axes.
        """
        x, y, z = np.asarray(X, np.float64).T
        if epsg and epsg != self.epsg:
            x, y = pyproj.Transformer.from_crs(epsg, self.epsg, always_xy=True).transform(x, y)
        back = pyproj.enums.TransformDirection.INVERSE
        local_points = pyproj.Transformer.from_pipeline(self.steps).transform(x, y, z, direction=back)
        return np.column_stack(local_points).astype(np.float64)

    def is_on_map(self, X: Float64s) -> bool:
        """Do points (n, 3) lie nearer to the site in the map's coordinates than in the site's own?"""
        middle = np.median(X[:, :2], axis=0)
        origin = self.points(np.zeros((1, 3)))[0, :2]
        # the site's own origin is 0, the map's thousands of kilometres away
        return bool(np.linalg.norm(middle - origin) < np.linalg.norm(middle))

    def directions(self, X: Float64s, directions: Float64s) -> Float64s:
        """(n, 3) unit vectors in map axes, from those at world points X: the map's north differs from the local frame's."""
        # differences over a metre: the convergence of the meridians hardly changes within it
        map_directions = self.points(X + directions) - self.points(X)
        return np.asarray(map_directions / np.linalg.norm(map_directions, axis=1, keepdims=True), dtype=np.float64)


def georeference(crs: str) -> Georeference:
    """The UTM zone around the origin of a local frame (`Poses.crs`).

    Raises ValueError for another kind of coordinate system, and for an origin at a latitude outside UTM.
    """
    if not crs.startswith(LOCAL):
        raise ValueError(f"{crs!r} is not the coordinate system of a local frame")
    to_geographic = f"+proj=pipeline +step +inv {crs} +step +inv +proj=cart +ellps=WGS84"
    to_degrees = "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    longitude, latitude, _ = pyproj.Transformer.from_pipeline(f"{to_geographic} {to_degrees}").transform(0.0, 0.0, 0.0)
    if not -80 <= latitude <= 84:
        raise ValueError(f"UTM does not reach latitude {latitude:g}")
    # 60 zones of 6 degrees, the first from 180 degrees west
    zone = int((longitude + 180) // 6) % 60 + 1
    if latitude < 0:
        epsg = 32700 + zone
        hemisphere = " +south"
    else:
        epsg = 32600 + zone
        hemisphere = ""
    steps = f"{to_geographic} +step +proj=utm +zone={zone}{hemisphere} +ellps=WGS84"
    return Georeference(epsg, steps, f"{to_geographic} {to_degrees}", f"+proj=pipeline +step +inv {crs}")
