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
from ..types import Camera, Changes, Coverage, CutFill, Float32s, Float64s, GroundGrid, Poses, Uint8s

_WIDTH = 960
_QUALITY = 85
_BACKGROUND = (24, 24, 24)
_COLOURS = ((196, 60, 50), (232, 150, 50), (240, 215, 90), (150, 205, 95), (60, 170, 90), (25, 120, 110), (20, 80, 120))
"""Colours for 0, 1, 2, ... cameras; the last one also stands for more."""


def coverage_files(coverage: Coverage) -> Iterator[tuple[str, bytes]]:
    """coverage.png, and coverage.tif if the site is georeferenced: cameras, angle and expected error of each cell."""
    yield "coverage.png", png(_map(coverage))
    if coverage.crs:
        layers = {
            "cameras that see it": np.where(np.isfinite(coverage.heights), coverage.views, np.nan).astype(np.float32),
            "best angle between rays, degrees": coverage.angle_deg,
            "expected error, metres": coverage.error,
        }
        yield "coverage.tif", _map_geotiff(coverage.grid, coverage.heights, layers, coverage.crs)


def coverage_layer(coverage: Coverage) -> bytes:
    """Coverage for the report's map: length of a JSON header (uint32, little-endian), the header, and a PNG, transparent where
    unknown.  The header holds three corners of the image in the world, at ground height, and the legend of its colours."""
    grid, known = coverage.grid, np.isfinite(coverage.heights)
    level = float(np.median(coverage.heights[known])) if known.any() else 0.0
    width, height = grid.columns * grid.cell, grid.rows * grid.cell
    corners = [(grid.left, grid.top, level), (grid.left + width, grid.top, level), (grid.left, grid.top - height, level)]
    colours = np.array(_COLOURS, np.uint8)[np.minimum(coverage.views, len(_COLOURS) - 1)]
    image = np.dstack([colours, np.where(known, 255, 0).astype(np.uint8)])
    names = [f"{k}{' or more' if k == len(_COLOURS) - 1 else ''}" for k in range(len(_COLOURS))]
    legend = [[name, f"#{r:02x}{g:02x}{b:02x}"] for name, (r, g, b) in zip(names, _COLOURS, strict=True)]
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
    low, high = np.floor(centres.min(axis=0) / grid.cell), np.ceil(centres.max(axis=0) / grid.cell)
    columns, rows = (high - low).astype(int)
    x, y = np.meshgrid((low[0] + np.arange(columns) + 0.5) * grid.cell, (high[1] - np.arange(rows) - 0.5) * grid.cell)
    distance, nearest = cKDTree(centres).query(np.column_stack([x.ravel(), y.ravel()]), workers=1)
    inside = distance < 0.75 * grid.cell
    bands = [np.where(inside, v.ravel()[nearest], np.nan).reshape(rows, columns).astype(np.float32) for v in layers.values()]
    left, top = low[0] * grid.cell, high[1] * grid.cell
    return geotiff(np.stack(bands), left, top, grid.cell, reference.epsg, [*layers])


def _map(coverage: Coverage, cameras: Mapping[str, Camera] | None = None) -> Uint8s:
    """(h, w, 3) uint8: number of cameras as colours, the cameras, and a legend below."""
    views = np.minimum(coverage.views, len(_COLOURS) - 1)
    colours = np.where(np.isfinite(coverage.heights)[..., None], np.array(_COLOURS, np.uint8)[views], np.uint8(_BACKGROUND[0]))
    return _with_legend(draw_plan(coverage.grid, colours.astype(np.uint8), cameras or {}))


