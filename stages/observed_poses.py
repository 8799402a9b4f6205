"""Where cameras are, from observations of things that move before them: a lamp, a board, a drone, or points clicked in pictures.

Cameras that share no texture share time: what two of them see at once are two rays to one place.  Clocks may be seconds off; they
are solved with the poses.  Wrong observations are the rule, and are found.

1. Observations become rays along tracks (`observed.tracks`).
2. Two cameras begin a model; the others join one by one (`observed.hypotheses`, `observed.growth`).
3. All are adjusted together, with covariance (`observed.adjustment`, `observed.uncertainty`).
4. The frame is that of stated poses, of known places of the thing, or the cameras' own (`observed.frame`).
5. Two halves of the observations show how exact the result is.

References
----------
Svoboda, Martinec & Pajdla, A convenient multi-camera self-calibration for virtual environments, Presence 14, 2005.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .contracts.observation_figures import ObservedCamera
from .contracts.reasons import Reason, Rejected
from .observed.adjustment import Adjusted
from .observed.distances import scaled_by_distances
from .observed.final import Solved, halves, solve
from .observed.frame import WorldFrame, find_frame
from .observed.notes import advice, unplaced_reasons
from .observed.tracks import make_tracks
from .observed.uncertainty import Covariances, covariances
from .types import Bools, Float64s, Lens, Observations, ObservedPoses, Placement, Survey, ThingSurvey

FRAMES_PER_SECOND = 25.0
"""Frame rate that is assumed where observations count frames."""


def solve_observations(
    observations: Observations | None,
    lenses: Mapping[str, Lens],
    placements: Mapping[str, Placement],
    thing_survey: ThingSurvey | None = None,
    survey: Survey | None = None,
    *,
    max_offset_s: float = 5.0,
    seed: int = 0,
) -> ObservedPoses | Rejected:
    """Place the cameras by what they saw.

    Returns `Rejected` if no two cameras can be placed.

    Parameters
    ----------
    observations : of all cameras, in pixels of the pictures as captured; None if there are none.
    lenses : of the pictures as captured, by camera.
    placements : stated poses by camera; positions of two cameras or more give the frame.
    thing_survey : known places of the things, or lengths between them.
    survey : distances between cameras, which give the scale if nothing else does.
    max_offset_s : clocks of cameras may differ by this much, seconds; observations that count frames: at 25 frames a second.
    seed : of the random samples.
    """
    if observations is None or not len(observations.camera):
        return Rejected(Reason.NO_OBSERVATIONS)
    unit = 1.0 if observations.time_unit == "s" else FRAMES_PER_SECOND
    # times are counted from the middle of the recording: clocks may count from 1970
    moving = np.isfinite(observations.time)
    origin = float(np.median(observations.time[moving])) if moving.any() else 0.0
    shifted = replace(observations, time=observations.time - origin)
    surveyed = None if thing_survey is None else _for_things(thing_survey, observations.things, origin)

    lenses = {name: _with_intrinsics(lens) for name, lens in lenses.items()}
    tracks = make_tracks(shifted, lenses)
    still = np.zeros(len(observations.things), dtype=bool)
    still[observations.thing[~moving]] = True
    solved = solve(tracks, still, lenses, unit, max_offset_s, seed)
    if isinstance(solved, Rejected):
        return solved
    frame = find_frame(solved.names, solved.adjusted, placements, surveyed, max_offset_s * unit)
    poses = _result(observations, shifted, lenses, solved, frame)
    return scaled_by_distances(poses, placements, survey or Survey())


def _with_intrinsics(lens: Lens) -> Lens:
    """The lens with K of its horizontal field of view, if only that is stated; `hfov_deg` then stays as a mark of it."""
    if lens.K is not None:
        return replace(lens, hfov_deg=None)
    if lens.hfov_deg is None or not lens.width:
        return lens
    focal = 0.5 * lens.width / np.tan(np.deg2rad(lens.hfov_deg) / 2)
    K = np.array([[focal, 0, 0.5 * lens.width - 0.5], [0, focal, 0.5 * lens.height - 0.5], [0, 0, 1]])
    return replace(lens, K=K)


def _for_things(survey: ThingSurvey, things: tuple[str, ...], origin: float) -> ThingSurvey:
    """The survey by the numbers of the observations' things, and by their clock."""
    number = {name: k for k, name in enumerate(things)}
    numbers = np.array([number.get(name, -1) for name in survey.things], dtype=np.int32)
    # a survey without ids is of the only thing that moves
    if len(survey.things) == 1 and len(things) == 1:
        numbers = np.zeros(1, np.int32)
    lengths = []
    for first, second, metres in survey.lengths:
        if numbers[first] >= 0 and numbers[second] >= 0:
            lengths.append((int(numbers[first]), int(numbers[second]), metres))
    thing = numbers[survey.thing] if len(survey.thing) else survey.thing
    known = thing >= 0
    return replace(
        survey,
        things=things,
        thing=thing[known],
        time=survey.time[known] - origin,
        position=survey.position[known],
        sigma_m=survey.sigma_m[known],
        lengths=tuple(lengths),
    )


