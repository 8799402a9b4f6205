"""The vision of wbflow: plain functions that turn arrays into arrays.  Nothing here knows a path, a cache or the engine.

Conventions that hold everywhere:

* **Pixels**: `(x, y)`, x to the right, y down; the origin is the *centre* of the top-left pixel, so an image of width `w`
  covers x from -0.5 to w - 0.5.  Resizing by `s` maps `x` to `(x + 0.5) * s - 0.5`.
* **Images**: `(h, w, 3) uint8` in **RGB** order; grey images are `(h, w) float32`, 0 to 255.  Masks are `(h, w) bool`, True
  where a pixel may be used.
* **Points**: `x1, x2` are `(n, 2) float64` pixels in images 1 and 2 (left and right: the order of the cameras in the site
  file); `X` is `(n, 3) float64` in the world frame.
* **Cameras**: `x ~ K R (X - C)`; R turns world axes into camera axes (x right, y down, z forward); C is the centre.
  `cam2_R_cam1` turns a direction of camera 1 into one of camera 2.  Lengths are metres where the world is metric.
* **Depth** is z along the optical axis, not range.
* **Epipolar geometry**: `x2^T F x1 = 0`, F of unit Frobenius norm.
* **Disparity**: after rectification a point lies on the same row in both images and `x2 = x1 - d`.
* **Angles** are in radians, and in degrees only where the name says so (`_deg`).
* A function that finds nothing usable *returns* `Rejected` with a reason and figures, which `usable` turns into an error; bad
  input *raises* `ValueError`.
* The same inputs give the same bytes: every random choice has an explicit seed.

The exported functions turn two photographs into disparity: README.md has an example.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for type checkers and editors: the names below
    from . import types as types
    from .contracts.reasons import Rejected as Rejected
    from .contracts.reasons import usable as usable
    from .depth import view_depth as view_depth
    from .disparity import match_dense as match_dense
    from .exports.previews import cloud_preview as cloud_preview
    from .exports.previews import depth_preview as depth_preview
    from .exports.previews import disparity_preview as disparity_preview
    from .exports.previews import frame_preview as frame_preview
    from .exports.previews import matches_preview as matches_preview
    from .exports.previews import rectified_preview as rectified_preview
    from .features import detect as detect
    from .frames import clean_frame as clean_frame
    from .fuse import fuse as fuse
    from .geometry import estimate_geometry as estimate_geometry
    from .matches import match as match
    from .overlap import estimate_overlap as estimate_overlap
    from .photographs import read_frame as read_frame
    from .poses import solve_poses as solve_poses
    from .rectification.warping import disparity_px as disparity_px
    from .rectification.warping import warp as warp
    from .rectify import rectify as rectify
    from .refine import refine as refine

_EXPORTED = {
    "read_frame": "photographs",
    "clean_frame": "frames",
    "detect": "features",
    "estimate_overlap": "overlap",
    "match": "matches",
    "estimate_geometry": "geometry",
    "solve_poses": "poses",
    "rectify": "rectify",
    "match_dense": "disparity",
    "view_depth": "depth",
    "refine": "refine",
    "fuse": "fuse",
    "warp": "rectification.warping",
    "disparity_px": "rectification.warping",
    "frame_preview": "exports.previews",
    "matches_preview": "exports.previews",
    "rectified_preview": "exports.previews",
    "disparity_preview": "exports.previews",
    "depth_preview": "exports.previews",
    "cloud_preview": "exports.previews",
    "Rejected": "contracts.reasons",
    "usable": "contracts.reasons",
}
"""Exported names, and the module that defines each: it is imported on first access, and so is `types`."""

__all__ = ["types", *_EXPORTED]


def __getattr__(name: str) -> Any:
    if name == "types":
        return import_module(f"{__name__}.types")
    if name not in _EXPORTED:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_EXPORTED[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """A module class for this package: some stage functions share the name of their file, and `wbflow_stages.rectify` is
    always the function, even after an import of the module."""

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and name in _EXPORTED:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
