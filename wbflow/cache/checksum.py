"""JSON files that contain a checksum of their content and the identity of what they describe.

A receipt or memo is one JSON object whose first entry is the checksum of all bytes that follow it.  It can be checked without
serializing it again, and remains ordinary JSON.  The checksum detects accidents (a failing disk, an edit, two files swapped), not
malice: anyone who may write to the work folder is trusted.
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

_DIGITS = 32
"""Hexadecimal digits of a digest: 128 bits."""
_HEAD = b'{"signed":"'  # the entry keeps the name that the first version gave it
"""What a file with a checksum begins with; the digest follows."""
_TAIL = b'",'
"""What follows the digest; the rest of the file is what the digest covers."""
_BODY_START = len(_HEAD) + _DIGITS + len(_TAIL)
"""Position of the bytes that the digest covers."""


def content_digest(data: bytes | bytearray | memoryview) -> str:
    """Return the digest by which files and artifacts are compared: the first 32 hexadecimal digits of SHA-256."""
    return hashlib.sha256(data).hexdigest()[:_DIGITS]


def file_digest(path: Path) -> str:
    """Return the content digest of a file from outside, read in chunks.  Raises OSError."""
    return _sha256(path, MOST_CAPTURE_BYTES)[:_DIGITS]


def sha256_of(path: Path) -> str:
    """Return the full SHA-256 (64 hex digits) of a file of the work folder, whatever its size; "" if it cannot be read."""
    try:
        return _sha256(path, sys.maxsize)
    except OSError:
        return ""


def _sha256(path: Path, most_bytes: int) -> str:
    with os.fdopen(open_untrusted(path, most_bytes), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Damaged(WbflowError, ValueError):
    """The bytes differ from those that were written, or describe something else."""


class NoChecksum(Damaged):
    """The bytes carry no checksum, as in files of earlier versions; all such files but run.json are treated as missing."""


def dump_with_checksum(of: str, content: Mapping[str, Any], in_lines: bool = False) -> bytes:
    """Return a JSON object with its checksum and the identity of what it describes.

    of: the identity: stage/subject/key.json for a receipt, the name of a memo.  content: entries, none of which may be named
    "signed" or "of".  in_lines: write one entry per line, for files that people read.
    """
    entries = {"of": of, **content}
    if in_lines:
        text = dump_in_lines(entries)
    else:
        text = json.dumps(entries, separators=(",", ":"))
    body = text.encode()[1:]  # without the brace, with which the head begins
    return _HEAD + content_digest(body).encode() + _TAIL + body


def dump_in_lines(content: Mapping[str, Any]) -> str:
    """Return a JSON object for people, with one entry per line, or one item per line for entries that are lists or objects.
    (`json.dumps` takes twenty times as long with indentation as without.)"""
    lines = [f"{json.dumps(name)}: {_entry_lines(entry)}" for name, entry in content.items()]
    return "{\n " + ",\n ".join(lines) + "\n}"


def _entry_lines(entry: Any) -> str:
    """An entry as JSON, with one item per line if it is a list or an object."""
    if isinstance(entry, Mapping) and entry:
        items = [f"{json.dumps(name)}: {json.dumps(item)}" for name, item in entry.items()]
        return "{\n  " + ",\n  ".join(items) + "\n }"
    if isinstance(entry, list | tuple) and entry:
        items = [json.dumps(item) for item in entry]
        return "[\n  " + ",\n  ".join(items) + "\n ]"
    return json.dumps(entry)


def parse_checksummed(data: bytes, of: str) -> dict[str, Any]:
    """Return the entries of an object that `dump_with_checksum` wrote.

    Raises NoChecksum if it has no checksum, Damaged if the checksum is wrong or `of` does not match.
    """
    body = data[_BODY_START:]
    if not data.startswith(_HEAD):
        raise NoChecksum("carries no checksum")
    if data[len(_HEAD) : _BODY_START] != content_digest(body).encode() + _TAIL:
        raise Damaged("is damaged")
    content: dict[str, Any] = json.loads(b"{" + body)
    identity = content.pop("of", None)
    if identity != of:  # an intact file in a wrong place: copied, or two were swapped
        raise Damaged(f"belongs to {identity}")
    return content


def write_checksummed(path: Path, of: str, content: Mapping[str, Any]) -> None:
    """Write a file with a checksum to the work folder, atomically.  Raises OSError."""
    write_atomic(path, dump_with_checksum(of, content), own_path=True)


def read_checksummed(path: Path, of: str) -> dict[str, Any] | None:
    """Return the entries of a file with a checksum; None if the file is missing or has no checksum (earlier versions).

    Raises Damaged, which names the file, if the checksum is wrong, `of` does not match, or the file cannot be read.
    """
    try:
        return parse_checksummed(read_untrusted(path), of)
    except NoChecksum:
        return None
    except Unreadable as error:
        # a dangling link counts as damage, not as missing
        if not os.path.lexists(path):
            return None
        raise Damaged(f"{path} {error.what}") from None
    except Damaged as error:
        raise Damaged(f"{path} {error}") from None
