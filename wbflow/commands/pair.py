"""`wbflow pair`: make a site of two photographs and nothing else, and write its results as files that other programs read."""

from __future__ import annotations

import json
from mimetypes import guess_type
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..errors import UsageError
from ..pipeline.stages import DISPARITY, FRAMES, GEOMETRY, MATCHES, POSES, RECTIFY
from ..plugins import load
from ..records.finished_run import Run
from ..report import render
from ..site.load import load_site
from ..site.models import Site
from ..task import Task

PAIR = ("left", "right")
"""Ids of the two cameras."""
LAST_STAGE = DISPARITY
"""The stage at which a pair's run ends."""


def pair_site(left: Path, right: Path, out: Path, resolution: int | None) -> Site:
    """A site of the two photographs, written to out/site.yaml (which can be extended to a larger site).

    Raises UsageError if a photograph is not there.

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
    cameras = []
    for name, path in zip(PAIR, (left, right), strict=True):
        cameras.append({"id": name, "images": [str(path.resolve())]})
    description = {
        "site": "pair",
        "captures": {"root": ".", "pattern": "{camera}"},
        "cameras": cameras,
        "resolution": resolution,
        # the user has chosen the pair: it is matched whatever the angle between its views
        "pairs": {"min_angle": 0.0, "max_angle": 180.0, "include": [list(PAIR)]},
        # one pair determines no scale, and the results of this command need no poses
        "stages": {POSES: False},
        "work": "work",
    }
    write_atomic(out / "site.yaml", json.dumps(description, indent=1).encode())
    return load_site(out)


def write_pair(run: Run, out: Path) -> tuple[Path, ...]:
    """Write the results of a pair's run into `out`; returns the files, if any.  Raises WbflowError, DamagedArtifact."""
    left = run.load(Task(FRAMES, ("left",)))
    right = run.load(Task(FRAMES, ("right",)))
    matches = run.load(Task(MATCHES, PAIR))
    if left is None or right is None or matches is None:
        return ()
    # 1. the results as files; later stages may have made nothing
    files, summary = load("wbflow_stages.exports.pairfiles:pair_files")(
        left,
        right,
        matches=matches,
        geometry=run.load(Task(GEOMETRY, PAIR)),
        rectification=run.load(Task(RECTIFY, PAIR)),
        disparity=run.load(Task(DISPARITY, PAIR)),
    )
    figures = run.record.pairs[0].to_json() | summary
    # 2. a page of the pictures and figures, with links to the other files
    pictures: list[tuple[str, str]] = []
    others: list[str] = []
    for name in files:
        if guess_type(name)[0] == "image/jpeg":
            title = name[2:].rpartition(".")[0]  # without the number that orders the pictures
            pictures.append((name, title))
        else:
            others.append(name)
    rows: list[tuple[str, Any]] = []
    for name, value in figures.items():
        if isinstance(value, str | int | float):
            rows.append((name.replace("_", " "), value))
    files["index.html"] = render("pair.html", pictures=pictures, rows=rows, others=sorted(others)).encode()
    files["pair.json"] = json.dumps(figures, indent=1).encode()
    for name, data in files.items():
        write_atomic(out / name, data)
    return tuple(out / name for name in files)


def failure(run: Run) -> str | None:
    """Why there is no disparity, if there is none."""
    for event in run.task_events.values():
        if event.outcome in {"failed", "rejected"}:
            return f"{event.task} {event.outcome}: {event.reason}"
    return None
