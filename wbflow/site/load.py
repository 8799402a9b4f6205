"""Loading of the site file: one YAML file, typed and validated; all errors are reported at once, with line and remedy."""

from __future__ import annotations

import difflib
import os
import re
import typing
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from wbflow_stages.contracts.stated import LensModel

from ..cache.layout import WorkFolder
from ..cache.untrusted import is_file, is_folder
from ..errors import Location
from ..pipeline.binding import Bindings
from ..pipeline.functions import FunctionReader
from ..pipeline.pairs import MOST_PAIRS_PER_VIEW
from ..remote import is_url
from ..words import printable
from .cameras import read_cameras, read_survey, views_of
from .geodesy import POSITION_REMEDY, LocalFrame, local_frame
from .models import CUSTOM, Camera, Site, SiteFile
from .observation_tables import ObservationTable, SurveyTable
from .observations import OBSERVATIONS_REMEDY, SURVEY_REMEDY, read_observations, read_thing_survey
from .pattern import Pattern
from .plausibility import check_plausibility
from .stage_settings import read_stages
from .yaml_document import Document, Problem, Problems, SiteError, is_name, load_yaml, resolve_path, similar, suggest


def load_site(path: str | Path, work: str | Path | None = None) -> Site:
    """Read and validate a site file (or the `site.yaml` in a folder).  work: replaces the work folder of the file.

    Raises SiteError with every problem found.
    """
    path = Path(path)
    if not is_folder(path):
        return site_of(load_yaml(path), work)
    file = path / "site.yaml"
    if not file.exists():
        remedy = f"wbflow init {path}  writes one from the photographs in there"
        raise SiteError(Problem(file, "cannot be read: there is no such file", remedy))
    return site_of(load_yaml(file), work)


def site_of(document: Document, work: str | Path | None = None) -> Site:
    """Validate the content of a site file, as `load_site` does.  Raises SiteError."""
    # all parts are checked, so that every problem is reported in one go
    problems = Problems(document)
    file = _validated(document, problems)
    observations, thing_survey = _read_tables(file, problems)
    frame = local_frame(file, thing_survey.first_geodetic if thing_survey else None, problems)
    doubts = Problems(document)
    cameras = read_cameras(file, frame, problems, doubts)
    survey = read_survey(file, frame, problems)
    if thing_survey:
        thing_survey = _in_metres(thing_survey, frame, problems)
    work_folder = _work_folder(str(work or ""), file, problems)
    reader = FunctionReader(work_folder.functions_memo, document.path.resolve().parent)
    bindings = Bindings(reader)
    stages, notes = read_stages(file.stages, bindings, problems)
    _check_pairs(file, problems, notes)
    check_plausibility(file, cameras, stages, reader, problems, doubts)
    captures = _captures_pattern(file, problems)
    if not is_name(file.site):
        remedy = "use letters, digits, '_', '.', '-' (not dots alone), at most 100"
        problems.add(("site",), f"{file.site!r} is not a name", remedy)
    if problems.found:
        raise SiteError(*problems.found)
    views: list[Camera] = []
    for camera in cameras:
        views.extend(views_of(camera))
    return Site(
        file,
        document,
        captures,
        tuple(cameras),
        tuple(views),
        survey,
        observations,
        thing_survey,
        stages,
        work_folder,
        bindings,
        tuple(notes.found),
        tuple(doubts.found),
    )


def _validated(document: Document, problems: Problems) -> SiteFile:
    """The validated file; faults are added to `problems`, and faulty values left out, so that the rest is checked too.

    Raises SiteError if too little is valid for that.
    """
    if not isinstance(document.data, dict):
        remedy = "start with 'site: NAME'; see sites/template.yaml"
        raise SiteError(Problem(document.path, "a site file is a mapping", remedy, 1, 1))
    # before validation, since ids and paths are texts for it
    data = _prepared(document.data, problems)
    try:
        return SiteFile.model_validate(data)
    except ValidationError as error:
        _explain(error, problems)
        valid_part = _without_faults(data, error)
        if valid_part is None:
            raise SiteError(*problems.found) from None
        return valid_part


