"""Observations from recordings (`wbflow observe SITE.yaml RECORDINGS...`): tables beside the site file, and pictures of them."""

from __future__ import annotations

import math
import mimetypes
import os
from codecs import BOM_UTF8
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..cache.layout import picture_name
from ..cache.untrusted import MOST_CAPTURE_BYTES, Unreadable, is_file, is_folder, is_nobodys, open_untrusted
from ..edit.splice import NotEditable, put
from ..errors import UsageError
from ..pipeline.stages import SITE_TYPES
from ..plugins import load
from ..runner.spec import Value
from ..runner.worker import from_plain
from ..site.csv_table import read_csv
from ..site.load import site_of
from ..site.models import Site, stated_fields
from ..site.yaml_document import Problem, SiteError, parse_yaml, read_text, suggest
from ..words import counted, printable

OBSERVE = "wbflow_stages.recordings:observe_recordings"
"""The function that finds things in recordings."""
OBSERVATIONS = "observations.csv"
SURVEY = "survey.csv"
"""Names of the tables that are written beside the site file."""
_TIMES = {"camera": ("camera", "cam"), "frame": ("frame", "frame_index"), "time": ("seconds", "time", "timestamp", "frame_time")}
_TIMES_REMEDY = "the columns are camera, frame (from 0) and seconds"
_MOST_FRAMES = 10_000_000
"""More frames are no recording that anybody makes."""


def recordings_of(site: Site, named: Sequence[str]) -> dict[str, Path]:
    """The recording of each camera, in the order of the site: files named after their camera, folders of such, or CAMERA=FILE.

    Raises UsageError if a file belongs to no camera or is not there, or if fewer than two cameras have one.
    """
    ids = [camera.id for camera in site.cameras]
    found: dict[str, Path] = {}
    for text in named:
        camera, equals, file = text.partition("=")
        if equals and not Path(text).exists():
            if camera not in ids:
                raise UsageError(f"there is no camera {camera!r}", remedy=suggest(camera, ids, f"there are {', '.join(ids)}"))
            _add(found, camera, Path(file))
        elif is_folder(Path(text)):
            for path in _videos_in(Path(text), ids):
                _add(found, path.stem, path)
        else:
            path = Path(text)
            if path.stem not in ids:
                remedy = f"{suggest(path.stem, ids, 'name it after its camera')}; or say which it is: CAMERA={text}"
                raise UsageError(f"{text}: there is no camera {path.stem!r}", remedy=remedy)
            _add(found, path.stem, path)
    if len(found) < 2:
        have = ", ".join(found) or "none"
        remedy = "give one of each camera, all of the same time, named after it (gate.mp4), or as CAMERA=FILE, or their folder"
        raise UsageError(f"recordings of two cameras or more are needed; there are those of {have}", remedy=remedy)
    return {camera: found[camera] for camera in ids if camera in found}


def _add(found: dict[str, Path], camera: str, path: Path) -> None:
    if not is_file(path):
        raise UsageError(f"there is no file {path}", remedy="give a recording: a video")
    if camera in found:
        raise UsageError(f"{camera} has two recordings, {found[camera]} and {path}", remedy="give one of each camera")
    found[camera] = path


def _videos_in(folder: Path, ids: Iterable[str]) -> list[Path]:
    """The files in a folder that are named after cameras, without tables and texts beside them."""
    known = set(ids)
    files = []
    for path in sorted(folder.iterdir()):
        # recorders give videos any suffix, and tables and pictures of the same camera may lie beside them
        kind = mimetypes.guess_type(path.name)[0] or ""
        is_other = kind.startswith(("image/", "text/")) or kind == "application/json"
        if path.stem in known and path.is_file() and not is_other and not is_nobodys(path.name):
            files.append(path)
    return files


def read_times(path: Path) -> dict[str, Any]:
    """Seconds of each frame by camera: (n,) float64 arrays, nan for frames that the table lacks.  Raises SiteError."""
    import numpy as np

    table = read_csv(path, _TIMES, _TIMES_REMEDY)
    for meaning in _TIMES:
        if not table.has(meaning):
            raise SiteError(Problem(path, f"has no column {meaning}", _TIMES_REMEDY, 1))
    frames = table.numbers("frame")
    seconds = table.numbers("time")
    rows: dict[str, dict[int, float]] = {}
    for row, camera in enumerate(table.texts("camera")):
        frame = frames[row]
        if math.isnan(frame) or not 0 <= frame < _MOST_FRAMES or frame != int(frame):
            table.faults.add("frame", table.lines[row], f"frame {frame:g} is none", "number the frames of each video from 0")
            continue
        rows.setdefault(camera.strip(), {})[int(frame)] = seconds[row]
    table.faults.raise_any()
    times = {}
    for camera, by_frame in rows.items():
        times[camera] = np.full(max(by_frame) + 1, np.nan)
        times[camera][list(by_frame)] = list(by_frame.values())
    return times