def _result(
    observations: Observations, shifted: Observations, lenses: Mapping[str, Lens], solved: Solved, frame: WorldFrame
) -> ObservedPoses:
    """Poses and figures in the world."""
    adjusted = solved.adjusted
    state = adjusted.state
    similarity = frame.similarity
    spread = covariances(adjusted)
    apart = halves(solved, spread)
    if apart is not None:
        spread = Covariances(spread.blocks * apart.excess)
    placements = {}
    figures = {}
    focal_scales = {}
    for k, name in enumerate(solved.names):
        C = similarity.points(state.C[k][None])[0]
        sigma_m, sigma_deg = _sigmas(spread, frame, k, C, state.R[k])
        # the errors of the frame move all cameras alike: as evidence for each other, they are known better
        alone_m, alone_deg = _sigmas(spread, replace(frame, covariance=np.zeros((7, 7))), k, C, state.R[k])
        placements[name] = Placement(state.R[k] @ similarity.R.T, C, alone_m, alone_deg, frame.metric)
        if name in solved.focal_solved:
            focal_scales[name] = float(np.exp(state.log_focal[k]))
        figures[name] = _camera_figures(observations, solved, k, (sigma_m, sigma_deg), spread)
    for name, reason in unplaced_reasons(shifted, lenses, solved).items():
        count = int((observations.camera == observations.cameras.index(name)).sum())
        figures[name] = ObservedCamera(observations=count, reason=reason)
    used = adjusted.used
    seen = used.sum(axis=0) >= 2
    return ObservedPoses(
        placements=placements,
        focal_scales=focal_scales,
        track=similarity.points(state.X[seen]),
        cameras={name: figures[name] for name in observations.cameras if name in figures},
        things=int(seen.sum()),
        reprojection_px=float(np.median(adjusted.residual.pixels[used])),
        survey_m=frame.survey_m,
        halves_m=None if apart is None else apart.distance * similarity.scale,
        halves_deg=None if apart is None else apart.degrees,
        metric=frame.metric,
        scale=frame.scale,
        time_unit=observations.time_unit,
        notes=(*frame.notes, *advice(observations, shifted, lenses, solved, figures)),
    )


def _camera_figures(
    observations: Observations,
    solved: Solved,
    k: int,
    sigmas: tuple[float, float],
    spread: Covariances,
) -> ObservedCamera:
    """Figures of a placed camera."""
    adjusted = solved.adjusted
    name = solved.names[k]
    used = adjusted.used[k]
    change = None
    if name in solved.focal_solved and name not in solved.of_hfov:
        change = float(np.expm1(adjusted.state.log_focal[k]))
    return ObservedCamera(
        observations=int((observations.camera == observations.cameras.index(name)).sum()),
        used=_used_rows(adjusted, k, used, solved),
        reprojection_px=float(np.median(adjusted.residual.pixels[k][used])) if used.any() else None,
        offset=float(adjusted.state.clocks[k].offset),
        offset_sigma=spread.offset_sigma(k),
        sigma_m=sigmas[0],
        sigma_deg=sigmas[1],
        focal_change=change,
    )


def _used_rows(adjusted: Adjusted, k: int, used: Bools, solved: Solved) -> int:
    """Number of observations that are nearest to a used moment."""
    return len(np.unique(solved.nearest[k][used]))


def _sigmas(spread: Covariances, frame: WorldFrame, k: int, C: Float64s, R: Float64s) -> tuple[float, float]:
    """Standard deviations of place (world lengths) and turn (degrees) in their worst directions, with those of the frame."""
    s = frame.similarity
    centre = s.scale**2 * s.R @ spread.centre(k) @ s.R.T
    turn = s.R @ R.T @ spread.turn(k) @ R @ s.R.T
    # the frame's own errors, at the camera's distance from the places that determine it
    arm = C - frame.centre
    J = np.zeros((3, 7))
    J[:, :3] = np.eye(3)
    J[:, 3:6] = [[0, arm[2], -arm[1]], [-arm[2], 0, arm[0]], [arm[1], -arm[0], 0]]
    J[:, 6] = arm
    if frame.covariance.any():
        centre = centre + J @ frame.covariance @ J.T
        turn = turn + frame.covariance[3:6, 3:6]
    sigma_m = float(np.sqrt(max(np.linalg.eigvalsh(centre)[-1], 0.0)))
    sigma_deg = float(np.rad2deg(np.sqrt(max(np.linalg.eigvalsh(turn)[-1], 0.0))))
    return sigma_m, sigma_deg
