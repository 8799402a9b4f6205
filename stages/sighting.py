"""Where a place of the scene is in the captures of posed cameras: guides for somebody who points at it in several of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from .core.lenses import lens_pixels, lens_rays
from .types import Float64s, Lens

Pixel = list[float]
"""x, y in a capture."""

_NEAR, _FAR, _STEPS = 0.02, 2000.0, 600
"""Of a ray, the part that is drawn in other pictures, over the distance between the cameras; and of how many points."""
_EDGE = 24
"""Points of the edge of an outline: lenses bend it."""
_MARGIN = 0.5
"""Over a picture's size: what lies farther outside of it is not drawn."""


@dataclass(frozen=True)
class Sight:
    """A posed camera, for captures as they are."""

    lens: Lens
    R: Float64s
    C: Float64s

    def pixels(self, X: Float64s) -> Float64s:
        """(n, 2) where places (n, 3) of the world are; nan where the camera does not see them."""
        return lens_pixels(self.lens, (X - self.C) @ self.R.T)

    def ray(self, pixel: Pixel) -> Float64s:
        """(3,) unit direction in the world."""
        return np.asarray((lens_rays(self.lens, np.array([pixel], dtype=np.float64)) @ self.R)[0], dtype=np.float64)

    def drawn(self, X: Float64s) -> list[list[Pixel]]:
        """A line through places (n, 3), as far as it is in the picture or near it: pieces."""
        pixels = self.pixels(X)
        size = np.array([self.lens.width, self.lens.height])
        with np.errstate(invalid="ignore"):
            near = ((pixels > -_MARGIN * size) & (pixels < (1 + _MARGIN) * size)).all(axis=1)
        breaks = np.flatnonzero(np.diff(near.astype(int))) + 1
        pieces = [p for p, inside in zip(np.split(pixels, breaks), np.split(near, breaks), strict=True) if inside.any()]
        return [np.round(piece, 2).tolist() for piece in pieces if len(piece) > 1]


class Sights:
    """The posed cameras of a site, by id."""

    def __init__(self, cameras: Mapping[str, Mapping[str, Any]]) -> None:
        """cameras: as `cameras.json` has them: K, R, C, width, height, and where they are there model and distortion."""
        self._sights = {name: _sight(entry) for name, entry in cameras.items()}

    def residuals(self, pixels: Mapping[str, Pixel], stated: Sequence[float] | None) -> dict[str, Any]:
        """How well clicks on one place fit together, and to its stated coordinates.

        Returns
        -------
        dict of "place": [x, y, z] that fits the clicks best, None of fewer than two; "pixels": by camera, how far the click is
        from where that place (else the stated one) is seen; "metres": from the stated place, None where there is none.
        """
        seen = {name: pixel for name, pixel in pixels.items() if name in self._sights}
        place = self._place(seen)
        against = place if place is not None else None if stated is None else np.array(stated, dtype=np.float64)
        off = {} if against is None else {name: self._off(name, against, pixel) for name, pixel in seen.items()}
        apart = None if place is None or stated is None else float(np.linalg.norm(place - stated))
        return {"place": None if place is None else place.tolist(), "pixels": off, "metres": apart}

    def guide(self, camera: str, pixels: Mapping[str, Pixel], stated: Sequence[float] | None) -> dict[str, Any]:
        """Where a place should be in one camera's picture, by the clicks in others.

        Returns
        -------
        dict of "at": its pixel, of two clicks or more; "lines": pieces of the epipolar line, of one; "stated": the pixel of its
        stated coordinates.
        """
        if (sight := self._sights.get(camera)) is None:
            return {}
        others = {name: pixel for name, pixel in pixels.items() if name in self._sights and name != camera}
        found: dict[str, Any] = {}
        if (place := self._place(others)) is not None:
            found["at"] = _plain(sight.pixels(place[None])[0])
        elif others:
            found["lines"] = self._epipolar(sight, *next(iter(others.items())))
        if stated is not None:
            found["stated"] = _plain(sight.pixels(np.array([stated], dtype=np.float64))[0])
        return found

    def on_ground(self, camera: str, pixel: Pixel, height: float) -> Pixel | None:
        """x, y of the place at a height that a pixel shows; None above the horizon."""
        sight = self._sights[camera]
        ray = sight.ray(pixel)
        along = (height - sight.C[2]) / ray[2] if abs(ray[2]) > 1e-9 else np.nan
        return np.round((sight.C + along * ray)[:2], 3).tolist() if along > 0 else None

    def outline(self, camera: str, corners: Sequence[Pixel], height: float) -> dict[str, Any]:
        """A polygon on the ground in a camera's picture: "lines", and "corners" (None for one that is not seen)."""
        if (sight := self._sights.get(camera)) is None:
            return {"lines": [], "corners": [None] * len(corners)}
        at = np.column_stack([np.array(corners, dtype=np.float64).reshape(-1, 2), np.full(len(corners), height)])
        share = np.linspace(0, 1, _EDGE)[:, None]
        edges = [a + share * (b - a) for a, b in zip(at, np.roll(at, -1, axis=0), strict=True)]
        lines = [line for edge in edges for line in sight.drawn(edge)]
        return {"lines": lines, "corners": [_plain(pixel) for pixel in sight.pixels(at)]}

    def _off(self, camera: str, X: Float64s, pixel: Pixel) -> float | None:
        off = float(np.linalg.norm(self._sights[camera].pixels(X[None])[0] - pixel))
        return off if np.isfinite(off) else None

    def _epipolar(self, sight: Sight, other: str, pixel: Pixel) -> list[list[Pixel]]:
        from_there = self._sights[other]
        apart = float(np.linalg.norm(sight.C - from_there.C))
        along = np.geomspace(_NEAR, _FAR, _STEPS)[:, None] * max(apart, 1e-6)
        return sight.drawn(from_there.C + along * from_there.ray(pixel))

    def _place(self, pixels: Mapping[str, Pixel]) -> Float64s | None:
        """(3,) the place that clicks in two cameras or more show: next to all rays, then least squares of pixels."""
        if len(pixels) < 2:
            return None
        sights = [self._sights[name] for name in pixels]
        across = [np.eye(3) - np.outer(d, d) for d in (s.ray(p) for s, p in zip(sights, pixels.values(), strict=True))]
        A = np.sum(across, axis=0)
        if not np.isfinite(A).all() or np.linalg.cond(A) > 1e10:
            return None
        start = np.linalg.solve(A, np.sum([a @ s.C for a, s in zip(across, sights, strict=True)], axis=0))

        def off(X: Float64s) -> Float64s:
            found = [s.pixels(X[None])[0] - p for s, p in zip(sights, pixels.values(), strict=True)]
            return np.asarray(np.nan_to_num(np.concatenate(found), nan=1e4), dtype=np.float64)

        return np.asarray(least_squares(off, start, method="lm").x, dtype=np.float64)


def _sight(entry: Mapping[str, Any]) -> Sight:
    lens = Lens(
        np.array(entry["K"], dtype=np.float64),
        np.array(entry.get("distortion") or np.zeros(5), dtype=np.float64),
        None,
        int(entry["width"]),
        int(entry["height"]),
        str(entry.get("model", "brown")),
    )
    return Sight(lens, np.array(entry["R"], dtype=np.float64), np.array(entry["C"], dtype=np.float64))


def _plain(pixel: Float64s) -> Pixel | None:
    return np.round(pixel, 2).tolist() if np.isfinite(pixel).all() else None
