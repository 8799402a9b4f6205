"""File names of captures: `captures.pattern` with {camera}, {date}, {time}, * and **, parsed and filled in."""

from __future__ import annotations

import datetime
import glob
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ..cache.untrusted import find_untrusted, is_folder

_NUMBERS = {"%Y": r"\d{4}", "%j": r"\d{3}", "%f": r"\d{1,6}"} | dict.fromkeys(
    ("%y", "%m", "%d", "%H", "%I", "%M", "%S"), r"\d{2}"
)
"""A regular expression for each directive of `strftime` that is a number."""
_WORDS = ("%b", "%B", "%a", "%A", "%p")
"""Directives that are words."""
_FORMATS = {"date": "%Y-%m-%d", "time": "%H%M%S"}
_FIELD = re.compile(r"\{(date|time)(?::([^}]*))?\}")
_PARTS = re.compile(r"(\{(?:date|time)(?::[^}]*)?\}|\{camera\}|\*\*/?|\*)")
"""Splits a pattern into its fields, its wildcards and the text between them."""
_DIRECTIVE = re.compile(r"(%[a-zA-Z])")


def pattern_fault(text: str) -> str:
    """What is wrong with the text of a pattern, and what to write; "" if nothing is."""
    for name in re.findall(r"\{(\w*)", text):
        if name not in {"camera", "date", "time"}:
            return f"{{{name}}} is not known; use {{camera}}, {{date:%Y-%m-%d}}, {{time:%H%M%S}}, * and **"
    directives: set[str] = set()
    hours: set[str] = set()
    for field in _FIELD.finditer(text):
        for directive in _DIRECTIVE.findall(_format_of(field)):
            if directive not in _NUMBERS and directive not in _WORDS:
                return f"{directive} in {field.group()} is not known; use %Y, %m, %d, %j, %H, %M and %S"
            if field.group(1) == "date":
                directives.add(directive)
            if directive in {"%I", "%p"}:
                hours.add(directive)
    if hours == {"%I"}:
        return "%I, the hour of 12, does not say which half of the day; add %p (AM or PM), or use %H for the hour of 24"
    if directives:
        has_year = directives & {"%Y", "%y"}
        has_month = directives & {"%m", "%b", "%B"}
        has_day = "%j" in directives or ("%d" in directives and has_month)
        if not (has_year and has_day):
            return "{date} does not say year, month and day; for example {date:%Y-%m-%d}, or {date:%Y} and {date:%m%d}"
    return ""


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
    def timed(self) -> bool:
        """Do the names contain date and time of day?"""
        return {"date", "time"} <= self._fields

    @property
    def _fields(self) -> set[str]:
        return {match.group(1) for match in _FIELD.finditer(self.text)}

    def files(self, camera: str, date: datetime.date) -> list[Path]:
        """A camera's captures of a date, ordered by the times in their names, or by name if these contain no time.

        The date is that in the names; `bursts.py` says to which night they belong.  Raises OSError, with the folder as its
        `filename`, if there is none and a folder in which they may be cannot be read.
        """
        moment = self._moment_reader(camera)
        unreadable: list[OSError] = []
        names = find_untrusted(self._glob_pattern(camera, date), unreadable.append)
        paths = [path for path in map(Path, names) if not is_folder(path)]
        # where there are some, a folder that cannot be read need not be this camera's: `**` searches many
        if unreadable and not paths:
            raise unreadable[0]
        # files without a valid time come first, in the order of their names
        return sorted(paths, key=lambda path: (moment(str(path)) or datetime.datetime.min, path))

    def moment(self, camera: str, path: Path) -> datetime.datetime | None:
        """When a capture was taken, from its name; None if the name contains no time of day."""
        if "time" not in self._fields:
            return None
        return self._moment_reader(camera)(str(path))

    def moments(self, camera: str) -> Iterator[datetime.datetime]:
        """The date, with the time if names contain it, of each file of a camera."""
        moment = self._moment_reader(camera)
        for name in find_untrusted(self._glob_pattern(camera)):
            taken = moment(name)
            if taken:
                yield taken

    def undated(self, camera: str) -> Iterator[str]:
        """The names, relative to the root, of a camera's files that fit the pattern except that their date or time is none."""
        moment = self._moment_reader(camera)
        for name in find_untrusted(self._glob_pattern(camera)):
            if self.dated and moment(name) is None:
                yield name.removeprefix(f"{self.root}/")

    def cameras(self) -> set[str]:
        """The values of `{camera}` for which there are files, of any night."""
        if "{camera}" not in self.text:
            return set()
        wildcards = self._in_root(self._filled(None).replace("{camera}", "*"))
        # a zero byte, which no pattern has, marks the places of {camera}: all but the first must repeat the same name
        start, *others = self._regex("\0").split("\0")
        expression = re.compile(start + "(?P<camera>[^/]+?)" + "(?P=camera)".join(others))
        cameras = set()
        for name in find_untrusted(wildcards):
            match = expression.fullmatch(name)
            if match:
                cameras.add(match["camera"])
        return cameras

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
        # a new capture lies in the first folder that the pattern allows: `**` may be none
        text = re.sub(r"\*\*/?", "", text)
        if "time" not in self._fields:
            text = text.replace("*", f"{moment:%H%M%S}", 1)
        text = text.replace("*", "")
        return self.root / text.replace("{camera}", camera)

    def _glob_pattern(self, camera: str, date: datetime.date | None = None) -> str:
        """A `glob` pattern for the files of one date, or of all dates (`date` None)."""
        return self._in_root(self._filled(date).replace("{camera}", glob.escape(camera)))

    def _in_root(self, text: str) -> str:
        return str(Path(glob.escape(str(self.root))) / text)

    def _filled(self, date: datetime.date | None) -> str:
        """The pattern with the date filled in; fields without a known value become wildcards."""

        def fill(match: re.Match[str]) -> str:
            if match.group(1) == "date" and date is not None:
                return datetime.datetime.combine(date, datetime.time()).strftime(_format_of(match))
            return re.sub(r"\*+", "*", _DIRECTIVE.sub("*", _format_of(match)))

        return _FIELD.sub(fill, self.text)

    def _moment_reader(self, camera: str) -> Callable[[str], datetime.datetime | None]:
        """A function that reads date and time from a path; it returns None for a path that does not match."""
        # one group of the expression for each directive, in this order
        directives: list[str] = []
        for field in _FIELD.finditer(self.text):
            directives += _DIRECTIVE.findall(_format_of(field))
        expression = re.compile(self._regex(re.escape(camera)))

        def moment(path: str) -> datetime.datetime | None:
            match = expression.fullmatch(path) if directives else None
            if match is None:
                return None
            return _parsed(directives, match.groups())

        return moment

    def _regex(self, camera: str) -> str:
        """A regular expression for a capture's path with one group per directive of {date} and {time}.

        camera: replaces {camera}.  The case of the suffix is ignored, as `find_untrusted` does.
        """
        text = str(Path(self.text))  # as the paths on disk are written: without `./` and double slashes
        pieces = [re.escape(str(self.root / "x")[:-1])]
        if Path(text).is_absolute():
            pieces = []
        suffix = re.search(r"\.\w+\Z", text)
        if suffix:
            text = text[: suffix.start()]
        for part in _PARTS.split(text):
            field = _FIELD.fullmatch(part)
            if field:
                for piece in _DIRECTIVE.split(_format_of(field)):
                    if _DIRECTIVE.fullmatch(piece):
                        pieces.append(f"({_NUMBERS.get(piece, '.+?')})")
                    else:
                        pieces.append(re.escape(piece))
            elif part == "{camera}":
                pieces.append(camera)
            elif part.startswith("**"):
                pieces.append("(?:.*/)?" if part.endswith("/") else ".*")
            elif part == "*":
                pieces.append("[^/]*")
            else:
                pieces.append(_wildcards_as_regex(part))
        if suffix:
            pieces.append(f"(?i:{re.escape(suffix.group())})")
        return "".join(pieces)


