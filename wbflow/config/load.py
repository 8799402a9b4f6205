"""The site description: one YAML file, typed and validated; every error at once, each with its line and what to write instead."""

from __future__ import annotations

import difflib
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from ..graph.functions import FunctionReader
from ..graph.modules import FunctionError
from ..graph.pipeline import STAGES, Stage
from ..store.layout import WorkFolder
from .calibration import Calibrated, CalibrationError, find_camera, read_calibration
from .geodesy import PLACE_REMEDY, ControlPoint, Distance, LocalFrame, Position, local_frame, read_survey
from .positions import Document, Place, Problem, SiteError, load_yaml
from .rotations import look_at, yaw_pitch_roll

GEODETIC_SIGMA_M = 3.0
"""Standard deviation of a position that is given by latitude and longitude without one: a plain satellite receiver's, metres."""
ID = re.compile(r"[A-Za-z0-9_.-]{1,100}")
Vector3 = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix3 = Annotated[list[Vector3], Field(min_length=3, max_length=3)]


@dataclass(frozen=True)
class SiteCamera:
    """One camera of a site, in plain values.

    lens: K (3x3 or None), distortion (5), hfov_deg, width, height (0: unstated); placement: R (3x3) and C (3), or None each,
    sigma_m and metric where the file says so;
    images: file names below the captures' root, where the site file lists them; place: where it stands in the site file.
    """

    id: str
    lens: dict[str, Any]
    placement: dict[str, Any]
    mask: Path | None = None
    images: tuple[str, ...] | None = None
    place: Place = ()

    @property
    def posed(self) -> bool:
        """Are intrinsics and pose both given, to be taken as they are?"""
        stated = self.lens["K"] is not None and self.placement["R"] is not None and self.placement["C"] is not None
        return stated and not self.placement.get("sigma_m")


@dataclass(frozen=True)
class StageSettings:
    """What the site file says of one stage: another function for it (`use`), parameters, or that it is off."""

    use: str | None = None
    parameters: dict[str, Any] = field(default_factory=dict)
    enabled: bool = True


@dataclass(frozen=True)
class Site:
    """A valid site description.  survey: fields of `wbflow_stages.types.Survey`."""

    name: str
    document: Document
    root: Path
    pattern: str
    cameras: tuple[SiteCamera, ...]
    resolution: int | None
    pairs: dict[str, Any]
    stages: dict[str, StageSettings]
    work: Path
    reader: FunctionReader
    survey: dict[str, Any] = field(default_factory=dict)

    @property
    def file(self) -> Path:
        """The site file."""
        return self.document.path

    @property
    def posed(self) -> bool:
        """Are the intrinsics and poses of all cameras given?"""
        return all(camera.posed for camera in self.cameras)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class _Captures(_Model):
    root: str = "."
    pattern: str

    @field_validator("pattern")
    @classmethod
    def _known_fields(cls, pattern: str) -> str:
        unknown = [f for f in re.findall(r"\{(\w*)", pattern) if f not in {"camera", "date"}]
        if unknown:
            raise PydanticCustomError("pattern", f"{{{unknown[0]}}} is not known; use {{camera}}, {{date:%Y-%m-%d}}, * and **")
        return pattern


class _Intrinsics(_Model):
    fx: float | None = Field(None, gt=0)
    fy: float | None = Field(None, gt=0)
    cx: float | None = None
    cy: float | None = None
    width: int | None = Field(None, gt=0)
    height: int | None = Field(None, gt=0)
    hfov: float | None = Field(None, gt=1, lt=179)

    @model_validator(mode="after")
    def _complete(self) -> _Intrinsics:
        if self.hfov is not None:
            if self.fx is not None or self.fy is not None:
                raise PydanticCustomError("intrinsics", "'hfov' and 'fx', 'fy' say the same thing twice")
            return self
        missing = [name for name in ("fx", "fy", "cx", "cy", "width", "height") if getattr(self, name) is None]
        if missing:
            names = ", ".join(f"'{name}'" for name in missing)
            raise PydanticCustomError("intrinsics", f"{names} {'is' if len(missing) == 1 else 'are'} missing")
        return self


