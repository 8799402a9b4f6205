"""One camera: its pinhole, its frame, its keypoints."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..core.short_repr import Record
from .arrays import Bools, Float32s, Float64s, Uint8s
from .captured import Lens


@dataclass(frozen=True)
class View(Record):
    """The pinhole of a frame, without its pixels."""

    width: int
    height: int
    K: Float64s | None = None
    """(3, 3) pixels of the frame (working resolution, distortion removed), None when nothing is known."""
    focal_known: bool = True
    """False when K is only a guess, from a field of view."""
    captured_width: int = 0
    captured_height: int = 0
    """Size of the capture; 0: as the frame."""
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))
    """(n,) what was removed from the capture (see `Lens`)."""
    lens: Lens | None = None
    """The capture's lens, where the frame has another pinhole than its own (then `distortion` says nothing)."""


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
    """k1 and k2 of the distortion that was found to be left in the frame where the lens was unknown (the frame is used as it
    is)."""
    captured_width: int = 0
    captured_height: int = 0
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))
    lens: Lens | None = None
    """These four as of `View`."""


@dataclass(frozen=True)
class Frame(Record):
    """The night's clean view of one camera at working resolution: upright, undistorted, moving things removed."""

    image: Uint8s
    """(h, w, 3) RGB."""
    mask: Bools
    """(h, w), True where a pixel may be used."""
    view: View
    notes: tuple[str, ...] = ()
    """What the operator should know (frames left out, exposure)."""
    brightness: float = float("nan")
    """Mean grey of the usable pixels, 0 to 255."""
    contrast: float = float("nan")
    """Standard deviation of their grey levels."""
    saturated: float = float("nan")
    """Share of them that is white, beyond what the sensor can tell."""
    sharpness: float = float("nan")
    """Standard deviation of their Laplacian as a share of the contrast: defocus, drops and dirt lower it, darkness doesn't."""
    combing: float = 0.0
    """Share of the captures' structured parts in which every second row is from another moment, or shifted (median)."""
    blocking: float = 1.0
    """How many times stronger edges are at the borders of the captures' coded blocks than within them."""
    blur_px: float = float("nan")
    """Standard deviation of the blur of the sharper edges in the frame's softest quarter, pixels; nan where it has no edges."""
    detail_px: float = 1.0
    """So many pixels lie between details that the frame resolves, in the coarser direction."""
    coarseness: float = 1.0
    """`blocking` as far as it is left at working resolution."""
    cast: float = 1.0
    """Mean of the strongest of red, green and blue over that of the weakest, in the captures."""
    colour: float = 1.0
    """Median saturation of the captures once their cast is taken off, 0 (grey, infrared) to 1."""
    noise: float = 0.0
    """Standard deviation of the captures' noise, grey levels (median)."""
    noise_left: float = 0.0
    """`noise` as far as it is left at working resolution by the median of the captures."""
    frames_used: int = 1
    """Captures that count fully."""
    doubtful: float = 0.0
    """Share of pixels where no majority of the captures agrees: something stood or moved there."""
    unchanged: float = 0.0
    """Share of pixels that all captures show alike to the last grey level; 0 for a single one."""
    taken_first: str = ""
    taken_last: str = ""
    """When the first and the last capture were taken, ISO 8601, by what the camera wrote into them; "" where it says nothing."""
    taken_in_order: bool = True
    """False where the cameras' times contradict the order of the captures."""
    picture_digest: str = ""
    """Of the last capture's pixels: no two cameras show the same."""


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
    """(n,)"""
    tilts: Uint8s
    """(n,) `PLAIN`, or `TILTED` for the view compressed by 2 in x."""
    view: View
    lookalikes: Float32s = field(default_factory=lambda: np.zeros(0, np.float32))
    """(p,) of the plain view's keypoints, the distance to the most similar descriptor of that view at least 6 px away: how
    distinctive a keypoint is in its own image (empty: unknown).  Of a tilted view few are ever asked."""
    plain_keypoints: int = 0
    """Rows of the plain view."""
    preprocessing: str = "none"
    """"none" or "clahe": how the image was prepared."""


PLAIN, TILTED = 0, 1
"""Values of `Features.tilts`."""
