"""What a surveyor should know of the result: why cameras are missing, which are badly tied, where to move the thing next."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..contracts.observation_figures import ObservedCamera
from ..types import Float64s, Lens, Observations
from .final import Solved
from .hypotheses import LEAST_COMMON

LEAST_PICTURE_SHARE = 0.1
"""A camera is badly tied if the thing was seen in a smaller part of its picture."""
_CELLS = 4
"""Columns and rows into which pictures are divided."""


def unplaced_reasons(observations: Observations, lenses: Mapping[str, Lens], solved: Solved) -> dict[str, str]:
    """Why cameras that have observations are not placed, by id."""
    reasons = {}
    order = list(solved.tracks)
    for name in observations.cameras:
        if name in solved.names:
            continue
        lens = lenses.get(name)
        if lens is None or lens.K is None:
            reasons[name] = "its lens is not known: state its focal length or its field of view"
        elif name not in solved.tracks:
            reasons[name] = "it has no observations within the field of its lens"
        elif solved.common[order.index(name), [order.index(other) for other in solved.names]].max() < LEAST_COMMON:
            reasons[name] = "it never sees the thing at the same time as another placed camera: move the thing where both see it"
        else:
            reasons[name] = "no pose explains its observations together with those of the others"
    return reasons


def advice(
    observations: Observations,
    shifted: Observations,
    lenses: Mapping[str, Lens],
    solved: Solved,
    figures: Mapping[str, ObservedCamera],
) -> list[str]:
    """Sentences for the surveyor.

    Parameters
    ----------
    observations, shifted : as stated, and with times that count from the middle.
    lenses : by camera.
    solved : the result.
    figures : by camera.
    """
    notes = []
    for k, name in enumerate(solved.names):
        change = figures[name].focal_change
        if change is not None:
            notes.append(f"{name}: its focal length is {change:+.1%} from the stated one, which was solved instead")
        track = solved.tracks[name]
        used = np.unique(solved.nearest[k][solved.adjusted.used[k]])
        note = _picture_note(name, observations.xy[track.row[used]], lenses[name])
        if note:
            notes.append(note)
    return notes


def _picture_note(name: str, xy: Float64s, lens: Lens) -> str:
    """What to say if the thing was seen in a small part of a camera's picture only; "" if it was not so."""
    width = lens.width or float(xy[:, 0].max()) + 1
    height = lens.height or float(xy[:, 1].max()) + 1
    columns = np.clip(xy[:, 0] / width * _CELLS, 0, _CELLS - 1).astype(int)
    rows = np.clip(xy[:, 1] / height * _CELLS, 0, _CELLS - 1).astype(int)
    share = len(np.unique(rows * _CELLS + columns)) / _CELLS**2
    if share > LEAST_PICTURE_SHARE:
        return ""
    middle = np.median(xy, axis=0) / [width, height]
    vertical = ("upper", "middle", "lower")[int(np.clip(middle[1] * 3, 0, 2))]
    horizontal = ("left", "middle", "right")[int(np.clip(middle[0] * 3, 0, 2))]
    return f"{name}: the thing was seen only in the {vertical} {horizontal} of its picture: move it through the rest, too"