class _Pose(Position):
    position_sigma_m: float | None = Field(None, ge=0)
    rotation: Matrix3 | None = None
    look_at: Vector3 | None = None
    yaw_pitch_roll: Vector3 | None = None

    @model_validator(mode="after")
    def _one_direction(self) -> _Pose:
        given = [n for n in ("rotation", "look_at", "yaw_pitch_roll") if getattr(self, n) is not None]
        if len(given) > 1:
            raise PydanticCustomError("pose", f"{' and '.join(given)} are both given")
        if self.look_at is not None and self.position is None:
            raise PydanticCustomError("pose", "'look_at' needs 'position' in the same coordinates")
        self.matrix()
        return self

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position: as stated, else what a satellite receiver gives, else exact."""
        if self.position_sigma_m is not None:
            return self.position_sigma_m
        return GEODETIC_SIGMA_M if self.geodetic else 0.0

    def matrix(self) -> list[list[float]] | None:
        """R, whichever way it is stated; None where only the position is."""
        try:
            if self.look_at is not None and self.position is not None:
                return look_at(self.position, self.look_at)
            if self.yaw_pitch_roll is not None:
                return yaw_pitch_roll(*self.yaw_pitch_roll)
        except ValueError as error:
            raise PydanticCustomError("pose", str(error)) from None
        R = self.rotation
        if R is not None and any(
            abs(sum(a * b for a, b in zip(R[i], R[j], strict=True)) - (i == j)) > 1e-3 for i in range(3) for j in range(3)
        ):
            raise PydanticCustomError("pose", "'rotation' is not a rotation matrix (rows of unit length, at right angles)")
        return R


class _Camera(_Model):
    id: str
    intrinsics: _Intrinsics | None = None
    distortion: Annotated[list[float], Field(min_length=1, max_length=5)] | None = None
    pose: _Pose | None = None
    mask: str | None = None
    images: list[str] | None = None


class _Pairs(_Model):
    degree: int = Field(6, ge=1)
    min_angle: float = Field(4.0, ge=0, lt=180)
    max_angle: float = Field(60.0, gt=0, le=180)
    include: list[Annotated[list[str], Field(min_length=2, max_length=2)]] = Field(default_factory=list)
    exclude: list[Annotated[list[str], Field(min_length=2, max_length=2)]] = Field(default_factory=list)


class _Site(_Model):
    site: str
    captures: _Captures
    cameras: Annotated[list[_Camera], Field(min_length=1)]
    calibration: str | None = None
    distances: list[Distance] = Field(default_factory=list)
    control_points: list[ControlPoint] = Field(default_factory=list)
    resolution: int | None = Field(1600, ge=64)
    pairs: _Pairs = _Pairs.model_validate({})
    stages: dict[str, Any] = Field(default_factory=dict)
    work: str | None = None


_REMEDIES = {
    "intrinsics": "give fx, fy, cx, cy, width, height in pixels, or the horizontal field of view: intrinsics: {hfov: 72}",
    "pose": f"{PLACE_REMEDY}; where known too, one of look_at: [x, y, z], yaw_pitch_roll: [deg, deg, deg], rotation: 3x3",
    "distances": "write [camera, camera, metres], e.g. distances: [[gate, roof, 12.4]]",
    "control_points": "write {position: [x, y, z], pixels: {gate: [x, y], roof: [x, y]}}",
    "captures": "give root: FOLDER and pattern, e.g. pattern: '{camera}/{date:%Y-%m-%d}*.jpg'",
    "cameras": "list the cameras: cameras: [gate, roof], or mappings with id, intrinsics, distortion, pose, mask, images",
    "distortion": "give [k1, k2, p1, p2, k3] as OpenCV defines them",
    "site": "give the site a name: site: harbour",
    "resolution": "give the long side in pixels that stages work at, e.g. resolution: 1600, or null for as captured",
    "degree": "give a whole number, e.g. degree: 6",
    "min_angle": "give degrees, e.g. min_angle: 4",
    "max_angle": "give degrees, e.g. max_angle: 60",
    "include": "give two camera ids: include: [[gate, roof]]",
    "exclude": "give two camera ids: exclude: [[gate, roof]]",
}


def load_site(path: Path, work: Path | None = None) -> Site:
    """Read and validate a site file (or the `site.yaml` in a folder).  work: overrides the work folder that the file names.

    Raises
    ------
    SiteError
        With every problem that was found.
    """
    path = path / "site.yaml" if path.is_dir() else path
    document = load_yaml(path)
    if not isinstance(document.data, dict):
        raise SiteError([Problem(path, 1, 1, "", "a site file is a mapping", "start with 'site: NAME'; see sites/template.yaml")])
    problems: list[Problem] = []
    data = _expanded(_with_texts(document), document, problems)
    try:
        model = _Site.model_validate(data)
    except ValidationError as error:
        problems += _problems(error, document)
        salvaged = _without_faults(data, error)
        if salvaged is None:
            raise SiteError(problems) from None
        model = salvaged
    places: list[tuple[Place, Position]] = [
        (("cameras", i, "pose"), camera.pose) for i, camera in enumerate(model.cameras) if camera.pose
    ]
    places += [(("control_points", i), point) for i, point in enumerate(model.control_points)]
    frame = local_frame(iter(places), document, problems)
    cameras = _cameras(model, frame, document, problems)
    ids = [camera.id for camera in model.cameras]
    survey = read_survey(ids, model.distances, model.control_points, frame, document, problems)
    if work is None:
        work = _beside(path, model.work) if model.work else WorkFolder.beside(path, model.site).root
    reader = FunctionReader(WorkFolder(work).functions_memo, path.resolve().parent)
    stages = _stages(model, document, reader, problems)
    _check_pairs(model, document, problems)
    root = _beside(path, model.captures.root)
    if not root.is_dir():
        remedy = "check the path and the variables in it; it is relative to the site file"
        problems.append(document.problem(("captures", "root"), f"there is no folder {root}", remedy))
    if not ID.fullmatch(model.site):
        problems.append(document.problem(("site",), f"{model.site!r} is not a name", "use letters, digits, '_', '.', '-'"))
    if problems:
        raise SiteError(sorted(problems, key=lambda p: (str(p.file), p.line, p.column)))
    pairs = {name: getattr(model.pairs, name) for name in ("degree", "min_angle", "max_angle", "include", "exclude")}
    return Site(
        model.site, document, root, model.captures.pattern, tuple(cameras), model.resolution, pairs, stages, work, reader, survey
    )


def _beside(file: Path, path: str) -> Path:
    return Path(os.path.normpath(file.resolve().parent / Path(path).expanduser()))


def _with_texts(document: Document) -> Any:
    """The data with ids as they are written: an unquoted `0000` stays '0000' and does not become a number."""
    data = dict(document.data)
    texts = document.texts
    data["site"] = texts.get(("site",), data.get("site"))
    if data["site"] is None:
        del data["site"]
    if isinstance(data.get("cameras"), list):
        entries = []
        for i, entry in enumerate(data["cameras"]):
            if isinstance(entry, dict):
                entries.append({**entry, **({"id": texts[("cameras", i, "id")]} if ("cameras", i, "id") in texts else {})})
            else:
                entries.append({"id": texts[("cameras", i)]} if ("cameras", i) in texts else entry)
        data["cameras"] = entries
    pairs = data.get("pairs")
    if isinstance(pairs, dict):
        data["pairs"] = dict(pairs)
        for name in ("include", "exclude"):
            if isinstance(pairs.get(name), list):
                rows = enumerate(pairs[name])
                data["pairs"][name] = [
                    [texts.get(("pairs", name, i, j), item) for j, item in enumerate(row)] if isinstance(row, list) else row
                    for i, row in rows
                ]
    if isinstance(data.get("distances"), list):
        data["distances"] = [
            [texts.get(("distances", i, j), item) if j < 2 else item for j, item in enumerate(row)]
            if isinstance(row, list)
            else row
            for i, row in enumerate(data["distances"])
        ]
    return data


def _expanded(data: Any, document: Document, problems: list[Problem], place: Place = ()) -> Any:
    """Replace ${VAR} and ${VAR:-default} in every string."""
    if isinstance(data, dict):
        return {key: _expanded(value, document, problems, (*place, str(key))) for key, value in data.items()}
    if isinstance(data, list):
        return [_expanded(value, document, problems, (*place, i)) for i, value in enumerate(data)]
    if not isinstance(data, str) or "${" not in data:
        return data

    def value(match: re.Match[str]) -> str:
        name, default = match.group(1), match.group(2)
        found = os.environ.get(name) or default
        if found is None:
            remedy = f"set it, or write a default: ${{{name}:-/path}}"
            problems.append(document.problem(place, f"the environment variable {name} is not set", remedy))
            return ""
        return found

    return re.sub(r"\$\{(\w+)(?::-([^}]*))?\}", value, data)


def _problems(error: ValidationError, document: Document) -> list[Problem]:
    """pydantic's findings in the words of a site file."""
    found = []
    for item in error.errors():
        place: Place = tuple(item["loc"])
        kind, last = item["type"], str(item["loc"][-1]) if item["loc"] else ""
        section = next((str(step) for step in reversed(place) if step in _REMEDIES), "")
        remedy = _REMEDIES.get(section, "see sites/template.yaml")
        if kind == "extra_forbidden":
            allowed = _fields_at(place[:-1])
            close = difflib.get_close_matches(last, allowed, 1)
            remedy = f"did you mean {close[0]!r}?" if close else f"known here: {', '.join(allowed)}"
            found.append(document.problem(place, f"unknown key {last!r}", remedy, key=True))
        elif kind == "missing":
            found.append(document.problem(place[:-1], f"{last!r} is missing", remedy))
        else:
            what = item["msg"]
            if kind not in {"intrinsics", "pose", "place", "pattern"}:
                shown = f", not {item['input']!r}" if not isinstance(item["input"], dict | list) else ""
                what = f"{what[0].lower()}{what[1:]}{shown}"
            found.append(document.problem(place, what, remedy))
    return sorted(found, key=lambda p: (p.line, p.column))


