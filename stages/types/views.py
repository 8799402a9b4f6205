"""Data of one camera: its pinhole, its frame, its keypoints."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module

import numpy as np

from ..contracts.camera_figures import FeaturesFigures, FrameFigures, Notes
from ..contracts.short_repr import Record
from .arrays import Bools, Float32s, Float64s, Uint8s
from .captured import Capture, Lens
from .checking import wrong_array


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

    @classmethod
    def from_image(
        cls,
        image: Uint8s,
        *,
        K: Float64s | None = None,
        distortion: Float64s | None = None,
        hfov_deg: float | None = None,
        mask: Bools | None = None,
        resolution: int | None = 1600,
    ) -> Frame:
        """The clean frame of a picture in memory: the same as `wbflow_stages.read_frame` makes of a file with these pixels.

        Raises ValueError if an argument is of another type, shape or dtype, or if the picture is not usable (black, blank).

        Parameters
        ----------
        image : (h, w, 3) uint8, RGB, upright.
        K : (3, 3) intrinsics in pixels of the image, if they are known.
        distortion : (n,) k1 k2 p1 p2 k3 (OpenCV's order and meaning); None: no distortion.
        hfov_deg : horizontal field of view in degrees, if only that is known.
        mask : (h, w) bool, True where a pixel may be used; None: everywhere.
        resolution : long side of the frame in pixels; None: as the image.
        """
        lengths: dict[str, int] = {}
        if wrong := wrong_array(image, np.uint8, ("h", "w", 3), lengths):
            raise ValueError(f"image {wrong}: RGB from 0 to 255{_remedy(image)}")
        if not image.size:
            raise ValueError(f"image is empty, {image.shape}")
        if mask is not None and (wrong := wrong_array(mask, np.bool_, ("h", "w"), lengths)):
            raise ValueError(f"mask {wrong}: True where a pixel may be used")
        mask_capture = None
        if mask is not None:
            mask_capture = Capture.of_pixels("mask", mask.astype(np.uint8) * np.uint8(255))
        # by name: the stages are a layer above their types
        clean_frame = import_module("..frames", __package__).clean_frame
        lens = Lens.of_arrays(K, distortion, hfov_deg)
        frame: Frame = clean_frame([Capture.of_pixels("image", image)], lens, mask_capture, resolution=resolution)
        return frame


def _remedy(image: object) -> str:
    """How a picture of another kind becomes one that can be used; "" if that is not obvious."""
    if not isinstance(image, np.ndarray) or not image.size:
        return ""
    if image.dtype.kind == "f":
        highest = "1" if image.max() <= 1 else "255"
        scaled = "(image * 255)" if highest == "1" else "image"
        return f"; if its values are 0 to {highest}, use {scaled}.round().astype(np.uint8)"
    if image.dtype == np.uint8 and image.ndim == 2:
        return "; if it is grey, use np.dstack([image] * 3)"
    if image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 4:
        return "; without its fourth channel, use image[..., :3]"
    return ""


@dataclass(frozen=True)
class Features(Record):
    """Keypoints of one frame.  Rows of the plain view come first, those of the compressed view last; the strongest of each view
    is its first."""

    xy: Float64s
    """(n, 2) pixels of the frame."""
    frames: Float64s
    """(n, 2, 2) local affine frames s R(theta), canonical patch to image; of a tilted view, mapped back into the frame."""
    descriptors: Float32s
    """(n, d) of unit length (RootSIFT)."""
    responses: Float32s
    """(n,) detector responses."""
    tilts: Uint8s
    """(n,) `PLAIN`, `TILTED` for the view compressed by 2 in x, or `LEARNED` plus the quarter turns of the picture."""
    view: View
    lookalikes: Float32s = field(default_factory=lambda: np.zeros(0, np.float32))
    """(p,) distance of each keypoint to the most similar descriptor of its kind at least 6 px away: how distinctive it is in its
    own image (empty: unknown).  Tilted keypoints have none, since few are ever needed."""
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
LEARNED = 2
"""Keypoints of a network in the frame as it is; 3, 4, 5: in the frame turned anticlockwise by one, two, three quarter turns.
They have neither scale nor orientation: their frames are a nominal size and that turn."""
