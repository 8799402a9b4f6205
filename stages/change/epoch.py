"""One night as it is compared with another: its cloud, its cameras, what they saw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ..types import Camera, Cloud, DepthMap, Float64s, Frame
from .likeness import Photograph

_IN_MEMORY, _IN_MEMORY_PX = 4, 6_000_000
"""Depth maps of a night kept at hand, at least, and more while they are small: each is asked several times."""


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

    @cached_property
    def seeing(self) -> list[str]:
        """The cameras with a depth map."""
        return [name for name in self.cameras if name in self.refined or name in self.depths]

    @cached_property
    def depth(self) -> Callable[[str], DepthMap]:
        """What a camera saw, by its name."""
        largest = max((camera.width * camera.height for camera in self.cameras.values()), default=1)

        @lru_cache(maxsize=max(_IN_MEMORY, _IN_MEMORY_PX // largest))
        def depth_of(name: str) -> DepthMap:
            return self.refined[name] if name in self.refined else self.depths[name]

        return depth_of

    def photograph(self, name: str) -> Photograph:
        """A camera with its frame."""
        return Photograph(self.cameras[name], self.frames[name])

    @cached_property
    def points(self) -> Float64s:
        """(n, 3) of the cloud."""
        return np.asarray(self.cloud.points, dtype=np.float64)

    @cached_property
    def sigma(self) -> Float64s:
        """(n,) of the cloud's points, world lengths."""
        return np.asarray(self.cloud.sigma_mm, dtype=np.float64) / 1000.0