def _without_faults(data: dict[str, Any], error: ValidationError) -> _Site | None:
    """What is left of a site file without its faulty values, to be examined in the same go; None when too little is."""
    data = {**data, "cameras": list(data.get("cameras") or [])}
    for item in error.errors():
        section, *rest = item["loc"]
        if section == "cameras" and rest and isinstance(rest[0], int):
            camera = data["cameras"][rest[0]]
            data["cameras"][rest[0]] = (
                {"id": camera.get("id"), "intrinsics": {"hfov": 60.0}} if isinstance(camera, dict) else None
            )
        else:
            data.pop(str(section), None)
    try:
        return _Site.model_validate({"site": "site", "captures": {"pattern": "{camera}"}, **data})
    except ValidationError:
        return None


def _fields_at(place: Place) -> list[str]:
    model: Any = _Site
    sections = {
        "captures": _Captures,
        "cameras": _Camera,
        "intrinsics": _Intrinsics,
        "pose": _Pose,
        "pairs": _Pairs,
        "control_points": ControlPoint,
    }
    for step in place:
        model = sections.get(str(step), model)
    return list(model.model_fields)


def _cameras(model: _Site, frame: LocalFrame | None, document: Document, problems: list[Problem]) -> list[SiteCamera]:
    calibrated: dict[str, Calibrated] = {}
    if model.calibration:
        try:
            calibrated = read_calibration(_beside(document.path, model.calibration))
        except CalibrationError as error:
            problems.append(
                document.problem(("calibration",), str(error), "give the path of cameras.json or of a COLMAP text model")
            )
    seen: dict[str, int] = {}
    found = []
    for i, camera in enumerate(model.cameras):
        place: Place = ("cameras", i)
        if not ID.fullmatch(camera.id) or not camera.id.strip("."):
            what, remedy = f"{camera.id!r} is not a camera id", "use letters, digits, '_', '.', '-' (not dots alone), at most 100"
            problems.append(document.problem(place, what, remedy))
        if camera.id in seen:
            first = document.marks.get(("cameras", seen[camera.id]), (0, 0))[0]
            what, remedy = f"camera {camera.id!r} is named twice, first on line {first}", "give each camera its own id"
            problems.append(document.problem(place, what, remedy))
        seen.setdefault(camera.id, i)
        entry = find_camera(calibrated, camera.id)
        if calibrated and entry is None and camera.intrinsics is None:
            what = f"{model.calibration} has no camera {camera.id!r}; it has {_shown(calibrated)}"
            problems.append(
                document.problem(place, what, "correct the id, add the camera to that file, or give its intrinsics here")
            )
        mask = _beside(document.path, camera.mask) if camera.mask else None
        if mask and not mask.is_file():
            remedy = "give the path of an image of the capture's size, white where pixels may be used"
            problems.append(document.problem((*place, "mask"), f"there is no file {mask}", remedy))
        lens, placement = _lens(camera, entry), _placement(camera, entry, frame)
        images = tuple(camera.images) if camera.images is not None else None
        found.append(SiteCamera(camera.id, lens, placement, mask, images, place))
    return found