def _read_tables(file: SiteFile, problems: Problems) -> tuple[ObservationTable | None, SurveyTable | None]:
    """The tables of observations and of their survey; their faults are added to `problems`."""
    if file.observations is None:
        if file.survey is not None:
            remedy = "name the file with what the cameras saw, too: observations: FILE"
            problems.add(("survey",), "says where things were, but no observations of them are given", remedy)
        return None, None
    ids = [camera.id for camera in file.cameras]
    location: Location = ("observations",)
    try:
        observations = read_observations(_existing_file(file.observations, location, problems), ids)
        if file.survey is None:
            return observations, None
        location = ("survey",)
        return observations, read_thing_survey(_existing_file(file.survey, location, problems), observations)
    except SiteError as error:
        for fault in error.problems:
            problems.add(location, f"{fault.mark}: {fault.what}", fault.remedy)
        return None, None


def _existing_file(path: str, location: Location, problems: Problems) -> Path:
    """The path of a file that the site file names at a location.  Raises SiteError if there is none."""
    file = resolve_path(path, location, problems)
    if not is_file(file):
        remedy = similar(file) or "check the path; it is relative to the site file"
        raise SiteError(Problem(file, "there is no such file", remedy))
    return file


def _in_metres(survey: SurveyTable, frame: LocalFrame | None, problems: Problems) -> SurveyTable:
    """The survey with positions in the metres of cameras and control points; if it cannot be, that is added to `problems`."""
    if frame is None or not survey.rows.thing:
        return survey
    if not survey.geodetic:
        what = (
            "metres here, but latitude and longitude of cameras or control points: the transformation between the two is unknown"
        )
        problems.add(("survey",), what, "give latitude, longitude and height here, too")
        return survey
    rows = replace(survey.rows, position=frame.metres_of(survey.rows.position), crs=frame.crs)
    return replace(survey, rows=rows, geodetic=False)


def _work_folder(requested: str, file: SiteFile, problems: Problems) -> WorkFolder:
    """Return the work folder.  requested: takes precedence over the key `work` of the file."""
    work = requested or file.work or ""
    name = file.site if is_name(file.site) else "site"  # a wrong name is a problem of its own
    if is_url(work):
        return WorkFolder.mirroring(work, name)
    if requested:  # on the command line: relative to the present folder, not to the site file
        return WorkFolder(Path(requested).resolve())
    if work:
        return WorkFolder(resolve_path(work, ("work",), problems))
    return WorkFolder.default_for(problems.document.path, name)


def _captures_pattern(file: SiteFile, problems: Problems) -> Pattern:
    """The captures' pattern, with the folder they are in, or the local mirror of their object store.

    The folder must be there, unless all cameras have a `url`: then `wbflow capture` makes it.
    """
    settings = file.captures
    if is_url(settings.root):
        mirror = WorkFolder.mirroring(settings.root, "captures")
        return Pattern(mirror.root, settings.pattern, mirror.store)
    root = resolve_path(settings.root, ("captures", "root"), problems)
    # an empty list of cameras is a problem of its own
    is_made_later = bool(file.cameras) and all(camera.url for camera in file.cameras)
    if not is_folder(root) and not is_made_later:
        remedy = similar(root) or "check the path and the variables in it; it is relative to the site file"
        problems.add(("captures", "root"), f"there is no folder {printable(root)}", remedy)
    return Pattern(root, settings.pattern)


_NAME_LOCATIONS = re.compile(r"site|cameras\.\d+(\.id)?|pairs\.(include|exclude)\.\d+\.\d+|distances\.\d+\.[01]")
"""Locations of site and camera names."""


def _prepared(data: Any, problems: Problems, location: Location = ()) -> Any:
    """The data with ids as written (an unquoted `0000` stays '0000' instead of becoming a number), and with ${VAR} and
    ${VAR:-default} replaced in every string."""
    if isinstance(data, dict):
        return {str(key): _prepared(value, problems, (*location, str(key))) for key, value in data.items()}
    if isinstance(data, list):
        return [_prepared(value, problems, (*location, i)) for i, value in enumerate(data)]
    if data is not None and _NAME_LOCATIONS.fullmatch(".".join(map(str, location))):
        data = problems.document.texts.get(location, data)
    if not isinstance(data, str):
        return data
    if "\0" in data:  # not allowed in paths and commands
        problems.add(location, f"{printable(repr(data), 80)} holds a zero byte", "write the text without \\0")
        data = data.replace("\0", "")

    def value(match: re.Match[str]) -> str:
        name, default = match.groups()
        content = os.environ.get(name) or default  # an empty variable counts as unset, as in a shell
        if content is None:
            remedy = f"set it, or write a default: ${{{name}:-/path}}"
            problems.add(location, f"the environment variable {name} is not set", remedy)
            return ""
        return content

    return re.sub(r"\$\{(\w+)(?::-([^}]*))?\}", value, data)


