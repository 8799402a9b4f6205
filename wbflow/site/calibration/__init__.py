"""Calibrations read from wbflow's own JSON and the files of many other programs, and from folders with one file per camera.

All give cameras by image or camera name.  Every key of a file is used, known to say nothing about lens or pose, or refused.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...cache.untrusted import is_file, is_folder
from ...errors import Location
from ..yaml_document import Document, Problem, SiteError, parse_yaml, read_text
from .calibrated import REMEDY, Calibrated, Faulty
from .camera_entry import is_camera, read_camera
from .colmap import is_colmap, read_colmap
from .entry import IRRELEVANT, Entry, plain
from .kalibr import is_chain, read_chain
from .metashape import is_metashape, read_metashape
from .nerf import is_splatting, is_transforms, read_splatting, read_transforms
from .pix4d import is_pix4d, read_pix4d
from .stereo import is_stereo, read_stereo
from .values import text_of
from .xml_tree import parse_xml, storage_data

_SUFFIXES = {".yaml", ".yml", ".json", ".xml"}
"""Suffixes of the files in a folder with one calibration file per camera."""
_COLMAP_NAMES = {"cameras.txt", "images.txt", "cameras.bin", "images.bin"}
_NAME_KEYS = ("name", "id", "camera", "camera_name", "camera_id", "img_name", "image_name", "file_name", "label")
"""Keys for the name of a camera in a list of cameras."""
_PROGRAM_WORDS = re.compile(r"^(camchain|calib|calibration|intrinsics)[-_.]|[-_.](camchain|calib|calibration|intrinsics)$")
"""What programs put before or after the name of a camera in the names of their files: `gate-camchain.yaml`."""
_OWN_REMEDY = "give K (3x3), width, height and, where known, R (3x3) and C (3 numbers): x ~ K R (X - C); see sites/README.md"


def read_calibration(path: Path) -> dict[str, Calibrated]:
    """Cameras by name, from a file, a COLMAP model (a folder), or a folder with one file per camera.

    Raises SiteError for missing or unreadable files, and for entries that are incomplete, ambiguous or not understood.
    """
    if is_folder(path):
        return _read_folder(path)
    if path.name in _COLMAP_NAMES:
        return read_colmap(path.parent)
    # the content decides, as programs and people give files any name
    text = read_text(path)
    if is_pix4d(text):
        try:
            return read_pix4d(text)
        except Faulty as fault:
            raise SiteError(Problem(path, fault.what, fault.remedy, _line_of(fault))) from None
    if text.lstrip().startswith("<"):
        return _read_xml(path, text)
    if path.suffix.lower() == ".json" or text.lstrip().startswith(("{", "[")):
        return _read_json(path, text)
    document = _parse_document(path, text)
    try:
        return _cameras_in(document.data, path.stem)
    except Faulty as fault:
        raise SiteError(Problem(path, fault.what, fault.remedy, *document.place(fault.location))) from None


def find_cameras(cameras: Mapping[str, Calibrated], camera: str) -> dict[str, Calibrated]:
    """The entries, by name, that may be a camera id's; one, unless the calibration has several that cannot be told apart.

    The name equals the id; else the file name does, with or without extension; else one of the folders in the name does.
    """
    if camera in cameras:
        return {camera: cameras[camera]}
    # names are often paths: `gate/0001.jpg` may be of camera `0001` or `gate`
    by_file: dict[str, Calibrated] = {}
    by_folder: dict[str, Calibrated] = {}
    for name, entry in cameras.items():
        path = Path(name)
        if camera in {path.stem, path.name}:
            by_file[name] = entry
        elif camera in path.parent.parts and not by_folder:
            by_folder[name] = entry  # pictures in one folder are of one camera
    found = by_file or by_folder
    first = next(iter(found.values()), None)
    return {name: entry for name, entry in found.items() if entry is first or entry != first}


def only_camera(cameras: Mapping[str, Calibrated]) -> Calibrated | None:
    """The camera of a calibration that holds one only, under whatever names; None if it holds several."""
    distinct = {id(entry): entry for entry in cameras.values()}
    if len(distinct) != 1:
        return None
    return next(iter(distinct.values()))


def _read_folder(folder: Path) -> dict[str, Calibrated]:
    """The cameras of a COLMAP model, or of a folder with one file per camera.  Raises SiteError."""
    if is_colmap(folder):
        return read_colmap(folder)
    files = []
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() in _SUFFIXES and not file.name.startswith(".") and is_file(file):
            files.append(file)
    if not files:
        return read_colmap(folder)  # it reports what is missing
    cameras: dict[str, Calibrated] = {}
    file_of: dict[str, Path] = {}
    for file in files:
        entries = read_calibration(file)
        camera = only_camera(entries)
        if camera is not None:
            # a file with one camera has the camera's name; a name inside it comes from the calibration program
            entries = dict.fromkeys((file.stem, _PROGRAM_WORDS.sub("", file.stem) or file.stem), camera)
        for name, entry in entries.items():
            if name in cameras:
                what = f"holds a camera {name!r}, and so does {file_of[name].name}: which is which is not stated"
                raise SiteError(Problem(file, what, "keep one of the files, or name each camera's file in cameras: calibration"))
            cameras[name] = entry
            file_of[name] = file
    return cameras


def _read_json(path: Path, text: str) -> dict[str, Calibrated]:
    """The cameras of a JSON file.  Raises SiteError."""
    try:
        data = json.loads(text, object_pairs_hook=_without_repeats)
        return _cameras_in(data, path.stem)
    except json.JSONDecodeError as error:
        raise SiteError(Problem(path, f"not JSON: {error.msg}", _OWN_REMEDY, error.lineno, error.colno)) from None
    except Faulty as fault:
        raise SiteError(_problem_in_json(path, text, fault)) from None
    except (ValueError, RecursionError):  # numbers of thousands of digits, brackets within brackets
        raise SiteError(Problem(path, "not JSON that can be read", _OWN_REMEDY)) from None


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The mapping of an object in JSON.  Raises Faulty if it has a key twice, of which Python would ignore the first."""
    data = dict(pairs)
    if len(data) < len(pairs):
        keys = [key for key, _ in pairs]
        repeated = next(key for key in keys if keys.count(key) > 1)
        raise Faulty(f"the key {repeated!r} is there twice", (), "keep one of them")
    return data


