"""Data of one camera: its pinhole, its frame, its keypoints."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..contracts.camera_figures import FeaturesFigures, FrameFigures, Notes
from ..contracts.short_repr import Record
from .arrays import Bools, Float32s, Float64s, Uint8s
from .captured import Lens


@dataclass(frozen=True)
class View(Record):
    """The pinhole of a frame, without its pixels."""

    width: int
    height: int
    K: Float64s | None = None
    """(3, 3) pixels of the frame (working resolution, distortion removed), None if nothing is known."""
    focal_known: bool = True
    """False if K is only a guess, from a field of view."""
    captured_width: int = 0
    captured_height: int = 0
    """Size of the capture; 0: the same as the frame's."""
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))
    """(n,) distortion coefficients that were removed from the capture (see `Lens`)."""
    lens: Lens | None = None
    """The capture's lens, if the frame has another pinhole than the lens itself (then `distortion` has no meaning)."""


@dataclass(frozen=True)
class Camera(Record):
    """A pinhole camera at working resolution."""

    K: Float64s
    """(3, 3) pixels."""
    R: Float64s
    """(3, 3), world axes to camera axes."""
    C: Float64s
    """(3,), the centre in the world."""
    width: int
    height: int
    component: int = 0
    """Cameras with the same number share a world; 0 is the main one."""
    radial: tuple[float, float] = (0.0, 0.0)
    """k1 and k2 of the distortion found to remain in the frame if the lens was unknown (the frame itself is not straightened)."""
    captured_width: int = 0
    captured_height: int = 0
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))
    lens: Lens | None = None
    """These four fields: see `View`."""


@dataclass(frozen=True)
class Frame(FrameFigures, Notes):
    """The night's clean view of one camera at working resolution: upright, undistorted, moving things removed."""

    image: Uint8s
    """(h, w, 3) RGB."""
    mask: Bools
    """(h, w), True where a pixel may be used."""
    view: View


@dataclass(frozen=True)
class Features(Record):
    """Keypoints of one frame.  Rows of the plain view come first, each view's strongest keypoint first."""

    xy: Float64s
    """(n, 2) pixels of the frame."""
    frames: Float64s
    """(n, 2, 2) local affine frames s R(theta), canonical patch to image; of a tilted view, mapped back into the frame."""
    descriptors: Float32s
    """(n, d) of unit length (RootSIFT)."""
    responses: Float32s
    """(n,) detector responses."""
    tilts: Uint8s
    """(n,) `PLAIN`, or `TILTED` for the view compressed by 2 in x."""
    view: View
    lookalikes: Float32s = field(default_factory=lambda: np.zeros(0, np.float32))
    """(p,) distance of each plain-view keypoint to the most similar descriptor of that view at least 6 px away: how
    distinctive it is in its own image (empty: unknown).  Tilted keypoints have none, since few are ever needed."""
    plain_keypoints: int = 0
    """Number of rows of the plain view."""
    preprocessing: str = "none"
    """How the image was prepared: "none" or "clahe"."""

    @property
    def figures(self) -> FeaturesFigures:
        """What the engine reports of them."""
        return FeaturesFigures(keypoints=len(self.xy))


# Values of `Features.tilts`
PLAIN = 0
"""The frame as it is."""
TILTED = 1
"""The frame compressed by 2 in x."""
