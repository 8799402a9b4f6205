"""The demo site on disk: captures, a site file that works as it is, and the truth beside them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..cache.plugins import load
from ..cache.ply import ply_bytes
from ..errors import UsageError
from ..pipeline.exports import DEMO_FILES, DEMO_NIGHTS

MANIFEST = "demo.json"
EDITABLE = ("site.yaml", "cameras.json")
_ELSEWHERE = "name a new or an empty folder"


class NotADemo(UsageError):
    """A folder holds something that a demo must not overwrite."""


def write_demo(folder: Path, *, scene: str = "yard", **options: Any) -> None:
    """Render a demo scene into a folder that is new, empty, or holds an earlier demo; the same arguments write the same bytes.

    Parameters
    ----------
    folder : Path
        Where the files go.
    scene : str
        "yard", "square" or "carpark".
    **options
        Those of `wbflow_demo.scenes.render`: small, light, cameras, captures, seed, lenses, surfaces.

    Raises
    ------
    NotADemo
        The folder holds something else than a demo, or a demo whose site file or calibration was edited.
    UsageError
        An unknown scene or light, or no captures.
    """
    _write(folder, lambda: load(DEMO_FILES)(scene, **options))


def write_nights(folder: Path, nights: int, **options: Any) -> None:
    """Render so many nights of the demo yard into a folder, with what happens in them; otherwise as `write_demo`.

    options: those of `wbflow_demo.files.demo_nights`: frames, small, cameras, seed.
    """
    _write(folder, lambda: load(DEMO_NIGHTS)(nights, **options))


def _write(folder: Path, render: Callable[[], Any]) -> None:
    known = _claim(folder)
    try:
        demo = render()
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
        raise NotADemo(f"{folder} is a file", remedy=_ELSEWHERE)
    manifest = folder / MANIFEST
    if not manifest.is_file():
        if any(folder.iterdir()):
            raise NotADemo(f"{folder} holds other files", remedy=_ELSEWHERE)
        return {}
    try:
        known = {str(name): str(digest) for name, digest in json.loads(manifest.read_bytes())["files"].items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise NotADemo(f"{manifest} isn't what a demo leaves there", remedy=_ELSEWHERE) from None
    for name in EDITABLE:
        file = folder / name
        if file.is_file() and name in known and hashlib.sha256(file.read_bytes()).hexdigest() != known[name]:
            raise NotADemo(f"{file} was edited since the demo was written", remedy="move it away, or name another folder")
    return known


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=1) + "\n").encode()
