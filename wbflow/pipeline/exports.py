"""The export formats: which function of `wbflow_stages` makes each, and from which results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

_CLOUD = ("fuse",)
_POSES = ("poses",)
_FRAMES = ("frames",)
_DEPTHS = ("refine", "depth")


@dataclass(frozen=True)
class Export:
    """A format in which a run is exported: one option of `wbflow export`.

    The function of the same name gets its inputs by argument name, and yields names and bytes of files.  It raises ValueError,
    with the reason, if there is nothing to export.
    """

    name: str
    help: str
    """Text of the option in `wbflow export --help`."""
    inputs: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {"cloud": _CLOUD, "poses": _POSES})
    """Stages by argument name.  The function gets the cloud for `fuse`; the result, or None, for another site-wide stage; else a
    mapping by camera or pair, with the result of the first of the stages that has one."""
    dated: bool = False
    """Does the function also take the date of the night, as `day`?"""
    extra: str = ""
    """The extra of this package that the format needs; "": none."""
    extra_on_the_map: str = ""
    """The extra that it needs only if the site is georeferenced."""

    @property
    def function(self) -> str:
        """Dotted name, package.module:function."""
        return f"wbflow_stages.exports.forms:{self.name}"


EXTRAS: Mapping[str, tuple[str, ...]] = {
    "las": ("laspy", "lazrs", "pyproj", "copclib"),
    "e57": ("pye57",),
    "geo": ("rasterio", "pyproj", "pyogrio"),
}
"""The packages in each extra that exports may need."""

EXPORTS: tuple[Export, ...] = (
    Export("laz", "The cloud as LAZ, on the map where positions are known by latitude and longitude.", dated=True, extra="las"),
    Export("copc", "The cloud as COPC: LAZ that viewers and QGIS read in parts.", dated=True, extra="las"),
    Export(
        "tiles",
        "The cloud as 3D Tiles, which Cesium and iTowns stream, on the globe where the site is on the map.",
        extra_on_the_map="geo",
    ),
    Export("e57", "The cloud as E57, on the map like LAZ; intensity is the confidence.", extra="e57"),
    Export("heights", "Heights seen from above as GeoTIFF, on the map like LAZ.", extra="geo"),
    Export("depth", "Depth map of each camera: 16-bit PNG and PFM.", {"poses": _POSES, "depths": _DEPTHS}),
    Export(
        "mesh",
        "The surface through the cloud (Poisson): PLY, and OBJ with the photographs on it.",
        {"cloud": _CLOUD, "poses": _POSES, "frames": _FRAMES},
    ),
    Export(
        "orthophoto",
        "The site from straight above as GeoTIFF, on the map like LAZ.",
        {"cloud": _CLOUD, "poses": _POSES, "frames": _FRAMES},
        extra="geo",
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
        "Cameras, images, tracks and the whole cloud as a workspace of COLMAP.",
        {"cloud": _CLOUD, "poses": _POSES, "frames": _FRAMES, "geometries": ("geometry",), "depths": _DEPTHS},
    ),
)

SCANS = (".las", ".laz", ".e57", ".ply", ".pcd", ".xyz", ".obj", ".stl", ".off")
"""File name suffixes of scans and models."""
