"""Which files are tonight's, and what is in them (by digest, remembered as long as a file does not change)."""

from __future__ import annotations

import datetime
import functools
import glob
import re
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from ..cache.digests import Digests
from ..cache.untrusted import find_outside
from ..errors import UsageError, WbflowError, printable
from .models import Camera, Site

_DIRECTIVES = {
    "Y": r"\d{4}",
    "m": r"\d{2}",
    "d": r"\d{2}",
    "H": r"\d{2}",
    "M": r"\d{2}",
    "S": r"\d{2}",
    "f": r"\d{1,6}",
    "j": r"\d{3}",
    "y": r"\d{2}",
}
_FORMATS = {"date": "%Y-%m-%d", "time": "%H%M%S"}
_FIELD = re.compile(r"\{(date|time)(?::([^}]*))?\}")


@dataclass(frozen=True)
class Pattern:
    """How the captures of a site are called."""

    root: Path
    text: str
    """Relative to the root."""

    @property
    def dated(self) -> bool:
        """Do the names say which night they are of?"""
        return any(match.group(1) == "date" for match in _FIELD.finditer(self.text))

    def files(self, camera: str, date: datetime.date) -> list[Path]:
        """A camera's captures of a night, in the order of their times, where their names say them, else of their names."""
        moment = self._reader(camera)
        found = [path for path in map(Path, find_outside(self._wild(camera, date))) if not path.is_dir()]
        return sorted(found, key=lambda path: (moment(str(path)) or datetime.datetime.min, path))

    def moment(self, camera: str, path: Path) -> datetime.datetime | None:
        """When a capture was taken, by its name; None where that does not say a time of day."""
        if not any(match.group(1) == "time" for match in _FIELD.finditer(self.text)):
            return None
        return self._reader(camera)(str(path))

    def dates(self, camera: str) -> Iterator[datetime.date]:
        """Every night for which a camera has a file, as often as it has one."""
        moment = self._reader(camera)
        for name in find_outside(self._wild(camera)):
            if found := moment(name):
                yield found.date()

    def cameras(self) -> set[str]:
        """Names for which there are files, of whatever night, where the pattern's `{camera}` stands."""
        if "{camera}" not in self.text:
            return set()
        wild = self._in_root(self._filled(None).replace("{camera}", "*"))
        first, *rest = self._expression("\0").split("\0")
        expression = re.compile(first + "(?P<camera>[^/]+?)" + "(?P=camera)".join(rest))
        found = (expression.fullmatch(name) for name in find_outside(wild))
        return {match["camera"] for match in found if match}

    def expected(self, camera: str, date: datetime.date) -> str:
        """What a camera's captures of a night would be called, for messages."""
        return str(self.root / self._filled(date).replace("{camera}", camera))

    def _wild(self, camera: str, date: datetime.date | None = None) -> str:
        """A pattern for `glob`: of one night, or of all."""
        return self._in_root(self._filled(date).replace("{camera}", glob.escape(camera)))

    def _in_root(self, text: str) -> str:
        return str(Path(glob.escape(str(self.root))) / text)

    def _filled(self, date: datetime.date | None) -> str:
        """The text with the date put in; what is not known matches anything."""

        def of(match: re.Match[str]) -> str:
            form = match.group(2) or _FORMATS[match.group(1)]
            if match.group(1) == "date" and date is not None:
                return datetime.datetime.combine(date, datetime.time()).strftime(form)
            return re.sub(r"\*+", "*", re.sub(r"%[a-zA-Z]", "*", form))

        return _FIELD.sub(of, self.text)

    def _reader(self, camera: str) -> Callable[[str], datetime.datetime | None]:
        """A function that reads the moment out of a path; it returns None for a path without one."""
        formats = "|".join(match.group(2) or _FORMATS[match.group(1)] for match in _FIELD.finditer(self.text))
        expression = re.compile(self._expression(re.escape(camera)))

        def moment(path: str) -> datetime.datetime | None:
            match = expression.fullmatch(path) if formats else None
            try:
                return datetime.datetime.strptime("|".join(match.groups()), formats) if match else None
            except ValueError:
                return None

        return moment

    def _expression(self, camera: str) -> str:
        """A regular expression for a capture's path with one group for each {date} and {time}; camera stands for {camera}."""
        out = []
        for part in re.split(r"(\{(?:date|time)(?::[^}]*)?\}|\{camera\}|\*\*/?|\*)", str(self.root / self.text)):
            if field := _FIELD.fullmatch(part):
                directives = re.split(r"(%[a-zA-Z])", field.group(2) or _FORMATS[field.group(1)])
                inner = "".join(_DIRECTIVES.get(d[1:], ".+?") if d.startswith("%") else re.escape(d) for d in directives)
                out.append(f"({inner})")
            elif part == "{camera}":
                out.append(camera)
            elif part.startswith("**"):
                out.append("(?:.*/)?" if part.endswith("/") else ".*")
            else:
                out.append("[^/]*" if part == "*" else re.escape(part))
        return "".join(out)


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


