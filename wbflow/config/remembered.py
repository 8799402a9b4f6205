"""A site file that was found valid is not validated again, as long as it, what it names and the code that read it are the same.

What is remembered is the site in plain values, in a signed file of the work folder; whoever wants to know where something stands
in the site file reads the file itself (`load.load_site`).
"""

from __future__ import annotations

import dataclasses
import os
import re
from pathlib import Path
from typing import Any

from ..graph.functions import FunctionReader
from ..graph.installed import installed_code
from ..store.artifact import digest
from ..store.digests import is_settled, stamp_at
from ..store.keep import Keep
from ..store.layout import WorkFolder
from ..store.objects import is_url
from ..store.outside import MOST_TEXT_BYTES, is_folder, read_outside
from ..store.signed import Damaged, read_signed, write_signed
from .places import Document
from .site import (
    Expected,
    Notify,
    Site,
    SiteCamera,
    StageSettings,
    StatedLens,
    StatedPlacement,
    StatedPrivacy,
    StatedSurvey,
)

_OF = "a site file that was found valid"
_TOP = re.compile(r"""^[ {]{0,2}["']?(site|work)["']?\s*:\s*["']?([^"'#,\n}]+)""", re.MULTILINE)
"""What the keys at the top of a site file say; whatever else it finds leads to no memo that fits."""
_VARIABLE = re.compile(r"\$\{(\w+)")


def load(path: Path, work: str | Path | None = None) -> Site:
    """The same as `load_site`: from memory where that is as good."""
    known = _recall(path, work)
    if known is not None:
        return known
    from .load import load_site  # here: it takes modules that a night on which nothing changed has no use for

    return load_site(path, work)


def remember(site: Site) -> None:
    """Remember a site that was read from its file, and not from memory.  Raises OSError."""
    document, work = site.document, site.work_folder
    if not document.digest or site.notes:
        return
    folders = {str(site.root), str(site.work)}
    stated = {path: stamp for path, stamp in document.stated.items() if path not in folders}
    for path, stamp in stated.items():
        if stamp is None or is_folder(Path(path)) or not is_settled(stamp.mtime_ns, stamp.ctime_ns):
            return
    text = document.path.read_text("utf-8-sig")
    if digest(text.encode()) != document.digest:  # it has been changed since
        return
    told: dict[str, Any] = {
        "site": _plain(site),
        "digest": document.digest,
        "file": str(document.path.resolve()),
        "code": installed_code(),
    }
    told |= {"variables": _variables(text), "stated": stated, "functions": site.reader.stamps()}
    try:
        again = _site(told["site"], document, site.reader)
    except (TypeError, KeyError):
        return
    if again == site and site.reader.as_read():
        write_signed(work.site_memo, _OF, told)


def _recall(path: Path, work: str | Path | None) -> Site | None:
    file = path / "site.yaml" if is_folder(path) else path
    try:
        text = read_outside(file, MOST_TEXT_BYTES).decode("utf-8-sig")
        place = _work_of(text, file, str(work or ""))
        told = read_signed(place.site_memo, _OF)
        if not told or told["digest"] != digest(text.encode()) or told["code"] != installed_code():
            return None
        same = told["file"] == str(file.resolve()) and told["variables"] == _variables(text)
        same = same and all(_stamp(path) == stamp for path, stamp in told["stated"].items())
        reader = FunctionReader(place.functions_memo, file.resolve().parent)
        site = _site({**told["site"], "work": str(place.root), "store": place.store}, Document(file, None), reader)
        return site if same and reader.are_now(told["functions"]) and is_folder(site.root) else None
    except (OSError, Damaged, ValueError, KeyError, TypeError):
        return None


def _work_of(text: str, file: Path, asked: str) -> WorkFolder:
    """Where the work folder is likely to be: what is found there says whether it is the site's."""
    stated = {match[1]: match[2].strip() for match in reversed(list(_TOP.finditer(text)))}
    place = asked or stated.get("work", "")
    if is_url(place):
        return WorkFolder.mirroring(place, stated["site"])
    if place:
        return WorkFolder(Path(asked).resolve() if asked else Path(os.path.normpath(file.resolve().parent / place)))
    return WorkFolder.beside(file, stated["site"])


def _variables(text: str) -> dict[str, str | None]:
    """All that the environment may put into a site file."""
    return {name: os.environ.get(name) for name in sorted({"HOME", *_VARIABLE.findall(text)})}


def _stamp(path: str) -> list[int] | None:
    stamp = stamp_at(path)
    return None if stamp is None else list(stamp)


def _plain(site: Site) -> dict[str, Any]:
    """A site as JSON can hold it."""
    left_out = {"document", "reader", "notes"}
    plain = {f.name: getattr(site, f.name) for f in dataclasses.fields(site) if f.name not in left_out}
    for name in ("root", "work"):
        plain[name] = str(plain[name])
    for name in ("cameras", "views"):
        plain[name] = [{**dataclasses.asdict(c), "mask": str(c.mask) if c.mask else None} for c in plain[name]]
    if plain["views"] == plain["cameras"]:  # as of most sites
        plain["views"] = None
    plain["stages"] = {
        name: {**dataclasses.asdict(settings), "files": {key: str(file) for key, file in settings.files.items()}}
        for name, settings in site.stages.items()
    }
    for name in ("survey", "expected", "keep"):
        plain[name] = dataclasses.asdict(plain[name])
    plain["notify"] = {**dataclasses.asdict(site.notify), "folder": str(site.notify.folder)} if site.notify else None
    return plain


def _site(plain: dict[str, Any], document: Document, reader: FunctionReader) -> Site:
    """The site again.  Raises TypeError, KeyError for what is none of this version."""
    told = dict(plain)
    told |= {"root": Path(told["root"]), "work": Path(told["work"]), "cameras": tuple(map(_camera, told["cameras"]))}
    told["views"] = tuple(map(_camera, told["views"])) if told["views"] is not None else told["cameras"]
    told["stages"] = {name: _settings(settings) for name, settings in told["stages"].items()}
    told["survey"] = StatedSurvey(**{**told["survey"], "cameras": tuple(told["survey"]["cameras"])})
    told |= {"expected": Expected(**told["expected"]), "keep": Keep(**told["keep"])}
    if notify := told["notify"]:
        command = notify["command"] if isinstance(notify["command"], str) else tuple(notify["command"])
        told["notify"] = Notify(**{**notify, "command": command, "folder": Path(notify["folder"])})
    return Site(document=document, reader=reader, **told)


def _settings(plain: dict[str, Any]) -> StageSettings:
    return StageSettings(**{**plain, "files": {name: Path(file) for name, file in plain["files"].items()}})


def _camera(plain: dict[str, Any]) -> SiteCamera:
    images = plain["images"]
    return SiteCamera(
        plain["id"],
        StatedLens(**plain["lens"]),
        StatedPlacement(**plain["placement"]),
        Path(plain["mask"]) if plain["mask"] else None,
        StatedPrivacy(**plain["privacy"]),
        None if images is None else tuple(images),
        tuple(plain["place"]),
    )
