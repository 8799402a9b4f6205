"""Maps of the ground's coverage and of its changes: pictures, and files for other programs."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np

from ..core.ground_grid import cell_centres
from ..io.clouds import Columns
from ..io.rasters import geotiff, jpeg, png
from ..types import Camera, Change, Changes, Coverage, CutFill, Float32s, Float64s, GroundGrid, Poses, Uint8s

_WIDTH = 640
"""Longer side of a map, pixels, before it is extended for cameras: cells get as many whole pixels as fit."""
_PHONE_WIDTH_PX = 350
"""Width of a picture of the report on a phone, pixels."""
_LETTERS_PX = 11
"""Height of the letters there, pixels, with what reaches below the line."""
_FONT_PX = 30
"""The same height of OpenCV's letters at scale 1, pixels."""
_QUALITY = 85
"""JPEG quality of pictures, per cent."""
_BACKGROUND = (24, 24, 24)
"""Colour of places of which nothing is known, RGB."""
_MARGIN_PX = 20
"""Distance of cameras from the edge of a map, pixels."""
_GAP_PX = 4
"""Width of the white gap between the pictures of both nights, pixels."""
_NEAREST_CELL = 0.75
"""A pixel of a GeoTIFF shows a cell whose centre is within this many cell widths: a little more than half a diagonal."""
_COLOURS = ((196, 60, 50), (232, 150, 50), (240, 215, 90), (150, 205, 95), (60, 170, 90), (25, 120, 110), (20, 80, 120))
"""Colours for 0, 1, 2, ... cameras, RGB; the last one also stands for more."""
_MOST_VIEWS = len(_COLOURS) - 1
"""Number of cameras from which on the colour stays the same."""


def coverage_files(coverage: Coverage) -> Iterator[tuple[str, bytes]]:
    """coverage.png, and coverage.tif if the site is georeferenced: cameras, angle and expected error of each cell."""
    yield "coverage.png", png(_map(coverage))
    if coverage.crs:
        views = np.where(np.isfinite(coverage.heights), coverage.views, np.nan).astype(np.float32)
        layers = {
            "cameras that see it": views,
            "best angle between rays, degrees": coverage.angle_deg,
            "expected error, metres": coverage.error,
        }
        yield "coverage.tif", _map_geotiff(coverage.grid, coverage.heights, layers, coverage.crs)


def coverage_layer(coverage: Coverage) -> bytes:
    """Coverage for the report's map: length of a JSON header (uint32, little-endian), the header, and a PNG, transparent where
    unknown.  The header holds three corners of the image in the world, at ground height, and the legend of its colours."""
    grid = coverage.grid
    known = np.isfinite(coverage.heights)
    level = float(np.median(coverage.heights[known])) if known.any() else 0.0
    right = grid.left + grid.columns * grid.cell
    bottom = grid.top - grid.rows * grid.cell
    corners = [(grid.left, grid.top, level), (right, grid.top, level), (grid.left, bottom, level)]
    colours = np.array(_COLOURS, np.uint8)[np.minimum(coverage.views, _MOST_VIEWS)]
    opacity = np.where(known, 255, 0).astype(np.uint8)
    image = np.dstack([colours, opacity])
    legend = []
    for views, (red, green, blue) in enumerate(_COLOURS):
        label = f"{views} or more" if views == _MOST_VIEWS else str(views)
        legend.append([label, f"#{red:02x}{green:02x}{blue:02x}"])
    metadata = {"corners": (np.array(corners) @ grid.axes).tolist(), "legend": legend, "words": "cameras that see the ground"}
    header = json.dumps(metadata).encode()
    return struct.pack("<I", len(header)) + header + png(image)


def coverage_preview(coverage: Coverage, poses: Poses | None = None) -> Uint8s:
    """Number of cameras that see each place, from above, as the bytes of a JPEG file; poses: also draw their cameras."""
    return jpeg(_map(coverage, poses.main_cameras() if poses else None), _QUALITY)