def _check_pairs(file: SiteFile, problems: Problems, notes: Problems) -> None:
    """Do the limits leave any pair, and are the pairs that the file names pairs of its cameras?"""
    if file.pairs.degree > MOST_PAIRS_PER_VIEW:
        what = f"a view takes {MOST_PAIRS_PER_VIEW} pairs at most, its best, not {file.pairs.degree}"
        notes.add(("pairs", "degree"), what, f"write {MOST_PAIRS_PER_VIEW} or less, e.g. degree: 6")
    ids = [camera.id for camera in file.cameras]
    pairs = file.pairs
    if pairs.min_angle >= pairs.max_angle:
        remedy = "min_angle must be below max_angle, both in degrees"
        problems.add(("pairs",), f"no angle is between {pairs.min_angle} and {pairs.max_angle}", remedy)
    for name, rows in (("include", pairs.include), ("exclude", pairs.exclude)):
        for i, row in enumerate(rows):
            for j, camera in enumerate(row):
                if camera not in ids:
                    remedy = suggest(camera, ids, "use ids from 'cameras'")
                    problems.add(("pairs", name, i, j), f"there is no camera {camera!r}", remedy)
            if row[0] == row[1]:
                problems.add(("pairs", name, i), "a camera makes no pair with itself", "name two cameras")


_REMEDIES = {
    "intrinsics": "give fx, fy, cx, cy, width, height in pixels, or the horizontal field of view: intrinsics: {hfov: 72}",
    "pose": f"{POSITION_REMEDY}; where known too, one of look_at: [x, y, z], yaw_pitch_roll: [deg, deg, deg], rotation: 3x3, "
    "and how well: position_sigma_m, rotation_sigma_deg",
    "observations": OBSERVATIONS_REMEDY,
    "survey": SURVEY_REMEDY,
    "distances": "write [camera, camera, metres], e.g. distances: [[gate, roof, 12.4]]",
    "control_points": "write {position: [x, y, z], pixels: {gate: [x, y], roof: [x, y]}}",
    "captures": "give root: FOLDER and pattern, e.g. pattern: '{camera}/{date:%Y-%m-%d}*.jpg'",
    "cameras": "list the cameras: cameras: [gate, roof], or mappings with id, intrinsics, distortion, pose, mask, images",
    "url": "write the address alone, e.g. url: 'http://10.0.0.5/snapshot.jpg', and name a file as captures: {credentials: FILE}; "
    "it has lines such as  gate: {user: viewer, password: secret}",
    "tls": "true: verified by known authorities (default); false: not verified; 'sha256:AB:CD:...': the camera's fingerprint; or "
    "a PEM file with its certificate",
    "distortion": "give [k1, k2, p1, p2, k3] as OpenCV defines them, or those of the model that you name",
    "model": f"name one of {', '.join(LensModel)}; without it a lens is brown (OpenCV's k1 k2 p1 p2 k3)",
    "site": "give the site a name: site: harbour",
    "timezone": "give the name of a time zone, e.g. timezone: Europe/Berlin",
    "resolution": "give the long side in pixels that stages work at, e.g. resolution: 1600, or null for as captured",
    "bounds": "give two corners of the box that matters, in metres: bounds: [[-20, -30, 0], [20, 30, 12]]",
    "zones": "give name, three corners or more and, if you like, a least size in metres: zones: [{name: quay, polygon: [[0, 0], "
    "[20, 0], [20, 8]], least_m: 0.5}]",
    "degree": f"give a whole number from 1 to {MOST_PAIRS_PER_VIEW}, e.g. degree: 6",
    "min_angle": "give degrees, e.g. min_angle: 4",
    "max_angle": "give degrees, e.g. max_angle: 60",
    "keep": "for example keep: {nights: 7, bytes: 50GB, clouds: all, reports: 365}",
    "expect": "give shares of what is usual, or least counts: expect: {points: 0.7, pairs: 0.7, cameras: 1.0, since: 2026-11-20}",
    "notify": "give a command, e.g. notify: {command: 'mail -s \"$WBFLOW_SUMMARY\" me@example.org'}",
    "images": "list file names below captures.root: images: [gate/1.jpg, gate/2.jpg]",
    "include": "give two camera ids: include: [[gate, roof]]",
    "exclude": "give two camera ids: exclude: [[gate, roof]]",
}


