"""Orthophoto: the site from straight above, each cell in the colour of the textured mesh's uppermost triangle there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..core.cameras import project
from ..core.ground_grid import preferred_above
from ..types import Float64s, Int64s, Uint8s
from .heights import map_cells, spacing
from .mesh import NO_VIEW, Textured, cast, sampled, scene_of

if TYPE_CHECKING:
    from .world import Georeference

_CELLS_AT_ONCE = 2_000_000
"""Number of cells that are processed at once, which bounds the memory of rays and hits."""


@dataclass(frozen=True)
class Orthophoto:
    """Colours seen from above, on a grid; the first row has the largest y."""

    image: Uint8s
    """(rows, columns, 4) uint8 RGBA; transparent where there is no surface."""
    left: float
    top: float
    """x and y of the outer corner of the first cell."""
    cell: float
    """Edge of a cell."""


def orthophoto(found: Textured, georeference: Georeference | None = None) -> Orthophoto:
    """The orthophoto of a textured mesh, in map coordinates if there is a georeference.

    Cells are as wide as the median of the pixels that they show, rounded up to 1, 2 or 5 times a power of ten; their corners
    lie at multiples of that, so that orthophotos of different nights align.
    """
    # 1. The grid, in map coordinates.
    mesh = found.mesh
    X = georeference.points(mesh.vertices) if georeference else mesh.vertices
    low = X.min(axis=0)
    high = X.max(axis=0)
    least_cell = preferred_above(found.pixel or spacing(X))
    cell, first_column, last_row, columns, rows = map_cells(low[:2], high[:2], least_cell)

    # 2. Rays straight down through the middle of each cell, about the middle of the mesh: rays are cast in float32.
    middle = 0.5 * (low + high)
    scene = scene_of(X - middle, mesh.triangles)
    image = np.zeros((rows * columns, 4), np.uint8)
    for start in range(0, rows * columns, _CELLS_AT_ONCE):
        row, column = np.divmod(np.arange(start, min(start + _CELLS_AT_ONCE, rows * columns)), columns)
        centres = np.column_stack([(first_column + column + 0.5) * cell, (last_row - row + 0.5) * cell]) - middle[:2]
        start_z = np.full(len(centres), float(high[2] - middle[2]) + 1.0)  # one unit above the highest point
        down = np.broadcast_to(np.array([0.0, 0.0, -1.0]), (len(centres), 3))
        hits = cast(scene, np.column_stack([centres, start_z]), down)

        # 3. The colour of the triangle that each ray hits first.
        covered = np.flatnonzero(np.isfinite(hits["t_hit"]))
        triangles = hits["primitive_ids"][covered].astype(np.int64)
        uv = hits["primitive_uvs"][covered]
        image[start + covered, :3] = _colours(found, triangles, uv.astype(np.float64))
        image[start + covered, 3] = 255
    return Orthophoto(image.reshape(rows, columns, 4), first_column * cell, (last_row + 1) * cell, cell)


def _colours(textured: Textured, triangles: Int64s, uv: Float64s) -> Uint8s:
    """(n, 3) colours of triangles at barycentric coordinates (n, 2)."""
    corners = textured.mesh.triangles[triangles]  # (n, 3) indices of vertices
    weights = np.column_stack([1 - uv.sum(axis=1), uv])  # (n, 3), of the three corners
    # colours of the vertices first, where no view shows the triangle
    colours = np.einsum("nk,nkc->nc", weights, textured.mesh.colors[corners].astype(np.float64))
    points = np.einsum("nk,nkc->nc", weights, textured.mesh.vertices[corners])
    chosen = textured.view_of_triangle[triangles]
    for number in np.unique(chosen[chosen != NO_VIEW]).tolist():
        view = textured.views[number]
        in_view = chosen == number
        colours[in_view] = sampled(view.image, project(view.camera, points[in_view])[0])
    return np.asarray((colours + 0.5).clip(0, 255), np.uint8)