def _map_geotiff(grid: GroundGrid, heights: Float32s, layers: Mapping[str, Float32s], crs: str) -> bytes:
    """GeoTIFF of layers (rows, columns) by description, in the UTM zone of the site, whose local frame is `crs`.

    heights: (rows, columns) of the surface along the grid's up axis; their median suffices, as positions on the map hardly
    depend on height.  Raises ValueError for a site outside UTM.
    """
    from scipy.spatial import cKDTree

    from .world import georeference  # imported here: only georeferenced sites need it

    reference = georeference(crs)
    level = float(np.nanmedian(heights)) if np.isfinite(heights).any() else 0.0
    centres = reference.points(cell_centres(grid, np.full(heights.shape, level)))[:, :2]
    # pixels as wide as the cells, on whole multiples of that width, north up: the site's own grid is turned against them
    low = np.floor(centres.min(axis=0) / grid.cell)
    high = np.ceil(centres.max(axis=0) / grid.cell)
    columns, rows = (high - low).astype(int)
    easting = (low[0] + np.arange(columns) + 0.5) * grid.cell
    northing = (high[1] - np.arange(rows) - 0.5) * grid.cell
    x, y = np.meshgrid(easting, northing)
    # each pixel shows the nearest cell, if there is one
    distance, nearest = cKDTree(centres).query(np.column_stack([x.ravel(), y.ravel()]), workers=1)
    inside = distance < _NEAREST_CELL * grid.cell
    bands = []
    for values in layers.values():
        band = np.where(inside, values.ravel()[nearest], np.nan)
        bands.append(band.reshape(rows, columns).astype(np.float32))
    left = low[0] * grid.cell
    top = high[1] * grid.cell
    return geotiff(np.stack(bands), left, top, grid.cell, reference.epsg, [*layers])


def _map(coverage: Coverage, cameras: Mapping[str, Camera] | None = None) -> Uint8s:
    """(h, w, 3) uint8: number of cameras as colours, the cameras, and a legend below."""
    known = np.isfinite(coverage.heights)
    colours = np.array(_COLOURS, np.uint8)[np.minimum(coverage.views, _MOST_VIEWS)]
    colours = np.where(known[..., None], colours, np.array(_BACKGROUND, np.uint8)).astype(np.uint8)
    return _with_legend(draw_plan(coverage.grid, colours, cameras or {}))