def write_observations(
    site: Site, recordings: Mapping[str, Path], board: Mapping[str, float | str] | None, times: Mapping[str, Any], out: Path
) -> tuple[list[Path], list[str]]:
    """Find the board or the lamp in recordings; write the tables, name them in the site file, and draw what was found.

    Returns the files that were written, and lines for the operator.  Raises UsageError if nothing was found, or if the site file
    cannot be edited.

    Parameters
    ----------
    site : Site
        The site.
    recordings : mapping
        Videos by camera.
    board : mapping, optional
        The board's fields by name; None: a lamp.
    times : mapping
        (n,) float64 seconds of each frame, by camera, as far as the videos do not tell them.
    out : Path
        Folder for the pictures.
    """
    lenses = {}
    for camera in site.cameras:
        lenses[camera.id] = from_plain(Value(SITE_TYPES["lens"], stated_fields(camera.lens)))
    # 1. what they show
    with ExitStack() as stack:
        opened = {}
        for name, path in recordings.items():
            try:
                opened[name] = stack.enter_context(os.fdopen(open_untrusted(path, MOST_CAPTURE_BYTES), "rb"))
            except Unreadable as error:
                raise UsageError(f"{path}: {error.what}", remedy="give a recording: a video") from None
        try:
            found = load(OBSERVE)(opened, board, times=dict(times), lenses=lenses)
        except ValueError as error:
            remedy = (
                "record the lamp at night, moving, seen by two cameras or more at once; for a board, give --board and --square"
            )
            raise UsageError(printable(error, 400), remedy=remedy) from None
    lines = [str(message) for message in found.messages]
    # 2. the tables, and their names in the site file
    files = [_replace(_table_path(site, site.settings.observations, OBSERVATIONS), observations_csv(found.observations), lines)]
    keys = {"observations": files[0]}
    if found.survey.lengths and site.settings.survey is None:
        files.append(_replace(site.folder / SURVEY, lengths_csv(found.survey, found.observations), lines))
        keys["survey"] = files[1]
    elif found.survey.lengths:
        lines.append(f"{site.settings.survey} stays the survey: the board's lengths are not used")
    _name_in_site_file(site, keys, lines)
    # 3. the pictures
    out.mkdir(parents=True, exist_ok=True)
    for name, picture in found.pictures.items():
        files.append(out / picture_name(name))
        write_atomic(files[-1], picture)
    return files, lines


def observations_csv(observations: Any) -> bytes:
    """Observations (`wbflow_stages.types.Observations`) as a table; columns that say nothing are left out."""
    # 1. the columns, each with the text of a row
    columns: dict[str, Callable[[int], str]] = {}
    if not all(map(math.isnan, observations.time)):
        if observations.time_unit == "frames":
            columns["frame"] = lambda row: _text(observations.time[row], ".10g")
        else:
            columns["time"] = lambda row: _text(observations.time[row], ".6f")
    columns["camera"] = lambda row: str(observations.cameras[observations.camera[row]])
    if len(observations.things) > 1:
        columns["id"] = lambda row: str(observations.things[observations.thing[row]])
    columns["x"] = lambda row: f"{observations.xy[row, 0]:.3f}"
    columns["y"] = lambda row: f"{observations.xy[row, 1]:.3f}"
    if not all(map(math.isnan, observations.sigma_px)):
        columns["sigma"] = lambda row: _text(observations.sigma_px[row], ".3g")
    # 2. the rows
    lines = [",".join(columns)]
    for row in range(len(observations.camera)):
        lines.append(",".join(cell(row) for cell in columns.values()))
    return ("\n".join(lines) + "\n").encode()


def _text(value: float, form: str) -> str:
    """A number as text; "" if it is unknown."""
    if math.isnan(value):
        return ""
    return f"{value:{form}}"


def lengths_csv(survey: Any, observations: Any) -> bytes:
    """Lengths (`wbflow_stages.types.ThingSurvey`) between things that were observed, as a table."""
    seen = set(observations.thing.tolist())
    lines = ["id,to,metres"]
    for first, second, metres in survey.lengths:
        if first not in seen or second not in seen:
            continue
        lines.append(f"{survey.things[first]},{survey.things[second]},{metres:.6g}")
    return ("\n".join(lines) + "\n").encode()


def _table_path(site: Site, named: str | None, otherwise: str) -> Path:
    """The path of a table: as the site file names it, else beside the site file."""
    if named is None or site.observations is None:
        return site.folder / otherwise
    return site.observations.path


def _replace(path: Path, data: bytes, lines: list[str]) -> Path:
    """Write a table; an earlier one with other content is kept under another name, which is added to the lines."""
    if path.exists() and path.read_bytes() != data:
        number = 1
        kept = path.with_name(f"{path.stem}-{number}{path.suffix}")
        while kept.exists():
            number += 1
            kept = path.with_name(f"{path.stem}-{number}{path.suffix}")
        path.rename(kept)
        lines.append(f"the {path.name} that was there is {kept.name} now")
    write_atomic(path, data)
    return path


def _name_in_site_file(site: Site, keys: Mapping[str, Path], lines: list[str]) -> None:
    """Add the keys for tables to the site file, as far as it does not have them; every other byte stays."""
    text = read_text(site.file)
    edited = text
    for key, path in keys.items():
        if getattr(site.settings, key) is not None:
            continue
        try:
            edited = put(edited, (key,), path.name)
        except NotEditable:
            raise UsageError(f"{site.file} cannot be edited here", remedy=f"add a line to it: {key}: {path.name}") from None
        lines.append(f"{site.file}: now has  {key}: {path.name}")
    if edited != text:
        site_of(parse_yaml(edited, site.file), site.work_folder.root)  # nothing that cannot be read is written
        mark = b""
        if site.file.read_bytes().startswith(BOM_UTF8):
            mark = BOM_UTF8
        write_atomic(site.file.resolve(), mark + edited.encode())


def summary_line(recordings: Mapping[str, Path], site: Site) -> str:
    """Which cameras have recordings, as text."""
    missing = [camera.id for camera in site.cameras if camera.id not in recordings]
    text = f"recordings of {counted(len(recordings), 'camera')}"
    if missing:
        text += f"; none of {', '.join(missing)}"
    return text
