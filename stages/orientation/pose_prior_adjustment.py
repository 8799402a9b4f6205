"""Adjust stated poses to the images within their standard deviations: the most probable cameras, and their covariance.

The covariance gives the uncertainty of a pair's rows: dense matching needs rows that are right to about a pixel.

References
----------
Normal equations with the points eliminated: Triggs, McLauchlan, Hartley, Fitzgibbon, Bundle adjustment: a modern synthesis, 2000,
section 6.  Noise from the median of Rayleigh distributed residuals: see `sfm.triangulation`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..core.cameras import same_camera
from ..core.epipolar import fundamental_from_cameras, homogeneous, symmetric_epipolar_distance
from ..core.least_squares import Equations, levenberg_marquardt
from ..core.rotations import rotation_matrix, rotation_vector
from ..sfm.rigs import first_views, rotation_between
from ..sfm.tracks import Tracks, build_tracks
from ..sfm.triangulation import RAYLEIGH, angles, residuals, triangulate
from ..types import Camera, Float64s, Geometry, Pair, at_rows
from .pose_check import DEVIATIONS, LEAST_PROBABILITY, PAIR_PX, PoseConstraints, Sigma, slack_px

MIN_MATCHES = 20
"""A pair enters the adjustment only if this many of its matches lie within the tolerance of the stated poses."""
MIN_SHARE = 0.5
"""A pair enters the adjustment only if this share of its matches lies within the tolerance of the stated poses."""
MIN_SHARE_OF_TRUSTED = 0.3
"""Replaces `MIN_SHARE` for matches that contain no look-alikes."""
LEAST_NOISE_PX = 0.2
"""Smallest standard deviation of the matches: errors within a pair are correlated, however small the residuals."""
WEIGHT_UNCONFIRMED = 4.0
"""Largest weight of the matches of an unconfirmed pair, as a number of independent matches with a noise of one pixel: correlated
errors do not average out.  Small, as such a pair may contain look-alikes within the standard deviations."""
WEIGHT_CONFIRMED = 400.0
"""The same for a pair that a third camera confirms, which contains none."""
NOISES = 3.0
"""Scale of the Cauchy loss, in standard deviations of the noise."""
ROUNDS = 4
"""Rounds of the adjustment, each with the inliers and the noise of the one before."""
FIRST_NOISE_PX = 2.0
"""Standard deviation of the matches that the first round assumes: stated poses may be that far off."""
OUTLIER_SCALES = 4.0
"""Observations with larger errors, in scales of the loss, are left out of a round."""
MIN_ANGLE = np.radians(1.0)
"""Rays that meet at less than this (radians) yield no point."""
_MOST_LEAST_SQUARES_STEPS = 20
"""Largest number of steps in a round."""


def adjust_within_priors(
    cameras: Mapping[str, Camera], sigmas: Mapping[str, Sigma], geometries: Mapping[Pair, Geometry], *, trusted: bool = False
) -> AdjustedPoses:
    """The most probable cameras, given their stated poses with standard deviations and the matches that these allow.

    Parameters
    ----------
    cameras, sigmas : stated cameras, and their standard deviations; cameras not named in `sigmas` are exact, and stay fixed.
    geometries : matches of the pairs.  Improbable pairs are ignored, and so are matches farther from the epipolar lines than
        the standard deviations allow.
    trusted : whether the matches contain no look-alikes: each pair then has the weight of a confirmed one.
    """
    least_share = MIN_SHARE_OF_TRUSTED if trusted else MIN_SHARE
    pairs = _allowed_matches(cameras, sigmas, geometries, least_share)
    adjustable = {name: sigmas[name] for name in cameras if not sigmas.get(name, Sigma()).exact}
    stated_only = AdjustedPoses.as_stated(cameras, adjustable)
    if not pairs or not adjustable:
        return stated_only
    names = tuple(cameras)
    number = {name: k for k, name in enumerate(names)}
    stated = dict(enumerate(cameras.values()))
    confirmed = set(pairs)
    if not trusted:
        triplets = PoseConstraints.of(names, pairs).triplets
        confirmed = set()
        for triplet in triplets:
            confirmed.update(combinations(triplet.cameras, 2))
    while True:
        # 1. Adjust all that may move.
        edges = {(number[left], number[right]): geometry for (left, right), geometry in pairs.items()}
        tracks = build_tracks(edges, len(names))
        weight = sum(WEIGHT_CONFIRMED if pair in confirmed else WEIGHT_UNCONFIRMED for pair in pairs)
        free = {number[name]: sigma for name, sigma in adjustable.items()}
        solved, problem = _most_probable(stated, free, tracks, weight)
        adjusted = {name: solved[number[name]] for name in names}

        # 2. Has any left the range that its standard deviations allow?
        excesses = {name: _excess(adjusted[name], cameras[name], sigma) for name, sigma in adjustable.items()}
        strayed = [name for name, excess in excesses.items() if excess > 1]
        if not strayed:
            if problem is None:
                return stated_only
            return stated_only.with_images(adjusted, *problem.covariance_of(solved, names))

        # 3. The worst one stays as stated, and no longer influences the others; all its views move together.
        worst = max(strayed, key=excesses.__getitem__)
        dropped = {name for name in names if name == worst or same_camera(cameras[name], cameras[worst])}
        adjustable = {name: sigma for name, sigma in adjustable.items() if name not in dropped}
        pairs = {pair: geometry for pair, geometry in pairs.items() if not dropped & {*pair}}


def _allowed_matches(
    cameras: Mapping[str, Camera], sigmas: Mapping[str, Sigma], geometries: Mapping[Pair, Geometry], least_share: float
) -> dict[Pair, Geometry]:
    """The matches that the standard deviations allow, of the probable pairs where these are enough."""
    allowed = {}
    for pair, geometry in geometries.items():
        if geometry.good_probability < LEAST_PROBABILITY or not set(pair) <= set(cameras):
            continue
        F = fundamental_from_cameras(cameras[pair[0]], cameras[pair[1]])
        slack = slack_px(cameras, sigmas, pair, geometry)
        near = symmetric_epipolar_distance(F, geometry.x1, geometry.x2) <= 3 * PAIR_PX + slack
        if near.sum() >= max(MIN_MATCHES, least_share * len(near)):
            allowed[pair] = at_rows(geometry, near)
    return allowed


def _excess(adjusted: Camera, stated: Camera, sigma: Sigma) -> float:
    """Distance of a camera from its stated pose, as a share of what its standard deviations allow."""
    metres = float(np.linalg.norm(adjusted.C - stated.C))
    degrees = float(np.degrees(np.linalg.norm(rotation_vector(adjusted.R @ stated.R.T))))
    limit = DEVIATIONS * float(np.sqrt(3))  # three coordinates together
    return max(metres / (limit * sigma.metres + 1e-9), degrees / (limit * sigma.degrees + 1e-9))


def _most_probable(
    stated: Mapping[int, Camera], sigmas: Mapping[int, Sigma], tracks: Tracks, weight: float
) -> tuple[dict[int, Camera], _Problem | None]:
    """Rounds of least squares over cameras and points, each with the inliers and the noise found so far.

    Also returns the last of these problems, None if no observation was in use.

    weight: largest weight of all matches together, as a number of matches with a noise of one pixel.
    """
    cameras = dict(stated)
    noise = FIRST_NOISE_PX
    problem = None
    for _ in range(ROUNDS):
        # 1. Inliers: near their point, which two of them see, at an angle that determines it.
        scale = NOISES * noise
        X = triangulate(cameras, tracks, np.ones(len(tracks.track), bool), scale)
        error = np.linalg.norm(residuals(cameras, tracks, X), axis=1)
        with np.errstate(invalid="ignore"):  # points that could not be triangulated are nan
            use = np.asarray(error < OUTLIER_SCALES * scale)
        use &= (np.bincount(tracks.track[use], minlength=tracks.count) >= 2)[tracks.track]
        use &= (angles(cameras, tracks, X, use) >= MIN_ANGLE)[tracks.track]
        if not use.any():
            return cameras, problem

        # 2. Adjust.  With many points, their weight is limited to that of `weight` independent ones.
        points = len(np.unique(tracks.track[use]))
        inliers = Tracks(tracks.track[use], tracks.view[use], tracks.xy[use], tracks.count)
        share = min(1.0, weight * noise**2 / points)
        problem = _Problem(stated, sigmas, inliers, noise, share)
        _, cameras = levenberg_marquardt(
            cameras,
            problem.equations,
            problem.moved,
            steps=_MOST_LEAST_SQUARES_STEPS,
            damping=1e-3,
            least_damping=1e-9,
            relative_tolerance=1e-6,
        )

        # 3. The noise that remains.
        remaining_px = np.linalg.norm(residuals(cameras, inliers, problem.points(cameras)), axis=1)
        noise = max(LEAST_NOISE_PX, float(np.nanmedian(remaining_px)) / RAYLEIGH)
    return cameras, problem


class _Problem:
    """Least squares over the adjustable cameras; each point is at its optimum, so that steps contain cameras only."""

    def __init__(
        self, stated: Mapping[int, Camera], known: Mapping[int, Sigma], tracks: Tracks, noise: float, share: float
    ) -> None:
        """tracks: the observations in use; share: weight of the images relative to the stated poses."""
        self.stated = stated
        self.known = known
        self.tracks = tracks
        self.noise = noise
        self.share = share
        first = first_views({view: stated[view] for view in known})
        blocks = {view: 6 * k for k, view in enumerate(dict.fromkeys(first.values()))}
        self.place = {view: blocks[first[view]] for view in known}
        """For each view, where the step of its camera begins: all views of a camera move together."""
        self.size = 6 * len(blocks)
        self.turns = {}
        """For each further view of a camera: the rotation (3, 3) from the axes of the first view to its own."""
        for view, first_view in first.items():
            if first_view != view:
                self.turns[view] = rotation_between(stated[first_view].lens, stated[view].lens)

    def points(self, cameras: Mapping[int, Camera]) -> Float64s:
        """(count, 3) points triangulated from the observations."""
        return triangulate(cameras, self.tracks, np.ones(len(self.tracks.track), bool), NOISES * self.noise)

    def moved(self, cameras: Mapping[int, Camera], step: Float64s) -> dict[int, Camera]:
        """The cameras after a step: for each adjustable one a rotation in its own axes, and a shift."""
        stepped = dict(cameras)
        for view, k in self.place.items():
            camera = cameras[view]
            turn = step[k : k + 3]
            if view in self.turns:
                turn = self.turns[view] @ turn
            stepped[view] = replace(camera, R=rotation_matrix(turn) @ camera.R, C=camera.C + step[k + 3 : k + 6])
        return stepped

    def covariance_of(self, cameras: Mapping[int, Camera], names: tuple[str, ...]) -> tuple[dict[str, Place], Float64s]:
        """Indices of the cameras' rotations and shifts in the covariance (n, n), and this inverse of the normal equations."""
        identity = np.eye(3)
        places = {names[view]: Place(k, self.turns.get(view, identity)) for view, k in self.place.items()}
        covariance = np.asarray(np.linalg.inv(self.equations(cameras)[1]), dtype=np.float64)
        # What is exact has no variance; the equations hold it by an arbitrary weight.
        for view, k in self.place.items():
            for first, sigma in ((k, self.known[view].degrees), (k + 3, self.known[view].metres)):
                if sigma == 0 and view not in self.turns:
                    covariance[first : first + 3] = 0.0
                    covariance[:, first : first + 3] = 0.0
        return places, covariance

    def equations(self, cameras: Mapping[int, Camera]) -> Equations:
        """Cauchy loss of the pixels in standard deviations, plus the priors; normal equations with the points eliminated."""
        tracks = self.tracks
        size = self.size

        # 1. Errors in standard deviations; points behind a camera count as outliers, without weight.
        X = self.points(cameras)
        error = residuals(cameras, tracks, X) / self.noise
        visible = np.isfinite(error).all(axis=1)
        error[~visible] = OUTLIER_SCALES * NOISES
        squared = (error**2).sum(axis=1)
        cost = 0.5 * NOISES**2 * float(np.log1p(squared / NOISES**2).sum())
        weight = np.where(visible, 1 / (1 + squared / NOISES**2), 0.0)
        J_camera, J_point = self._jacobians(cameras, X)

        # 2. The points' own normal matrices H (3, 3) and gradients g, and the inverses, regularised for poorly determined points.
        H = np.zeros((tracks.count, 3, 3))
        g = np.zeros((tracks.count, 3))
        weighted = weight[:, None, None] * J_point
        np.add.at(H, tracks.track, weighted.transpose(0, 2, 1) @ J_point)
        np.add.at(g, tracks.track, np.einsum("nki,nk->ni", weighted, error))
        trace = np.trace(H, axis1=1, axis2=2)[:, None, None]
        inverse = np.linalg.inv(H + (1e-9 * trace + 1e-12) * np.eye(3))

        # 3. The cameras' part, and W, which couples each view with each point.
        normal = np.zeros((size, size))
        gradient = np.zeros(size)
        W = np.zeros((len(self.place), tracks.count, 6, 3))
        for block, (view, k) in enumerate(self.place.items()):
            rows = tracks.view == view
            A = weight[rows, None, None] * J_camera[rows]
            normal[k : k + 6, k : k + 6] += np.tensordot(A, J_camera[rows], ((0, 1), (0, 1)))
            gradient[k : k + 6] += np.tensordot(A, error[rows], ((0, 1), (0, 1)))
            W[block, tracks.track[rows]] = A.transpose(0, 2, 1) @ J_point[rows]

        # 4. Eliminate the points: subtract W H^-1 W^T and W H^-1 g (the Schur complement).
        WH = W @ inverse
        for a, k in enumerate(self.place.values()):
            gradient[k : k + 6] -= np.tensordot(WH[a], g, ((0, 2), (0, 1)))
            for b, m in enumerate(self.place.values()):
                normal[k : k + 6, m : m + 6] -= np.tensordot(WH[a], W[b], ((0, 2), (0, 2)))
        return self._with_priors(cameras, cost, normal, gradient)

    def _jacobians(self, cameras: Mapping[int, Camera], X: Float64s) -> tuple[Float64s, Float64s]:
        """Derivatives of observed minus projected by rotation and shift of the camera (n, 2, 6), and by the point (n, 2, 3)."""
        tracks = self.tracks
        J_camera = np.zeros((len(tracks.track), 2, 6))
        J_point = np.zeros((len(tracks.track), 2, 3))
        for view, camera in cameras.items():
            rows = np.flatnonzero(tracks.view == view)
            in_camera = (np.nan_to_num(X[tracks.track[rows]]) - camera.C) @ camera.R.T
            z = np.where(in_camera[:, 2] > 0, in_camera[:, 2], 1.0)
            pixels = in_camera @ camera.K.T / z[:, None]
            # D (n, 2, 3): derivatives of the pixels by the point in camera axes.
            D = (camera.K[None, :2] - pixels[:, :2, None] * camera.K[None, 2:]) / z[:, None, None]
            J_camera[rows, :, :3] = np.cross(D, in_camera[:, None]) / self.noise
            if view in self.turns:
                J_camera[rows, :, :3] = J_camera[rows, :, :3] @ self.turns[view]
            J_point[rows] = -D @ camera.R / self.noise
            J_camera[rows, :, 3:] = -J_point[rows]
        return J_camera, J_point

    def _with_priors(self, cameras: Mapping[int, Camera], cost: float, normal: Float64s, gradient: Float64s) -> Equations:
        """The equations of the images, weighted, plus those of the stated poses."""
        cost = self.share * cost
        normal = self.share * normal
        gradient = self.share * gradient
        for view, k in self.place.items():
            if view in self.turns:  # stated once for each camera: with its first view
                continue
            sigma = self.known[view]
            camera = cameras[view]
            stated = self.stated[view]
            turn = rotation_vector(camera.R @ stated.R.T)
            shift = camera.C - stated.C
            for first, deviation, prior_sigma in ((k, turn, np.radians(sigma.degrees)), (k + 3, shift, sigma.metres)):
                rows = slice(first, first + 3)
                if prior_sigma == 0:  # exact: the equation "step = 0" keeps it in place
                    normal[rows] = 0.0
                    normal[:, rows] = 0.0
                    gradient[rows] = 0.0
                    normal[rows, rows] = np.eye(3)
                    continue
                cost += 0.5 * float(deviation @ deviation) / prior_sigma**2
                normal[rows, rows] += np.eye(3) / prior_sigma**2
                gradient[rows] += deviation / prior_sigma**2
        return cost, normal, gradient


