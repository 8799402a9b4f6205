"""Cameras and changes as map features: GeoJSON in degrees, and GeoPackage in UTM like the other exports.

References: RFC 7946, The GeoJSON Format, 2016; OGC 12-128r18, GeoPackage Encoding Standard 1.3.1, 2021.
"""

from __future__ import annotations

import datetime
import json
import struct
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..types import Camera, Change, Float64s
from .world import Georeference


@dataclass(frozen=True)
class Feature:
    """A world point with its properties."""

    position: Float64s
    """(3,) in the world."""
    properties: dict[str, str | float | int]
    """Values by name; all features of a layer have the same names."""


def camera_features(cameras: Mapping[str, Camera]) -> list[Feature]:
    """Return a feature for each camera, at its position, with its name and compass heading in degrees."""
    features = []
    for name, camera in cameras.items():
        east, north, _ = camera.R[2]  # the optical axis in the world
        # clockwise from north
        heading = round(float(np.degrees(np.arctan2(east, north))) % 360, 2)
        features.append(Feature(camera.C, {"camera": name, "heading_deg": heading}))
    return features


def change_features(changes: Mapping[str, Change]) -> list[Feature]:
    """Return a feature for each change, at its centre."""
    features = []
    for change in changes.values():
        centre = np.array([change.x, change.y, change.z])
        features.append(Feature(centre, dict(vars(change))))
    return features


def geojson_bytes(features: list[Feature], place: Georeference) -> bytes:
    """Return a FeatureCollection: longitude, latitude in degrees, height in metres above the ellipsoid."""
    entries = []
    for feature in features:
        longitude, latitude, height = place.degrees(feature.position)
        # to a millimetre: 1e-8 degrees are 1.1 mm at the equator
        coordinates = [round(longitude, 8), round(latitude, 8), round(height, 3)]
        point = {"type": "Point", "coordinates": coordinates}
        entries.append({"type": "Feature", "geometry": point, "properties": feature.properties})
    return (json.dumps({"type": "FeatureCollection", "features": entries}, indent=1) + "\n").encode()


def geopackage_bytes(layers: dict[str, list[Feature]], place: Georeference, day: datetime.date) -> bytes:
    """Return a GeoPackage with a layer of points for each list of features that is not empty.

    day: written to the file as the time of its last change.
    """
    import pyogrio  # an optional dependency of this format only
    import pyogrio.raw

    wkb = struct.Struct("<BI3d")  # well-known binary of a point: byte order, type, coordinates
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": f"{day}T00:00:00.000Z"})  # for reproducible bytes
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "site.gpkg"
        for layer, features in layers.items():
            if not features:
                continue
            points = place.points(np.array([feature.position for feature in features]))
            names = list(features[0].properties)
            columns: list[Any] = [_column(features, name) for name in names]
            # 1: little-endian, 1001: a point with height
            shapes = np.array([wkb.pack(1, 1001, *point) for point in points], dtype=object)
            # the first layer creates the file, the next ones are added to it
            pyogrio.raw.write(
                *(path, shapes, columns, names),
                layer=layer, driver="GPKG", geometry_type="Point Z", crs=f"EPSG:{place.epsg}", append=path.exists(),
            )  # fmt: skip
        return path.read_bytes()


def _column(features: list[Feature], name: str) -> np.ndarray:
    """(n,) values of one property; GDAL takes texts as objects only."""
    column = np.array([feature.properties[name] for feature in features])
    if column.dtype.kind == "U":
        return column.astype(object)
    return column
