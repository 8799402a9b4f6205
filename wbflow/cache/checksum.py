"""JSON files with a checksum of their own content, which also say what they are of.

A receipt or memo is one JSON object whose first entry is the checksum of all bytes that follow it: it is checked without being
written anew, and people and programs read it as what it is.  The checksum finds chance and mistakes (a failing disk, an editor,
two files exchanged), not malice: whoever may write to the work folder is trusted with it.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from .atomic import write_atomic
from .untrusted import MOST_CAPTURE_BYTES, Unreadable, open_untrusted, read_untrusted

_HEAD, _TAIL = b'{"signed":"', b'",'  # as the first version has called it
_BODY = len(_HEAD) + 32 + len(_TAIL)


def content_digest(data: bytes | bytearray | memoryview) -> str:
    """By this files and artifacts are compared: 32 hexadecimal digits of SHA-256."""
    return hashlib.sha256(data).hexdigest()[:32]


def file_digest(path: Path) -> str:
    """The same of a file from outside, read in pieces.  Raises OSError."""
    return _sha256(path, MOST_CAPTURE_BYTES)[:32]


def sha256_of(path: Path) -> str:
    """All 64 digits of a file of the work folder, however large; "" where it cannot be read."""
    try:
        return _sha256(path, sys.maxsize)
    except OSError:
        return ""


def _sha256(path: Path, most: int) -> str:
    with os.fdopen(open_untrusted(path, most), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Damaged(WbflowError, ValueError):
    """Bytes that are not as they were written, or that belong to something else."""


class NoChecksum(Damaged):
    """Bytes without a checksum, as earlier versions wrote them: they are not believed."""


def with_checksum(of: str, content: Mapping[str, Any], in_lines: bool = False) -> bytes:
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


def checked(data: bytes, of: str) -> dict[str, Any]:
    """The entries of what `with_checksum` gave.

    Raises NoChecksum where it carries no checksum, Damaged where that is wrong, or it belongs to something else.
    """
    body = data[_BODY:]
    if not data.startswith(_HEAD):
        raise NoChecksum("carries no checksum")
    if data[len(_HEAD) : _BODY] != content_digest(body).encode() + _TAIL:
        raise Damaged("is damaged")
    content: dict[str, Any] = json.loads(b"{" + body)
    if (whose := content.pop("of", None)) != of:
        raise Damaged(f"belongs to {whose}")
    return content


def write_checksummed(path: Path, of: str, content: Mapping[str, Any]) -> None:
    """Put a file with a checksum into its place in the work folder.  Raises OSError."""
    write_atomic(path, with_checksum(of, content), ours=True)


def read_checksummed(path: Path, of: str) -> dict[str, Any] | None:
    """The entries of a file with a checksum; None where there is none, or one of an earlier version.

    Raises Damaged, naming the file, where its checksum is wrong, it belongs to something else, or it cannot be read.
    """
    try:
        return checked(read_untrusted(path), of)
    except NoChecksum:
        return None
    except Unreadable as error:
        if not os.path.lexists(path):
            return None
        raise Damaged(f"{path} {error.what}") from None
    except Damaged as error:
        raise Damaged(f"{path} {error}") from None
