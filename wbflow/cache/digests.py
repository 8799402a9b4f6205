"""The content digest by which files and artifacts are compared: 32 hexadecimal digits of SHA-256."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from .untrusted import open_outside


def content_digest(data: bytes | bytearray | memoryview) -> str:
    """Of bytes."""
    return hashlib.sha256(data).hexdigest()[:32]


def file_digest(path: Path) -> str:
    """Of a file from outside, read in pieces.  Raises OSError."""
    with os.fdopen(open_outside(path), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]
