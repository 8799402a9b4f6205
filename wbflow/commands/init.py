"""Files for a new site: a site file from a folder of photographs (`wbflow init`), systemd units that run it every night, and the
calibration of a lens from pictures of a board (`wbflow calibrate`)."""

from __future__ import annotations

import getpass
import itertools
import json
import shlex
import sys
from pathlib import Path

from wbflow_stages.contracts.defaults import RESOLUTION

from ..cache.atomic import write_atomic
from ..cache.untrusted import Unreadable, is_nobodys, read_untrusted
from ..errors import UsageError
from ..plugins import load
from ..site.ids import as_id, unique_ids
from ..site.models import Site
from ..site.yaml_document import is_name

PHOTOGRAPHS = {".jpg", ".jpeg", ".png", ".tif", ".tiff"}
"""Suffixes of photographs in lower case; the case of a file's suffix is ignored."""

SITE_FILE = "site.yaml"
"""Name of the file that is written."""
_LONGEST_LIST = 112
"""Characters up to which all ids are written on one line."""


def write_site(folder: Path, out: Path | None = None) -> tuple[Path, list[str], str]:
    """Write `site.yaml` for a folder of photographs; returns it, its camera ids, and a note on ids that differ from names.

    Each photograph in the folder is a camera; or each folder in it that holds photographs is a camera with several captures.
    Raises UsageError if there is no such folder, a site file already, fewer than two cameras, or both kinds of them, or if the
    site file cannot be written.

    out: the folder for the site file; None: that of the photographs.
    """
    file = (out or folder) / SITE_FILE
    if not folder.is_dir():
        raise UsageError(f"{folder}: there is no such folder", remedy="name the folder that holds the photographs")
    if file.exists():
        raise UsageError(f"{file} is there already", remedy="move it away to have a new one written")
    try:
        photographs_by_name = _cameras(folder)
    except OSError as error:
        what = f"{error.filename} cannot be read: {error.strerror}"
        raise UsageError(what, remedy="give the user who runs wbflow the right to read it") from None
    ids = unique_ids(name for name, _ in photographs_by_name)
    cameras: dict[str, list[str]] = {}
    renamed: list[str] = []
    for identity, (name, photographs) in zip(ids, photographs_by_name, strict=True):
        cameras[identity] = photographs
        if identity != name:
            renamed.append(f"{identity}: {name}")
    pattern = None
    note = f"ids were made from names: {', '.join(renamed)}"
    if not renamed:  # a pattern finds files by the id, so cameras whose names are no ids have their files listed
        pattern = _pattern(cameras)
        note = ""
    site_name = as_id(file.parent.resolve().name) or "site"
    root = "."
    if out is not None and out.resolve() != folder.resolve():
        root = str(folder.resolve())
    text = _site_text(site_name, root, cameras, pattern)
    try:
        write_atomic(file, text.encode())
    except OSError as error:
        remedy = f"write the site file elsewhere, where its results go as well: wbflow init {shlex.quote(str(folder))} --out DIR"
        raise UsageError(f"{file.parent} cannot be written: {error.strerror}", remedy=remedy) from None
    return file, ids, note


def _cameras(folder: Path) -> list[tuple[str, list[str]]]:
    """Return each camera's name (of its folder, or of its photograph without suffix) and photographs, relative to `folder`."""
    # 1. cameras with one photograph each, and folders of cameras with several
    single = [(path.stem, [path.name]) for path in _photographs(folder)]
    folders: list[tuple[str, list[str]]] = []
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not is_nobodys(path.name):
            names = [f"{path.name}/{file.name}" for file in _photographs(path)]
            if names:
                folders.append((path.name, names))
    # 2. exactly one of these, with two cameras or more
    if single and folders:
        what = f"{folder} holds photographs ({single[0][1][0]}) and folders of photographs ({folders[0][0]}/)"
        raise UsageError(what, remedy="keep one kind: one photograph of each camera, or one folder for each camera")
    cameras = single or folders
    if len(cameras) < 2:
        contents = f"no photographs ({', '.join(sorted(PHOTOGRAPHS))})"
        if cameras:
            contents = f"one camera only ({cameras[0][0]})"
        remedy = "two cameras that see the same things are the least"
        deeper = _deeper_photograph(folder)
        if not cameras and deeper:
            contents = f"photographs in folders within its folders ({deeper}), which init does not look into"
            remedy = "write a site file with captures.pattern, such as '{camera}/**/*.jpg'; see sites/README.md"
        raise UsageError(f"{folder} holds {contents}", remedy=remedy)
    return cameras


def _deeper_photograph(folder: Path) -> str:
    """The first photograph in the folders within a folder's folders, relative to it; "" if there is none."""
    for path in folder.glob("*/*/**/*"):
        if path.suffix.lower() in PHOTOGRAPHS and not any(map(is_nobodys, path.relative_to(folder).parts)):
            return str(path.relative_to(folder))
    return ""


def _photographs(folder: Path) -> list[Path]:
    """The photographs in a folder, by name; thumbnails of disks, and hidden files, are none."""
    found: list[Path] = []
    for path in sorted(folder.iterdir()):
        if path.is_file() and path.suffix.lower() in PHOTOGRAPHS and not is_nobodys(path.name):
            found.append(path)
    return found


