"""What is drawn in the page, as it arrives from there, and its way into the text of the site file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import Field

from ..site.locations import Location
from ..site.models import ControlPoint, Section, Site, Vector2, Vector3, Zone
from .splice import append, put, remove

Corners = list[Vector2]


class Drawn(Section):
    """Something that the site file may hold already."""

    was: int | None = None
    """Its place in the file's list; None: it is new."""


class PolygonMark(Drawn):
    """A privacy polygon."""

    corners: Corners


class MaskArea(Section):
    """A polygon that is painted over a camera's mask."""

    use: bool
    """Its pixels may be used."""
    corners: Annotated[Corners, Field(min_length=3)]


class ZoneMark(Drawn):
    """A zone."""

    name: str
    corners: Corners
    least_m: float = 0.0


class PointMark(Drawn):
    """A control point."""

    id: str = ""
    position: Vector3 | None = None
    """x, y, z; or latitude, longitude, height, in a site that has those; None: not stated."""
    pixels: dict[str, Vector2] = Field(default_factory=dict)


class CameraMarks(Section):
    """What is drawn in one camera's picture."""

    privacy: list[PolygonMark] = Field(default_factory=list)
    mask: list[MaskArea] = Field(default_factory=list)


class Marks(Section):
    """All that is drawn."""

    cameras: dict[str, CameraMarks] = Field(default_factory=dict)
    """Those in which something was drawn."""
    zones: list[ZoneMark] = Field(default_factory=list)
    points: list[PointMark] = Field(default_factory=list)


def edited(text: str, site: Site, marks: Marks, masks: Mapping[str, str]) -> str:
    """Return the text of a site file with what is drawn.

    Parameters
    ----------
    text : str
        As it is.
    site : Site
        What it says.
    marks : Marks
        What it should say.
    masks : mapping
        Paths of masks that are new, by camera.

    Raises
    ------
    NotEditable
        A value is written in a form that cannot be changed.
    """
    file, geodetic = site.settings, bool(site.survey.crs)
    for k, camera in enumerate(file.cameras):
        if (drawn := marks.cameras.get(camera.id)) is None:
            continue
        at: Location = ("cameras", k)
        changes: dict[str, Any] = {"mask": masks[camera.id]} if camera.id in masks else {}
        polygons = [(mark.was, mark.corners) for mark in drawn.privacy]
        if not isinstance(site.document.data["cameras"][k], dict):  # its id alone
            changes |= {"privacy": _numbers([corners for _, corners in polygons])} if polygons else {}
            text = put(text, at, {"id": camera.id, **changes}) if changes else text
            continue
        for key, value in changes.items():
            text = put(text, (*at, key), value)
        text = _listed(text, (*at, "privacy"), camera.privacy, polygons)
    zones = [(mark.was, _zone(mark)) for mark in marks.zones]
    text = _listed(text, ("zones",), [_zone_of(zone) for zone in file.zones or ()], zones)
    points = [(mark.was, _point(mark, geodetic)) for mark in marks.points]
    return _listed(text, ("control_points",), [_point_of(point) for point in file.control_points], points)


def _listed(text: str, location: Location, there: Sequence[Any], wanted: Sequence[tuple[int | None, Any]]) -> str:
    """The text with a list as it is wanted: items that stay keep their text, but for what differs."""
    kept = {was: value for was, value in wanted if was is not None and was < len(there)}
    for k, before in enumerate(there):
        if k in kept:
            text = _changed(text, (*location, k), before, kept[k])
    for k in reversed(range(len(there))):
        if k not in kept:
            text = remove(text, (*location, k))
    new = [value for was, value in wanted if was is None or was >= len(there)]
    if new and not kept:
        return put(text, location, _numbers(new))
    for value in new:
        text = append(text, location, _numbers(value))
    return text


def _changed(text: str, location: Location, before: Any, after: Any) -> str:
    if before == after:
        return text
    if isinstance(before, dict) and before.keys() <= after.keys():
        for key, value in after.items():
            text = _changed(text, (*location, key), before.get(key), value)
        return text
    return put(text, location, _numbers(after))


def _zone(mark: ZoneMark) -> dict[str, Any]:
    least = {"least_m": mark.least_m} if mark.least_m else {}
    return {"name": mark.name, "polygon": mark.corners, **least}


def _zone_of(zone: Zone) -> dict[str, Any]:
    return _zone(ZoneMark(name=zone.name, corners=zone.polygon, least_m=zone.least_m))


def _point(mark: PointMark, geodetic: bool) -> dict[str, Any]:
    names = ("latitude", "longitude", "height")
    where: dict[str, Any] = {}
    if mark.position is not None:
        where = dict(zip(names, mark.position, strict=True)) if geodetic else {"position": mark.position}
    return {**({"id": mark.id} if mark.id else {}), **where, "pixels": mark.pixels}


def _point_of(point: ControlPoint) -> dict[str, Any]:
    where = point.position if point.geodetic is None else list(point.geodetic)
    mark = PointMark(id=point.id or "", position=where, pixels=point.pixels)
    return _point(mark, point.geodetic is not None)


def _numbers(value: Any) -> Any:
    """The same with whole numbers written as such."""
    if isinstance(value, dict):
        return {key: _numbers(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_numbers(inner) for inner in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value
