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
"""Larger values are not noise.  With a larger limit, look-alikes go unnoticed; with a smaller one, right cameras are solved again
(measured: right cameras with stated lenses 0.9 to 4.3, with solved ones 1.7 to 14.0; wrong ones 22 to 57)."""
FEWEST = 15
"""Fewest confirmed observations of a camera for it to be checked, and of a pair to be used instead of all its matches."""
LEAST_PX = 0.05
"""Smallest noise, pixels: no image locates points better."""
LENS_SHARE = 1.2e-4
"""Tolerated misfit due to lenses, as a share of the long side (0.09 px of 768): with thousands of matches, any difference is
significant (measured: right sites at most 1.1e-4, wrong ones 2e-4 and more)."""
OUTLIER = 2.0
"""Errors beyond this many standard deviations count with their length instead of its square."""


def inconsistency(model: Model, geometries: Mapping[Edge, Geometry]) -> float:
    """How much better confirmed observations fit cameras solved from them alone.

    The gain in squared standard deviations of their noise, per degree of freedom of the cameras.  About one if all matches are
    consistent; nan if too few are confirmed.

    model: as it was solved from all matches; geometries: the accepted pairs.
    """
    # 1. Solve the cameras again, from confirmed matches.
    pairs = {edge: geometry for edge, geometry in geometries.items() if set(edge) <= set(model.cameras)}
    tracks = build_tracks(consistent_matches(pairs), 1 + max(model.cameras))
    checked = {view: camera for view, camera in model.cameras.items() if (tracks.view == view).sum() >= FEWEST}
    if len(checked) < 3:
        return float("nan")
    unfitted = replace(Model.without_points(checked, tracks, model.lenses), held=model.held)
    refit = refine(unfitted, rounds=3, rough=True)
    if not refit.use.any():
        return float("nan")

    # 2. Errors of the same observations, under these cameras and under those of the model.
    refit_errors = _errors(refit, refit.cameras)
    model_errors = _errors(refit, checked)
    finite = np.isfinite(refit_errors) & np.isfinite(model_errors)
    if not finite.any():
        return float("nan")

    # 3. The gain in pseudo-Huber loss, less what lenses explain.
    sigma = max(float(np.median(refit_errors[finite])) / RAYLEIGH, LEAST_PX)
    scale = OUTLIER * sigma
    gain = 2 * OUTLIER**2 * (np.hypot(1, model_errors[finite] / scale) - np.hypot(1, refit_errors[finite] / scale))
    long_side = max(max(camera.width, camera.height) for camera in checked.values())
    gain -= (LENS_SHARE * long_side / sigma) ** 2
    return float(max(gain.sum(), 0.0)) / max(1, _freedoms(refit))


def _freedoms(model: Model) -> int:
    """Degrees of freedom of a model's cameras: 6 for each pose, 3 for each solved lens, less those of the common frame."""
    free_views = [view for view in model.cameras if view not in model.held]
    # A similarity moves all cameras together; one held camera leaves its scale, two leave nothing.
    gauge = 0
    if len(model.held) == 0:
        gauge = 7
    elif len(model.held) == 1:
        gauge = 1
    lenses = {model.lenses[view] for view in free_views if view in model.lenses}
    return 6 * len(free_views) - gauge + 3 * len(lenses)


def _errors(model: Model, cameras: Mapping[int, Camera]) -> Float64s:
    """(n,) errors in pixels of a model's observations with these cameras, and with points triangulated for them."""
    posed = replace(model, cameras=dict(cameras))
    X = triangulate(posed.cameras, posed.undistorted_tracks, model.use, 1.0)
    return replace(posed, X=X).error_px()[model.use]
