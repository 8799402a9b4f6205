"""Depths of one view in some pixels, of another kind in the others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..types import Bools, DepthMap, Uint32s

_PARTNERS = 32
"""Bits of `DepthMap.support`."""


def overlaid(depth: DepthMap, other: DepthMap, taken: Bools) -> DepthMap:
    """Depth of a view with that of another map of the same view where that is `taken` (h, w)."""
    partners = tuple(dict.fromkeys((*depth.partners, *other.partners)))[:_PARTNERS]
    names = ("depth", "sigma", "slope_x", "slope_y", "sure")
    mixed: dict[str, Any] = {name: np.where(taken, getattr(other, name), getattr(depth, name)) for name in names}
    return replace(depth, **mixed, support=np.where(taken, renumbered(other, partners), depth.support), partners=partners)


def renumbered(depth: DepthMap, partners: tuple[str, ...]) -> Uint32s:
    """(h, w) `support` with the bits of other partners; one that is not among them is left out."""
    support = np.zeros(depth.support.shape, np.uint32)
    place = {name: k for k, name in enumerate(partners)}
    for k, name in enumerate(depth.partners):
        if name in place:
            support |= (depth.support >> np.uint32(k) & np.uint32(1)) << np.uint32(place[name])
    return support
