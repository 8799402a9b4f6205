"""Do solved cameras fit the matches that a third camera confirms?

If things repeat along a row (parked cars, windows), matches to the neighbour of the right thing agree with a pose of their own,
and right matches of far surfaces fit it to fractions of a pixel: every pair looks good, and so do its loops.  Three cameras
that are all matched with each other give more evidence: a match is confirmed if the chain of matches through the third camera
ends at the same place.  In a car park that was solved 0.6 degrees off, 68 to 81 % of the matches of the worst pairs were right,
and 96 to 99 % of their confirmed ones.  If confirmed matches alone place the cameras elsewhere, wrong matches misled them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..sfm.consistent_matches import consistent_matches
from ..sfm.incremental import Model, refine
from ..sfm.tracks import Edge, build_tracks
from ..sfm.triangulation import RAYLEIGH, triangulate
from ..types import Camera, Float64s, Geometry

MOST_INCONSISTENCY = 16.0
"""Larger values are not noise.  Right cameras had 0.9 to 4.3 with stated lenses; with solved ones 1.7 to 5.4 (photographs), 12.6
to 14.0 (yards 0.45 % of their size off, whose lenses k1 and k2 do not describe).  Wrong ones had 22 to 57 (car parks, houses)."""
FEWEST = 15
"""Fewest confirmed observations of a camera for it to be checked, and of a pair to be used instead of all its matches."""
LEAST_PX = 0.05
"""Smallest noise: no image locates points better."""
LENS_SHARE = 1.2e-4
"""Tolerated misfit due to lenses, as a share of the long side (0.09 px of 768): with thousands of matches, any difference is
significant.  Chosen between three photographs of an entry, 0.2 degrees off (0.7e-4), and a car park 3 degrees off (2e-4); tested
on a wrong small car park and platform (6 to 19e-4), and on a right yard and fountain (at most 1.1e-4)."""
OUTLIER = 2.0
"""Errors beyond this many standard deviations count with their length instead of its square."""


def inconsistency(model: Model, geometries: Mapping[Edge, Geometry]) -> float:
    """How much better confirmed observations fit cameras solved from them alone: the gain in squared standard deviations of their
    noise, per degree of freedom of the cameras.  About one if all matches are consistent; nan if too few are confirmed.

    model: as it was solved from all matches; geometries: the accepted pairs.
    """
    pairs = {edge: geometry for edge, geometry in geometries.items() if edge[0] in model.cameras and edge[1] in model.cameras}
    tracks = build_tracks(consistent_matches(pairs), 1 + max(model.cameras))
    checked = {view: camera for view, camera in model.cameras.items() if (tracks.view == view).sum() >= FEWEST}
    if len(checked) < 3:
        return float("nan")
    unfitted = replace(Model.without_points(checked, tracks, model.lenses), held=model.held)
    refit = refine(unfitted, rounds=3, rough=True)
    if not refit.use.any():
        return float("nan")
    refit_errors, model_errors = (_errors(refit, cameras) for cameras in (refit.cameras, checked))
    finite = np.isfinite(refit_errors) & np.isfinite(model_errors)
    if not finite.any():
        return float("nan")
    sigma = max(float(np.median(refit_errors[finite])) / RAYLEIGH, LEAST_PX)
    scale = OUTLIER * sigma
    loss = 2 * OUTLIER**2 * (np.hypot(1, model_errors[finite] / scale) - np.hypot(1, refit_errors[finite] / scale))
    loss -= (LENS_SHARE * max(max(camera.width, camera.height) for camera in checked.values()) / sigma) ** 2
    free_views = [view for view in refit.cameras if view not in refit.held]
    gauge = 7 if len(refit.held) == 0 else 1 if len(refit.held) == 1 else 0  # free parameters of the frame that all poses share
    freedoms = 6 * len(free_views) - gauge + 3 * len({refit.lenses[view] for view in free_views if view in refit.lenses})
    return float(max(loss.sum(), 0.0)) / max(1, freedoms)


def _errors(model: Model, cameras: Mapping[int, Camera]) -> Float64s:
    """(n,) errors in pixels of a model's observations with these cameras, and with points triangulated for them."""
    posed = replace(model, cameras=dict(cameras))
    X = triangulate(posed.cameras, posed.undistorted_tracks, model.use, 1.0)
    return replace(posed, X=X).error_px()[model.use]
