"""What a new site begins with: a site file from a folder of photographs, a calibration from pictures of a board, a demo, units
that have systemd run it every night; and two photographs and nothing else, whose results are files that other programs read."""

from __future__ import annotations

import getpass
import hashlib
import json
import re
import sys
from collections.abc import Iterable
from mimetypes import guess_type
from pathlib import Path
from typing import Any

from ..cache.artifact import ply_bytes
from ..cache.atomic import write_atomic
from ..cache.fingerprint import load
from ..cache.untrusted import Unreadable, read_outside
from ..errors import UsageError
from ..pipeline.stages import DISPARITY, FRAMES, GEOMETRY, MATCHES, POSES, RECTIFY
from ..report import render
from ..site.load import load_site
from ..site.locations import is_name
from ..site.models import Site
from .artifacts import Run

PHOTOGRAPHS = {".jpg", ".jpeg", ".png", ".tif", ".tiff"}
"""Suffixes of files that are taken for photographs, whatever their case."""

SITE_FILE = "site.yaml"


def write_site(folder: Path) -> tuple[Path, list[str], str]:
    """Write `site.yaml` into a folder of photographs; returns the file, ids of its cameras, and which were made from other names.

    Photographs in the folder are one camera each; folders with photographs in it are one camera each, with several
    captures.  Raises UsageError where there is no such folder, a site file already, no two cameras, or both kinds of them.
    """
    file = folder / SITE_FILE
    if not folder.is_dir():
        raise UsageError(f"{folder}: there is no such folder", remedy="name the folder that holds the photographs")
    if file.exists():
        raise UsageError(f"{file} is there already", remedy="move it away if a new one is wanted")
    found = _cameras(folder)
    ids = _ids(name for name, _ in found)
    renamed = [f"{identity}: {name}" for identity, (name, _) in zip(ids, found, strict=True) if identity != name]
    cameras = dict(zip(ids, (photographs for _, photographs in found), strict=True))
    pattern = None if renamed else _pattern([name for names in cameras.values() for name in names])
    write_atomic(file, _text(_id(folder.resolve().name) or "site", cameras, pattern).encode())
    return file, ids, f"ids were made from names: {', '.join(renamed)}" if renamed else ""


def _cameras(folder: Path) -> list[tuple[str, list[str]]]:
    """Return the name of each folder of photographs, or photograph without suffix, and its photographs seen from the folder."""
    single = [(path.stem, [path.name]) for path in _photographs(folder)]
    inner = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    folders = [(path.name, names) for path in inner if (names := [f"{path.name}/{file.name}" for file in _photographs(path)])]
    if single and folders:
        what = f"{folder} holds photographs ({single[0][1][0]}) and folders of photographs ({folders[0][0]}/)"
        raise UsageError(what, remedy="keep one kind: one photograph of each camera, or one folder for each camera")
    found = single or folders
    if len(found) < 2:
        have = f"one camera only ({found[0][0]})" if found else f"no photographs ({', '.join(sorted(PHOTOGRAPHS))})"
        raise UsageError(f"{folder} holds {have}", remedy="two cameras that see the same things are needed at least")
    return found


def _photographs(folder: Path) -> list[Path]:
    files = (path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))
    return sorted(path for path in files if path.suffix.lower() in PHOTOGRAPHS)


def _id(name: str) -> str:
    """A name as an id: letters, digits, `_`, `.` and `-`, anything else becomes `-`."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.")[:90]


def _ids(names: Iterable[str]) -> list[str]:
    found: list[str] = []
    for position, name in enumerate(names, 1):
        base = identity = _id(name) or f"camera-{position}"
        number = 1
        while identity in found:
            number += 1
            identity = f"{base}-{number}"
        found.append(identity)
    return found


def _pattern(photographs: list[str]) -> str | None:
    """Return a pattern that finds exactly each camera's photographs, where there is one."""
    suffixes = {Path(name).suffix for name in photographs}
    inside = "/*" if "/" in photographs[0] else ""
    return f"{{camera}}{inside}{suffixes.pop()}" if len(suffixes) == 1 else None


