"""Planes of one view, propagated, improved and scored against all views around it: multi-view PatchMatch (see `mvs.kernels`)."""

from __future__ import annotations

import numpy as np

from ..core.jit import Scalar
from ..types import Bools, Float32s, Float64s, Int32s
from .kernels import BLOCK, NOISE, UNSEEN, Support, View, evaluate, propagate
from .photometric_refinement import refine_photometrically

_CHANGES = 3
"""Random changes that a pixel tries in a pass."""

_CHANGES_NEARLY_RIGHT = 2
"""Random changes if the planes are nearly right: then the cheapest of many changes is so by chance only, and fewer changes give a
better surface, in less time."""


class Propagation:
    """A view and its sources.

    Parameters
    ----------
    image, usable : (h, w) float32, grey, and (h, w) bool, True where it may be matched.
    sources : (s, h', w') float32, grey.
    M, b : (s, 3, 3) and (s, 3) float64: source s sees pixel p with inverse depth q at M_s p + b_s q.
    taps : (n, 2) int32, offsets (x, y) of a patch's pixels, its centre first.
    """

    def __init__(self, image: Float32s, usable: Bools, sources: Float32s, M: Float64s, b: Float64s, taps: Int32s) -> None:
        self.sources = len(sources)
        reach = int(np.abs(taps).max())
        # each pixel of a source beside its right neighbour, in one number of 64 bits: one access fetches both
        shifted = np.concatenate([sources[..., 1:], sources[..., -1:]], axis=-1)
        pairs = np.stack([sources, shifted], axis=-1).view(np.uint64).ravel()
        height, width = sources.shape[1:]
        self.view = View(
            image=np.pad(image, reach, mode="edge"),
            usable=np.pad(usable.astype(np.float32), reach),  # the margin is not usable
            pairs=pairs,
            height=height,
            width=width,
            M=M.astype(np.float32),
            b=b.astype(np.float32),
            taps=taps,
            reach=reach,
        )

    def improve(
        self, planes: Float32s, sweeps: int, ring_px: int, low: float, high: float, *, nearly_right: bool = False
    ) -> Float32s:
        """Improve planes in place, holes (nan) included, by propagation from neighbours and ever smaller random changes.  Returns
        their cost (h, w) float32.

        Parameters
        ----------
        planes : (3, h, w) float32: q, A, B.
        sweeps : passes over the image, alternately down and up.
        ring_px : distance of the second ring of neighbours, pixels.
        low, high : limits of q.
        nearly_right : the planes are nearly right: do at most one pass, with fewer neighbours and changes.
        """
        cost = np.full(planes.shape[1:], UNSEEN, np.float32)
        best = np.zeros(planes.shape[1:], np.int32)
        # the seed is fixed, and one block longer than a period, so that a block can start anywhere
        noise = np.random.default_rng(1).uniform(-1, 1, NOISE + BLOCK).astype(np.float32)
        if nearly_right:
            rings = [(0, 1), (1, 0), (ring_px, 0)]
            changes = _CHANGES_NEARLY_RIGHT
            sweeps = min(sweeps, 1)
        else:
            rings = [(0, 1), (1, 0), (0, ring_px), (ring_px, 0), (2, 3), (-2, 3)]
            changes = _CHANGES
        for sweep in range(sweeps):
            propagate(self.view, noise, sweep, np.array(rings), changes, Scalar(low), Scalar(high), planes, cost, best)
        return cost

    def refine_photometrically(self, planes: Float32s, radius: int) -> None:
        """Move planes (3, h, w) in place, by fractions of a pixel, to the best fit of all sources together
        (`mvs.photometric_refinement`).  radius: of the patch in pixels; it reaches no farther than `taps`.
        """
        near = range(-radius, radius + 1)
        square = [(i, j) for j in near for i in near]
        offsets = np.array(sorted(square, key=lambda at: at != (0, 0)), np.int32)  # the centre comes first, the others in order
        tap_weights = np.exp(-2 * (offsets**2).sum(axis=1) / radius**2).astype(np.float32)
        refine_photometrically(*self.view._replace(taps=offsets), tap_weights, planes)

    def support(self, planes: Float32s, limit: float) -> Support:
        """Evidence of the sources for planes (3, h, w); a source sees a plane that costs less than `limit` in it."""
        shape = planes.shape[1:]
        result = Support(
            first=np.full(shape, UNSEEN, np.float32),
            second=np.full(shape, UNSEEN, np.float32),
            sources=np.zeros(shape, np.uint32),
            parallax=np.zeros(shape, np.float32),
        )
        evaluate(self.view, planes, Scalar(limit), result)
        return result