def _pattern(cameras: dict[str, list[str]]) -> str | None:
    """Return a pattern that finds exactly each camera's photographs, or None if their suffixes differ by more than case."""
    names = list(itertools.chain.from_iterable(cameras.values()))
    suffixes = {Path(name).suffix.lower() for name in names}
    if len(suffixes) > 1:
        return None
    in_folders = "/" in names[0]
    stem = "{camera}/*" if in_folders else "{camera}"
    return stem + Path(names[0]).suffix


def _site_text(site: str, root: str, cameras: dict[str, list[str]], pattern: str | None) -> str:
    """Return the text of a site file.

    Parameters
    ----------
    site, root : str, str
        Name of the site, and the folder of photographs as the site file names it.
    cameras : dict
        Photographs by camera id.
    pattern : str, optional
        Finds the photographs; None if they must be listed.
    """
    lines: list[str] = []
    for name, photographs in cameras.items():
        entry = json.dumps(name)  # JSON is YAML, so quotes protect what YAML would read as a number or a date
        if pattern is None:
            images = json.dumps(photographs, ensure_ascii=False)
            entry = f"{{id: {entry}, images: {images}}}"
        lines.append(f"\n  - {entry}")
    camera_list = f" [{', '.join(map(json.dumps, cameras))}]"
    if pattern is None or len(camera_list) > _LONGEST_LIST:
        camera_list = "".join(lines)
    return _SITE.format(
        site=json.dumps(site),
        root=root if root == "." else json.dumps(root, ensure_ascii=False),
        pattern=json.dumps(pattern or "{camera}"),
        cameras=camera_list,
        resolution=RESOLUTION,
    )


_SITE = """\
# Made by `wbflow init`.  Try:  wbflow check .   wbflow run .   wbflow status .
site: {site}
captures: {{root: {root}, pattern: {pattern}}}
cameras:{cameras}
# Known intrinsics and poses make the cloud metric and more complete (a JSON file, or a COLMAP text model):
# calibration: cameras.json
# Long side in pixels that stages work at:
resolution: {resolution}
"""


def write_calibration(
    camera: str, pictures: Path, board: dict[str, float | str], model: str, out: Path
) -> tuple[list[Path], list[str]]:
    """Write the calibration of a camera and the plot of its coverage; returns the files, and lines to print.

    Raises UsageError if there are no pictures, or they do not show the board well enough.

    Parameters
    ----------
    camera, model : str, str
        The id of the camera, and the model of its lens.
    pictures : Path
        A folder of photographs, or a video.
    board : dict
        The board's fields by name.
    out : Path
        The folder for the files.
    """
    if not is_name(camera):
        raise UsageError(f"{camera!r} is not a camera id", remedy="use letters, digits, '_', '.', '-'")
    files = [pictures]
    if pictures.is_dir():
        files = sorted(file for file in pictures.iterdir() if file.is_file() and not is_nobodys(file.name))
    # names and bytes: the vision decides what is a picture, a video, or neither
    try:
        data = {file.name: read_untrusted(file) for file in files}
    except Unreadable as error:
        raise UsageError(f"{pictures}: {error.what}", remedy="name a folder of photographs, or a video") from None
    try:
        contents, lines = load("wbflow_stages.board:board_files")(camera, data, board, model)
    except ValueError as error:
        remedy = "5 sharp pictures and more, with the board near, far, turned, and in every corner of the picture"
        raise UsageError(f"{pictures}: {error}", remedy=remedy) from None
    for name, content in contents.items():
        write_atomic(out / name, content)
    return [out / name for name in contents], lines


_SERVICE = """\
[Unit]
Description=wbflow: the night's work of {name}
Wants=network-online.target
After=network-online.target
# OnFailure=mail@%n.service     is also started after a degraded night (exit code 3); SuccessExitStatus=3 below prevents that

[Service]
Type=oneshot
User={user}
ExecStart={python} -m wbflow run {file} -q{capture} --stop-at 06:00
TimeoutStartSec=6h
# the run ends its workers itself, and keeps what is finished
KillMode=mixed
Nice=10
NoNewPrivileges=yes
PrivateTmp=yes
ProtectSystem=full
"""

_TIMER = """\
[Unit]
Description=wbflow: {name} every night

[Timer]
OnCalendar=*-*-* 03:30:00
# a machine that slept works through the night when it wakes
Persistent=true

[Install]
WantedBy=timers.target
"""


def write_units(site: Site) -> list[Path]:
    """Write a systemd service and a timer beside the site file; returns their paths.  Raises UsageError."""
    has_urls = any(entry.url for entry in site.settings.cameras)
    # systemd replaces % by its own names, and takes what is in quotes as one word
    file = '"' + str(site.file.resolve()).replace("%", "%%").replace('"', '\\"') + '"'
    service = _SERVICE.format(
        name=site.name,
        user=getpass.getuser(),
        python=sys.executable,
        file=file,
        capture=" --capture" if has_urls else "",
    )
    units = {"service": service, "timer": _TIMER.format(name=site.name)}
    paths = []
    for kind, text in units.items():
        path = site.folder / f"wbflow-{site.name}.{kind}"
        try:
            write_atomic(path, text.encode())
        except OSError as error:
            what = f"{site.folder} cannot be written: {error.strerror}"
            remedy = "run this as a user who may write there, or keep the site file in another folder"
            raise UsageError(what, remedy=remedy) from None
        paths.append(path)
    return paths
