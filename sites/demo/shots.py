"""What is asked of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Daytime = Literal["day", "dusk", "night", "dark"]


@dataclass(frozen=True)
class Shots:
    """How many pictures are to be taken of a scene, how large, and when."""

    cameras: int
    """The scene's first ones."""
    captures: int
    """Of each camera."""
    size: tuple[int, int] = (960, 540)
    """Width and height, pixels."""
    seed: int = 0
    """Of textures, movers, exposures and noise."""
    light: Daytime = "day"
    """The hour."""
    threads: int = 2
    """Of rendering; the result does not depend on it."""
    lenses: str = "standard"
    """A name of `variants.VARIANTS`."""
    surfaces: str = "standard"
    """A name of `weak.SURFACES`."""

    def check(self, there_are: int) -> None:
        """Raises ValueError for pictures that are too small, or none, and for more cameras than `there_are`."""
        if not 1 <= self.cameras <= there_are:
            raise ValueError(f"this scene has 1 to {there_are} cameras, not {self.cameras}")
        if self.captures < 1 or min(self.size) < 16:
            wide, high = self.size
            raise ValueError(f"a camera needs at least 1 capture of 16 x 16 pixels, not {self.captures} of {wide} x {high}")

    def texel_m(self, width_m: float, finest_m: float, coarsest_m: float) -> float:
        """Side of a texel, metres: a picture as wide as `width_m` of the scene has one for each of its pixels, within limits."""
        return float(np.clip(width_m / self.size[0], finest_m, coarsest_m))

    def voxel_m(self, width_m: float, coarsest_m: float = 0.1) -> float:
        """The same of a cell of the reference cloud, in whole centimetres and at least two."""
        return float(np.clip(round(width_m / self.size[0], 2), 0.02, coarsest_m))

    def random(self, part: int) -> np.random.Generator:
        """The random numbers of one part of the scene."""
        return np.random.default_rng([self.seed, part])