def _problem_in_json(path: Path, text: str, fault: Faulty) -> Problem:
    """The problem, with line and column if these can be found by parsing the JSON as YAML (nearly a superset)."""
    try:
        place = parse_yaml(text, path).place(fault.location)
    except SiteError:
        place = 0, 0
    return Problem(path, fault.what, fault.remedy, *place)


def _read_xml(path: Path, text: str) -> dict[str, Calibrated]:
    """The cameras of an XML file, of Metashape or OpenCV.  Raises SiteError."""
    try:
        root = parse_xml(text)
        if is_metashape(root):
            return read_metashape(root)
        if root.tag != "opencv_storage":
            what = f"is XML of an unknown kind (<{root.tag}>): neither OpenCV's storage nor Metashape's cameras"
            raise Faulty(what, (root.line,))
    except Faulty as fault:
        raise SiteError(Problem(path, fault.what, fault.remedy, _line_of(fault))) from None
    try:
        return _cameras_in(storage_data(root), path.stem)
    except Faulty as fault:
        raise SiteError(Problem(path, fault.what, fault.remedy, _line_of_key(root, fault.location))) from None


def _line_of(fault: Faulty) -> int:
    """The line of a fault whose location is a line; 0 if it has none."""
    for step in fault.location:
        if isinstance(step, int):
            return step
    return 0


def _line_of_key(root: Any, location: Location) -> int:
    """The line of the element that a location in OpenCV's storage leads to, or of the nearest one around it."""
    element = root
    for step in location:
        if isinstance(step, int) and step < len(element.children):
            inner = element.children[step]
        else:
            inner = element.find(str(step))
        if inner is None:
            break
        element = inner
    return int(element.line)


def _parse_document(path: Path, text: str) -> Document:
    """A YAML file, without OpenCV's own first line and tags, which YAML parsers reject.  Raises SiteError."""
    text = re.sub(r"\A%YAML[:\s]\s*1\.[0-9]+[^\n]*", "# YAML", text)  # the line stays, for the locations of errors
    text = re.sub(r"!!opencv-[\w-]+", "", text)
    text = re.sub(r"\n---\s*\Z", "\n", text)  # `ros2 topic echo` ends each message with it
    try:
        return parse_yaml(text, path)
    except SiteError as error:
        raise SiteError(replace(error.problems[0], remedy=REMEDY)) from None