def _wildcards_as_regex(text: str) -> str:
    """A regular expression for text with the lesser wildcards of `glob`, `?` and `[...]`."""
    pieces: list[str] = []
    for piece in re.split(r"(\?|\[[^\]]+\])", text):
        if piece == "?":
            pieces.append("[^/]")
        elif piece.startswith("[") and piece.endswith("]"):
            # `!` excludes in a file name, `^` in an expression; a backslash is an ordinary letter of a name
            inner = piece[1:-1].replace("\\", r"\\")
            pieces.append(f"[^{inner[1:]}]" if inner.startswith("!") else f"[{inner}]")
        else:
            pieces.append(re.escape(piece))
    return "".join(pieces)


def _parsed(directives: list[str], texts: tuple[str, ...]) -> datetime.datetime | None:
    """Date and time from the text of each directive; None if they are no date, or contradict each other.

    A pattern may name a directive twice, as for folders of days with dated files in them: both texts must agree.
    """
    text_of: dict[str, str] = {}
    for directive, text in zip(directives, texts, strict=True):
        if text_of.setdefault(directive, text) != text:
            return None
    try:
        moment = datetime.datetime.strptime("|".join(text_of.values()), "|".join(text_of))
    except ValueError:
        return None
    for directive, text in text_of.items():
        # %Y and %y, or %j and %m, may both be there, and say different things
        if directive in _NUMBERS and directive != "%f" and int(moment.strftime(directive)) != int(text):
            return None
    return moment
