"""File names of captures: `captures.pattern` with {camera}, {date}, {time}, * and **, parsed and filled in."""

from __future__ import annotations

import datetime
import glob
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..cache.untrusted import find_untrusted

_DIRECTIVES = {"%Y": r"\d{4}", "%j": r"\d{3}", "%f": r"\d{1,6}"} | dict.fromkeys(("%y", "%m", "%d", "%H", "%M", "%S"), r"\d{2}")
"""A regular expression for each directive of `strftime`."""
_FORMATS = {"date": "%Y-%m-%d", "time": "%H%M%S"}
_FIELD = re.compile(r"\{(date|time)(?::([^}]*))?\}")


def _format_of(field: re.Match[str]) -> str:
    return field.group(2) or _FORMATS[field.group(1)]


@dataclass(frozen=True)
class Pattern:
    """File name pattern of the captures of a site."""

    root: Path
    text: str
    """The pattern, relative to the root."""
    store: str = ""
    """URL of the object store that holds the captures; "" if they are in a folder."""

    @property
    def dated(self) -> bool:
        """Do the names contain the date of the night?"""
        return "date" in self._fields

    @property
    def _fields(self) -> set[str]:
        return {match.group(1) for match in _FIELD.finditer(self.text)}

    def files(self, camera: str, date: datetime.date) -> list[Path]:
        """A camera's captures of a night, ordered by the times in their names, or by name if these contain no time."""
        moment = self._moment_reader(camera)
        paths = [path for path in map(Path, find_untrusted(self._glob_pattern(camera, date))) if not path.is_dir()]
        return sorted(paths, key=lambda path: (moment(str(path)) or datetime.datetime.min, path))

    def moment(self, camera: str, path: Path) -> datetime.datetime | None:
        """When a capture was taken, from its name; None if the name contains no time of day."""
        return self._moment_reader(camera)(str(path)) if "time" in self._fields else None

    def dates(self, camera: str) -> Iterator[datetime.date]:
        """The night of each file of a camera; a night with several files is repeated."""
        moment = self._moment_reader(camera)
        for name in find_untrusted(self._glob_pattern(camera)):
            if taken := moment(name):
                yield taken.date()

    def cameras(self) -> set[str]:
        """The values of `{camera}` for which there are files, of any night."""
        if "{camera}" not in self.text:
            return set()
        wildcards = self._in_root(self._filled(None).replace("{camera}", "*"))
        start, *others = self._regex("\0").split("\0")
        expression = re.compile(start + "(?P<camera>[^/]+?)" + "(?P=camera)".join(others))
        matches = (expression.fullmatch(name) for name in find_untrusted(wildcards))
        return {match["camera"] for match in matches if match}

    def expected(self, camera: str, date: datetime.date) -> str:
        """The path, with wildcards, of a camera's captures of a night, for messages."""
        return str(self.root / self._filled(date).replace("{camera}", camera))

    def name(self, camera: str, moment: datetime.datetime) -> Path:
        """The path of a new capture; the first `*` becomes the time of day if the pattern has no {time}.

        Raises ValueError for a pattern with `?` or `[`, from which no name can be made.
        """
        if re.search(r"[?\[]", self.text):
            raise ValueError(f"{self.text} contains ? or [, which the name of a new capture cannot have")
        text = _FIELD.sub(lambda match: moment.strftime(_format_of(match)), self.text)
        text = re.sub(r"\*\*/?", "", text)
        text = text.replace("*", "" if "time" in self._fields else f"{moment:%H%M%S}", 1).replace("*", "")
        return self.root / text.replace("{camera}", camera)

    def _glob_pattern(self, camera: str, date: datetime.date | None = None) -> str:
        """A `glob` pattern for the files of one night, or of all nights (`date` None)."""
        return self._in_root(self._filled(date).replace("{camera}", glob.escape(camera)))

    def _in_root(self, text: str) -> str:
        return str(Path(glob.escape(str(self.root))) / text)

    def _filled(self, date: datetime.date | None) -> str:
        """The pattern with the date filled in; fields without a known value become wildcards."""

        def fill(match: re.Match[str]) -> str:
            if match.group(1) == "date" and date is not None:
                return datetime.datetime.combine(date, datetime.time()).strftime(_format_of(match))
            return re.sub(r"\*+", "*", re.sub(r"%[a-zA-Z]", "*", _format_of(match)))

        return _FIELD.sub(fill, self.text)

    def _moment_reader(self, camera: str) -> Callable[[str], datetime.datetime | None]:
        """A function that reads date and time from a path; it returns None for a path that does not match."""
        formats = "|".join(map(_format_of, _FIELD.finditer(self.text)))
        expression = re.compile(self._regex(re.escape(camera)))

        def moment(path: str) -> datetime.datetime | None:
            match = expression.fullmatch(path) if formats else None
            try:
                return datetime.datetime.strptime("|".join(match.groups()), formats) if match else None
            except ValueError:
                return None

        return moment

    def _regex(self, camera: str) -> str:
        """A regular expression for a capture's path with one group per {date} and {time}; `camera` replaces {camera}."""
        pieces = []
        for part in re.split(r"(\{(?:date|time)(?::[^}]*)?\}|\{camera\}|\*\*/?|\*)", str(self.root / self.text)):
            if field := _FIELD.fullmatch(part):
                directives = re.split(r"(%[a-zA-Z])", _format_of(field))
                field_regex = "".join(_DIRECTIVES.get(d, ".+?") if d.startswith("%") else re.escape(d) for d in directives)
                pieces.append(f"({field_regex})")
            elif part == "{camera}":
                pieces.append(camera)
            elif part.startswith("**"):
                pieces.append("(?:.*/)?" if part.endswith("/") else ".*")
            else:
                pieces.append("[^/]*" if part == "*" else re.escape(part))
        return "".join(pieces)
