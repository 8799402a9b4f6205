"""What a site file's validation finds, in the words of a site file; and what is left of it without its faults."""

from __future__ import annotations

import difflib
import typing
from typing import Any

from pydantic import BaseModel, ValidationError

from ..pipeline.pairs import MOST_AT_A_CAMERA
from .calibration.calibrated import LENS_MODELS
from .locations import Document, Location, SiteProblem
from .models import CUSTOM, POSITION_REMEDY, SiteFile

_REMEDIES = {
    "intrinsics": "give fx, fy, cx, cy, width, height in pixels, or the horizontal field of view: intrinsics: {hfov: 72}",
    "pose": f"{POSITION_REMEDY}; where known too, one of look_at: [x, y, z], yaw_pitch_roll: [deg, deg, deg], rotation: 3x3, "
    "and how well: position_sigma_m, rotation_sigma_deg",
    "distances": "write [camera, camera, metres], e.g. distances: [[gate, roof, 12.4]]",
    "control_points": "write {position: [x, y, z], pixels: {gate: [x, y], roof: [x, y]}}",
    "captures": "give root: FOLDER and pattern, e.g. pattern: '{camera}/{date:%Y-%m-%d}*.jpg'",
    "cameras": "list the cameras: cameras: [gate, roof], or mappings with id, intrinsics, distortion, pose, mask, images",
    "distortion": "give [k1, k2, p1, p2, k3] as OpenCV defines them, or those of the model that you name",
    "model": f"name one of {', '.join(LENS_MODELS)}; without it a lens is brown (OpenCV's k1 k2 p1 p2 k3)",
    "site": "give the site a name: site: harbour",
    "timezone": "give the name of a time zone, e.g. timezone: Europe/Berlin",
    "resolution": "give the long side in pixels that stages work at, e.g. resolution: 1600, or null for as captured",
    "bounds": "give two corners of the box that matters, in metres: bounds: [[-20, -30, 0], [20, 30, 12]]",
    "zones": "give name, three corners or more and, if you like, a least size in metres: zones: [{name: quay, polygon: [[0, 0], "
    "[20, 0], [20, 8]], least_m: 0.5}]",
    "degree": f"give a whole number from 1 to {MOST_AT_A_CAMERA}, e.g. degree: 6",
    "min_angle": "give degrees, e.g. min_angle: 4",
    "max_angle": "give degrees, e.g. max_angle: 60",
    "keep": "for example keep: {nights: 7, bytes: 50GB, clouds: all, reports: 365}",
    "expect": "give shares of what is usual, or least counts: expect: {points: 0.7, pairs: 0.7, cameras: 1.0, since: 2026-11-20}",
    "notify": "give a command, e.g. notify: {command: 'mail -s \"$WBFLOW_SUMMARY\" me@example.org'}",
    "include": "give two camera ids: include: [[gate, roof]]",
    "exclude": "give two camera ids: exclude: [[gate, roof]]",
}


def explained(error: ValidationError, document: Document) -> list[SiteProblem]:
    """pydantic's findings in the words of a site file."""
    found = []
    errors = error.errors()
    misspelt = {(*e["loc"][:-1], _close(str(e["loc"][-1]), e["loc"][:-1])) for e in errors if e["type"] == "extra_forbidden"}
    for item in errors:
        location: Location = tuple(item["loc"])
        kind, last = item["type"], str(location[-1]) if location else ""
        section = next((str(step) for step in reversed(location) if step in _REMEDIES), "")
        remedy = _REMEDIES.get(section, "see sites/template.yaml")
        if kind == "extra_forbidden":
            close = _close(last, location[:-1])
            remedy = f"did you mean {close!r}?" if close else f"known here: {', '.join(_keys_at(location[:-1]))}"
            found.append(document.problem(location, f"unknown key {last!r}", remedy, key=True))
        elif kind == "missing":
            if location not in misspelt:  # else it is there, under another name
                found.append(document.problem(location[:-1], f"{last!r} is missing", remedy))
        elif last == "pattern" and isinstance(item["input"], dict):
            what = "is no text: YAML takes {camera} for a mapping where no quotes are around it"
            found.append(document.problem(location, what, "put it in quotes: pattern: '{camera}.jpg'"))
        else:
            what = item["msg"]
            if kind != CUSTOM:
                shown = f", not {item['input']!r}" if not isinstance(item["input"], dict | list) else ""
                what = f"{what[0].lower()}{what[1:]}{shown}"
            found.append(document.problem(location, what, remedy))
    return found


def without_faults(data: dict[str, Any], error: ValidationError) -> SiteFile | None:
    """What is left of a site file without its faulty values, to be examined in the same go; None when too little is."""
    cameras = data.get("cameras")
    data = {**data, "cameras": list(cameras) if isinstance(cameras, list) else []}
    for item in error.errors():
        section, *rest = item["loc"] or ("",)
        if section == "cameras" and rest and isinstance(rest[0], int):
            camera = data["cameras"][rest[0]]
            data["cameras"][rest[0]] = (
                {"id": camera.get("id"), "intrinsics": {"hfov": 60.0}} if isinstance(camera, dict) else None
            )
        else:
            data.pop(str(section), None)
    try:
        return SiteFile.model_validate({"site": "site", "captures": {"pattern": "{camera}"}, **data})
    except ValidationError:
        return None


def _close(key: str, location: Location) -> str:
    """Return the known key nearest to a misspelt one; "" where none is near."""
    return next(iter(difflib.get_close_matches(key, _keys_at(location), 1)), "")


def _keys_at(location: Location) -> list[str]:
    """The keys that a section may have."""
    model: type[BaseModel] = SiteFile
    for step in location:
        if isinstance(step, str) and step in model.model_fields:
            model = _model_in(model.model_fields[step].annotation) or model
    return list(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The model that an annotation such as `list[CameraEntry]` or `Pose | None` is about."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for inner in typing.get_args(annotation) if (model := _model_in(inner))), None)