def _text(site: str, cameras: dict[str, list[str]], pattern: str | None) -> str:
    listed = f" [{', '.join(map(json.dumps, cameras))}]"
    if pattern is None:
        files = {name: json.dumps(photographs, ensure_ascii=False) for name, photographs in cameras.items()}
        listed = "".join(f"\n  - {{id: {json.dumps(name)}, images: {images}}}" for name, images in files.items())
    elif len(listed) > 112:
        listed = "".join(f"\n  - {json.dumps(name)}" for name in cameras)
    return _SITE.format(site=json.dumps(site), pattern=json.dumps(pattern or "{camera}"), cameras=listed)


_SITE = """\
# Made by `wbflow init`.  Try:  wbflow check .   wbflow run .   wbflow status .
site: {site}
captures: {{root: ., pattern: {pattern}}}
cameras:{cameras}
# Known intrinsics and poses make the cloud metric and more complete (a JSON file, or a COLMAP text model):
# calibration: cameras.json
# Long side in pixels that stages work at:
resolution: 1600
"""

FILES = "wbflow_stages.board:board_files"
MOST_BYTES = 1_000_000_000


def write_calibration(
    camera: str, pictures: Path, board: dict[str, float | str], model: str, out: Path
) -> tuple[list[Path], list[str]]:
    """Write the calibration of a camera and the plot of its coverage; which files, and what to say.

    Raises UsageError where there are no pictures, or they do not show the board well enough.

    Parameters
    ----------
    camera, model : str, str
        Its id, and the model of its lens.
    pictures : Path
        A folder of photographs, or a video.
    board : dict
        The board's fields by name.
    out : Path
        The folder for the files.
    """
    if not is_name(camera):
        raise UsageError(f"{camera!r} is not a camera id", remedy="use letters, digits, '_', '.', '-'")
    files = sorted(file for file in pictures.iterdir() if file.is_file()) if pictures.is_dir() else [pictures]
    try:
        data = {file.name: read_outside(file, MOST_BYTES) for file in files}
    except Unreadable as error:
        raise UsageError(f"{pictures}: {error.what}", remedy="name a folder of photographs, or a video") from None
    try:
        made, words = load(FILES)(camera, data, board, model)
    except ValueError as error:
        remedy = "5 sharp pictures and more, with the board near, far, turned, and in every corner of the picture"
        raise UsageError(f"{pictures}: {error}", remedy=remedy) from None
    for name, content in made.items():
        write_atomic(out / name, content)
    return [out / name for name in made], words


MANIFEST = "demo.json"
EDITABLE = ("site.yaml", "cameras.json")
_ELSEWHERE = "name a new or an empty folder"


def write_demo(folder: Path, *, scene: str = "yard", nights: int | None = None, **options: Any) -> None:
    """Render a demo scene, or so many nights of the demo yard with what happens in them; the same arguments write the same bytes.

    scene: "yard", "square" or "carpark".  options: those of `wbflow_demo.scenes.render` (small, light, cameras, captures, seed,
    lenses, surfaces), or of `wbflow_demo.files.demo_nights` (frames, small, cameras, seed).  Raises UsageError where the folder
    holds something else than a demo, or a demo whose site file or calibration was edited; for an unknown scene or light, and for
    no captures.
    """
    known = _claim(folder)
    try:
        files = "wbflow_demo.files:demo_files" if nights is None else "wbflow_demo.files:demo_nights"
        demo = load(files)(scene if nights is None else nights, **options)
    except ValueError as error:
        raise UsageError(str(error), remedy="wbflow demo --help  says what there is") from error
    # an interrupted demo can be written again: the manifest comes first, its digests last
    write_atomic(folder / MANIFEST, _json({"files": known}))
    digests = {}
    for name, content in demo.files:
        data = content if isinstance(content, bytes) else bytes(ply_bytes(content.columns, content.comments))
        write_atomic(folder / name, data)
        digests[name] = hashlib.sha256(data).hexdigest()
    for name in known.keys() - digests.keys():
        (folder / name).unlink(missing_ok=True)
    write_atomic(folder / MANIFEST, _json({**demo.manifest, "files": digests}))


