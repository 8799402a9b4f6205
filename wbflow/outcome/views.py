"""What a night came to for a camera that has several views: people think of cameras, and are told of cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from ..records.record import CameraRecord
from ..task import camera_of


def of_camera(views: Sequence[CameraRecord], sums: frozenset[str]) -> CameraRecord:
    """The record of a camera from those of its views: it is well where one of them is, and says what it lost.

    Parameters
    ----------
    views : sequence of CameraRecord
        Of the views of one camera.
    sums : frozenset of str
        Figures that add up; of other numbers the camera has the mean.
    """
    camera = camera_of(views[0].id)
    if len(views) == 1:
        return views[0]
    well = [view for view in views if view.ok]
    told = well or list(views)
    lost = tuple(f"{view.id}: {view.reason or view.outcome}" for view in views if well and not view.ok)
    notes = tuple(dict.fromkeys(note for view in views for note in view.notes))
    names = dict.fromkeys(name for view in told for name in view.figures)
    figures = {name: _figure([view.figures.get(name) for view in told], name in sums) for name in names}
    return replace(told[0], id=camera, notes=(*notes, *lost), figures=figures)


def _figure(values: Sequence[Any], adds: bool) -> Any:
    known = [value for value in values if value is not None]
    if not known:
        return None
    if all(isinstance(value, bool) for value in known):
        return all(known)
    if all(isinstance(value, int | float) for value in known):
        if adds:
            return sum(known)
        mean = sum(known) / len(known)
        return round(mean) if all(isinstance(value, int) for value in known) else mean
    return known[0]


def by_camera(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of the whole site in which mappings and lists name cameras, where a stage has named their views."""
    return {name: _named(value) for name, value in figures.items()}


def _named(value: Any) -> Any:
    """The first entry of each camera's views; pairs are of views, and keep their names."""
    if isinstance(value, Mapping):
        found: dict[str, Any] = {}
        for name, entry in value.items():
            found.setdefault(_name(name), entry)
        return found
    if isinstance(value, list | tuple):
        if all(isinstance(entry, str) for entry in value):
            return list(dict.fromkeys(map(_name, value)))
        return [_named(entry) for entry in value]
    return value


def _name(name: str) -> str:
    return name if "--" in name or " " in name else camera_of(name)
