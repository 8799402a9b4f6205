"""Positions in a site file, by x, y, z or by latitude and longitude.

Geodetic positions become metres east, north and up of the first one that the file states (z up, so poses mean the same as ever).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from .locations import Document, Location, SiteProblem

Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
GEODETIC = ("latitude", "longitude", "height")

PLACE_REMEDY = (
    "give position: [x, y, z] in metres, or latitude, longitude (degrees, WGS 84) and height (metres above the ellipsoid)"
)


class Position(BaseModel):
    """A place: x, y, z in metres, or latitude, longitude, height."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    position: Vector3 | None = None
    latitude: float | None = Field(None, ge=-90, le=90)
    longitude: float | None = Field(None, ge=-180, le=360)
    height: float | None = None

    @model_validator(mode="after")
    def _one_place(self) -> Position:
        given = [name for name in GEODETIC if getattr(self, name) is not None]
        if self.position is not None and given:
            raise PydanticCustomError("place", f"'position' and '{given[0]}' say the same thing twice")
        if self.position is None and not given:
            raise PydanticCustomError("place", "'position' is missing")
        if given and len(given) < 3:
            missing = next(name for name in GEODETIC if name not in given)
            raise PydanticCustomError("place", f"'{missing}' is missing")
        return self

    @property
    def geodetic(self) -> tuple[float, float, float] | None:
        """latitude, longitude, height; None where x, y, z are given."""
        if self.latitude is None or self.longitude is None or self.height is None:
            return None
        return self.latitude, self.longitude, self.height


class ControlPoint(Position):
    """A place of the scene, and where it is in captures: pixels by camera, of a capture as it is."""

    id: str | None = None
    pixels: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]]


Distance = Annotated[list[Any], Field(min_length=3, max_length=3)]


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


def local_frame(
    positions: Iterator[tuple[Location, Position]], document: Document, problems: list[SiteProblem]
) -> LocalFrame | None:
    """The frame of all geodetic positions of a site; None where there are none.  Says where both kinds are mixed."""
    listed = list(positions)
    geodetic = [(place, p.geodetic) for place, p in listed if p.geodetic is not None]
    if not geodetic:
        return None
    mixed = next((place for place, p in listed if p.geodetic is None), None)
    if mixed is not None:
        what = "x, y, z here, but latitude and longitude elsewhere: how they lie to each other is unknown"
        problems.append(document.problem(mixed, what, PLACE_REMEDY))
    first = geodetic[0][1]
    assert first is not None
    try:
        return LocalFrame(*first)
    except ImportError:
        what, remedy = "latitude and longitude need the package pyproj", "pip install pyproj"
        problems.append(document.problem(geodetic[0][0], what, remedy))
        return None