def _claim(folder: Path) -> dict[str, str]:
    """The files, with digests, of the demo that `folder` holds already."""
    if not folder.exists():
        return {}
    if not folder.is_dir():
        raise UsageError(f"{folder} is a file", remedy=_ELSEWHERE)
    manifest = folder / MANIFEST
    if not manifest.is_file():
        if any(folder.iterdir()):
            raise UsageError(f"{folder} holds other files", remedy=_ELSEWHERE)
        return {}
    try:
        known = {str(name): str(digest) for name, digest in json.loads(manifest.read_bytes())["files"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise UsageError(f"{manifest} isn't what a demo leaves there", remedy=_ELSEWHERE) from None
    for name in EDITABLE:
        file = folder / name
        if file.is_file() and name in known and hashlib.sha256(file.read_bytes()).hexdigest() != known[name]:
            raise UsageError(f"{file} was edited since the demo was written", remedy="move it away, or name another folder")
    return known


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=1) + "\n").encode()


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
    """Write a service and a timer beside the site file; returns them.  Raises OSError."""
    captures = any(entry.url for entry in site.settings.cameras)
    file = '"' + str(site.file.resolve()).replace("%", "%%").replace('"', '\\"') + '"'
    filled = {"name": site.name, "user": getpass.getuser(), "python": sys.executable, "file": file}
    units = {"service": _SERVICE.format(**filled, capture=" --capture" if captures else ""), "timer": _TIMER.format(**filled)}
    paths = [site.folder / f"wbflow-{site.name}.{kind}" for kind in units]
    for path, text in zip(paths, units.values(), strict=True):
        write_atomic(path, text.encode())
    return paths


PAIR = ("left", "right")

LAST_STAGE = DISPARITY
"""Where a run of a pair ends."""


def pair_site(left: Path, right: Path, out: Path, resolution: int | None) -> Site:
    """A site of the two photographs, written to out/site.yaml (from where it can be taken further).

    Raises UsageError where a photograph is not there.

    Parameters
    ----------
    left, right, out : Path
        The photographs, and the folder for the results.
    resolution : int, optional
        Long side in pixels to work at.
    """
    for path in (left, right):
        if not path.is_file():
            raise UsageError(f"{path}: there is no such file", remedy="wbflow pair LEFT.jpg RIGHT.jpg --out DIR")
    cameras = [{"id": name, "images": [str(path.resolve())]} for name, path in zip(PAIR, (left, right), strict=True)]
    description = {
        "site": "pair",
        "captures": {"root": ".", "pattern": "{camera}"},
        "cameras": cameras,
        "resolution": resolution,
        "pairs": {"min_angle": 0.0, "max_angle": 180.0, "include": [list(PAIR)]},
        "stages": {POSES: False},
        "work": "work",
    }
    write_atomic(out / "site.yaml", json.dumps(description, indent=1).encode())
    return load_site(out)


def write_pair(run: Run, out: Path) -> tuple[Path, ...]:
    """Write what a run of a pair's site made into `out`.  Raises Gone, DamagedArtifact."""
    left, right = (run.made(FRAMES, (name,)) for name in PAIR)
    stages = {"matches": MATCHES, "geometry": GEOMETRY, "rectification": RECTIFY, "disparity": DISPARITY}
    results = {name: run.made(stage, PAIR) for name, stage in stages.items()}
    if left is None or right is None or next(iter(results.values())) is None:
        return ()
    made, summary = load("wbflow_stages.exports.pairfiles:pair_files")(left, right, **results)
    figures = run.record.pairs[0].to_json() | summary
    pictures = [(name, name[2:].rpartition(".")[0]) for name in made if guess_type(name)[0] == "image/jpeg"]
    rows = [(name.replace("_", " "), value) for name, value in figures.items() if isinstance(value, str | int | float)]
    others = sorted({*made} - {name for name, _ in pictures})
    made["index.html"] = render("pair.html", pictures=pictures, rows=rows, others=others).encode()
    made["pair.json"] = json.dumps(figures, indent=1).encode()
    for name, data in made.items():
        write_atomic(out / name, data)
    return tuple(out / name for name in made)


def failure(run: Run) -> str | None:
    """Why there is no disparity, if there is none."""
    ended = (event for event in run.ended.values() if event.outcome in {"failed", "rejected"})
    return next((f"{event.task} {event.outcome}: {event.reason}" for event in ended), None)
