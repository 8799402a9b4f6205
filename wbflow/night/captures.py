"""Which files are tonight's, and what is in them (by digest, remembered as long as a file does not change)."""

from __future__ import annotations

import datetime
import glob
import re
from dataclasses import dataclass
from pathlib import Path

from ..config.site import Site, SiteCamera
from ..errors import WbflowError, printable
from ..store.digests import Digests

_DIRECTIVES = {
    "Y": r"\d{4}",
    "m": r"\d{2}",
    "d": r"\d{2}",
    "H": r"\d{2}",
    "M": r"\d{2}",
    "S": r"\d{2}",
    "j": r"\d{3}",
    "y": r"\d{2}",
}
_DATE = re.compile(r"\{date(?::([^}]*))?\}")


@dataclass(frozen=True)
class CaptureFile:
    """A capture of the night, as it lies on disk."""

    name: str
    """Relative to the captures' root."""
    path: Path
    digest: str
    """Of its bytes, "" where it cannot be read."""
    fault: str = ""
    """Why it cannot."""


def night(site: Site, date: datetime.date | None) -> datetime.date:
    """The night to work on: `date`, else the newest for which any camera has a capture, else today."""
    if date is not None or not _DATE.search(site.pattern):
        return date or datetime.date.today()
    dates = [found for camera in site.cameras for found in _dates(site, camera)]
    return max(dates, default=datetime.date.today())


def find_captures(site: Site, date: datetime.date, digests: Digests) -> dict[str, list[CaptureFile]]:
    """Tonight's files of each camera, in the order of their names; an empty list where there are none."""
    found = {}
    for camera in site.cameras:
        if camera.images is not None:
            paths = [site.root / name for name in camera.images]
        else:
            paths = sorted(p for p in map(Path, glob.glob(str(_pattern(site, camera, date)), recursive=True)) if p.is_file())
        found[camera.id] = [_file(site, path, digests) for path in paths]
    return found


def expected(site: Site, camera: SiteCamera, date: datetime.date) -> str:
    """What a camera's captures would be called tonight, for messages."""
    return ", ".join(camera.images) if camera.images else str(_pattern(site, camera, date, escape=False))


def find_masks(site: Site, digests: Digests) -> dict[str, CaptureFile]:
    """The masks of cameras that have one."""
    return {camera.id: _digested(camera.mask.name, camera.mask, digests) for camera in site.cameras if camera.mask}


def _file(site: Site, path: Path, digests: Digests) -> CaptureFile:
    return _digested(str(path.relative_to(site.root)) if path.is_relative_to(site.root) else str(path), path, digests)


def _digested(name: str, path: Path, digests: Digests) -> CaptureFile:
    """name: as it is shown, whatever whoever named the file put into it."""
    try:
        return CaptureFile(printable(name), path, digests.of(path))
    except (OSError, ValueError) as error:
        why = error.what if isinstance(error, WbflowError) else getattr(error, "strerror", None) or str(error)
        return CaptureFile(printable(name), path, "", printable(why))


def _pattern(site: Site, camera: SiteCamera, date: datetime.date, escape: bool = True) -> Path:
    moment = datetime.datetime.combine(date, datetime.time())
    name = _DATE.sub(lambda m: moment.strftime(m.group(1) or "%Y-%m-%d"), site.pattern)
    name = name.replace("{camera}", glob.escape(camera.id) if escape else camera.id)
    return (Path(glob.escape(str(site.root))) if escape else site.root) / name


def _dates(site: Site, camera: SiteCamera) -> list[datetime.date]:
    """Every date for which a camera has a file, read from the names."""
    formats = [m.group(1) or "%Y-%m-%d" for m in _DATE.finditer(site.pattern)]
    wild = _DATE.sub(lambda m: re.sub(r"%[a-zA-Z]", "*", m.group(1) or "%Y-%m-%d"), site.pattern)
    wild = str(Path(glob.escape(str(site.root))) / wild.replace("{camera}", glob.escape(camera.id)))
    expression = re.compile(_expression(str(site.root / site.pattern), camera.id))
    found = []
    for name in glob.iglob(wild, recursive=True):
        if match := expression.fullmatch(name):
            try:
                found.append(datetime.datetime.strptime("|".join(match.groups()), "|".join(formats)).date())
            except ValueError:
                continue
    return found


def _expression(pattern: str, camera: str) -> str:
    """A regular expression for a capture's path with one group for each {date}."""
    parts = re.split(r"(\{date(?::[^}]*)?\}|\{camera\}|\*\*/?|\*)", pattern)
    out = []
    for part in parts:
        if date := _DATE.fullmatch(part):
            directives = re.split(r"(%[a-zA-Z])", date.group(1) or "%Y-%m-%d")
            inner = "".join(_DIRECTIVES.get(d[1:], ".+?") if d.startswith("%") else re.escape(d) for d in directives)
            out.append(f"({inner})")
        elif part == "{camera}":
            out.append(re.escape(camera))
        elif part.startswith("**"):
            out.append("(?:.*/)?" if part.endswith("/") else ".*")
        else:
            out.append("[^/]*" if part == "*" else re.escape(part))
    return "".join(out)
