"""How exact the adjusted cameras are: covariance in the frame of all cameras, for errors that last for several moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Float64s
from .adjustment import FOCAL, OFFSET, SIZE, Adjusted

LEAST_CORRELATION = 0.05
"""Errors are followed along the track until their correlation falls below this."""
MOST_LAG = 400
"""Most moments over which they are followed."""
_GAUGE = 7
"""Freedoms of the frame: place, turn and scale."""


@dataclass(frozen=True)
class Covariances:
    """Covariances of each camera's unknowns."""

    blocks: Float64s
    """(c, 9, 9) in the order of `adjustment.SIZE`; turns in camera axes, radians."""

    def centre(self, camera: int) -> Float64s:
        """(3, 3)."""
        return np.asarray(self.blocks[camera, 3:6, 3:6])

    def turn(self, camera: int) -> Float64s:
        """(3, 3) in camera axes."""
        return np.asarray(self.blocks[camera, :3, :3])

    def offset_sigma(self, camera: int) -> float:
        """Of the clock."""
        return float(np.sqrt(max(self.blocks[camera, OFFSET, OFFSET], 0.0)))

    def focal_sigma(self, camera: int) -> float:
        """Of the logarithm of the focal length."""
        return float(np.sqrt(max(self.blocks[camera, FOCAL, FOCAL], 0.0)))


def covariances(adjusted: Adjusted) -> Covariances:
    """Covariances of the cameras; in a free frame relative to all cameras together (inner constraints)."""
    state = adjusted.state
    cameras = len(state.C)
    free = np.flatnonzero(adjusted.is_free)
    normal = (adjusted.equations.normal + np.diag(adjusted.prior_information))[np.ix_(free, free)]

    # 1. Units in which the unknowns are about equally large: lengths are counted in distances between cameras.
    unit = np.ones((cameras, SIZE))
    size = max(float(np.linalg.norm(state.C - state.C.mean(axis=0), axis=1).mean()), 1e-12)
    unit[:, 3:6] = size
    unit = unit.ravel()[free]
    scaled = normal * unit[:, None] * unit[None, :]

    # 2. The frame's freedoms, unless known poses fix it.  They are added with a stiff weight, and cost nothing.
    gauge = (_gauge(adjusted).reshape(-1, _GAUGE)[free]) / unit[:, None]
    basis = np.linalg.qr(gauge)[0]
    stiffness = float(np.trace(scaled)) / len(scaled)
    if not adjusted.has_known_frame:
        scaled = scaled + stiffness * basis @ basis.T
    inverse = np.linalg.inv(scaled + 1e-13 * stiffness * np.eye(len(scaled)))
    if not adjusted.has_known_frame:
        inverse = inverse - basis @ basis.T / stiffness
    full = np.zeros((cameras * SIZE, cameras * SIZE))
    full[np.ix_(free, free)] = inverse * unit[:, None] * unit[None, :]

    # 3. Errors that last count fewer times.
    blocks = []
    for c in range(cameras):
        block = full[c * SIZE : (c + 1) * SIZE, c * SIZE : (c + 1) * SIZE]
        blocks.append(block * persistence(adjusted, c))
    return Covariances(np.array(blocks))


def _gauge(adjusted: Adjusted) -> Float64s:
    """(c, 9, 7) changes of the unknowns when the frame moves, turns or grows."""
    state = adjusted.state
    centre = state.C.mean(axis=0)
    gauge = np.zeros((len(state.C), SIZE, _GAUGE))
    for c, C in enumerate(state.C):
        arm = C - centre
        gauge[c, 3:6, :3] = np.eye(3)
        # the world turns by w: centres move by w x arm, camera axes see it turned back
        gauge[c, 3:6, 3:6] = -np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
        gauge[c, :3, 3:6] = -state.R[c]
        gauge[c, 3:6, 6] = arm
    return gauge


def persistence(adjusted: Adjusted, camera: int) -> float:
    """How many observations of a camera in a row say as much as one alone: the sum of its residuals' autocorrelations."""
    used = adjusted.used[camera]
    r = adjusted.residual.r[camera]
    r = r - r[used].mean(axis=0) if used.any() else r
    r = np.where(used[:, None], r, 0.0)
    thing = adjusted.moments.thing
    power = float((r**2).sum()) / max(int(used.sum()), 1)
    total = 1.0
    if power == 0:
        return total
    for lag in range(1, min(MOST_LAG, len(used) // 4)):
        both = used[lag:] & used[:-lag] & (thing[lag:] == thing[:-lag])
        if both.sum() < 10:
            break
        correlation = float((r[lag:] * r[:-lag])[both].sum()) / (int(both.sum()) * power)
        if correlation < LEAST_CORRELATION:
            break
        total += 2 * correlation
    return total
