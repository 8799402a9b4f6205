"""Does a camera see the thing on one straight line only?  Such a track determines no pose, however long it is."""

from __future__ import annotations

import numpy as np

from .hypotheses import pixel_angle
from .tracks import Track

WIDTH_PX = 3.0
"""Half the width of the line, pixels."""
SHARE = 0.7
"""Share of the observations on it from which on the others are taken for wrong ones."""
_TRIALS = 60
"""Lines through two observations that are tried."""
_MOST = 500
"""Most observations that are tested."""


def sees_a_line(track: Track) -> bool:
    """Do most observations of a camera lie on one line?  Straight lines are planes of rays, whatever the lens."""
    rays = track.ray[np.linspace(0, len(track) - 1, min(len(track), _MOST)).round().astype(np.int64)]
    rng = np.random.default_rng(0)
    first, second = rng.integers(0, len(rays), (2, _TRIALS))
    normals = np.cross(rays[first], rays[second])
    lengths = np.linalg.norm(normals, axis=1)
    width = WIDTH_PX * pixel_angle(track)
    # lines through two observations at the same place have no direction; if there are no others, the thing stood still
    is_apart = lengths > 5 * width
    if not is_apart.any():
        return True
    normals = normals[is_apart] / lengths[is_apart, None]
    shares = np.mean(np.abs(rays @ normals.T) < width, axis=0)
    return bool(shares.max() > SHARE)
