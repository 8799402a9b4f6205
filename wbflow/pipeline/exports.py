"""The forms in which results leave the engine: which function of the vision makes each, and of what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

_CLOUD, _POSES, _FRAMES = ("fuse",), ("poses",), ("frames",)


@dataclass(frozen=True)
class Export:
    """A form in which a run is exported: one option of `wbflow export`.

    The function that is called as it is gets what it needs by name and yields names and bytes of files; a ValueError says why
    there is nothing to make.
    """

    name: str
    help: str
    """Text of the option in `wbflow export --help`."""
    inputs: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {"cloud": _CLOUD, "poses": _POSES})
    """By argument name: the cloud, what a stage of the site gave (None: nothing), or of every camera or pair (as a mapping) what
    the first of these stages gave."""
    dated: bool = False
    """Takes the night's date, too, as `day`."""
    extra: str = ""
    extra_on_the_map: str = ""
    """The extra of this package that it needs, always or where the site is georeferenced."""

    @property
    def function(self) -> str:
        """Dotted: package.module:function."""
        return f"wbflow_stages.exports.forms:{self.name}"


EXTRAS: Mapping[str, tuple[str, ...]] = {
    "las": ("laspy", "lazrs", "pyproj", "copclib"),
    "e57": ("pye57",),
    "geo": ("rasterio", "pyproj", "pyogrio"),
}
"""Packages of the extras that exports may need."""

EXPORTS: tuple[Export, ...] = (
    Export("laz", "The cloud as LAZ, on the map where positions are known by latitude and longitude.", dated=True, extra="las"),
    Export("copc", "The cloud as COPC: LAZ that viewers and QGIS read in parts.", dated=True, extra="las"),
    Export(
        "tiles",
        "The cloud as 3D Tiles, which Cesium and iTowns stream, on the globe where the site is on the map.",
        extra_on_the_map="geo",
    ),
    Export("e57", "The cloud as E57, on the map like LAZ; intensity is the confidence.", extra="e57"),
    Export("heights", "Heights seen from above: GeoTIFF where the site is on the map, else PNG and PFM.", extra_on_the_map="geo"),
    Export("depth", "Depth map of each camera: 16-bit PNG and PFM.", {"poses": _POSES, "depths": ("refine", "depth")}),
    Export(
        "mesh",
        "The surface through the cloud (Poisson): PLY, and OBJ with the photographs on it.",
        {"cloud": _CLOUD, "poses": _POSES, "frames": _FRAMES},
    ),
    Export(
        "orthophoto",
        "The site from straight above: GeoTIFF, or PNG with its world file.",
        {"cloud": _CLOUD, "poses": _POSES, "frames": _FRAMES},
        extra_on_the_map="geo",
    ),
    Export(
        "geojson",
        "Cameras and changes as GeoJSON, of a site on the map.",
        {"poses": _POSES, "changes": ("changes",)},
        extra="geo",
    ),
    Export(
        "gpkg",
        "Cameras and changes as a GeoPackage, of a site on the map.",
        {"poses": _POSES, "changes": ("changes",)},
        dated=True,
        extra="geo",
    ),
    Export(
        "colmap",
        "Cameras, images and points as a COLMAP model.",
        {"cloud": _CLOUD, "poses": _POSES, "frames": _FRAMES, "geometries": ("geometry",)},
    ),
)

SCANS = (".las", ".laz", ".e57", ".ply", ".pcd", ".xyz", ".obj", ".stl", ".off")
"""How names of scans and models end."""
