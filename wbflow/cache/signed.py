"""JSON files with a checksum of their own content, which also say what they are of.

A receipt or memo is one JSON object whose first entry is the checksum of all bytes that follow it: it is checked without being
written anew, and people and programs read it as what it is.  The checksum finds chance and mistakes (a failing disk, an editor,
two files exchanged), not malice: whoever may write to the work folder is trusted with it.

Memos keep what was learnt from run to run: digests of files from outside, as long as these do not change.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from .atomic import write_atomic
from .untrusted import Unreadable, open_outside, read_outside

_HEAD, _TAIL = b'{"signed":"', b'",'
_BODY = len(_HEAD) + 32 + len(_TAIL)


def content_digest(data: bytes | bytearray | memoryview) -> str:
    """By this files and artifacts are compared: 32 hexadecimal digits of SHA-256."""
    return hashlib.sha256(data).hexdigest()[:32]


def file_digest(path: Path) -> str:
    """The same of a file from outside, read in pieces.  Raises OSError."""
    with os.fdopen(open_outside(path), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]


class Damaged(WbflowError, ValueError):
    """Bytes that are not as they were written, or that belong to something else."""


class Unsigned(Damaged):
    """Bytes without a checksum, as earlier versions wrote them: they are not believed."""


def signed(of: str, content: Mapping[str, Any], in_lines: bool = False) -> bytes:
    """A JSON object with its checksum and what it is of.

    of: a task and its key, the name of a memo.  content: none of its entries may be called "signed" or "of".  in_lines: for files
    that people read.
    """
    entries = {"of": of, **content}
    body = (lines_of(entries) if in_lines else json.dumps(entries, separators=(",", ":"))).encode()[1:]
    return _HEAD + content_digest(body).encode() + _TAIL + body


def lines_of(content: Mapping[str, Any]) -> str:
    """A JSON object for people: one entry in a line, and of an entry that holds many one item.  (`json` indents twenty times as
    slowly as it writes.)"""
    return "{\n " + ",\n ".join(f"{json.dumps(name)}: {_items(entry)}" for name, entry in content.items()) + "\n}"


def _items(entry: Any) -> str:
    if isinstance(entry, Mapping) and entry:
        return "{\n  " + ",\n  ".join(f"{json.dumps(name)}: {json.dumps(item)}" for name, item in entry.items()) + "\n }"
    if isinstance(entry, list | tuple) and entry:
        return "[\n  " + ",\n  ".join(map(json.dumps, entry)) + "\n ]"
    return json.dumps(entry)


def unsigned(data: bytes, of: str) -> dict[str, Any]:
    """The entries of what `signed` gave.

    Raises Unsigned where it carries no checksum, Damaged where that is wrong, or it belongs to something else.
    """
    body = data[_BODY:]
    if not data.startswith(_HEAD):
        raise Unsigned("carries no checksum")
    if data[len(_HEAD) : _BODY] != content_digest(body).encode() + _TAIL:
        raise Damaged("is damaged")
    content: dict[str, Any] = json.loads(b"{" + body)
    if (whose := content.pop("of", None)) != of:
        raise Damaged(f"belongs to {whose}")
    return content


def write_signed(path: Path, of: str, content: Mapping[str, Any]) -> None:
    """Put a signed file of the work folder into its place (see `signed`).  Raises OSError."""
    write_atomic(path, signed(of, content), ours=True)


def read_signed(path: Path, of: str) -> dict[str, Any] | None:
    """The entries of a signed file; None where there is none, or one of an earlier version.

    Raises Damaged, naming the file, where its checksum is wrong, it belongs to something else, or it cannot be read.
    """
    try:
        return unsigned(read_outside(path), of)
    except Unsigned:
        return None
    except Unreadable as error:
        if not os.path.lexists(path):
            return None
        raise Damaged(f"{path} {error.what}") from None
    except Damaged as error:
        raise Damaged(f"{path} {error}") from None


_SETTLED_NS = 2_000_000_000
"""A file younger than this may change again within its time stamp's resolution."""
_FORMER = 2000
"""So many files that were not looked up this time are remembered besides those that were."""
NIGHTS = 60
"""So many nights of captures are remembered."""