def draw_plan(grid: GroundGrid, colours: Uint8s, cameras: Mapping[str, Camera]) -> Uint8s:
    """Image of the cells (rows, columns, 3) as squares, and of cameras as triangles that open in the viewing direction; it is
    extended to hold the cameras with a margin."""
    scale = max(1, _WIDTH // max(grid.columns, grid.rows))
    image = np.repeat(np.repeat(colours, scale, axis=0), scale, axis=1)
    if not cameras:
        return image
    pixel = {name: _grid_pixel(grid, camera.C, scale) for name, camera in cameras.items()}
    all_pixels = np.array(list(pixel.values()))
    size = np.array([image.shape[1], image.shape[0]])
    shift = np.clip(np.ceil(20 - all_pixels.min(axis=0)), 0, size / 2).astype(int)
    end_margin = np.clip(np.ceil(all_pixels.max(axis=0) + 20 - size), 0, size / 2).astype(int)
    canvas = np.full((*(size + shift + end_margin)[::-1], 3), _BACKGROUND, np.uint8)
    canvas[shift[1] : shift[1] + size[1], shift[0] : shift[0] + size[0]] = image
    for name, camera in cameras.items():
        ahead = grid.axes[:2] @ camera.R[2] * (1.0, -1.0)
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        across = np.array([-ahead[1], ahead[0]])
        corners = pixel[name] + shift + np.array([np.zeros(2), 22 * ahead + 10 * across, 22 * ahead - 10 * across])
        cv2.polylines(canvas, [np.round(corners).astype(np.int32)], True, (255, 255, 255), 2, cv2.LINE_AA)
        cv2.putText(canvas, name, tuple((pixel[name] + shift + 6).astype(int).tolist()), 0, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)


def _grid_pixel(grid: GroundGrid, X: Float64s, scale: int) -> Float64s:
    east, north = grid.axes[:2] @ X
    return np.array([(east - grid.left) / grid.cell * scale, (grid.top - north) / grid.cell * scale])


def _with_legend(image: Uint8s) -> Uint8s:
    width = max(image.shape[1], 60 * len(_COLOURS))
    canvas = np.full((image.shape[0] + 34, width, 3), _BACKGROUND, np.uint8)
    canvas[: image.shape[0], : image.shape[1]] = image
    for k, colour in enumerate(_COLOURS):
        x, y = 8 + 58 * k, image.shape[0] + 8
        cv2.rectangle(canvas, (x, y), (x + 18, y + 18), colour, -1)
        label = f"{k}{'+' if k == len(_COLOURS) - 1 else ''}"
        cv2.putText(canvas, label, (x + 24, y + 15), 0, 0.5, (230, 230, 230), 1, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)


_FULL_COLOUR_PERCENT = 2.0
"""Height difference, in percent of the map's width, from which on the colour is full."""
_MOST_CROPS = 6
"""Number of changes whose images the report shows."""


def changes_files(changes: Changes) -> Iterator[tuple[str, bytes | Columns]]:
    """changes.ply (as columns), changes.json, a picture of each change, and changes.tif if the site is georeferenced; nothing
    if there was no night to compare with."""
    if not changes.compared:
        return
    yield (
        "changes.ply",
        {
            **{name: changes.points[:, k] for k, name in enumerate(("x", "y", "z"))},
            **{name: changes.colors[:, k] for k, name in enumerate(("red", "green", "blue"))},
            **{name: getattr(changes, name) for name in ("distance", "sigma", "significance", "label", "blob")},
        },
    )
    yield "changes.json", (json.dumps(changes_data(changes), indent=1) + "\n").encode()
    for number, image in changes.crops.items():
        yield f"change-{number}.jpg", jpeg(image, _QUALITY).tobytes()
    if changes.crs:
        layers = {"tonight's height less that of the reference, metres": changes.difference}
        yield "changes.tif", _map_geotiff(changes.grid, changes.difference, layers, changes.crs)


def changes_data(changes: Changes) -> dict[str, Any]:
    """Content of changes.json: the changes with their numbers, volumes of the site and its zones, changed and unknown shares."""
    rows = []
    for number, change in changes.changes.items():
        numbers = ("length", "width", "height", "area", "volume", "volume_sigma", "significance", "points")
        row: dict[str, Any] = {"number": int(number), "kind": change.kind}
        row["position"] = [round(v, 3) for v in (change.x, change.y, change.z)]
        row |= {name: round(getattr(change, name), 3) for name in numbers}
        row |= {"likeness": round(change.likeness, 3)} if change.likeness >= -1 else {}
        row |= {"cameras": change.cameras.split(",") if change.cameras else []}
        row |= {"zone": change.zone} if change.zone else {}
        row |= {"from": [round(v, 3) for v in (change.from_x, change.from_y, change.from_z)]} if change.kind == "moved" else {}
        row |= {"picture": f"change-{number}.jpg"} if number in changes.crops else {}
        rows.append(row)
    totals = {"changed_share": changes.changed_share, "unknown_share": changes.unknown_share, "noise": changes.noise}
    data: dict[str, Any] = {"unit": "m" if changes.metric else "arbitrary"}
    data |= {name: round(value, 5) for name, value in totals.items()}
    data |= {"cut_fill": _volumes(changes.cut_fill)} if changes.cut_fill else {}
    return data | {"zones": {name: _volumes(zone) for name, zone in changes.zones.items()}, "changes": rows}


def _volumes(part: CutFill) -> dict[str, float]:
    return {name: round(value, 4) for name, value in vars(part).items()}


def changes_preview(changes: Changes) -> Uint8s:
    """Height differences from above with circled, numbered changes, and images before and after, as the bytes of a JPEG file."""
    if not changes.compared or not changes.grid.rows:
        return jpeg(np.full((40, 480, 3), 24, np.uint8), _QUALITY)
    known = np.isfinite(changes.difference)
    full_height = max(0.01 * _FULL_COLOUR_PERCENT * changes.grid.cell * changes.grid.columns, 1e-9)
    share = np.clip(np.nan_to_num(changes.difference) / full_height, -1, 1)[..., None]
    paper, raised, lowered = (np.array(rgb, np.float64) for rgb in ((225, 225, 225), (200, 40, 30), (30, 80, 200)))
    colours = np.where(share > 0, paper + share * (raised - paper), paper - share * (lowered - paper))
    image = draw_plan(changes.grid, np.where(known[..., None], colours, 24).astype(np.uint8), {})
    _mark(image, changes)
    crops = [_with_number(crop, number) for number, crop in list(changes.crops.items())[:_MOST_CROPS]]
    width = max(image.shape[1], *(crop.shape[1] for crop in crops)) if crops else image.shape[1]
    rows = [np.pad(panel, ((0, 6), (0, width - panel.shape[1]), (0, 0)), constant_values=24) for panel in (image, *crops)]
    return jpeg(np.vstack(rows), _QUALITY)


def _mark(image: Uint8s, changes: Changes) -> None:
    grid, scale = changes.grid, image.shape[1] / changes.grid.columns
    for number, change in changes.changes.items():
        east, north, _ = grid.axes @ (change.x, change.y, change.z)
        x, y = (east - grid.left) / grid.cell * scale, (grid.top - north) / grid.cell * scale
        radius = max(6.0, 0.6 * np.hypot(change.length, change.width) / grid.cell * scale)
        cv2.circle(image, (round(x), round(y)), round(radius), (20, 20, 20), 2, cv2.LINE_AA)
        cv2.putText(image, number, (round(x + radius), round(y - 4)), 0, 0.6, (20, 20, 20), 2, cv2.LINE_AA)


def _with_number(crop: Uint8s, number: str) -> Uint8s:
    labelled = crop.copy()
    cv2.putText(labelled, number, (6, 24), 0, 0.8, (0, 0, 0), 4, cv2.LINE_AA)
    cv2.putText(labelled, number, (6, 24), 0, 0.8, (255, 255, 255), 2, cv2.LINE_AA)
    return labelled
