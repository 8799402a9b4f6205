"""A camera that is too wide for one pinhole, as several views that share its captures, its mask and its place."""

from __future__ import annotations

import dataclasses

from ..cache.plugins import load
from ..pipeline.exports import VIEWS_OF_LENS
from ..task import view_name
from .models import Camera, Matrix, Placement

_OWN_PINHOLE = frozenset({"pinhole", "brown"})
"""Frames of these keep the K of their lens, however wide it is: the vision is not asked."""


def views_of(camera: Camera) -> tuple[Camera, ...]:
    """The camera itself, or what is stated of each of its views.

    What they are follows from the stated lens alone, so that a camera has the same views in all nights.
    """
    lens = camera.lens
    if lens.K is None or lens.model in _OWN_PINHOLE or not (lens.width and lens.height):
        return (camera,)
    try:
        found = load(VIEWS_OF_LENS)(lens.K, lens.distortion, lens.width, lens.height, lens.model)
    except (ValueError, ArithmeticError):  # no lens has such numbers: the camera's frame says what is wrong
        found = []
    if not found:
        return (camera,)
    return tuple(
        dataclasses.replace(
            camera,
            id=view_name(camera.id, number),
            lens=dataclasses.replace(lens, camera=camera.id, turn=turn, window=window),
            placement=_turned(camera.placement, turn),
        )
        for number, (turn, window) in enumerate(found, 1)
    )


def _turned(placement: Placement, turn: Matrix) -> Placement:
    """Where a view is, of a camera that is there."""
    if placement.R is None:
        return placement
    columns = list(zip(*placement.R, strict=True))
    R = [[sum(a * b for a, b in zip(row, column, strict=True)) for column in columns] for row in turn]
    return dataclasses.replace(placement, R=R)
