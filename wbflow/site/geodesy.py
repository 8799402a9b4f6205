"""Positions by latitude and longitude, and what a site file gives besides the cameras: known distances and control points.

Geodetic positions become metres east, north and up of the first one in the file (z up, as in every world).
"""

from __future__ import annotations

import math
from typing import Any

from .locations import Location, Problems
from .models import POSITION_REMEDY, SiteFile, Survey


class LocalFrame:
    """East, north, up around an origin on the WGS 84 ellipsoid."""

    def __init__(self, latitude: float, longitude: float, height: float) -> None:
        from pyproj import Transformer  # here: only sites with geodetic positions need it

        self.crs = f"+proj=topocentric +ellps=WGS84 +lat_0={latitude!r} +lon_0={longitude!r} +h_0={height!r}"
        steps = "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 +step "
        self._transformer = Transformer.from_pipeline(steps + self.crs)

    def metres(self, latitude: float, longitude: float, height: float) -> list[float]:
        """[east, north, up]."""
        return [float(v) for v in self._transformer.transform(longitude, latitude, height)]


def origin_of(crs: str) -> list[float] | None:
    """Latitude, longitude and height that a world's coordinates begin at; None for a local one."""
    named = dict(word.lstrip("+").split("=", 1) for word in crs.split() if "=" in word)
    return [float(named[key]) for key in ("lat_0", "lon_0", "h_0")] if {"lat_0", "lon_0", "h_0"} <= set(named) else None


def local_frame(file: SiteFile, problems: Problems) -> LocalFrame | None:
    """The frame of all geodetic positions of a site; None where there are none."""
    positions = list(file.positions())
    geodetic = [(location, p.geodetic) for location, p in positions if p.geodetic is not None]
    if not geodetic:
        return None
    mixed = next((location for location, p in positions if p.geodetic is None), None)
    if mixed is not None:
        what = "x, y, z here, but latitude and longitude elsewhere: how they lie to each other is unknown"
        problems.add(mixed, what, POSITION_REMEDY)
    location, origin = geodetic[0]
    try:
        return LocalFrame(*origin)
    except ImportError:
        problems.add(location, "latitude and longitude need the package pyproj", "pip install pyproj")
        return None


def read_survey(file: SiteFile, frame: LocalFrame | None, problems: Problems) -> Survey:
    """Distances and control points, with cameras by number; what is wrong with them is added to `problems`."""
    number = {camera.id: k for k, camera in reversed(list(enumerate(file.cameras)))}

    def camera_at(location: Location, camera: Any) -> int:
        if not isinstance(camera, str) or camera not in number:
            problems.add(location, f"there is no camera {camera!r}", "use ids from 'cameras'")
            return 0
        return number[camera]

    rows = []
    for k, (left, right, metres) in enumerate(file.distances):
        i, j = camera_at(("distances", k, 0), left), camera_at(("distances", k, 1), right)
        if not isinstance(metres, int | float) or isinstance(metres, bool) or not 0 < metres < math.inf:
            problems.add(("distances", k, 2), f"{metres!r} is no distance in metres", "write [camera, camera, metres]")
        elif i == j:
            problems.add(("distances", k), "a camera has no distance from itself", "name two cameras")
        else:
            rows.append([float(i), float(j), float(metres)])
    observations = []
    for k, point in enumerate(file.control_points):
        if len(point.pixels) < 2:
            remedy = "point at it in the captures of two cameras or more, better three"
            problems.add(("control_points", k), "fewer than two cameras see it", remedy)
        for camera, (x, y) in point.pixels.items():
            observations.append([float(k), float(camera_at(("control_points", k, "pixels", camera), camera)), x, y])
    points = [frame.metres(*p.geodetic) if frame and p.geodetic else p.position or [0.0] * 3 for p in file.control_points]
    return Survey(tuple(camera.id for camera in file.cameras), rows, points, observations, frame.crs if frame else "")