def _shown(names: dict[str, Any], most: int = 5) -> str:
    listed = list(names)[:most]
    return ", ".join(listed) + (f" and {len(names) - most} more" if len(names) > most else "")


def _lens(camera: _Camera, entry: Calibrated | None) -> dict[str, Any]:
    lens: dict[str, Any] = {"K": None, "distortion": [0.0] * 5, "hfov_deg": None, "width": 0, "height": 0}
    if entry:
        lens |= {"K": entry.K, "width": entry.width, "height": entry.height, "distortion": entry.distortion or [0.0] * 5}
    if (own := camera.intrinsics) and not (entry and own.hfov is not None):  # a calibration knows better than a field of view
        K = None if own.hfov is not None else [[own.fx, 0.0, own.cx], [0.0, own.fy, own.cy], [0.0, 0.0, 1.0]]
        lens |= {"K": K, "hfov_deg": own.hfov, "width": own.width or 0, "height": own.height or 0}
    if camera.distortion is not None:
        lens["distortion"] = (camera.distortion + [0.0] * 5)[:5]
    return lens


def _placement(camera: _Camera, entry: Calibrated | None, frame: LocalFrame | None) -> dict[str, Any]:
    rough = camera.pose is not None and (camera.pose.matrix() is None or camera.pose.sigma_m > 0)
    if (pose := camera.pose) and not (rough and entry and entry.R and entry.C):  # what was solved from it knows better
        geodetic = pose.geodetic
        C = frame.metres(*geodetic) if frame and geodetic else pose.position
        return {"R": pose.matrix(), "C": C} | ({"sigma_m": pose.sigma_m} if pose.sigma_m else {})
    if entry is None:
        return {"R": None, "C": None}
    return {"R": entry.R, "C": entry.C} | ({} if entry.metric else {"metric": False})


