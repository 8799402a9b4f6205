"""Where the scene lies: the bounds that the site states, and the ground plane, found from all views together.

Pairs of known cameras that lack keypoint matches search for partners there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .core.luminance import grey_levels
from .core.residual_distortion import undistorted_frames
from .mvs.ground import find_ground
from .types import Camera, Frame, Scene


def find_scene(
    frames: Mapping[str, Frame], cameras: Mapping[str, Camera], *, bounds: list[list[float]] | None = None, ground: bool = True
) -> Scene:
    """What is known of the scene's position.

    Parameters
    ----------
    frames : the clean frame of each camera.
    cameras : cameras by id; only those of the main component are used.
    bounds : two corners [[x, y, z], [x, y, z]] of the box that holds all that matters, in world lengths.
    ground : look for the plane on which most of the site stands.
    """
    box = None
    if bounds is not None:
        box = np.sort(np.array(bounds, dtype=np.float64), axis=0)  # the corners may be any two opposite ones
    known = {name: camera for name, camera in cameras.items() if camera.component == 0 and name in frames}
    if not ground or len(known) < 2:
        return Scene(box, None)
    undistorted = undistorted_frames(frames, known)
    grey = {name: grey_levels(undistorted[name].image).astype(np.float32) for name in known}
    return Scene(box, find_ground(grey, known))
