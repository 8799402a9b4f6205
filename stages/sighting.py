"""Where a point of the scene appears in the captures of posed cameras: guides for marking it in several of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .core.lenses import lens_pixels, lens_rays
from .types import Float64s, Lens

Pixel = list[float]
"""x, y in a capture, pixels."""

_NEAR = 0.02
"""Nearest point of a ray that is drawn in other pictures, in units of the baseline between the two cameras."""
_FAR = 2000.0
"""Farthest point of a ray that is drawn in other pictures, in units of the baseline."""
_STEPS = 600
"""Number of points of a ray that is drawn in other pictures, evenly in the logarithm of their distance."""
_EDGE_POINTS = 24
"""Points along each edge of an outline, since lenses bend straight lines."""
_MARGIN = 0.5
"""Margin around a picture, as a share of its size, within which lines are still drawn."""
_ROUNDS = 5
"""Rounds in which a point is solved with weights by its distance from the cameras."""
_MOST_CONDITION = 1e10
"""Condition number of the equations above which the rays are parallel and have no intersection."""

_Ray = tuple[Float64s, Float64s, float]
"""Origin, unit direction, and pixels per radian."""


@dataclass(frozen=True)
class Sight:
    """A posed camera, with the pixels of captures as they are (distorted)."""

    lens: Lens
    R: Float64s
    C: Float64s

    def pixels(self, X: Float64s) -> Float64s:
        """(n, 2) pixels of points (n, 3) of the world; nan where the camera does not see them."""
        return lens_pixels(self.lens, (X - self.C) @ self.R.T)

    def rays(self, pixels: Sequence[Pixel]) -> Float64s:
        """(n, 3) unit directions in the world."""
        return np.asarray(lens_rays(self.lens, np.array(pixels, dtype=np.float64)) @ self.R, dtype=np.float64)

    @property
    def focal(self) -> float:
        """Pixels per radian in the middle of the picture."""
        assert self.lens.K is not None
        return float(self.lens.K[0, 0])

    def line_pieces(self, X: Float64s) -> list[list[Pixel]]:
        """The pieces of a line through points (n, 3) of the world that are in or near the picture."""
        pixels = self.pixels(X)
        size = np.array([self.lens.width, self.lens.height])
        with np.errstate(invalid="ignore"):  # points that the camera does not see are nan, and near nothing
            is_near = ((pixels > -_MARGIN * size) & (pixels < (1 + _MARGIN) * size)).all(axis=1)
        # cut where points enter or leave the picture: each run is then near it as a whole, or not at all
        cuts = np.flatnonzero(np.diff(is_near.astype(int))) + 1
        pieces = []
        for run, is_inside in zip(np.split(pixels, cuts), np.split(is_near, cuts), strict=True):
            if len(run) > 1 and is_inside.any():
                pieces.append(np.round(run, 2).tolist())
        return pieces


class Sights:
    """The posed cameras of a site, by id."""

    def __init__(self, cameras: Mapping[str, Mapping[str, Any]]) -> None:
        """cameras: entries of `cameras.json`: K, R, C, width, height, and optionally model and distortion."""
        self._sights = {name: _sight(entry) for name, entry in cameras.items()}

    def residuals(self, points: Sequence[tuple[Mapping[str, Pixel], Sequence[float] | None]]) -> list[dict[str, Any]]:
        """How well clicks on points, by camera, agree with each other and with stated coordinates.

        For each point: "place", the [x, y, z] that fits the clicks best, None if there are fewer than two; "pixels", by camera
        the distance of the click from the projection of that (else the stated) place; "metres" from the stated place, or None.
        """
        places = self._places([pixels for pixels, _ in points])
        results: list[dict[str, Any]] = []
        expected: list[Float64s | None] = []
        for place, (_, stated) in zip(places, points, strict=True):
            stated_place = None if stated is None else np.array(stated, dtype=np.float64)
            metres = None
            if place is not None and stated_place is not None:
                metres = float(np.linalg.norm(place - stated_place))
            # clicks are compared with the place that fits them, or with the stated one if they determine none
            if place is None:
                results.append({"place": None, "pixels": {}, "metres": metres})
                expected.append(stated_place)
            else:
                results.append({"place": place.tolist(), "pixels": {}, "metres": metres})
                expected.append(place)

        # all points of one camera are projected together
        for name, sight in self._sights.items():
            rows = []
            clicks = []
            seen_places = []
            for k, (pixels, _) in enumerate(points):
                place = expected[k]
                if name in pixels and place is not None:
                    rows.append(k)
                    clicks.append(pixels[name])
                    seen_places.append(place)
            if not rows:
                continue
            projected = sight.pixels(np.array(seen_places, dtype=np.float64))
            distances = np.linalg.norm(projected - np.array(clicks), axis=1)
            for k, distance in zip(rows, distances.tolist(), strict=True):
                results[k]["pixels"][name] = distance if np.isfinite(distance) else None
        return results

    def guide(self, camera: str, pixels: Mapping[str, Pixel], stated: Sequence[float] | None) -> dict[str, Any]:
        """Where a point should be in one camera's picture, by the clicks in others: "at": its pixel, from two clicks or more;
        "lines": pieces of the epipolar line, from one click; "stated": the pixel of its stated coordinates."""
        sight = self._sights.get(camera)
        if sight is None:
            return {}
        others = {name: pixel for name, pixel in pixels.items() if name in self._sights and name != camera}
        guides: dict[str, Any] = {}
        (place,) = self._places([others])
        # two clicks or more give a point; one gives a ray, whose image here is the epipolar line
        if place is not None:
            guides["at"] = _rounded(sight.pixels(place[None])[0])
        elif others:
            other, pixel = next(iter(others.items()))
            other_sight = self._sights[other]
            baseline = max(float(np.linalg.norm(sight.C - other_sight.C)), 1e-6)
            # (n, 1) evenly in the logarithm: nearby points move much faster through the picture than distant ones
            distances = np.geomspace(_NEAR, _FAR, _STEPS)[:, None] * baseline
            guides["lines"] = sight.line_pieces(other_sight.C + distances * other_sight.rays([pixel]))
        if stated is not None:
            guides["stated"] = _rounded(sight.pixels(np.array([stated], dtype=np.float64))[0])
        return guides

    def on_ground(self, camera: str, pixel: Pixel, height: float) -> Pixel | None:
        """x, y of the point at a given height that a pixel shows; None above the horizon."""
        sight = self._sights[camera]
        (ray,) = sight.rays([pixel])
        if not abs(ray[2]) > 1e-9:  # horizontal, or nan
            return None
        distance = (height - sight.C[2]) / ray[2]
        if not distance > 0:
            return None
        x, y = np.round((sight.C + distance * ray)[:2], 3).tolist()
        return [x, y]

    def outline(self, camera: str, corners: Sequence[Pixel], height: float) -> dict[str, Any]:
        """A polygon on the ground in a camera's picture: "lines", and "corners" (None for one that is not seen)."""
        sight = self._sights.get(camera)
        if sight is None:
            return {"lines": [], "corners": [None] * len(corners)}
        points = np.column_stack([np.array(corners, dtype=np.float64).reshape(-1, 2), np.full(len(corners), height)])
        fractions = np.linspace(0, 1, _EDGE_POINTS)[:, None]
        lines: list[list[Pixel]] = []
        for start, end in zip(points, np.roll(points, -1, axis=0), strict=True):
            lines += sight.line_pieces(start + fractions * (end - start))
        return {"lines": lines, "corners": [_rounded(pixel) for pixel in sight.pixels(points)]}

    def _places(self, points: Sequence[Mapping[str, Pixel]]) -> list[Float64s | None]:
        """(3,) the position of each point from clicks in two cameras or more; None if it is not determined."""
        rays: list[list[_Ray]] = [[] for _ in points]
        for name, sight in self._sights.items():
            clicked = [k for k, pixels in enumerate(points) if name in pixels]
            if not clicked:
                continue
            directions = sight.rays([points[k][name] for k in clicked])
            for k, direction in zip(clicked, directions, strict=True):
                rays[k].append((sight.C, direction, sight.focal))
        return [_intersection(point_rays) for point_rays in rays]