ANSWER_SECONDS = 120.0
"""A camera's folder that takes longer to list and read does not answer: its mount is dead."""
LATER_SECONDS = 5.0
"""The same once another camera's folder has not answered: most cameras share one mount."""
T = TypeVar("T")


def answered(read: Callable[[], T], seconds: float) -> T:
    """Return what a function reads from a disk that may hang.  Raises TimeoutError if it does, and what the function raises."""
    result: Future[T] = Future()

    def run() -> None:
        try:
            result.set_result(read())
        except (OSError, ValueError, WbflowError) as error:
            result.set_exception(error)

    threading.Thread(target=run, daemon=True).start()  # not a pool: its threads would be waited for when the program ends
    try:
        return result.result(seconds)
    except TimeoutError:
        if result.done():
            raise
        raise TimeoutError(f"does not answer within {seconds:.0f} s: is its disk, or the network, there?") from None


def pattern_of(site: Site) -> Pattern:
    """How a site's captures are called."""
    return _pattern(site.root, site.pattern)


@functools.cache
def _pattern(root: Path, text: str) -> Pattern:
    return Pattern(root, text)


def nights(site: Site, since: datetime.date | None = None) -> list[datetime.date]:
    """The nights for which any camera has a capture by its name, in order."""
    pattern = pattern_of(site)
    if not pattern.dated:
        return []
    found: set[datetime.date] = set()
    seconds = ANSWER_SECONDS
    for camera in site.cameras:
        if camera.images is None:
            try:
                found |= answered(functools.partial(lambda name: set(pattern.dates(name)), camera.id), seconds)
            except TimeoutError:  # `find_captures` names the camera
                seconds = LATER_SECONDS
    return sorted(date for date in found if since is None or date >= since)


def look_again(site: Site) -> None:
    """See what has arrived in an object store, where the captures lie in one.  Raises StoreError, OSError."""
    if site.captures_store:
        from ..remote import list_captures  # here: most captures lie in folders

        list_captures(site.root, site.captures_store)


def night(site: Site, date: datetime.date | None) -> datetime.date:
    """The night to work on: `date`, else the newest for which any camera has a capture, else today.

    A name that tells of days to come (a camera whose clock is wrong) says nothing, unless all names do.
    """
    today = datetime.date.today()
    if date is not None:
        return date
    found = nights(site)
    return max((d for d in found if d <= today + datetime.timedelta(days=1)), default=max(found, default=today))


def backlog(site: Site, since: datetime.date) -> list[datetime.date]:
    """The nights that have captures from a day on, in order.

    Raises
    ------
    UsageError
        The captures' names don't say which night they are of, or there are none.
    """
    if not pattern_of(site).dated:
        what = "--since needs {date} in captures.pattern: the names of captures don't say which night they are of"
        raise UsageError(what, remedy="for example: pattern: '{camera}/{date:%Y-%m-%d}.jpg'; or run without --since")
    look_again(site)
    found = nights(site, since)
    if not found:
        raise UsageError(f"there are no captures since {since}", remedy="check captures.root and pattern, or the cameras")
    return found


