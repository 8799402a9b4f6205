"""Observations of things that move or have an identity, and what was surveyed of the things: the tables that a site file names.

Row by row they are checked here; whether they suffice to place cameras, `observation_checks` tells.
"""

from __future__ import annotations

import datetime
import itertools
import math
from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..words import printable
from .csv_table import CsvTable, read_csv
from .observation_tables import ObservationRows, ObservationTable, SurveyRows, SurveyTable
from .yaml_document import Problem, SiteError, suggest

OBSERVATIONS_REMEDY = (
    "name a CSV file with the columns frame or time, camera, x, y (pixels of the captured picture) and, where known, id, sigma"
)
SURVEY_REMEDY = (
    "name a CSV file with the columns frame or time, and easting, northing, up (or x, y, z; or latitude, longitude, height) and, "
    "where known, id, sigma; or with the columns id, to, metres"
)

_TIME = {
    "time": ("time", "seconds", "timestamp", "t", "time_s", "datetime", "date_time", "frame_time"),
    "frame": ("frame", "frames", "frame_number", "frame_id", "frame_index", "sync_index"),
}
_THING = ("id", "thing", "track", "track_id", "object", "object_id", "point", "point_id")
_OBSERVATION_COLUMNS = {
    **_TIME,
    "camera": ("camera", "cam", "camera_id", "camera_name"),
    "thing": _THING,
    "x": ("x", "u", "x_px", "pixel_x", "img_loc_x"),
    "y": ("y", "v", "y_px", "pixel_y", "img_loc_y"),
    "sigma": ("sigma", "sigma_px", "std"),
}
_SURVEY_COLUMNS = {
    **_TIME,
    "thing": (*_THING, "from"),
    "to": ("to", "other"),
    "metres": ("metres", "meters", "length", "distance"),
    "x": ("easting", "east", "x", "e"),
    "y": ("northing", "north", "y", "n"),
    "z": ("up", "z", "height", "altitude", "elevation", "alt"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng", "long"),
    "sigma": ("sigma", "sigma_m", "std"),
}
ONE_THING = "thing"
"""Name of the thing in a table without ids."""
_UNITS_OF_EPOCH = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))
"""Times since 1970 above the first number are in units of so many seconds: nano-, micro- and milliseconds."""
LONGEST_M = 100_000.0
"""Longer distances between two things of a site are in another unit."""


def read_observations(path: Path, cameras: Sequence[str]) -> ObservationTable:
    """Read a file of observations; rows without x and y (the thing was not seen) are left out.

    Raises SiteError, with the line of the first row with each fault.

    cameras: ids of the site's cameras.
    """
    table = read_csv(path, _OBSERVATION_COLUMNS, OBSERVATIONS_REMEDY)
    _require(table, ("camera", "x", "y"), OBSERVATIONS_REMEDY)
    time, time_unit = _times(table)
    if time is None and not table.has("thing"):
        raise SiteError(Problem(path, "has neither a column frame or time nor a column id", OBSERVATIONS_REMEDY, 1))
    # 1. the columns
    x = table.numbers("x")
    y = table.numbers("y")
    sigma = _sigmas(table)
    things: dict[str, int] = {}
    thing_names = _names(table, "thing")
    camera_names = _names(table, "camera")
    camera_numbers = {name: number for number, name in enumerate(cameras)}

    found = ObservationRows(tuple(cameras), (), array("i"), array("i"), array("d"), array("d"), array("d"), time_unit)
    kept_lines = array("i")
    # 2. row by row
    for row, line in enumerate(table.lines):
        # trackers have a row for each frame, also when they do not see the thing
        if line in table.faults.lines or (math.isnan(x[row]) and math.isnan(y[row])):
            continue
        if math.isnan(x[row]) or math.isnan(y[row]):
            table.faults.add("half", line, "has only one of x and y", "give both, or leave both empty if it was not seen")
            continue
        camera = camera_numbers.get(camera_names[row])
        if camera is None:
            remedy = suggest(camera_names[row], cameras, "use ids from 'cameras'")
            what = f"there is no camera {printable(repr(camera_names[row]), 60)} in the site"
            table.faults.add(f"camera {camera_names[row]}", line, what, remedy)
            continue
        found.camera.append(camera)
        found.thing.append(things.setdefault(thing_names[row], len(things)))
        found.time.append(time[row] if time is not None else math.nan)
        found.xy.extend((x[row], y[row]))
        found.sigma_px.append(sigma[row])
        kept_lines.append(line)
    if time is None:
        _refuse_repeated(found, kept_lines, table)
    table.faults.raise_any()
    if not found.camera:
        raise SiteError(Problem(path, "holds no observation", OBSERVATIONS_REMEDY, 1))
    return ObservationTable(path, replace(found, things=tuple(things)), kept_lines)


