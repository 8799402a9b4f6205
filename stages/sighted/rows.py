"""Places at which one recording shows things, and their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..types import Float64s, Int32s

_SHUTTER_S = 0.005
"""Standard deviation of when a row of a picture is exposed: rolling shutters read a picture in 10 to 30 ms."""
_LONGEST_GAP_S = 1.0
"""Longest time between two places of a thing from which its speed is taken."""


@dataclass(frozen=True)
class Rows:
    """Places of things in frames of one recording, in the order of time."""

    times: Float64s
    """(n,) float64 seconds by the camera's clock."""
    things: Int32s
    """(n,) int32."""
    xy: Float64s
    """(n, 2) float64 pixels of the recording."""
    sigma_px: Float64s
    """(n,) float64."""

    @classmethod
    def none(cls) -> Rows:
        """Nothing was seen."""
        return cls(np.zeros(0), np.zeros(0, np.int32), np.zeros((0, 2)), np.zeros(0))

    def __len__(self) -> int:
        return len(self.times)

    def scaled(self, factor: float) -> Rows:
        """The same in pictures that are larger by a factor."""
        return replace(self, xy=(self.xy + 0.5) * factor - 0.5, sigma_px=self.sigma_px * factor)

    def with_motion(self) -> Rows:
        """The same with larger standard deviations where things move fast: no row of a picture is exposed at its stated time."""
        speeds = np.zeros(len(self))
        for thing in np.unique(self.things):
            of_thing = np.flatnonzero(self.things == thing)
            if len(of_thing) > 1:
                speeds[of_thing] = _speeds(self.times[of_thing], self.xy[of_thing])
        return replace(self, sigma_px=np.hypot(self.sigma_px, _SHUTTER_S * speeds))


def _speeds(times: Float64s, xy: Float64s) -> Float64s:
    """(n,) pixels per second at each place of a track: the faster of the ways to it and from it."""
    seconds = np.diff(times)
    ways = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    is_near = (seconds > 0) & (seconds <= _LONGEST_GAP_S)
    speeds = np.zeros(len(seconds))
    speeds[is_near] = ways[is_near] / seconds[is_near]
    return np.asarray(np.maximum(np.append(speeds, 0.0), np.append(0.0, speeds)), np.float64)
