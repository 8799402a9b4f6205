"""Known cameras as the images have them, and how well that tells their rows: dense matching needs these to about a pixel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..core.rotations import rotation_matrix
from ..twoview.epipolar import fundamental_from_cameras, homogeneous
from ..types import Camera, Float64s, Pair
from .pose_check import Sigma


@dataclass(frozen=True)
class Place:
    """Where a camera's turn (3, radians) and shift (3) are in a covariance."""

    first: int
    """Row of the first of the six."""
    turn: Float64s
    """(3, 3) from the axes of the turn to the camera's own: views of one camera turn as the first of them."""


@dataclass(frozen=True)
class Adjusted:
    """Cameras in their most probable places, with the covariance of those that are not exact."""

    cameras: dict[str, Camera]
    """By id."""
    places: Mapping[str, Place]
    """Of those that are not exact."""
    covariance: Float64s
    """(n, n)."""

    @classmethod
    def as_stated(cls, cameras: Mapping[str, Camera], sigmas: Mapping[str, Sigma]) -> Adjusted:
        """Cameras of which the images say nothing; sigmas: of those that are not exact."""
        own = [(np.radians(sigma.degrees),) * 3 + (sigma.metres,) * 3 for sigma in sigmas.values()]
        places = {name: Place(6 * k, np.eye(3)) for k, name in enumerate(sigmas)}
        return cls(dict(cameras), places, np.diag(np.square(np.array(own, dtype=np.float64).reshape(-1))))

    def with_images(self, cameras: dict[str, Camera], places: Mapping[str, Place], covariance: Float64s) -> Adjusted:
        """These cameras, with what the images have told of some of them."""
        n = len(self.covariance)
        both = np.zeros((n + len(covariance),) * 2)
        both[:n, :n], both[n:, n:] = self.covariance, covariance
        told = {name: Place(n + place.first, place.turn) for name, place in places.items()}
        return Adjusted(cameras, {**self.places, **told}, both)

    def row_sigmas_px(self, pair: Pair, x1: Float64s, x2: Float64s) -> Float64s:
        """(n,) standard deviation of how far points x1, x2 (n, 2) of two cameras are from the epipolar lines, to first order."""
        firsts = {self.places[name].first for name in pair if name in self.places}
        rows = [first + k for first in sorted(firsts) for k in range(6)]
        values, vectors = np.linalg.eigh(self.covariance[np.ix_(rows, rows)])
        off = self._off_lines(pair, x1, x2, {})
        square = np.zeros(len(x1))
        for value, vector in zip(values, vectors.T, strict=True):
            step = dict(zip(rows, np.sqrt(max(value, 0.0)) * vector, strict=True))
            square += (self._off_lines(pair, x1, x2, step) - off) ** 2
        return np.sqrt(square)

    def _off_lines(self, pair: Pair, x1: Float64s, x2: Float64s, step: Mapping[int, float]) -> Float64s:
        """(n,) distances of x2 to the lines of x1, with sign, after a step."""
        left, right = (self._moved(name, step) for name in pair)
        lines = homogeneous(x1) @ fundamental_from_cameras(left, right).T
        return np.asarray(np.sum(lines * homogeneous(x2), axis=1) / np.linalg.norm(lines[:, :2], axis=1), dtype=np.float64)

    def _moved(self, name: str, step: Mapping[int, float]) -> Camera:
        camera, place = self.cameras[name], self.places.get(name)
        if not step or place is None:
            return camera
        turn, shift = (np.array([step[place.first + k + axis] for axis in range(3)]) for k in (0, 3))
        return replace(camera, R=rotation_matrix(place.turn @ turn) @ camera.R, C=camera.C + shift)