def read_thing_survey(path: Path, observations: ObservationTable) -> SurveyTable:
    """Read what was surveyed of the observed things.  Raises SiteError, with the line of the first row with each fault."""
    table = read_csv(path, _SURVEY_COLUMNS, SURVEY_REMEDY)
    if table.has("metres") or table.has("to"):
        return _read_lengths(table, observations.rows.things)
    geodetic = table.has("latitude") or table.has("longitude")
    columns = ("x", "y", "z")
    if geodetic:
        columns = ("latitude", "longitude", "z")
    _require(table, columns, SURVEY_REMEDY)
    time, time_unit = _times(table)
    is_dated = time is not None and not all(map(math.isnan, observations.rows.time))
    if is_dated and time_unit != observations.rows.time_unit:
        words = {"s": "times in seconds", "frames": "numbers of frames"}
        what = f"has {words[time_unit]}, {observations.path.name} has {words[observations.rows.time_unit]}"
        raise SiteError(Problem(path, what, "give both in the same unit", min(table.lines, default=1)))
    places = list(zip(*map(table.numbers, columns), strict=True))
    sigma = _sigmas(table)
    names = _names(table, "thing")

    things = observations.rows.things
    found = SurveyRows(things, array("i"), array("d"), array("d"), array("d"), time_unit=time_unit)
    kept_lines = array("i")
    numbers = {name: number for number, name in enumerate(things)}
    for row, line in enumerate(table.lines):
        position = places[row]
        # a receiver without a fix has no position
        if line in table.faults.lines or all(map(math.isnan, position)):
            continue
        thing = _surveyed_thing(names[row], numbers, table, line)
        if any(map(math.isnan, position)):
            table.faults.add("part", line, "lacks a coordinate", "give all three, or leave all three empty")
        elif geodetic and not (abs(position[0]) <= 90 and abs(position[1]) <= 360):
            what = f"latitude {position[0]:g}, longitude {position[1]:g} is no place on Earth"
            table.faults.add("place", line, what, "give degrees, latitude from -90 to 90; metres are easting, northing, up")
        elif thing is not None:
            found.thing.append(thing)
            found.time.append(math.nan if time is None else time[row])
            found.position.extend(position)
            found.sigma_m.append(sigma[row])
            kept_lines.append(line)
    table.faults.raise_any()
    if not found.thing:
        raise SiteError(Problem(path, "holds no position", SURVEY_REMEDY, 1))
    return SurveyTable(path, found, kept_lines, geodetic)


def _read_lengths(table: CsvTable, things: Sequence[str]) -> SurveyTable:
    """Read a survey of lengths between things."""
    _require(table, ("thing", "to", "metres"), SURVEY_REMEDY)
    numbers = {name: number for number, name in enumerate(things)}
    metres = table.numbers("metres")
    first_names = _names(table, "thing")
    second_names = _names(table, "to")
    lengths: list[tuple[int, int, float]] = []
    for row, line in enumerate(table.lines):
        if line in table.faults.lines:
            continue
        first = _surveyed_thing(first_names[row], numbers, table, line)
        second = _surveyed_thing(second_names[row], numbers, table, line)
        if not 0 < metres[row] < LONGEST_M:
            what = f"a length of {metres[row]:g} metres is none"
            table.faults.add("length", line, what, "give metres between the two things")
        elif first is not None and first == second:
            table.faults.add("same", line, f"{first_names[row]} has no length to itself", "name two things")
        elif first is not None and second is not None:
            lengths.append((first, second, metres[row]))
    table.faults.raise_any()
    if not lengths:
        raise SiteError(Problem(table.path, "holds no length", SURVEY_REMEDY, 1))
    rows = SurveyRows(tuple(things), array("i"), array("d"), array("d"), array("d"), tuple(lengths))
    return SurveyTable(table.path, rows, array("i"))


