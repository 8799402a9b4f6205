"""Orthophoto: the site from straight above, each cell in the colour of the textured mesh's uppermost triangle there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..core.cameras import project
from ..core.ground_grid import preferred_above
from ..types import Float64s, Int64s, Uint8s
from .heights import map_cells, spacing
from .mesh import NONE, Textured, cast, sampled, scene_of

if TYPE_CHECKING:
    from .world import Georeference

_STRIP = 2_000_000
"""Number of cells that are processed at once."""


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
    mesh = found.mesh
    X = georeference.points(mesh.vertices) if georeference else mesh.vertices
    low, high = X.min(axis=0), X.max(axis=0)
    wanted = preferred_above(found.pixel or spacing(X))
    cell, first_column, last_row, columns, rows = map_cells(low[:2], high[:2], wanted)
    middle = 0.5 * (low + high)
    scene = scene_of(X - middle, mesh.triangles)
    image = np.zeros((rows * columns, 4), np.uint8)
    for start in range(0, rows * columns, _STRIP):
        row, column = np.divmod(np.arange(start, min(start + _STRIP, rows * columns)), columns)
        above = np.column_stack([(first_column + column + 0.5) * cell, (last_row - row + 0.5) * cell]) - middle[:2]
        up = np.full(len(above), float(high[2] - middle[2]) + 1.0)
        hit = cast(scene, np.column_stack([above, up]), np.broadcast_to(np.array([0.0, 0.0, -1.0]), (len(above), 3)))
        there = np.flatnonzero(np.isfinite(hit["t_hit"]))
        triangles, uv = hit["primitive_ids"][there].astype(np.int64), hit["primitive_uvs"][there]
        image[start + there, :3] = _colours(found, triangles, uv.astype(np.float64))
        image[start + there, 3] = 255
    return Orthophoto(image.reshape(rows, columns, 4), first_column * cell, (last_row + 1) * cell, cell)


def _colours(found: Textured, triangles: Int64s, uv: Float64s) -> Uint8s:
    """(n, 3) colours of triangles at barycentric coordinates (n, 2)."""
    corners, weights = found.mesh.triangles[triangles], np.column_stack([1 - uv.sum(axis=1), uv])
    colours = np.einsum("nk,nkc->nc", weights, found.mesh.colors[corners].astype(np.float64))
    points = np.einsum("nk,nkc->nc", weights, found.mesh.vertices[corners])
    chosen = found.chosen[triangles]
    for number in np.unique(chosen[chosen != NONE]).tolist():
        view, here = found.views[number], chosen == number
        colours[here] = sampled(view.image, project(view.camera, points[here])[0])
    return np.asarray((colours + 0.5).clip(0, 255), np.uint8)
