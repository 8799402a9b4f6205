"""What a site file says of the ground: geodetic positions, known distances, control points; in plain values for the stages.

Geodetic positions become metres east, north and up of the first one that the file states (z up, so poses mean the same as ever).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from .positions import Document, Place, Problem

Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
GEODETIC = ("latitude", "longitude", "height")

PLACE_REMEDY = (
    "give position: [x, y, z] in metres, or latitude, longitude (degrees, WGS 84) and height (metres above the ellipsoid)"
)


class Position(BaseModel):
    """A place: x, y, z in metres, or latitude, longitude, height."""

    model_config = ConfigDict(extra="forbid", strict=True)

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


def local_frame(positions: Iterator[tuple[Place, Position]], document: Document, problems: list[Problem]) -> LocalFrame | None:
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


def read_survey(
    cameras: list[str],
    distances: list[list[Any]],
    points: list[ControlPoint],
    frame: LocalFrame | None,
    document: Document,
    problems: list[Problem],
) -> dict[str, Any]:
    """The fields of `wbflow_stages.types.Survey`, as far as they say something."""
    number = {camera: k for k, camera in enumerate(cameras)}

    def camera_at(place: Place, camera: Any) -> int:
        if camera not in number:
            problems.append(document.problem(place, f"there is no camera {camera!r}", "use ids from 'cameras'"))
        return number.get(camera, 0)

    rows = []
    for k, (left, right, metres) in enumerate(distances):
        i, j = camera_at(("distances", k, 0), left), camera_at(("distances", k, 1), right)
        if not isinstance(metres, int | float) or isinstance(metres, bool) or metres <= 0:
            what = f"{metres!r} is no distance in metres"
            problems.append(document.problem(("distances", k, 2), what, "write [camera, camera, metres]"))
        elif i == j:
            problems.append(document.problem(("distances", k), "a camera has no distance from itself", "name two cameras"))
        else:
            rows.append([float(i), float(j), float(metres)])
    observations = []
    for k, point in enumerate(points):
        if len(point.pixels) < 2:
            remedy = "point at it in the captures of two cameras or more, better three"
            problems.append(document.problem(("control_points", k), "fewer than two cameras see it", remedy))
        for camera, (x, y) in point.pixels.items():
            observations.append([float(k), float(camera_at(("control_points", k, "pixels", camera), camera)), x, y])
    where = [frame.metres(*point.geodetic) if frame and point.geodetic else point.position or [0.0] * 3 for point in points]
    found: dict[str, Any] = {"cameras": tuple(cameras), "crs": frame.crs if frame else ""}
    found |= {"distances": rows} if rows else {}
    return found | ({"points": where, "observations": observations} if points else {})
