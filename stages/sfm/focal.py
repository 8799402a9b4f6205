"""Lenses: what is known of them, what is guessed, and which focal lengths are to be solved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..robust import pose_of_fundamental
from ..types import Camera, Float64s, Geometry, View
from .tracks import Edge


@dataclass(frozen=True)
class Lenses:
    """views: all views by number; K: intrinsics of those that have some, known or guessed; solved: views whose focal length is to
    be solved, with the number of the lens they share."""

    views: tuple[View, ...]
    K: Mapping[int, Float64s]
    solved: Mapping[int, int]

    def camera(self, view: int) -> Camera:
        """A camera with these intrinsics, at the origin."""
        return Camera(self.K[view], np.eye(3), np.zeros(3), self.views[view].width, self.views[view].height)


def guess_lenses(views: tuple[View, ...], geometries: Mapping[Edge, Geometry]) -> Lenses:
    """Intrinsics of all views."""
    K = {k: view.K for k, view in enumerate(views) if view.K is not None}
    solved = {k: k for k, view in enumerate(views) if k in K and not view.focal_known}
    return Lenses(views, K, solved)


def relative_rotations(geometries: Mapping[Edge, Geometry], lenses: Lenses) -> dict[Edge, Geometry]:
    """The geometries of pairs whose lenses are known or guessed, with relative poses that go with these lenses."""
    found = {}
    for (i, j), geometry in geometries.items():
        if i not in lenses.K or j not in lenses.K:
            continue
        if i in lenses.solved or j in lenses.solved:
            view1, view2 = replace(geometry.view1, K=lenses.K[i]), replace(geometry.view2, K=lenses.K[j])
            pose = pose_of_fundamental(geometry.F, geometry.x1, geometry.x2, view1, view2)
            if pose is None:
                continue
            geometry = replace(geometry, cam2_R_cam1=pose[0], cam2_t_cam1=pose[1])
        found[i, j] = geometry
    return found
