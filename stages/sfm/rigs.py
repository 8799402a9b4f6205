"""Views that share a camera: one of them tells where all are, and they move as one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ..core.cameras import same_camera
from ..types import Camera, Float64s, Lens, View


def rigs_of(cameras: Mapping[int, Camera] | Mapping[int, View]) -> dict[int, list[int]]:
    """The views of each camera that has more than one among them, by its first view; views by number."""
    found: dict[int, list[int]] = {}
    first_of: dict[str, int] = {}
    for view in sorted(cameras):
        lens = cameras[view].lens
        if lens and lens.camera:
            found.setdefault(first_of.setdefault(lens.camera, view), []).append(view)
    return {first: views for first, views in found.items() if len(views) > 1}


def between(one: Lens | None, other: Lens | None) -> Float64s:
    """(3, 3) from the axes of one view to those of another of the same camera."""
    assert one is not None and other is not None and one.turn is not None and other.turn is not None
    return other.turn @ one.turn.T


def whole_R(camera: Camera) -> Float64s:
    """(3, 3) world axes to those of the camera that a view is of; most are their camera's own."""
    return camera.R if camera.lens is None or camera.lens.turn is None else camera.lens.turn.T @ camera.R


def beside(bare: Camera, cameras: Mapping[int, Camera]) -> Camera | None:
    """A view, of which the intrinsics count, where another view of its camera, among placed ones, says that it is; None where
    there is none."""
    for placed in cameras.values():
        if same_camera(bare, placed):
            return replace(bare, R=between(placed.lens, bare.lens) @ placed.R, C=placed.C, component=placed.component)
    return None
