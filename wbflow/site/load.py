"""The site description: one YAML file, typed and validated; every error at once, each with its line and what to write instead."""

from __future__ import annotations

import difflib
import os
import re
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..cache.functions import FunctionReader
from ..cache.layout import WorkFolder
from ..cache.untrusted import is_folder
from ..errors import printable
from ..pipeline.choice import MOST_AT_A_CAMERA
from ..remote.objects import is_url
from .cameras import beside, is_name, read_cameras
from .explain import explained, similar, without_faults
from .geodesy import Position, local_frame
from .locations import Document, Location, SiteError, SiteProblem, load_yaml
from .models import Camera, Expected, Notify, Site, StageSettings
from .schema import SiteSection
from .stages import read_stages
from .survey import read_survey
from .views import views_of

__all__ = ["Camera", "Site", "StageSettings", "load_site"]


def load_site(path: Path, work: str | Path | None = None) -> Site:
    """Read and validate a site file (or the `site.yaml` in a folder).  work: overrides what the file says of it.

    Raises
    ------
    SiteError
        With every problem that was found.
    """
    path = _file_of(path)
    document = load_yaml(path)
    if not isinstance(document.data, dict):
        raise SiteError(
            [SiteProblem(path, 1, 1, "", "a site file is a mapping", "start with 'site: NAME'; see sites/template.yaml")]
        )
    problems: list[SiteProblem] = []
    data = _expanded(_with_texts(document), document, problems)
    try:
        model = SiteSection.model_validate(data)
    except ValidationError as error:
        problems += explained(error, document)
        salvaged = without_faults(data, error)
        if salvaged is None:
            raise SiteError(problems) from None
        model = salvaged
    places: list[tuple[Location, Position]] = [
        (("cameras", i, "pose"), camera.pose) for i, camera in enumerate(model.cameras) if camera.pose
    ]
    places += [(("control_points", i), point) for i, point in enumerate(model.control_points)]
    frame = local_frame(iter(places), document, problems)
    cameras = read_cameras(model, frame, document, problems)
    ids = [camera.id for camera in model.cameras]
    survey = read_survey(ids, model.distances, model.control_points, frame, document, problems)
    place = _work_folder(str(work or ""), model, document, problems)
    reader = FunctionReader(place.functions_memo, path.resolve().parent)
    stages, notes = read_stages(model.stages, document, reader, problems)
    _check_pairs(model, document, problems)
    notes += _crowded(model, document)
    captures = _captures(model.captures.root, document, problems)
    if not is_name(model.site):
        remedy = "use letters, digits, '_', '.', '-' (not dots alone), at most 100"
        problems.append(document.problem(("site",), f"{model.site!r} is not a name", remedy))
    if problems:
        raise SiteError(sorted(problems, key=lambda p: (str(p.file), p.line, p.column)))
    pairs = {name: getattr(model.pairs, name) for name in ("degree", "min_angle", "max_angle", "include", "exclude")}
    return Site(
        model.site,
        document,
        captures.root,
        model.captures.pattern,
        tuple(cameras),
        tuple(view for camera in cameras for view in views_of(camera)),
        model.resolution,
        model.bounds,
        pairs,
        stages,
        place.root,
        reader,
        survey,
        Expected(model.expect.stated, str(model.expect.since or "")),
        _notify(model, path),
        model.keep.kept(),
        tuple(notes),
        model.pin,
        model.health.model_dump(),
        [zone.model_dump() for zone in model.zones] or None,
        place.store,
        captures.store,
    )


def _file_of(path: Path) -> Path:
    """The site file that a path means: of a folder, the one in there."""
    if not is_folder(path):
        return path
    file = path / "site.yaml"
    if not file.exists():
        remedy = f"wbflow init {path}  writes one from the photographs in there"
        raise SiteError([SiteProblem(file, 0, 0, "", "cannot be read: there is no such file", remedy)])
    return file


def _work_folder(asked: str, model: SiteSection, document: Document, problems: list[SiteProblem]) -> WorkFolder:
    """asked: what the file's own word gives way to."""
    stated, name = asked or model.work or "", model.site if is_name(model.site) else "site"
    if is_url(stated):
        return WorkFolder.mirroring(stated, name)
    if asked:
        return WorkFolder(Path(asked).resolve())
    return WorkFolder(beside(stated, ("work",), document, problems)) if stated else WorkFolder.beside(document.path, name)


def _captures(stated: str, document: Document, problems: list[SiteProblem]) -> WorkFolder:
    """Where the captures lie: a folder, or one that shows what is in an object store."""
    if is_url(stated):
        return WorkFolder.mirroring(stated, "captures")
    root = beside(stated, ("captures", "root"), document, problems)
    if not is_folder(root):
        remedy = similar(root) or "check the path and the variables in it; it is relative to the site file"
        problems.append(document.problem(("captures", "root"), f"there is no folder {printable(root)}", remedy))
    return WorkFolder(root)


def _notify(model: SiteSection, path: Path) -> Notify | None:
    if model.notify is None:
        return None
    command = model.notify.command
    folder = path.resolve().parent
    return Notify(command if isinstance(command, str) else tuple(command), folder, model.notify.heartbeat, model.notify.seconds)


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


def _expanded(data: Any, document: Document, problems: list[SiteProblem], location: Location = ()) -> Any:
    """Replace ${VAR} and ${VAR:-default} in every string."""
    if isinstance(data, dict):
        return {key: _expanded(value, document, problems, (*location, str(key))) for key, value in data.items()}
    if isinstance(data, list):
        return [_expanded(value, document, problems, (*location, i)) for i, value in enumerate(data)]
    if not isinstance(data, str) or "${" not in data:
        return data

    def value(match: re.Match[str]) -> str:
        name, default = match.group(1), match.group(2)
        found = os.environ.get(name) or default
        if found is None:
            remedy = f"set it, or write a default: ${{{name}:-/path}}"
            problems.append(document.problem(location, f"the environment variable {name} is not set", remedy))
            return ""
        return found

    return re.sub(r"\$\{(\w+)(?::-([^}]*))?\}", value, data)


def _crowded(model: SiteSection, document: Document) -> list[SiteProblem]:
    """What is to be said of a site that asks for more pairs than a view takes."""
    degree = model.pairs.degree
    if degree <= MOST_AT_A_CAMERA:
        return []
    what = f"a view takes {MOST_AT_A_CAMERA} pairs at most, its best, not {degree}"
    return [document.problem(("pairs", "degree"), what, f"write {MOST_AT_A_CAMERA} or less, e.g. degree: 6")]


def _check_pairs(model: SiteSection, document: Document, problems: list[SiteProblem]) -> None:
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
