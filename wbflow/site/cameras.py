"""The cameras of a site file, merged with their calibrations, and the views of cameras that are too wide for one pinhole.

Also the site file's survey data: known distances and control points.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from typing import Any

from wbflow_stages.contracts.stated import LensModel, Survey

from ..cache.untrusted import is_file
from ..errors import Location
from ..plugins import load
from ..task import view_name
from ..words import printable
from .calibration import find_cameras, only_camera, read_calibration
from .calibration.calibrated import REMEDY, Calibrated, Lens, Placement, product
from .geodesy import LocalFrame
from .ids import as_id
from .models import Camera, CameraEntry, Position, SiteFile
from .yaml_document import Problems, SiteError, is_name, resolve_path, suggest

_OWN_PINHOLE = frozenset({LensModel.PINHOLE, LensModel.BROWN})
"""Lens models whose frames keep the K of the lens, however wide it is: such a camera is never split into views."""


_REMEDY_OF_UNIT = (
    "OpenCV writes T in the unit that the board's squares were given in (often millimetres, or squares): "
    "write it in metres, and add a line to that file: unit: m"
)


def read_cameras(file: SiteFile, frame: LocalFrame | None, problems: Problems, doubts: Problems) -> list[Camera]:
    """The cameras of the site.

    Parameters
    ----------
    file : SiteFile
        The validated file.
    frame : LocalFrame, optional
        The local frame for positions given by latitude and longitude; None if there are none.
    problems, doubts : Problems
        Take the cameras' faults, and what calibrations leave open.
    """
    # the file of all cameras; a camera's own file takes precedence, and the site file's own entries do so over both
    calibrated = _calibrated_cameras(file.calibration, ("calibration",), problems)
    _check_ids([camera.id for camera in file.cameras], problems)
    cameras = []
    for i, camera in enumerate(file.cameras):
        location: Location = ("cameras", i)
        entry = _own_entry(camera, location, problems) or _entry_of(camera, calibrated, location, problems)
        if calibrated and entry is None and camera.intrinsics is None:
            remedy = "correct the id, add the camera to that file, or give its intrinsics here"
            problems.add(location, _lacks(file.calibration, camera, calibrated), remedy)
        mask = None
        if camera.mask:
            mask = resolve_path(camera.mask, (*location, "mask"), problems)
            if not is_file(mask):
                remedy = "give the path of an image of the capture's size, white where pixels may be used"
                problems.add((*location, "mask"), f"there is no file {printable(mask)}", remedy)
        lens = _merged_lens(camera, entry)
        placement = _merged_placement(camera, entry, frame)
        if entry is not None and entry.doubt and placement == entry.placement:
            place: Location = (*location, "calibration") if camera.calibration else ("calibration",)
            doubts.add(place, entry.doubt, _REMEDY_OF_UNIT)
        cameras.append(Camera(camera.id, lens, placement, mask, camera.privacy, camera.images))
    return cameras


def views_of(camera: Camera) -> tuple[Camera, ...]:
    """The camera itself or, if it is too wide for one pinhole, its views, which share its captures and mask.

    The views depend only on the lens that the site file gives, so a camera has the same views on all nights.
    """
    lens = camera.lens
    if lens.K is None or lens.model in _OWN_PINHOLE or not (lens.width and lens.height):
        return (camera,)
    views_of_lens = load("wbflow_stages.capture.wide:views_of_lens")
    try:
        turns_and_windows = views_of_lens(lens.K, lens.distortion, lens.width, lens.height, lens.model)
    except (ValueError, ArithmeticError):  # impossible lens: the camera's frame task reports it
        return (camera,)
    views = []
    for number, (turn, window) in enumerate(turns_and_windows, 1):
        view_lens = dataclasses.replace(lens, camera=camera.id, turn=turn, window=window)
        R = camera.placement.R
        view_placement = dataclasses.replace(camera.placement, R=R and product(turn, R))
        view_id = view_name(camera.id, number)
        views.append(dataclasses.replace(camera, id=view_id, lens=view_lens, placement=view_placement))
    return tuple(views) or (camera,)


def _calibrated_cameras(path: str | None, location: Location, problems: Problems) -> dict[str, Calibrated]:
    """The cameras of the calibration that the site file names at a location; none if it has problems."""
    if not path:
        return {}
    file = resolve_path(path, location, problems)
    try:
        cameras = read_calibration(file)
    except SiteError as error:
        fault = error.problems[0]
        remedy = fault.remedy or REMEDY
        problems.add(location, f"{fault.mark}: {fault.what}", remedy)
        return {}
    if not cameras:
        problems.add(location, f"{file}: holds no camera", "add the cameras, or leave calibration out")
    return cameras


def _own_entry(camera: CameraEntry, location: Location, problems: Problems) -> Calibrated | None:
    """A camera's entry in its own calibration file: the only camera in that file, or the one with the same name."""
    location = (*location, "calibration")
    entries = _calibrated_cameras(camera.calibration, location, problems)
    if not entries:
        return None
    entry = only_camera(entries) or _entry_of(camera, entries, location, problems)
    if entry is None:
        remedy = "rename the camera as in that file, or name another file"
        problems.add(location, _lacks(camera.calibration, camera, entries), remedy)
    return entry


def _entry_of(
    camera: CameraEntry, entries: Mapping[str, Calibrated], location: Location, problems: Problems
) -> Calibrated | None:
    """A camera's entry among those of a calibration; None if there is none.  Several that may be it are a problem."""
    found = find_cameras(entries, camera.id)
    if len(found) > 1:
        names = " and ".join(map(printable, list(found)[:2]))
        problems.add(location, f"the calibration has {names}, which may both be {camera.id!r}", "give one of them this name")
    return next(iter(found.values()), None)


