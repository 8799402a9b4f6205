"""Geodetic positions, converted to metres east, north and up (z up) of the first one in the site file."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..errors import Location
from .yaml_document import Problems

if TYPE_CHECKING:
    from .models import Position, SiteFile

POSITION_REMEDY = (
    "give position: [x, y, z] in metres, or latitude, longitude (degrees, WGS 84) and height (metres above the ellipsoid)"
)


class LocalFrame:
    """East, north, up around an origin given in WGS 84 coordinates."""

    def __init__(self, latitude: float, longitude: float, height: float) -> None:
        from pyproj import Transformer  # here: only sites with geodetic positions need it

        self.crs = f"+proj=topocentric +ellps=WGS84 +lat_0={latitude!r} +lon_0={longitude!r} +h_0={height!r}"
        steps = "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 +step "
        self._transformer = Transformer.from_pipeline(steps + self.crs)

    def metres(self, latitude: float, longitude: float, height: float) -> list[float]:
        """[east, north, up]."""
        return [float(v) for v in self._transformer.transform(longitude, latitude, height)]

    def metres_of(self, geodetic: array[float]) -> array[float]:
        """East, north and up of places, one after the other; geodetic: their latitudes, longitudes and heights."""
        east, north, up = self._transformer.transform(geodetic[1::3], geodetic[0::3], geodetic[2::3])
        metres = array("d", geodetic)
        metres[0::3] = array("d", east)
        metres[1::3] = array("d", north)
        metres[2::3] = array("d", up)
        return metres


def origin_of(crs: str) -> list[float] | None:
    """Latitude, longitude and height of the origin of a coordinate system; None for a local one."""
    parameters: dict[str, str] = {}
    for word in crs.split():  # such as +lat_0=53.5
        name, equals, value = word.lstrip("+").partition("=")
        if equals:
            parameters[name] = value
    keys = ("lat_0", "lon_0", "h_0")
    if not parameters.keys() >= set(keys):
        return None
    return [float(parameters[key]) for key in keys]


def local_frame(file: SiteFile, thing: Sequence[float] | None, problems: Problems) -> LocalFrame | None:
    """The local frame of a site's geodetic positions; None if there are none.

    thing: the first position of an observed thing (see `observations`), if its positions are geodetic.
    """
    positions: dict[Location, Position] = {}
    for k, camera in enumerate(file.cameras):
        if camera.pose:
            positions["cameras", k, "pose"] = camera.pose
    for k, point in enumerate(file.control_points):
        positions["control_points", k] = point
    geodetic = {location: position.geodetic for location, position in positions.items() if position.geodetic}
    if thing is not None:
        geodetic["survey",] = (thing[0], thing[1], thing[2])
    if not geodetic:
        return None
    local = [location for location in positions if location not in geodetic]
    if local:
        what = "x, y, z here, but latitude and longitude elsewhere: the transformation between the two is unknown"
        problems.add(local[0], what, POSITION_REMEDY)
    # the first one is the origin, so that adding a camera at the end moves nothing
    location, origin = next(iter(geodetic.items()))
    try:
        return LocalFrame(*origin)
    except ImportError:
        problems.add(location, "latitude and longitude need the package pyproj", "pip install pyproj")
        return None
