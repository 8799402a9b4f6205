"""What captures are called: a pattern such as `{camera}/{date:%Y-%m-%d}_{time:%H%M%S}.jpg`, and what a name says."""

from __future__ import annotations

import datetime
import functools
import glob
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..cache.untrusted import find_outside

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
        if not any(mark in (text := self._filled(self.text, date)) for mark in "*?["):  # one name, and nothing to search for
            path = f"{self.root}/{text.replace('{camera}', camera)}"
            return [Path(path)] if os.path.lexists(path) and not os.path.isdir(path) else []  # noqa: PTH112
        found = [path for path in map(Path, find_outside(self._wild(camera, date))) if not path.is_dir()]
        moment = self._reader(camera)
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
        text = self._filled(self.text, None).replace("{camera}", "*")
        first, *rest = self._expression("\0").split("\0")
        expression = re.compile(first + "(?P<camera>[^/]+?)" + "(?P=camera)".join(rest))
        found = (expression.fullmatch(name) for name in find_outside(str(Path(glob.escape(str(self.root))) / text)))
        return {match["camera"] for match in found if match}

    def expected(self, camera: str, date: datetime.date) -> str:
        """What a camera's captures of a night would be called, for messages."""
        return str(self.root / self._filled(self.text, date).replace("{camera}", camera))

    def _wild(self, camera: str, date: datetime.date | None = None) -> str:
        """A pattern for `glob`: of one night, or of all."""
        text = self._filled(self.text, date).replace("{camera}", glob.escape(camera))
        return str(Path(glob.escape(str(self.root))) / text)

    @staticmethod
    @functools.lru_cache(64)
    def _filled(text: str, date: datetime.date | None) -> str:
        """The date put in; what is not known matches anything."""

        def of(match: re.Match[str]) -> str:
            form = match.group(2) or _FORMATS[match.group(1)]
            if match.group(1) == "date" and date is not None:
                return datetime.datetime.combine(date, datetime.time()).strftime(form)
            return re.sub(r"\*+", "*", re.sub(r"%[a-zA-Z]", "*", form))

        return _FIELD.sub(of, text)

    def _reader(self, camera: str) -> Callable[[str], datetime.datetime | None]:
        """Reads the moment out of a path; None for a path without one."""
        formats = self._formats
        if not formats:
            return lambda path: None

        def moment(path: str) -> datetime.datetime | None:
            match = self._of_any.fullmatch(path)
            if match and "camera" in match.re.groupindex and match["camera"] != camera:  # it can be read in more ways than one
                match = re.fullmatch(self._expression(re.escape(camera)), path)
            if not match:
                return None
            try:
                return datetime.datetime.strptime("|".join(match[k] for k in self._groups(match)), "|".join(formats))
            except ValueError:
                return None

        return moment

    @functools.cached_property
    def _formats(self) -> list[str]:
        return [match.group(2) or _FORMATS[match.group(1)] for match in _FIELD.finditer(self.text)]

    @functools.cached_property
    def _of_any(self) -> re.Pattern[str]:
        """The expression for the captures of whatever camera; one is made for a site, not one for each camera."""
        first, *rest = self._expression("\0").split("\0")
        return re.compile(
            first + "".join(("(?P=camera)" if k else "(?P<camera>[A-Za-z0-9_.-]+?)") + part for k, part in enumerate(rest))
        )

    @staticmethod
    def _groups(match: re.Match[str]) -> list[int]:
        """The groups of a match that are dates and times."""
        return [k for k in range(1, match.re.groups + 1) if k != match.re.groupindex.get("camera")]

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