def _cameras_in(data: Any, stem: str) -> dict[str, Calibrated]:
    """The cameras of a file's data, whichever program wrote it.  Raises Faulty.

    stem: the file's name, which a file of one camera gives to it.
    """
    if isinstance(data, list):
        return _listed_cameras(data, ())
    if not isinstance(data, dict):
        raise Faulty("must map image names to K, width and height; or be what a program for calibration wrote", (), _OWN_REMEDY)
    # from the most particular layout to the most general one
    if is_transforms(data):
        return read_transforms(data)
    if is_chain(data):
        return read_chain(data)
    if is_chain({stem: data}) and "resolution" in data:
        return read_chain({stem: data})  # one camera of a chain, without its name
    if is_camera(data):
        entry = Entry(data)
        return {text_of(entry.value("camera_name")) or stem: read_camera(entry, needs_distortion=True)}
    if is_stereo(data):
        return read_stereo(data)
    cameras = data.get("cameras")
    if isinstance(cameras, list | dict) and not is_camera(cameras):
        _refuse_other_values({key: value for key, value in data.items() if key != "cameras"}, ())
        if isinstance(cameras, list):
            return _listed_cameras(cameras, ("cameras",))
        return _named_cameras(cameras, ("cameras",))
    return _named_cameras(data, ())


def _listed_cameras(entries: list[Any], location: Location) -> dict[str, Calibrated]:
    """The cameras of a list, in which each has its name or number under a key."""
    if is_splatting(entries):
        return read_splatting(entries)
    cameras: dict[str, Calibrated] = {}
    for number, data in enumerate(entries):
        place = (*location, number)
        if not isinstance(data, dict) or not is_camera(data):
            raise Faulty(f"{_dotted(place)} must hold a name, K, width and height", place, _OWN_REMEDY)
        entry = Entry(data, place, _dotted(place))
        name = _stated_name(data)
        if not name or name in cameras:
            remedy = "give each camera its id, as in the site file: name: gate"
            raise Faulty(f"{_dotted(place)} has {'the name of another' if name else 'no name'}", place, remedy)
        entry.ignore(*_NAME_KEYS)
        cameras[name] = read_camera(entry)
    if not cameras:
        raise Faulty("holds no camera; must map image names to K, width and height", location, _OWN_REMEDY)
    return cameras


def _stated_name(data: dict[str, Any]) -> str:
    """The name or number of a camera in a list; "" if it has none."""
    for key in _NAME_KEYS:
        if isinstance(data.get(key), str | int) and str(data[key]):
            return str(data[key])
    return ""


def _named_cameras(entries: dict[str, Any], location: Location) -> dict[str, Calibrated]:
    """The cameras of a mapping from names."""
    mappings: dict[str, dict[str, Any]] = {}
    others: dict[str, Any] = {}
    for name, value in entries.items():
        if isinstance(value, dict):
            mappings[str(name)] = value
        else:
            others[str(name)] = value
    if entries and not any(is_camera(value) for value in mappings.values()) and not _may_be_cameras(mappings):
        what = "holds no calibration: no camera matrix (K, camera_matrix), and no layout of a program that is known"
        raise Faulty(what, location, _OWN_REMEDY)
    _refuse_other_values(others, location)
    return {name: read_camera(Entry(value, (*location, name), name)) for name, value in mappings.items()}


def _may_be_cameras(mappings: dict[str, Any]) -> bool:
    """Are these cameras that lack their matrix: does each have the size of its pictures?"""
    return bool(mappings) and all(Entry(value).has("width", "image_width", "image_size") for value in mappings.values())


def _refuse_other_values(values: dict[str, Any], location: Location) -> None:
    """Refuse what stands among the cameras of a file and is none, unless it is known to say nothing about them."""
    for name, value in values.items():
        if plain(name) not in IRRELEVANT or isinstance(value, dict):
            raise Faulty(f"{name} must hold K, width and height", (*location, name), _OWN_REMEDY)


def _dotted(location: Location) -> str:
    """What a message calls a camera of a list: cameras.3, or number 3."""
    if len(location) > 1:
        return ".".join(map(str, location))
    return f"number {location[0]}"
