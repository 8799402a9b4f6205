"""Read a photograph from disk, for notebooks and scripts: the pipeline itself passes bytes to the stages."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from .contracts.defaults import RESOLUTION
from .frames import clean_frame
from .types import Capture, Float64s, Frame, Lens


def read_frame(
    path: str | PathLike[str],
    *,
    K: Float64s | None = None,
    distortion: Float64s | None = None,
    hfov_deg: float | None = None,
    mask: str | PathLike[str] | None = None,
    resolution: int | None = RESOLUTION,
) -> Frame:
    """The clean frame of one photograph: upright, undistorted, at working resolution, with intrinsics of its own size.

    Raises OSError if the file cannot be read, ValueError if it holds no usable image or the lens is impossible; the message names
    the fault.  `Frame.from_image` does the same for a picture in memory.

    Parameters
    ----------
    path : the image file.
    K : (3, 3) intrinsics in pixels of the upright photograph, if they are known.
    distortion : (5,) k1 k2 p1 p2 k3 (OpenCV's order and meaning); None: no distortion.
    hfov_deg : horizontal field of view in degrees, if only that is known.
    mask : an image file of the photograph's size; pixels that are not zero may be used.
    resolution : long side of the frame in pixels; None: as photographed.
    """
    lens = Lens.of_arrays(K, distortion, hfov_deg)
    mask_capture = None
    if mask is not None:
        mask_capture = _capture(mask)
    return clean_frame([_capture(path)], lens, mask_capture, resolution=resolution)


def _capture(path: str | PathLike[str]) -> Capture:
    """The bytes of a file, as the pipeline passes them to the stages."""
    return Capture(str(path), np.frombuffer(Path(path).read_bytes(), dtype=np.uint8))
