"""The cameras of a site file, with what its calibration knows of them."""

from __future__ import annotations

import itertools
import os
import re
from pathlib import Path
from typing import Any

from ..cache.untrusted import is_file
from ..errors import printable
from .calibration import Calibrated, CalibrationError, find_camera, read_calibration
from .geodesy import LocalFrame
from .locations import Document, Location, SiteProblem
from .models import Camera, Lens, Placement, Privacy
from .schema import CameraSection, SiteSection

ID = re.compile(r"[A-Za-z0-9_.-]{1,100}")
"""What a camera, and a site, may be called."""


def beside(path: str, location: Location, document: Document, problems: list[SiteProblem]) -> Path:
    """A path as a site file states it: relative to the file.

    Parameters
    ----------
    path : str
        As it is written.
    location : Location
        Where that stands in the site file.
    document : Document
        The site file.
    problems : list of SiteProblem
        To which is added what is wrong: then the path is taken as it is written.
    """
    try:
        if "\0" in path:
            raise ValueError("a path holds no zero byte")
        stated = Path(path).expanduser()
    except (RuntimeError, ValueError) as error:
        remedy = "write a path relative to the site file, or from the root: /srv/captures"
        problems.append(document.problem(location, f"{path!r} is no path: {printable(error)}", remedy))
        stated = Path(path.replace("\0", ""))
    return Path(os.path.normpath(document.path.resolve().parent / stated))


def is_name(name: str) -> bool:
    """May a camera, or a site, be called so?  It becomes the name of a folder."""
    return bool(ID.fullmatch(name) and name.strip("."))


def read_cameras(model: SiteSection, frame: LocalFrame | None, document: Document, problems: list[SiteProblem]) -> list[Camera]:
    """The cameras of the site; what is wrong with them is added to `problems`.

    Parameters
    ----------
    model : SiteSection
        The validated site file.
    frame : LocalFrame or None
        Where positions by latitude and longitude are counted from; None without such.
    document : Document
        For the places of problems.
    problems : list of SiteProblem
        What is wrong is added here.
    """
    calibrated = _calibrated(model.calibration, ("calibration",), document, problems)
    seen: dict[str, int] = {}
    found = []
    for i, camera in enumerate(model.cameras):
        location: Location = ("cameras", i)
        if not is_name(camera.id):
            what, remedy = f"{camera.id!r} is not a camera id", "use letters, digits, '_', '.', '-' (not dots alone), at most 100"
            problems.append(document.problem(location, what, remedy))
        if camera.id in seen:
            first = document.marks.get(("cameras", seen[camera.id]), (0, 0))[0]
            what, remedy = f"camera {camera.id!r} is named twice, first on line {first}", "give each camera its own id"
            problems.append(document.problem(location, what, remedy))
        seen.setdefault(camera.id, i)
        entry = _own_entry(camera, location, document, problems) or find_camera(calibrated, camera.id)
        if calibrated and entry is None and camera.intrinsics is None:
            what = f"{model.calibration} has no camera {camera.id!r}; it has {_shown(calibrated)}"
            problems.append(
                document.problem(location, what, "correct the id, add the camera to that file, or give its intrinsics here")
            )
        mask = beside(camera.mask, (*location, "mask"), document, problems) if camera.mask else None
        if mask and not is_file(mask):
            remedy = "give the path of an image of the capture's size, white where pixels may be used"
            problems.append(document.problem((*location, "mask"), f"there is no file {printable(mask)}", remedy))
        lens, placement = _lens(camera, entry), _placement(camera, entry, frame)
        images = tuple(camera.images) if camera.images is not None else None
        privacy = Privacy([c for p in camera.privacy for c in p], [float(len(p)) for p in camera.privacy])
        found.append(Camera(camera.id, lens, placement, mask, privacy, images, location))
    _refuse_ambiguous([camera.id for camera in model.cameras], document, problems)
    return found


