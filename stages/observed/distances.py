"""The scale of observed cameras from known distances between them, where nothing else tells it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..types import Float64s, ObservedPoses, Placement, Survey


def scaled_by_distances(poses: ObservedPoses, stated: Mapping[str, Placement], survey: Survey) -> ObservedPoses:
    """The poses in metres, if they have no scale yet and the site states distances between placed cameras.

    Parameters
    ----------
    poses : as the observations alone determine them.
    stated : poses of the site file; a position among them stays where it is.
    survey : distances between cameras.
    """
    if poses.metric:
        return poses
    ratios = []
    for first, second, metres in survey.distances:
        pair = [poses.placements.get(survey.cameras[number]) for number in (first, second)]
        centres = [placement.C for placement in pair if placement is not None and placement.C is not None]
        if len(centres) == 2:
            ratios.append(metres / float(np.linalg.norm(centres[0] - centres[1])))
    if not ratios:
        return poses
    scale = float(np.median(ratios))
    fixed: Float64s = np.zeros(3)
    for name in poses.placements:
        placement = stated.get(name)
        if placement is not None and placement.C is not None:
            fixed = placement.C
            break

    placements = {}
    for name, placement in poses.placements.items():
        if placement.C is not None:
            C = fixed + scale * (placement.C - fixed)
            placements[name] = replace(placement, C=C, sigma_m=scale * placement.sigma_m, metric=True)
    cameras = {}
    for name, figures in poses.cameras.items():
        sigma_m = None
        if figures.sigma_m is not None:
            sigma_m = scale * figures.sigma_m
        cameras[name] = replace(figures, sigma_m=sigma_m)
    halves_m = None
    if poses.halves_m is not None:
        halves_m = scale * poses.halves_m
    return replace(
        poses,
        placements=placements,
        cameras=cameras,
        track=fixed + scale * (poses.track - fixed),
        halves_m=halves_m,
        metric=True,
        scale="known distances between cameras",
    )
