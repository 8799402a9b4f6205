"""What a site file says of the ground: known distances and control points."""

from __future__ import annotations

import math
from typing import Any

from .geodesy import ControlPoint, LocalFrame
from .locations import Document, Location, SiteProblem
from .models import Survey


def read_survey(
    cameras: list[str],
    distances: list[list[Any]],
    points: list[ControlPoint],
    frame: LocalFrame | None,
    document: Document,
    problems: list[SiteProblem],
) -> Survey:
    """Distances and control points; what is wrong with them is added to `problems`.

    Parameters
    ----------
    cameras : list of str
        Ids.
    distances : list of list[Any]
        Rows of two ids and metres.
    points : list of ControlPoint
        Control points.
    frame : LocalFrame or None
        Where positions by latitude and longitude are counted from; None without such.
    document : Document
        For the places of problems.
    problems : list of SiteProblem
        What is wrong is added here.
    """
    number = {camera: k for k, camera in enumerate(cameras)}

    def camera_at(location: Location, camera: Any) -> int:
        if not isinstance(camera, str) or camera not in number:
            problems.append(document.problem(location, f"there is no camera {camera!r}", "use ids from 'cameras'"))
            return 0
        return number[camera]

    rows = []
    for k, (left, right, metres) in enumerate(distances):
        i, j = camera_at(("distances", k, 0), left), camera_at(("distances", k, 1), right)
        if not isinstance(metres, int | float) or isinstance(metres, bool) or not 0 < metres < math.inf:
            what = f"{metres!r} is no distance in metres"
            problems.append(document.problem(("distances", k, 2), what, "write [camera, camera, metres]"))
        elif i == j:
            problems.append(document.problem(("distances", k), "a camera has no distance from itself", "name two cameras"))
        else:
            rows.append([float(i), float(j), float(metres)])
    observations = []
    for k, point in enumerate(points):
        if len(point.pixels) < 2:
            remedy = "point at it in the captures of two cameras or more, better three"
            problems.append(document.problem(("control_points", k), "fewer than two cameras see it", remedy))
        for camera, (x, y) in point.pixels.items():
            observations.append([float(k), float(camera_at(("control_points", k, "pixels", camera), camera)), x, y])
    where = [frame.metres(*point.geodetic) if frame and point.geodetic else point.position or [0.0] * 3 for point in points]
    return Survey(tuple(cameras), rows, where, observations, frame.crs if frame else "")