class ChangedFile(WbflowError):
    """A file from outside does not hold any more what it held when its digest was taken."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path} has changed while the night was being worked on")
        self.path = path

    def __reduce__(self) -> tuple[type[ChangedFile], tuple[Path]]:  # it comes back from worker processes
        return type(self), (self.path,)


class Memo:
    """A signed file of what was learnt, kept between runs."""

    def __init__(self, path: Path | None, of: str, cost: str) -> None:
        """path: None keeps nothing.  cost: what it means, in words, when the file is damaged."""
        self._path, self._of = path, of
        self.damage: str | None = None
        """What was wrong with the file, if anything was."""
        self.entries: dict[str, Any] = {}
        try:
            self.entries = (read_signed(path, of) if path else None) or {}
        except Damaged as damage:
            self.damage = f"{damage.what}: {cost}"
        self._changed = self.damage is not None

    def save(self) -> None:
        """Keep what was learnt.  Raises OSError."""
        if self._path and self._changed:
            write_signed(self._path, self._of, self.entries)
            self._changed = False


class Digests(Memo):
    """Digests of files by path, size, time stamps and inode."""

    def __init__(self, memo: Path | None) -> None:
        super().__init__(memo, "digests of captures", "captures are read again")
        self._files: dict[str, list[Any]] = self.entries.setdefault("files", {})
        self._used: dict[str, None] = {}

    def of(self, path: Path) -> str:
        """The content digest of a file.  Raises OSError."""
        name, status = str(path), path.stat()
        self._used[name] = None
        before, known = _stamp(status), self._files.get(name)
        settled = time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _SETTLED_NS
        if known and known[:-1] == before and settled:
            return str(known[-1])
        digest = file_digest(path)
        if settled and _stamp(path.stat()) == before:  # the file is the one that was looked at before it was read
            self._files[name] = [*before, digest]
            self._changed = True
        return digest

    def forget(self, path: Path) -> None:
        """What is remembered of a file is wrong: it is read again."""
        self._changed |= self._files.pop(str(path), None) is not None

    def save(self) -> None:
        former = [name for name in self._files if name not in self._used][-_FORMER:]
        kept = [*former, *(name for name in self._used if name in self._files)]
        self._files = self.entries["files"] = {name: self._files[name] for name in kept}
        super().save()


def stamp(path: Path | str) -> list[int] | None:
    """What tells that a file has been touched, or replaced; None where there is none."""
    try:
        return _stamp(os.stat(path))  # noqa: PTH116 (a string where many are looked at)
    except OSError:
        return None


def _stamp(status: os.stat_result) -> list[int]:
    """Size, last change of its content and of anything, inode."""
    return [status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]


class Seen(Memo):
    """Digests of captures by camera and night (ISO 8601)."""

    def __init__(self, memo: Path) -> None:
        cost = "what cameras have delivered before tonight is forgotten"
        super().__init__(memo, "captures of earlier nights", cost)
        self._cameras: dict[str, dict[str, list[str]]] = self.entries.setdefault("cameras", {})

    def before(self, camera: str, night: str) -> dict[str, str]:
        """The newest earlier night of each digest that a camera has delivered."""
        earlier = sorted((date, found) for date, found in self._cameras.get(camera, {}).items() if date < night)
        return {digest: date for date, found in earlier for digest in found}

    def note(self, camera: str, night: str, digests: Iterable[str]) -> None:
        """Remember what a camera delivers tonight.  A night that is run again is remembered as it is now."""
        nights = self._cameras.setdefault(camera, {})
        found = sorted({digest for digest in digests if digest})
        if found and nights.get(night) != found:
            nights[night] = found
            self._cameras[camera] = {date: nights[date] for date in sorted(nights)[-NIGHTS:]}
            self._changed = True