def _check_ids(ids: list[str], problems: Problems) -> None:
    """Is each id the name of a folder, the only one of its kind, and are the names of pairs different, too?"""
    for i, name in enumerate(ids):
        if not is_name(name):
            remedy = "use letters, digits, '_', '.', '-' (not dots alone), at most 100"
            suggestion = as_id(name)
            if is_name(suggestion) and suggestion != name:
                remedy += (
                    f", for example {suggestion}; {{camera}} in captures.pattern stands for the id, so name its files like it"
                )
            problems.add(("cameras", i), f"{name!r} is not a camera id", remedy)
        first = ids.index(name)
        if first < i:
            line, _ = problems.document.place(("cameras", first))
            problems.add(("cameras", i), f"camera {name!r} is named twice, first on line {line}", "give each camera its own id")
    # pairs are called left--right: if ids have dashes in the wrong places, two pairs can get the same name and folder
    dashed = [k for k, name in enumerate(ids) if "--" in name or name.startswith("-") or name.endswith("-")]
    if not dashed:
        return
    pairs: dict[str, tuple[str, str]] = {}
    for left, right in itertools.combinations(dict.fromkeys(ids), 2):
        first_pair = pairs.setdefault(f"{left}--{right}", (left, right))
        if first_pair != (left, right):
            what = f"the pairs {first_pair[0]!r}, {first_pair[1]!r} and {left!r}, {right!r} would both be called {left}--{right}"
            problems.add(("cameras", dashed[0]), what, "use ids without '--', and without '-' at their ends")
            return


def _lacks(file: str | None, camera: CameraEntry, entries: dict[str, Calibrated]) -> str:
    """The message that a calibration file has no camera with this id."""
    names = list(entries)
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return f"{file} has no camera {camera.id!r}; it has {', '.join(names[:5])}{more}"


def _merged_lens(camera: CameraEntry, entry: Calibrated | None) -> Lens:
    """Intrinsics and distortion in the site file take precedence, but a calibration replaces a mere field of view."""
    lens = entry.lens if entry else Lens()
    own = camera.intrinsics
    if own and not (entry and own.hfov is not None):
        lens = dataclasses.replace(lens, K=own.K, hfov_deg=own.hfov, width=own.width or 0, height=own.height or 0)
    if camera.distortion is not None or camera.model is not None:
        # short lists mean that the others are 0
        coefficients = camera.distortion or []
        distortion = coefficients + [0.0] * (5 - len(coefficients))
        lens = dataclasses.replace(lens, distortion=distortion, model=camera.model or "brown")
    return lens


def _merged_placement(camera: CameraEntry, entry: Calibrated | None, frame: LocalFrame | None) -> Placement:
    """The pose in the site file takes precedence, but a complete calibrated pose replaces a rough or incomplete one."""
    pose = camera.pose
    calibrated = entry.placement if entry else Placement()
    if pose is None:
        return calibrated
    is_rough = pose.R is None or pose.sigma_m > 0 or pose.sigma_deg > 0
    if calibrated.R and calibrated.C and is_rough:
        return calibrated
    return Placement(pose.R, _metres(pose, frame), pose.sigma_m, pose.sigma_deg)


def read_survey(file: SiteFile, frame: LocalFrame | None, problems: Problems) -> Survey:
    """Distances and control points, with cameras by index; their faults are added to `problems`."""
    ids = [camera.id for camera in file.cameras]
    # 1. distances
    distances = []
    for k, (left, right, metres) in enumerate(file.distances):
        location: Location = ("distances", k)
        first = _index_of(left, ids, (*location, 0), problems)
        second = _index_of(right, ids, (*location, 1), problems)
        if not isinstance(metres, int | float) or isinstance(metres, bool) or not 0 < metres < math.inf:
            problems.add((*location, 2), f"{metres!r} is not a distance in metres", "write [camera, camera, metres]")
        elif first is None or second is None:
            continue
        elif first == second:
            problems.add(location, f"{left} has no distance from itself", "name two cameras")
        else:
            distances.append((first, second, float(metres)))
    # 2. control points
    points = []
    observations = []
    for k, point in enumerate(file.control_points):
        location = ("control_points", k)
        if len(point.pixels) < 2:
            remedy = "point at it in the captures of two cameras or more, better three"
            problems.add(location, "fewer than two cameras see it", remedy)
        for camera, (x, y) in point.pixels.items():
            index = _index_of(camera, ids, (*location, "pixels", camera), problems)
            if index is not None:
                observations.append((k, index, x, y))
        x, y, z = _metres(point, frame) or [0.0, 0.0, 0.0]
        points.append((x, y, z))
    return Survey(tuple(ids), tuple(distances), tuple(points), tuple(observations), frame.crs if frame else "")


def _index_of(camera: Any, ids: list[str], location: Location, problems: Problems) -> int | None:
    """The index of a camera that the file names at a location; None, and a problem, if there is none with this id."""
    if camera in ids:
        return ids.index(camera)
    problems.add(location, f"there is no camera {camera!r}", suggest(str(camera), ids, "use ids from 'cameras'"))
    return None


def _metres(position: Position, frame: LocalFrame | None) -> list[float] | None:
    """x, y, z; None for a geodetic position without a local frame, for which there is a problem already."""
    if frame and position.geodetic:
        return frame.metres(*position.geodetic)
    return position.position