def _explain(error: ValidationError, problems: Problems) -> None:
    """Add the errors that pydantic found to `problems`, in the terms of a site file."""
    errors = error.errors()
    # a misspelt key gives two errors: it is unknown, and the right one is missing
    misspelt: set[tuple[int | str, ...]] = set()
    for item in errors:
        if item["type"] == "extra_forbidden":
            *section_steps, key_step = item["loc"]
            for meant in difflib.get_close_matches(str(key_step), _keys_at(section_steps), 1):
                misspelt.add((*section_steps, meant))
    for item in errors:
        location = item["loc"]
        kind = item["type"]
        section = location[:-1]
        key = str(location[-1])
        remedy = _remedy_of(location)
        if kind == "extra_forbidden":
            keys = _keys_at(section)
            advice = _slip_of_key(key) or suggest(key, keys, f"known here: {', '.join(keys)}")
            problems.add(location, f"unknown key {key!r}", advice, key=True)
        elif kind == "missing":
            if location not in misspelt:  # otherwise it is present but misspelt
                problems.add(section, f"{key!r} is missing", remedy)
        elif key == "pattern" and isinstance(item["input"], dict):  # pattern: {camera}.jpg
            what = "is not a text: without quotes, YAML takes {camera} for a mapping"
            problems.add(location, what, "put it in quotes: pattern: '{camera}.jpg'")
        elif kind == "too_long":
            most = item["ctx"]["max_length"]
            count = item["ctx"]["actual_length"]
            advice = remedy
            if _may_have_decimal_commas(item["input"], most):
                advice = f"{_DECIMAL_COMMA}; {remedy}"
            problems.add(location, f"holds {count} values, {most} belong there", advice)
        elif isinstance(item["input"], str) and re.fullmatch(r"[-+]?\d+,\d+", item["input"].strip()):
            corrected = item["input"].strip().replace(",", ".")
            problems.add(location, f"{item['input']!r} is not a number", f"{_DECIMAL_COMMA}: {corrected}")
        elif kind == CUSTOM:
            problems.add(location, item["msg"], remedy)
        else:
            what = f"{item['msg'][0].lower()}{item['msg'][1:]}"
            if not isinstance(item["input"], dict | list):
                what += f", not {item['input']!r}"
            problems.add(location, what, remedy)


def _remedy_of(location: Location) -> str:
    """How the innermost section of a location, of those that have a remedy, is written."""
    for step in reversed(location):
        if step in _REMEDIES:
            return _REMEDIES[str(step)]
    return "see sites/template.yaml"


_DECIMAL_COMMA = "write decimals with a point, not a comma (1.5, not 1,5)"


def _may_have_decimal_commas(values: Any, most: int) -> bool:
    """May a list be too long because each decimal comma divided a number in two?"""
    if not isinstance(values, list) or len(values) > 2 * most:
        return False
    numbers = [value for value in values if isinstance(value, int | float) and not isinstance(value, bool)]
    return len(numbers) > 1


def _slip_of_key(key: str) -> str:
    """How a key came about that is none: a missing space after a colon, or a decimal comma; "" if neither."""
    name, colon, value = key.partition(":")
    if colon and name and value:
        return f"write a space after the colon: {printable(name)}: {printable(value)}"
    if re.fullmatch(r"\d+", key):
        return _DECIMAL_COMMA
    return ""


def _without_faults(data: dict[str, Any], error: ValidationError) -> SiteFile | None:
    """The site file without its faulty values, so that the rest is checked in the same run; None if too little is left."""
    valid = dict(data)
    cameras: list[Any] = []
    if isinstance(data.get("cameras"), list):
        cameras = list(data["cameras"])
    valid["cameras"] = cameras
    for item in error.errors():
        section, *steps = item["loc"]
        if section == "cameras" and steps and isinstance(steps[0], int):
            # a stand-in: the other cameras keep their positions, and pairs may name it
            camera = cameras[steps[0]]
            cameras[steps[0]] = None
            if isinstance(camera, dict):
                cameras[steps[0]] = {"id": camera.get("id"), "intrinsics": {"hfov": 60.0}}
        else:
            valid.pop(str(section), None)
    try:
        return SiteFile.model_validate({"site": "site", "captures": {"pattern": "{camera}"}, **valid})
    except ValidationError:
        return None


def _keys_at(location: Iterable[str | int]) -> list[str]:
    """The keys that the section at a location may have."""
    model: type[BaseModel] = SiteFile
    for step in location:
        if isinstance(step, str) and step in model.model_fields:
            model = _model_in(model.model_fields[step].annotation) or model
    return list(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel] | None:
    """The model within an annotation such as `list[CameraEntry]` or `Pose | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in typing.get_args(annotation):
        model = _model_in(inner)
        if model:
            return model
    return None