def _intersection(rays: Sequence[_Ray]) -> Float64s | None:
    """(3,) the point closest to all rays by least squares of distances in pixels (focal length times distance / range)."""
    if len(rays) < 2:
        return None
    # (3, 3) for each ray: the part of a vector across the ray, so |projector (X - C)| is the distance of X from it
    projectors = [np.eye(3) - np.outer(direction, direction) for _, direction, _ in rays]
    origins = np.array([C for C, _, _ in rays])
    focals = np.array([focal for _, _, focal in rays])
    weights = np.ones(len(rays))
    place = np.zeros(3)
    for _ in range(_ROUNDS):
        # the normal equations: the sum of w P X equals the sum of w P C over all rays
        A = np.sum([w * projector for w, projector in zip(weights, projectors, strict=True)], axis=0)
        if not np.isfinite(A).all() or np.linalg.cond(A) > _MOST_CONDITION:
            return None
        right_side = np.sum([w * projector @ C for w, projector, C in zip(weights, projectors, origins, strict=True)], axis=0)
        place = np.linalg.solve(A, right_side)
        distances = np.array([np.linalg.norm(place - C) for C in origins])
        weights = (focals / np.maximum(distances, 1e-9)) ** 2  # from metres across the ray to pixels
    return np.asarray(place, dtype=np.float64)


def _sight(entry: Mapping[str, Any]) -> Sight:
    """The camera of an entry of `cameras.json`."""
    lens = Lens(
        np.array(entry["K"], dtype=np.float64),
        np.array(entry.get("distortion") or np.zeros(5), dtype=np.float64),
        None,
        int(entry["width"]),
        int(entry["height"]),
        str(entry.get("model", "brown")),
    )
    return Sight(lens, np.array(entry["R"], dtype=np.float64), np.array(entry["C"], dtype=np.float64))


def _rounded(pixel: Float64s) -> Pixel | None:
    """A pixel to two decimals; None for one that is not seen."""
    if not np.isfinite(pixel).all():
        return None
    x, y = np.round(pixel, 2).tolist()
    return [x, y]