def find_captures(site: Site, date: datetime.date, digests: Digests) -> dict[str, list[CaptureFile]]:
    """Return a night's files of each camera, in the order of their times or names; an empty list where there are none.

    digests: remembered ones, by file.
    """
    found, seconds = {}, ANSWER_SECONDS
    for camera in site.cameras:
        try:
            found[camera.id] = answered(functools.partial(captures_of, site, camera, date, digests), seconds)
        except TimeoutError as error:
            name = expected(site, camera, date)
            found[camera.id] = [CaptureFile(printable(name), Path(name), "", str(error))]
            seconds = LATER_SECONDS
    return found


def captures_of(site: Site, camera: Camera, date: datetime.date, digests: Digests) -> list[CaptureFile]:
    """The files of one camera in a night.

    Parameters
    ----------
    site, camera : Site, Camera
        Whose.
    date : date
        The night.
    digests : Digests
        Of their bytes.
    """
    named = camera.images
    paths = pattern_of(site).files(camera.id, date) if named is None else [site.root / name for name in named]
    if site.captures_store:
        from ..remote import fetch_captures

        fetch_captures(site.root, site.captures_store, paths)
    return [_file(site, path, digests) for path in paths]


def expected(site: Site, camera: Camera, date: datetime.date) -> str:
    """What a camera's captures would be called tonight, for messages."""
    return ", ".join(camera.images) if camera.images else pattern_of(site).expected(camera.id, date)


def find_named(site: Site, digests: Digests) -> dict[str, CaptureFile]:
    """The files that the site file names: the masks of cameras by id, and those of stages by `file_of_stage`."""
    paths = {camera.id: camera.mask for camera in site.cameras if camera.mask}
    paths |= {
        file_of_stage(stage, name): path for stage, settings in site.stages.items() for name, path in settings.files.items()
    }
    return {named: _digested(path.name, path, digests) for named, path in paths.items()}


def file_of_stage(stage: str, name: str) -> str:
    """Under which key a file is found that a stage's section names; no camera is called so."""
    return f"{stage} {name}"


def _file(site: Site, path: Path, digests: Digests) -> CaptureFile:
    return _digested(str(path).removeprefix(f"{site.root}/"), path, digests)


def _digested(name: str, path: Path, digests: Digests) -> CaptureFile:
    """name: as it is shown, whatever whoever named the file put into it."""
    try:
        return CaptureFile(printable(name), path, digests.of(path))
    except (OSError, ValueError) as error:
        why = error.what if isinstance(error, WbflowError) else getattr(error, "strerror", None) or str(error)
        return CaptureFile(printable(name), path, "", printable(why))


def as_now(file: CaptureFile, digests: Digests) -> CaptureFile:
    """A file as it is now."""
    try:
        return replace(file, digest=digests.of(file.path))
    except OSError:  # gone since
        return replace(file, digest="")


def in_motion(captures: Mapping[str, list[CaptureFile]], replaced: Collection[Path], digests: Digests) -> dict[str, list[str]]:
    """Captures that were replaced, or grew, since their digests were taken: their names, by camera.

    One that is gone was complete, as far as anybody knows: recorders tidy up.

    replaced: files of which that is known.
    """

    def moved(files: list[CaptureFile]) -> list[str]:
        now = {f.name: as_now(f, digests).digest or f.digest for f in files if f.digest}
        return [f.name for f in files if f.digest and (f.path in replaced or now[f.name] != f.digest)]

    found, seconds = {}, ANSWER_SECONDS
    for camera, files in captures.items():
        try:
            found[camera] = answered(functools.partial(moved, files), seconds)
        except TimeoutError:  # the mount has died since
            seconds = LATER_SECONDS
    return {camera: names for camera, names in found.items() if names}
