"""The demo site on disk: captures, a site file that works as it is, and the truth beside them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..cache.ply import ply_bytes
from ..errors import UsageError
from ..pipeline.exports import DEMO_FILES, DEMO_NIGHTS
from .artifacts import function

MANIFEST = "demo.json"
EDITABLE = ("site.yaml", "cameras.json")
_ELSEWHERE = "name a new or an empty folder"


class NotADemo(UsageError):
    """A folder holds something that a demo must not overwrite."""


def write_demo(
    folder: Path,
    *,
    scene: str = "yard",
    small: bool = False,
    light: str = "day",
    cameras: int | None = None,
    captures: int | None = None,
    seed: int = 0,
    lenses: str = "standard",
    surfaces: str = "standard",
) -> None:
    """Render a demo scene into `folder`; the same arguments write the same bytes.

    Parameters
    ----------
    folder : Path
        New, empty, or holding an earlier demo.
    scene : str
        "yard", "square" or "carpark" (`wbflow_demo.scenes.SCENES`).
    small : bool
        320x180 pixels: rendered in seconds.
    light : str
        "day", "dusk", "night", or "dark" (night without lamps).
    cameras, captures : int, optional
        How many cameras, and captures of each; the scene's own where not given.
    seed : int
        Of everything that is drawn at random.
    lenses : str
        "standard", "fisheye", "brown", "mixed" or "infrared".
    surfaces : str
        "standard" or "weak".

    Raises
    ------
    NotADemo
        The folder holds something else than a demo, or a demo whose site file or calibration was edited.
    UsageError
        An unknown scene or light, or no captures.
    """
    kinds = {"light": light, "lenses": lenses, "surfaces": surfaces}
    chosen = {"small": small, "cameras": cameras, "captures": captures, "seed": seed, **kinds}
    _write(folder, lambda: function(DEMO_FILES)(scene, **chosen))


def write_nights(
    folder: Path, nights: int, *, frames: int = 3, small: bool = False, cameras: int | None = None, seed: int = 0
) -> None:
    """Render nights of the demo yard into `folder`, with what happens in them; the same arguments write the same bytes.

    Parameters
    ----------
    folder : Path
        New, empty, or holding an earlier demo.
    nights : int
        How many.
    frames : int
        Of each camera and night.
    small : bool
        320x180 pixels and 4 cameras, instead of 640x360 and 8.
    cameras : int, optional
        How many.
    seed : int
        Of everything that is drawn at random.

    Raises
    ------
    NotADemo
        As `write_demo`.
    UsageError
        Impossible numbers.
    """
    _write(folder, lambda: function(DEMO_NIGHTS)(nights, frames=frames, small=small, cameras=cameras, seed=seed))


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
