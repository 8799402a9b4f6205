"""What is remembered carries a checksum of its own content, and says what it is of.

A receipt or memo is one JSON object whose first entry is the checksum of all bytes that follow it: it is checked without being
written anew, and people and programs read it as what it is.  The checksum finds chance and mistakes (a failing disk, an editor,
two files exchanged), not malice: whoever may write to the work folder is trusted with it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from .artifact import digest
from .atomic import write_atomic
from .untrusted import Unreadable, read_outside

_HEAD, _TAIL, _LENGTH = b'{"signed":"', b'",', 32
_BODY = len(_HEAD) + _LENGTH + len(_TAIL)


class Damaged(WbflowError, ValueError):
    """Bytes that are not as they were written, or that belong to something else."""


class Unsigned(Damaged):
    """Bytes of an earlier version, which signed nothing: they are not believed."""


def signed(of: str, content: Mapping[str, Any], in_lines: bool = False) -> bytes:
    """A JSON object with its checksum and what it is of.

    Parameters
    ----------
    of : str
        What it belongs to: a task and its key, the name of a memo.
    content : mapping
        Its entries; none may be called "signed" or "of".
    in_lines : bool
        For files that people read.
    """
    told = {"of": of, **content}
    return sign((lines_of(told) if in_lines else json.dumps(told, separators=(",", ":"))).encode())


def lines_of(content: Mapping[str, Any]) -> str:
    """A JSON object for people: an entry a line, and of one that holds many an item a line.  (`json` indents twenty times as
    slowly as it writes.)"""
    return "{\n " + ",\n ".join(f"{json.dumps(name)}: {_items(entry)}" for name, entry in content.items()) + "\n}"


def _items(entry: Any) -> str:
    if isinstance(entry, Mapping) and entry:
        return "{\n  " + ",\n  ".join(f"{json.dumps(name)}: {json.dumps(item)}" for name, item in entry.items()) + "\n }"
    if isinstance(entry, list | tuple) and entry:
        return "[\n  " + ",\n  ".join(map(json.dumps, entry)) + "\n ]"
    return json.dumps(entry)


def sign(body: bytes) -> bytes:
    """The same of a JSON object that is text already, and says what it is of."""
    return b"".join([_HEAD, digest(body[1:]).encode(), _TAIL, body[1:]])


def unsigned(data: bytes, of: str) -> dict[str, Any]:
    """The entries of what `signed` gave.

    Raises
    ------
    Unsigned
        It carries no checksum.
    Damaged
        The checksum is wrong, or it belongs to something else.
    """
    body = data[_BODY:]
    if data[: len(_HEAD)] != _HEAD:
        raise Unsigned("carries no checksum")
    if data[len(_HEAD) : _BODY] != digest(body).encode() + _TAIL:
        raise Damaged("is damaged")
    content: dict[str, Any] = json.loads(b"{" + body)
    if (whose := content.pop("of", None)) != of:
        raise Damaged(f"belongs to {whose}")
    return content


def write_signed(path: Path | str, of: str, content: Mapping[str, Any], *, settle: bool = True, lasts: bool = True) -> None:
    """Put a signed file into its place.

    Parameters
    ----------
    path : Path or str
        Where.
    of : str
        What it belongs to.
    content : mapping
        Its entries (see `signed`).
    settle, lasts : bool
        See `write_atomic`.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    write_atomic(path, signed(of, content), settle=settle, lasts=lasts, ours=True)


def read_signed(path: Path | str, of: str) -> dict[str, Any] | None:
    """The entries of a signed file; None where there is none, or one of an earlier version.

    Raises
    ------
    Damaged
        Its checksum is wrong, it belongs to something else, or it cannot be read; the message names the file.
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