@dataclass(frozen=True)
class Place:
    """Indices of a camera's rotation (3, radians) and shift (3) in a covariance."""

    first: int
    """Row of the first of the six."""
    turn: Float64s
    """(3, 3) from the axes of that rotation to the view's own: all views of a camera turn with its first one."""


@dataclass(frozen=True)
class AdjustedPoses:
    """Cameras at their most probable poses, with the covariance of those that are not exact."""

    cameras: dict[str, Camera]
    """By id."""
    places: Mapping[str, Place]
    """For each camera that is not exact, by id."""
    covariance: Float64s
    """(n, n)."""

    @classmethod
    def as_stated(cls, cameras: Mapping[str, Camera], sigmas: Mapping[str, Sigma]) -> AdjustedPoses:
        """The stated cameras, without information from the images; sigmas: of those that are not exact."""
        places = {}
        deviations: list[float] = []
        for name, sigma in sigmas.items():
            places[name] = Place(len(deviations), np.eye(3))
            deviations += [np.radians(sigma.degrees)] * 3
            deviations += [sigma.metres] * 3
        return cls(dict(cameras), places, np.diag(np.square(np.array(deviations, dtype=np.float64))))

    def with_images(self, cameras: dict[str, Camera], places: Mapping[str, Place], covariance: Float64s) -> AdjustedPoses:
        """The adjusted `cameras`; `covariance` replaces the stated one of those in `places`."""
        n = len(self.covariance)
        combined = np.zeros((n + len(covariance),) * 2)
        combined[:n, :n] = self.covariance
        combined[n:, n:] = covariance
        adjusted = {name: Place(n + place.first, place.turn) for name, place in places.items()}
        return AdjustedPoses(cameras, {**self.places, **adjusted}, combined)

    def row_sigmas_px(self, pair: Pair, x1: Float64s, x2: Float64s) -> Float64s:
        """(n,) standard deviation of the distance of points x1, x2 (n, 2) of a pair to the epipolar lines, to first order."""
        # six rows of the covariance for each camera that could move
        firsts = {self.places[name].first for name in pair if name in self.places}
        rows: list[int] = []
        for first in sorted(firsts):
            rows += range(first, first + 6)
        # Steps along the principal axes of the covariance are independent: the squares of their effects add up.
        values, vectors = np.linalg.eigh(self.covariance[np.ix_(rows, rows)])
        distances = self._line_distances(pair, x1, x2, {})
        variance = np.zeros(len(x1))
        for value, vector in zip(values, vectors.T, strict=True):
            step = dict(zip(rows, np.sqrt(max(value, 0.0)) * vector, strict=True))
            variance += (self._line_distances(pair, x1, x2, step) - distances) ** 2
        return np.sqrt(variance)

    def _line_distances(self, pair: Pair, x1: Float64s, x2: Float64s, step: Mapping[int, float]) -> Float64s:
        """(n,) signed distances of x2 to the epipolar lines of x1, after a step."""
        left = self._stepped(pair[0], step)
        right = self._stepped(pair[1], step)
        lines = homogeneous(x1) @ fundamental_from_cameras(left, right).T
        products = np.sum(lines * homogeneous(x2), axis=1)
        return np.asarray(products / np.linalg.norm(lines[:, :2], axis=1), dtype=np.float64)

    def _stepped(self, name: str, step: Mapping[int, float]) -> Camera:
        """A camera after a step of its own; step: by index in the covariance."""
        camera = self.cameras[name]
        place = self.places.get(name)
        if not step or place is None:
            return camera
        own_step = [step[place.first + k] for k in range(6)]
        turn = np.array(own_step[:3])
        shift = np.array(own_step[3:])
        return replace(camera, R=rotation_matrix(place.turn @ turn) @ camera.R, C=camera.C + shift)