def draw_plan(grid: GroundGrid, colours: Uint8s, cameras: Mapping[str, Camera]) -> Uint8s:
    """Image of the cells (rows, columns, 3) as squares, and of cameras as triangles that open in the viewing direction; it is
    extended to hold the cameras with a margin."""
    scale = max(1, _WIDTH // max(grid.columns, grid.rows))
    image = np.repeat(np.repeat(colours, scale, axis=0), scale, axis=1)
    if not cameras:
        return image
    # extend the image for the cameras, by at most half its size on each side: far ones are not shown
    pixels = np.array([_grid_pixel(grid, camera.C, scale) for camera in cameras.values()])
    width = image.shape[1]
    height = image.shape[0]
    size = np.array([width, height])
    shift = np.clip(np.ceil(_MARGIN_PX - pixels.min(axis=0)), 0, size / 2).astype(int)
    end_margin = np.clip(np.ceil(pixels.max(axis=0) + _MARGIN_PX - size), 0, size / 2).astype(int)
    canvas_width, canvas_height = size + shift + end_margin
    canvas = np.full((canvas_height, canvas_width, 3), _BACKGROUND, np.uint8)
    left, top = shift
    canvas[top : top + height, left : left + width] = image
    white = (255, 255, 255)
    for pixel, (name, camera) in zip(pixels + shift, cameras.items(), strict=True):
        ahead = grid.axes[:2] @ camera.R[2] * (1.0, -1.0)  # rows grow southwards
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        across = np.array([-ahead[1], ahead[0]])
        corners = pixel + np.array([np.zeros(2), 22 * ahead + 10 * across, 22 * ahead - 10 * across])
        cv2.polylines(canvas, [np.round(corners).astype(np.int32)], True, white, 2, cv2.LINE_AA)
        x, y = (pixel + 6).astype(int).tolist()
        _write(canvas, name, (x, y), white)
    return np.asarray(canvas, dtype=np.uint8)


def _letter_scale(width: int) -> float:
    """Scale of OpenCV's letters in a picture of this width that people can still read on a phone."""
    return _LETTERS_PX * width / (_PHONE_WIDTH_PX * _FONT_PX)


def _write(image: Uint8s, text: str, place: tuple[int, int], colour: tuple[int, int, int], outline: bool = False) -> None:
    """Write a text into a picture, moved so that all of it is inside.

    Parameters
    ----------
    image : (h, w, 3) uint8
        The picture, which is changed.
    text : str
    place : tuple of int
        x and y of the beginning of the line, pixels.
    colour : tuple of int
        RGB.
    outline : bool
        Draw a black outline, which shows on any background?
    """
    height, width = image.shape[:2]
    scale = _letter_scale(width)
    thickness = max(1, round(1.5 * scale))
    (text_width, text_height), below = cv2.getTextSize(text, 0, scale, thickness)
    x = min(place[0], width - text_width - 2)
    y = min(place[1], height - below - 2)
    start = max(x, 2), max(y, text_height + 2)
    if outline:
        cv2.putText(image, text, start, 0, scale, (0, 0, 0), 3 * thickness, cv2.LINE_AA)
    cv2.putText(image, text, start, 0, scale, colour, thickness, cv2.LINE_AA)


def _grid_pixel(grid: GroundGrid, X: Float64s, scale: float) -> Float64s:
    """(2,) pixel of a point (3,) on a plan of the grid; scale: pixels of a cell."""
    east, north = grid.axes[:2] @ X
    column = (east - grid.left) / grid.cell * scale
    row = (grid.top - north) / grid.cell * scale
    return np.array([column, row])


def _with_legend(image: Uint8s) -> Uint8s:
    """The image with a strip below that shows the colours and their numbers of cameras."""
    height, width = image.shape[:2]
    side = round(_letter_scale(width) * _FONT_PX)  # of each coloured square, as high as the letters
    gap = side // 2
    canvas = np.full((height + side + 2 * gap, width, 3), _BACKGROUND, np.uint8)
    canvas[:height] = image
    for k, colour in enumerate(_COLOURS):
        x = gap + (width - gap) * k // len(_COLOURS)
        y = height + gap
        cv2.rectangle(canvas, (x, y), (x + side, y + side), colour, -1)
        label = f"{k}+" if k == _MOST_VIEWS else str(k)
        _write(canvas, label, (x + side + gap // 2, y + side - side // 6), (230, 230, 230))
    return np.asarray(canvas, dtype=np.uint8)


_FULL_COLOUR_PERCENT = 2.0
"""Height difference, in percent of the map's width, from which on the colour is full."""
_MOST_CROPS = 6
"""Number of changes whose images the report shows."""


def changes_files(changes: Changes) -> Iterator[tuple[str, bytes | Columns]]:
    """changes.ply (as columns), changes.json, pictures of each change (before, after, and side by side), and changes.tif if the
    site is georeferenced; nothing if there was no night to compare with."""
    if not changes.compared:
        return
    columns: Columns = {
        "x": changes.points[:, 0],
        "y": changes.points[:, 1],
        "z": changes.points[:, 2],
        "red": changes.colors[:, 0],
        "green": changes.colors[:, 1],
        "blue": changes.colors[:, 2],
        "distance": changes.distance,
        "sigma": changes.sigma,
        "significance": changes.significance,
        "label": changes.label,
        "blob": changes.blob,
    }
    yield "changes.ply", columns
    yield "changes.json", (json.dumps(changes_data(changes), indent=1) + "\n").encode()
    for name in changes.changes:
        for role, image in _pictures_of(changes, name).items():
            yield _picture_file(name, role), jpeg(image, _QUALITY).tobytes()
    if changes.crs:
        layers = {"tonight's height less that of the reference, metres": changes.difference}
        yield "changes.tif", _map_geotiff(changes.grid, changes.difference, layers, changes.crs)


def _pictures_of(changes: Changes, name: str) -> dict[str, Uint8s]:
    """The pictures (h, w, 3) of a change: "before" and "after" as far as these nights show it, and "picture", side by side."""
    pictures = {}
    if name in changes.before:
        pictures["before"] = changes.before[name]
    if name in changes.after:
        pictures["after"] = changes.after[name]
    if pictures:
        pictures["picture"] = _side_by_side(list(pictures.values()))
    return pictures


def _picture_file(name: str, role: str) -> str:
    """The name of the file of a picture of a change; name: its id; role: as in `_pictures_of`."""
    return f"change-{name}.jpg" if role == "picture" else f"change-{name}-{role}.jpg"


def _side_by_side(images: list[Uint8s]) -> Uint8s:
    """One picture of images (h, w, 3) of the same height, with a white gap between them."""
    gap = np.full((images[0].shape[0], _GAP_PX, 3), 255, np.uint8)
    parts = [images[0]]
    for image in images[1:]:
        parts += [gap, image]
    return np.hstack(parts)


def changes_data(changes: Changes) -> dict[str, Any]:
    """Content of changes.json: the changes with their ids, volumes of the site and its zones, changed and unknown shares."""
    data: dict[str, Any] = {
        "unit": "m" if changes.metric else "arbitrary",
        "changed_share": round(changes.changed_share, 5),
        "unknown_share": round(changes.unknown_share, 5),
        "noise": round(changes.noise, 5),
    }
    if changes.cut_fill:
        data["cut_fill"] = _volumes(changes.cut_fill)
    data["zones"] = {name: _volumes(zone) for name, zone in changes.zones.items()}
    data["changes"] = [_change_entry(name, change, list(_pictures_of(changes, name))) for name, change in changes.changes.items()]
    return data


def _change_entry(name: str, change: Change, pictures: list[str]) -> dict[str, Any]:
    """One change of changes.json; entries that do not apply to it are left out.  pictures: what there is of `_pictures_of`."""
    entry: dict[str, Any] = {
        "id": name,
        "kind": change.kind,
        "position": [round(change.x, 3), round(change.y, 3), round(change.z, 3)],
        "length": round(change.length, 3),
        "width": round(change.width, 3),
        "height": round(change.height, 3),
        "area": round(change.area, 3),
        "volume": round(change.volume, 3),
        "volume_sigma": round(change.volume_sigma, 3),
        "volume_least": round(change.volume_least, 3),
        "volume_most": round(change.volume_most, 3),
        "nights": change.nights,
        "seen": change.seen,
        "significance": round(change.significance, 3),
        "points": round(change.points, 3),
    }
    if change.likeness >= -1:  # -2 where the photographs show nothing
        entry["likeness"] = round(change.likeness, 3)
    entry["cameras"] = change.cameras.split(",") if change.cameras else []
    if change.zone:
        entry["zone"] = change.zone
    if change.kind == "moved":
        entry["from"] = [round(change.from_x, 3), round(change.from_y, 3), round(change.from_z, 3)]
    for role in pictures:
        entry[role] = _picture_file(name, role)
    return entry


def _volumes(part: CutFill) -> dict[str, float]:
    """Volumes as in changes.json."""
    return {name: round(value, 4) for name, value in vars(part).items()}


def changes_preview(changes: Changes) -> Uint8s:
    """Height differences from above with circled, labelled changes, and images before and after, as the bytes of a JPEG file."""
    if not changes.compared or not changes.grid.rows:
        return jpeg(np.full((40, 480, 3), 24, np.uint8), _QUALITY)
    # 1. height differences: white where nothing changed, towards red where raised, towards blue where lowered
    known = np.isfinite(changes.difference)
    full_height = max(0.01 * _FULL_COLOUR_PERCENT * changes.grid.cell * changes.grid.columns, 1e-9)
    share = np.clip(np.nan_to_num(changes.difference) / full_height, -1, 1)[..., None]
    paper = np.array([225.0, 225.0, 225.0])
    raised = np.array([200.0, 40.0, 30.0])
    lowered = np.array([30.0, 80.0, 200.0])
    colours = np.where(share > 0, paper + share * (raised - paper), paper - share * (lowered - paper))
    image = draw_plan(changes.grid, np.where(known[..., None], colours, 24).astype(np.uint8), {})
    _mark(image, changes)

    # 2. images of the first changes below, padded to one width
    panels = [image]
    for name in changes.changes:
        both_nights = _pictures_of(changes, name).get("picture")
        if both_nights is not None and len(panels) <= _MOST_CROPS:
            panels.append(_with_label(both_nights, name))
    width = max(panel.shape[1] for panel in panels)
    padded = []
    for panel in panels:
        padded.append(np.pad(panel, ((0, 6), (0, width - panel.shape[1]), (0, 0)), constant_values=24))
    return jpeg(np.vstack(padded), _QUALITY)


def _mark(image: Uint8s, changes: Changes) -> None:
    """Draw a circle and the id of each change into a plan of the grid."""
    grid = changes.grid
    scale = image.shape[1] / grid.columns
    for name, change in changes.changes.items():
        east, north, _ = grid.axes @ (change.x, change.y, change.z)
        x = (east - grid.left) / grid.cell * scale
        y = (grid.top - north) / grid.cell * scale
        radius = max(6.0, 0.6 * np.hypot(change.length, change.width) / grid.cell * scale)
        cv2.circle(image, (round(x), round(y)), round(radius), (20, 20, 20), 2, cv2.LINE_AA)
        _write(image, name, (round(x + radius), round(y - 4)), (255, 255, 255), outline=True)


def _with_label(crop: Uint8s, label: str) -> Uint8s:
    """The picture with a label in white on a black outline, which shows on any background."""
    labelled = crop.copy()
    _write(labelled, label, (6, 0), (255, 255, 255), outline=True)
    return labelled