def _surveyed_thing(name: str, numbers: Mapping[str, int], table: CsvTable, line: int) -> int | None:
    """The number of a surveyed thing; None, and a fault, if nobody has observed it.

    If there is only one thing, either file may leave out its name.
    """
    if name in numbers:
        return numbers[name]
    if len(numbers) == 1 and (name == ONE_THING or ONE_THING in numbers):
        return 0
    if not table.has("thing"):
        what = f"does not say which of the {len(numbers)} observed things it is about"
        table.faults.add("thing", line, what, "add a column id, with the ids of the observations")
        return None
    what = f"there is no observation of {printable(repr(name), 60)}"
    table.faults.add(f"thing {name}", line, what, suggest(name, numbers, "use ids of the observations"))
    return None


def _require(table: CsvTable, meanings: Collection[str], remedy: str) -> None:
    """Raise SiteError if a column is missing."""
    missing = list(itertools.filterfalse(table.has, meanings))
    if missing:
        have = ", ".join(table.titles.values())
        what = f"has no column {' and no column '.join(missing)}; of its columns these are understood: {have}"
        raise SiteError(Problem(table.path, what, remedy, 1))


def _names(table: CsvTable, meaning: str) -> list[str]:
    """The ids in a column, `ONE_THING` in each row if there is no such column."""
    if not table.has(meaning):
        return [ONE_THING] * len(table.rows)
    names = list(map(str.strip, table.texts(meaning)))
    for line, name in zip(table.lines, names, strict=True):
        if not name:
            table.faults.add(f"{meaning} empty", line, f"{table.titles[meaning]} is empty", "name it in each row")
    return names


def _sigmas(table: CsvTable) -> array[float]:
    """Standard deviations, nan where none is stated; those that are not positive are added to the faults."""
    if not table.has("sigma"):
        return array("d", [math.nan]) * len(table.rows)
    sigmas = table.numbers("sigma")
    for line, sigma in zip(table.lines, sigmas, strict=True):
        if sigma <= 0:
            what = f"{table.titles['sigma']} is {sigma:g}"
            table.faults.add("sigma sign", line, what, "a standard deviation is greater than 0; leave it empty if it is unknown")
    return sigmas


def _times(table: CsvTable) -> tuple[array[float] | None, str]:
    """The time of each row, nan where there is none, and its unit; None if the table has no such column."""
    if not table.has("time"):
        if not table.has("frame"):
            return None, "s"
        return table.numbers("frame"), "frames"
    texts = table.texts("time")
    first = next((text for text in texts if text.strip()), "")
    if table.number(first) is None and _moment(first) is not None:
        return _moments(table, texts), "s"
    times = table.numbers("time")
    # since 1970: seconds have ten digits, and programs also write smaller units
    latest = max(itertools.filterfalse(math.isnan, times), default=0.0)
    for least, unit in _UNITS_OF_EPOCH:
        if latest > least:
            return array("d", map(unit.__mul__, times)), "s"
    return times, "s"


def _moments(table: CsvTable, texts: Sequence[str]) -> array[float]:
    """Seconds since 1970 of dates and times; nan, and a fault, for anything else."""
    times = array("d")
    for line, text in zip(table.lines, texts, strict=True):
        moment = _moment(text)
        if moment is None:
            what = f"{table.titles['time']} is {printable(repr(text), 60)}, no date and time as in the first row"
            table.faults.add("time", line, what, "write 2026-11-20T03:15:00.250Z, or seconds in all rows")
            moment = math.nan
        times.append(moment)
    return times


def _moment(text: str) -> float | None:
    """Seconds since 1970 of a date and time in ISO 8601 (UTC unless it says otherwise); None if it is none."""
    try:
        moment = datetime.datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=datetime.UTC)
    return moment.timestamp()


def _refuse_repeated(found: ObservationRows, lines: array[int], table: CsvTable) -> None:
    """In a file without times, a camera sees each thing once; else the column of times has another name."""
    seen: dict[tuple[int, int], int] = {}
    for camera, thing, line in zip(found.camera, found.thing, lines, strict=True):
        first = seen.setdefault((camera, thing), line)
        if first != line:
            what = f"{found.cameras[camera]} has seen this thing in line {first} already, and there is no column frame or time"
            remedy = "things that move need a column frame or time; of others, give one row a camera"
            table.faults.add("repeated", line, what, remedy)
