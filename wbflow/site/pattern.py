"""How the captures of a site are called: `captures.pattern` with {camera}, {date}, {time}, * and **, read and filled in."""

from __future__ import annotations

import datetime
import glob
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..cache.untrusted import find_untrusted

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
    store: str = ""
    """URL of the object store that has the captures; "" where they lie in a folder."""

    @property
    def dated(self) -> bool:
        """Do the names say which night they are of?"""
        return "date" in self._fields

    @property
    def _fields(self) -> set[str]:
        return {match.group(1) for match in _FIELD.finditer(self.text)}

    def files(self, camera: str, date: datetime.date) -> list[Path]:
        """A camera's captures of a night, in the order of their times, where their names say them, else of their names."""
        moment = self._reader(camera)
        found = [path for path in map(Path, find_untrusted(self._wild(camera, date))) if not path.is_dir()]
        return sorted(found, key=lambda path: (moment(str(path)) or datetime.datetime.min, path))

    def moment(self, camera: str, path: Path) -> datetime.datetime | None:
        """When a capture was taken, by its name; None where that does not say a time of day."""
        return self._reader(camera)(str(path)) if "time" in self._fields else None

    def dates(self, camera: str) -> Iterator[datetime.date]:
        """Every night for which a camera has a file, as often as it has one."""
        moment = self._reader(camera)
        for name in find_untrusted(self._wild(camera)):
            if found := moment(name):
                yield found.date()

    def cameras(self) -> set[str]:
        """Names for which there are files, of whatever night, where the pattern's `{camera}` stands."""
        if "{camera}" not in self.text:
            return set()
        wild = self._in_root(self._filled(None).replace("{camera}", "*"))
        first, *rest = self._expression("\0").split("\0")
        expression = re.compile(first + "(?P<camera>[^/]+?)" + "(?P=camera)".join(rest))
        found = (expression.fullmatch(name) for name in find_untrusted(wild))
        return {match["camera"] for match in found if match}

    def expected(self, camera: str, date: datetime.date) -> str:
        """What a camera's captures of a night would be called, for messages."""
        return str(self.root / self._filled(date).replace("{camera}", camera))

    def name(self, camera: str, moment: datetime.datetime) -> Path:
        """The path of a new capture: `*` becomes the time of day, where no {time} says it.

        Raises ValueError for a pattern with `?` or `[`, which names nothing.
        """
        if re.search(r"[?\[]", self.text):
            raise ValueError(f"{self.text} has ? or [ in it: no new capture can be called so")
        text = _FIELD.sub(lambda match: moment.strftime(match.group(2) or _FORMATS[match.group(1)]), self.text)
        text = re.sub(r"\*\*/?", "", text)
        text = text.replace("*", "" if "time" in self._fields else f"{moment:%H%M%S}", 1).replace("*", "")
        return self.root / text.replace("{camera}", camera)

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
