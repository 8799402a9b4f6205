"""Views that share a camera: the pose of one determines those of all, and they move together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ..core.cameras import same_camera
from ..types import Camera, Float64s, Lens, View


def first_views(cameras: Mapping[int, Camera] | Mapping[int, View]) -> dict[int, int]:
    """For each view the first view of its camera, which is the view itself for most; views by number, sorted."""
    first_of: dict[str, int] = {}
    first = {}
    for view in sorted(cameras):
        lens = cameras[view].lens
        if lens and lens.camera:
            first[view] = first_of.setdefault(lens.camera, view)
        else:
            first[view] = view
    return first


def rotation_between(lens1: Lens | None, lens2: Lens | None) -> Float64s:
    """(3, 3) rotation from the axes of one view to those of another view of the same camera."""
    assert lens1 is not None and lens2 is not None and lens1.turn is not None and lens2.turn is not None
    return lens2.turn @ lens1.turn.T


def camera_R(camera: Camera) -> Float64s:
    """(3, 3) rotation from world axes to those of the camera that a view belongs to; most views have their camera's own axes."""
    if camera.lens is None or camera.lens.turn is None:
        return camera.R
    return camera.lens.turn.T @ camera.R


def posed_by_sibling(unposed: Camera, cameras: Mapping[int, Camera]) -> Camera | None:
    """The view `unposed`, of which only the intrinsics are used, posed by another view of its camera among `cameras`; None if
    there is none."""
    for sibling in cameras.values():
        if same_camera(unposed, sibling):
            R = rotation_between(sibling.lens, unposed.lens) @ sibling.R
            return replace(unposed, R=R, C=sibling.C, component=sibling.component)
    return None