def _stages(model: _Site, document: Document, reader: FunctionReader, problems: list[Problem]) -> dict[str, StageSettings]:
    found: dict[str, StageSettings] = {}
    known = {stage.name: stage for stage in STAGES}
    for name, section in model.stages.items():
        place: Place = ("stages", name)
        if name not in known:
            close = difflib.get_close_matches(name, known, 1)
            remedy = f"did you mean {close[0]!r}?" if close else f"stages are {', '.join(known)}"
            problems.append(document.problem(place, f"unknown stage {name!r}", remedy, key=True))
        elif section is False:
            if not known[name].optional:
                remedy = f"stages that can be: {', '.join(s.name for s in STAGES if s.optional) or 'none'}"
                problems.append(document.problem(place, f"{name} cannot be switched off", remedy))
            found[name] = StageSettings(enabled=False)
        elif section is None or section is True or isinstance(section, dict):
            found[name] = _stage(known[name], section if isinstance(section, dict) else {}, document, reader, problems)
        else:
            problems.append(
                document.problem(place, f"{section!r} is not a mapping of parameters", f"write {name}: {{parameter: value}}")
            )
    return found


def _stage(
    stage: Stage, section: dict[Any, Any], document: Document, reader: FunctionReader, problems: list[Problem]
) -> StageSettings:
    place: Place = ("stages", stage.name)
    values = {str(key): value for key, value in section.items()}
    use = values.pop("use", None)
    try:
        info = reader.read(use if isinstance(use, str) else stage.function)
    except FunctionError as error:
        problems.append(document.problem((*place, "use"), str(error), "write package.module:function, importable from here"))
        return StageSettings()
    fed = set(info.signature.parameters) if stage.pair_settings else {stage.resolution_parameter}
    for key, value in values.items():
        parameter = info.signature.parameters.get(key)
        allowed = [p for p in info.signature.parameters if p not in fed]
        if key in fed and parameter:
            remedy = f"set {key} in the section pairs" if stage.pair_settings else f"set {key} at the top of the file"
            problems.append(document.problem((*place, key), f"{key!r} is not set here", remedy, key=True))
        elif parameter is None:
            close = difflib.get_close_matches(key, allowed, 1)
            remedy = f"did you mean {close[0]!r}?" if close else f"parameters of {info.dotted}: {', '.join(allowed) or 'none'}"
            problems.append(document.problem((*place, key), f"unknown parameter {key!r}", remedy, key=True))
        elif wrong := parameter.problem(value):
            remedy = f"the default is {parameter.default!r}"
            problems.append(document.problem((*place, key), wrong, remedy))
    return StageSettings(use if isinstance(use, str) else None, values)


def _check_pairs(model: _Site, document: Document, problems: list[Problem]) -> None:
    ids = [camera.id for camera in model.cameras]
    if model.pairs.min_angle >= model.pairs.max_angle:
        remedy = "min_angle must be below max_angle, both in degrees"
        problems.append(
            document.problem(("pairs",), f"no angle is between {model.pairs.min_angle} and {model.pairs.max_angle}", remedy)
        )
    for name in ("include", "exclude"):
        for i, row in enumerate(getattr(model.pairs, name)):
            for j, camera in enumerate(row):
                if camera not in ids:
                    close = difflib.get_close_matches(camera, ids, 1)
                    remedy = f"did you mean {close[0]!r}?" if close else "use ids from 'cameras'"
                    problems.append(document.problem(("pairs", name, i, j), f"there is no camera {camera!r}", remedy))
            if row[0] == row[1]:
                problems.append(document.problem(("pairs", name, i), "a camera makes no pair with itself", "name two cameras"))
