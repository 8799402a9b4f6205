"""One night as it is compared with another: its cloud, its cameras, what they saw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..types import Camera, Cloud, DepthMap, Float64s, Frame
from .likeness import Photograph


@dataclass(frozen=True)
class Epoch:
    """A night."""

    cloud: Cloud
    cameras: Mapping[str, Camera]
    """Those that share the cloud's world."""
    frames: Mapping[str, Frame]
    """Loaded when they are asked for."""
    depths: Mapping[str, DepthMap]
    refined: Mapping[str, DepthMap]
    """Taken instead of `depths` where there is one."""

    @property
    def seeing(self) -> list[str]:
        """The cameras with a depth map."""
        return [name for name in self.cameras if name in self.refined or name in self.depths]

    def depth(self, name: str) -> DepthMap:
        """What a camera saw."""
        return self.refined[name] if name in self.refined else self.depths[name]

    def photograph(self, name: str) -> Photograph:
        """A camera with its frame."""
        return Photograph(self.cameras[name], self.frames[name])

    @property
    def points(self) -> Float64s:
        """(n, 3) of the cloud."""
        return np.asarray(self.cloud.points, dtype=np.float64)

    @property
    def sigma(self) -> Float64s:
        """(n,) of the cloud's points, world lengths."""
        return np.asarray(self.cloud.sigma_mm, dtype=np.float64) / 1000.0
