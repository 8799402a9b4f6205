"""Do the observations of a site suffice to place cameras, and does their survey go with them?  Each doubt gives both numbers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from functools import partial

from ..words import counted
from .models import Site
from .observation_tables import ObservationTable
from .yaml_document import Problem

_MARGIN_PX = 1.0
"""Observations may be outside of the picture by this much: they are measured with an error."""

MOST_APART = {"s": 5.0, "frames": 125.0}
"""Clocks of cameras, and of the survey, may differ by this much, by the unit of time."""

Span = tuple[float, float]
"""Earliest and latest time."""


def doubts_about_observations(site: Site) -> list[Problem]:
    """What is wrong with the observations and their survey as a whole; each doubt has the line that it begins with."""
    table = site.observations
    if table is None:
        return []
    rows_of: dict[str, list[int]] = {camera: [] for camera in table.rows.cameras}
    for row, number in enumerate(table.rows.camera):
        rows_of[table.rows.cameras[number]].append(row)
    # 1. row by row
    doubts = list(_outside(site, table, rows_of))
    # 2. camera by camera
    observed: dict[str, list[int]] = {}
    for name, rows in rows_of.items():
        if rows:
            observed[name] = rows
    if len(observed) == 1:
        (only,) = observed
        what = f"all {counted(len(table.line), 'observation')} are of 1 camera, {only}; 2 are needed, whose rays meet"
        return [*doubts, Problem(table.path, what, "add what other cameras saw of the same things", table.line[0])]
    for camera in site.cameras:
        if camera.id not in observed and not camera.stated:
            what = f"there is no observation of {camera.id} among {len(table.line):,}, and its pose is not stated"
            doubts.append(Problem(table.path, what, "it cannot be placed by them: move the thing through its view, too", 1))
    # 3. do they go together?
    doubts.extend(_apart_in_time(table, observed))
    doubts.extend(_survey_apart_in_time(site, table))
    return doubts


def _outside(site: Site, table: ObservationTable, rows_of: dict[str, list[int]]) -> Iterable[Problem]:
    """Observations outside of their camera's picture, whose size its lens states."""
    for camera in site.cameras:
        lens = camera.lens
        if not lens.width or not lens.height:
            continue
        outside = []
        for row in rows_of[camera.id]:
            x, y = table.point(row)
            is_inside_x = -_MARGIN_PX <= x <= lens.width + _MARGIN_PX
            is_inside_y = -_MARGIN_PX <= y <= lens.height + _MARGIN_PX
            if not (is_inside_x and is_inside_y):
                outside.append(row)
        if outside:
            first = outside[0]
            x, y = table.point(first)
            what = (
                f"{counted(len(outside), 'observation')} of {camera.id} outside of its picture of {lens.width}x{lens.height} "
                f"pixels, the first at {x:g}, {y:g}"
            )
            remedy = "give pixels of the captured picture, and its own width and height in the lens"
            yield Problem(table.path, what, remedy, table.line[first])


def _apart_in_time(table: ObservationTable, observed: dict[str, list[int]]) -> Iterable[Problem]:
    """Cameras whose observations are all at other times than those of every other camera."""
    spans: dict[str, Span] = {}
    for camera, rows in observed.items():
        span = _span(map(table.rows.time.__getitem__, rows))
        if span is None:  # some things do not move: they tie cameras whenever they were seen
            return
        spans[camera] = span
    unit = table.rows.time_unit
    for camera, span in spans.items():
        others = dict(spans)
        del others[camera]
        nearest = min(others.values(), key=partial(_gap, span))
        if _gap(span, nearest) > MOST_APART[unit]:
            what = f"{camera} saw things from {_words(span, unit)}, other cameras from {_words(nearest, unit)}: at no common time"
            remedy = (
                "record all cameras at the same time; or correct the clock of this one: seconds are of one and the same clock"
            )
            yield Problem(table.path, what, remedy, table.line[observed[camera][0]])


def _survey_apart_in_time(site: Site, table: ObservationTable) -> Iterable[Problem]:
    """A survey of moving things at other times than all observations."""
    survey = site.thing_survey
    if survey is None:
        return
    surveyed = _span(survey.rows.time)
    seen = _span(table.rows.time)
    unit = table.rows.time_unit
    if surveyed is None or seen is None or _gap(surveyed, seen) <= MOST_APART[unit]:
        return
    what = f"gives places from {_words(surveyed, unit)}, cameras saw things from {_words(seen, unit)}"
    yield Problem(survey.path, what, "count the time of both from the same moment", survey.line[0])


def _span(times: Iterable[float]) -> Span | None:
    """The earliest and the latest of some times; None if none is known."""
    known = list(itertools.filterfalse(math.isnan, times))
    if not known:
        return None
    return min(known), max(known)


def _gap(first: Span, second: Span) -> float:
    """The time between two spans; negative if they overlap."""
    return max(second[0] - first[1], first[0] - second[1])


def _words(span: Span, unit: str) -> str:
    """A span of time as text."""
    if unit == "frames":
        return f"frame {span[0]:g} to {span[1]:g}"
    return f"{span[0]:.3f} to {span[1]:.3f} s"
