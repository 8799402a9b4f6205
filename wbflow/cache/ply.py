"""Binary little-endian PLY files: named columns of a cloud to bytes, and back."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .untrusted import read_untrusted

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Columns = Mapping[str, npt.NDArray[Any]]

_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "i1": "char", "u2": "ushort", "i2": "short", "u4": "uint", "i4": "int"}
"""Names of the format for numpy's types."""
_CODES = {name: code for code, name in _TYPES.items()}
"""Numpy's types by the names of the format."""


def ply_bytes(columns: Columns, comments: tuple[str, ...] = ()) -> bytes | bytearray:
    """Return a PLY file with one vertex property for each column (1-D arrays of equal length)."""
    import numpy as np

    # 1. The header, and the layout of one vertex.
    count = len(next(iter(columns.values())))
    lines = ["ply", "format binary_little_endian 1.0"]
    for comment in comments:
        lines.append(f"comment {comment}")
    lines.append(f"element vertex {count}")
    row_layout = []
    for name, column in columns.items():
        code = column.dtype.str[1:]  # without the mark of the byte order
        lines.append(f"property {_TYPES[code]} {name}")
        row_layout.append((name, f"<{code}"))
    lines += ["end_header", ""]
    start = "\n".join(lines).encode()

    # 2. The rows.
    dtype = np.dtype(row_layout)
    data = bytearray(len(start) + count * dtype.itemsize)  # filled in place: a cloud can take as much memory as all else
    data[: len(start)] = start
    table = np.frombuffer(data, dtype, count, len(start))
    for name, column in columns.items():
        table[name] = column
    return data


def read_ply(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the vertex columns of a binary little-endian PLY file by name.

    Raises ValueError for another PLY format, or fewer bytes than the header states.  List properties are not supported.
    """
    try:
        return columns_of(read_untrusted(path, most=sys.maxsize))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def columns_of(data: bytes) -> dict[str, npt.NDArray[Any]]:
    """Return the vertex columns of the bytes of a binary little-endian PLY file by name.  Raises ValueError."""
    import numpy as np

    end = data.find(b"end_header\n")
    lines = []
    if end >= 0:
        lines = data[:end].decode("ascii", "replace").split("\n")
    if lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise ValueError("not a binary little-endian PLY file")
    header_words = [line.split() for line in lines]
    count = next(int(words[2]) for words in header_words if words[:2] == ["element", "vertex"])
    row_layout = []
    for words in header_words:
        if words and words[0] == "property":
            row_layout.append((words[2], f"<{_CODES[words[1]]}"))
    dtype: np.dtype[Any] = np.dtype(row_layout)
    start = end + len(b"end_header\n")
    if len(data) - start < count * dtype.itemsize:
        raise ValueError(f"ends after {len(data):,} bytes, {count:,} points were promised")
    table = np.frombuffer(data, dtype=dtype, count=count, offset=start)
    # copies: a view would keep all columns in memory for the sake of one
    return {name: table[name].copy() for name in dtype.names or ()}


def with_comments(ply: bytes, comments: tuple[str, ...]) -> bytes:
    """Return the PLY with further comments at the end of those in its header."""
    position = ply.index(b"element vertex")
    lines = [f"comment {comment}\n".encode() for comment in comments]
    return b"".join([ply[:position], *lines, memoryview(ply)[position:]])  # the points are copied only once
