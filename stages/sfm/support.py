"""Cameras that a model has put where most of what their pairs say is against it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..core.bending import without_distortion
from ..twoview.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
from ..types import Camera, Geometry
from .incremental import Model, refine
from .rigs import rigs_of
from .tracks import Edge


def straight_error_px(left: Camera, right: Camera, geometry: Geometry) -> float:
    """Median distance of a pair's inliers, lenses straightened, to the epipolar lines of its cameras."""
    x1, x2 = without_distortion(left, geometry.x1), without_distortion(right, geometry.x2)
    return float(np.median(symmetric_epipolar_distance(fundamental_from_cameras(left, right), x1, x2)))


def without_unsupported(model: Model, geometries: Mapping[Edge, Geometry], max_epipolar_px: float) -> tuple[Model, list[int]]:
    """The refined model without cameras whose believed pairs contradict it with more inliers than agree, and which these are.

    A few points of look-alikes that three views share place a camera as well as right ones do, and the adjustment then throws the
    right ones out: what is left agrees, though the pair that sees most does not.  Known cameras stay.

    Parameters
    ----------
    model
        All its views adjusted.
    geometries
        The pairs that are believed.
    max_epipolar_px
        A pair agrees up to this median distance to the epipolar lines of its cameras.
    """
    out: list[int] = []
    first_of = {view: first for first, views in rigs_of(model.cameras).items() for view in views}  # these go together
    while len(model.cameras) > 2:
        balance = dict.fromkeys((first_of.get(view, view) for view in model.cameras if view not in model.held), 0)
        for (i, j), geometry in geometries.items():
            if i in model.cameras and j in model.cameras:
                agrees = straight_error_px(model.cameras[i], model.cameras[j], geometry) <= max_epipolar_px
                for view in balance.keys() & {first_of.get(i, i), first_of.get(j, j)}:
                    balance[view] += geometry.inliers if agrees else -geometry.inliers
        worst = min(balance, key=lambda view: (balance[view], view), default=None)
        if worst is None or balance[worst] >= 0:
            break
        gone = [view for view in model.cameras if first_of.get(view, view) == worst]
        out += gone
        cameras = {view: camera for view, camera in model.cameras.items() if view not in gone}
        model = refine(replace(model, cameras=cameras, use=model.use & ~np.isin(model.tracks.view, gone)), rounds=3)
    return model, out
