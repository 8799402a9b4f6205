"""`wbflow demo`: a rendered site, written to a folder; it can be written again unless its site file or calibration was edited."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..cache.ply import ply_bytes
from ..errors import UsageError
from ..plugins import load

MANIFEST = "demo.json"
"""File with the digests of all others, by which a demo is known."""
EDITABLE = ("site.yaml", "cameras.json")
"""Files that people edit; they are not written over once they have."""
_FOLDER_REMEDY = "name a new or an empty folder"


def write_demo(folder: Path, *, scene: str = "yard", nights: int | None = None, **options: Any) -> None:
    """Render a demo scene, or `nights` nights of the demo yard with their events; the same arguments write the same bytes.

    scene: "yard", "square" or "carpark".  options: of `wbflow_demo.files.demo_files` (small, light, cameras, captures, seed,
    lenses, surfaces, walk) or `wbflow_demo.files.demo_nights` (frames, small, cameras, seed).  Raises UsageError if the
    folder holds something other than a demo, or a demo whose site file or calibration was edited; for an unknown scene or light,
    and for no captures.
    """
    existing = _existing_digests(folder)
    try:
        if nights is None:
            demo = load("wbflow_demo.files:demo_files")(scene, **options)
        else:
            demo = load("wbflow_demo.files:demo_nights")(nights, **options)
    except ValueError as error:
        raise UsageError(str(error), remedy="wbflow demo --help  says what there is") from error
    # an interrupted demo can be written again: the manifest is written first with the old digests, at the end with the new ones
    write_atomic(folder / MANIFEST, _json({"files": existing}))
    digests = {}
    for name, content in demo.files:
        data = content
        if not isinstance(content, bytes):  # a cloud
            data = bytes(ply_bytes(content.columns, content.comments))
        write_atomic(folder / name, data)
        digests[name] = hashlib.sha256(data).hexdigest()
    # files of the former demo that this one does not have
    for name in existing.keys() - digests.keys():
        (folder / name).unlink(missing_ok=True)
    write_atomic(folder / MANIFEST, _json({**demo.manifest, "files": digests}))


def _existing_digests(folder: Path) -> dict[str, str]:
    """Digests by name of the files of the demo that `folder` already holds.  Raises UsageError if it must not be written."""
    if not folder.exists():
        return {}
    if not folder.is_dir():
        raise UsageError(f"{folder} is a file", remedy=_FOLDER_REMEDY)
    manifest = folder / MANIFEST
    if not manifest.is_file():
        if any(folder.iterdir()):
            raise UsageError(f"{folder} contains other files", remedy=_FOLDER_REMEDY)
        return {}
    try:
        digests = {str(name): str(digest) for name, digest in json.loads(manifest.read_bytes())["files"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise UsageError(f"{manifest} was not written by wbflow demo", remedy=_FOLDER_REMEDY) from None
    for name in EDITABLE:
        file = folder / name
        if file.is_file() and name in digests and hashlib.sha256(file.read_bytes()).hexdigest() != digests[name]:
            raise UsageError(f"{file} was edited since the demo was written", remedy="move it away, or name another folder")
    return digests


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=1) + "\n").encode()