def _calibrated(stated: str | None, location: Location, document: Document, problems: list[SiteProblem]) -> dict[str, Calibrated]:
    """The cameras of a calibration that the site file names; none where that has problems.

    Parameters
    ----------
    stated : str or None
        Its path as it is written.
    location : Location
        Where that stands in the site file.
    document, problems
        As of `read_cameras`.
    """
    if not stated:
        return {}
    try:
        file = beside(stated, location, document, problems)
        found = read_calibration(file)
        if not found:
            raise CalibrationError("holds no camera", where=str(file), remedy="add the cameras, or leave calibration out")
    except CalibrationError as error:
        remedy = error.remedy or "give the path of cameras.json, of a COLMAP model, or of what OpenCV, ROS or Kalibr wrote"
        problems.append(document.problem(location, f"{error.where}: {error.what}", remedy))
        return {}
    return found


def _own_entry(camera: CameraSection, location: Location, document: Document, problems: list[SiteProblem]) -> Calibrated | None:
    """What a camera's own calibration file says of it: the only camera in there, or the one of its name.

    Parameters
    ----------
    camera : CameraSection
        Whose.
    location : Location
        Where it stands in the site file.
    document, problems
        As of `read_cameras`.
    """
    found = _calibrated(camera.calibration, (*location, "calibration"), document, problems)
    if not found:
        return None
    entry = next(iter(found.values())) if len(found) == 1 else find_camera(found, camera.id)
    if entry is None:
        what = f"{camera.calibration} has no camera {camera.id!r}; it has {_shown(found)}"
        problems.append(
            document.problem((*location, "calibration"), what, "call the camera as that file does, or name another file")
        )
    return entry


def _refuse_ambiguous(ids: list[str], document: Document, problems: list[SiteProblem]) -> None:
    """Pairs are called left--right: of ids with dashes in the wrong places, two pairs can have one name, and one folder."""
    dashed = [k for k, name in enumerate(ids) if "--" in name or name.startswith("-") or name.endswith("-")]
    if not dashed:
        return
    pairs: dict[str, tuple[str, str]] = {}
    for left, right in itertools.combinations(dict.fromkeys(ids), 2):
        other = pairs.setdefault(f"{left}--{right}", (left, right))
        if other != (left, right):
            what = f"the pairs {other[0]!r}, {other[1]!r} and {left!r}, {right!r} would both be called {left}--{right}"
            problems.append(document.problem(("cameras", dashed[0]), what, "use ids without '--', and without '-' at their ends"))
            return


def _shown(names: dict[str, Any], most: int = 5) -> str:
    listed = list(names)[:most]
    return ", ".join(listed) + (f" and {len(names) - most} more" if len(names) > most else "")


def _lens(camera: CameraSection, entry: Calibrated | None) -> Lens:
    K, width, height, distortion, hfov, model = None, 0, 0, [0.0] * 5, None, "brown"
    if entry:
        K, width, height, distortion = entry.K, entry.width, entry.height, entry.distortion or distortion
        model = entry.model
    if (own := camera.intrinsics) and not (entry and own.hfov is not None):  # a calibration knows better than a field of view
        hfov, width, height = own.hfov, own.width or 0, own.height or 0
        K = None
        if own.fx is not None and own.fy is not None and own.cx is not None and own.cy is not None:
            K = [[own.fx, 0.0, own.cx], [0.0, own.fy, own.cy], [0.0, 0.0, 1.0]]
    if camera.distortion is not None or camera.model is not None:
        given = camera.distortion or []
        distortion, model = given + [0.0] * (5 - len(given)), camera.model or "brown"
    return Lens(K, distortion, hfov, width, height, model)


def _placement(camera: CameraSection, entry: Calibrated | None, frame: LocalFrame | None) -> Placement:
    rough = camera.pose is not None and (camera.pose.matrix() is None or max(camera.pose.sigma_m, camera.pose.sigma_deg) > 0)
    if (pose := camera.pose) and not (rough and entry and entry.R and entry.C):  # what was solved from it knows better
        geodetic = pose.geodetic
        C = frame.metres(*geodetic) if frame and geodetic else pose.position
        return Placement(pose.matrix(), C, pose.sigma_m, pose.sigma_deg)
    if entry is None:
        return Placement()
    return Placement(entry.R, entry.C, entry.sigma_m, entry.sigma_deg, entry.metric)
