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


def ply_bytes(columns: Columns, comments: tuple[str, ...] = ()) -> bytes | bytearray:
    """Return a PLY file with one vertex property for each column (1-D arrays of equal length)."""
    import numpy as np

    count = len(next(iter(columns.values())))
    dtype = np.dtype([(name, "<" + column.dtype.str[1:]) for name, column in columns.items()])
    properties = [f"property {_TYPES[column.dtype.str[1:]]} {name}" for name, column in columns.items()]
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {c}" for c in comments), f"element vertex {count}"]
    start = "\n".join([*header, *properties, "end_header", ""]).encode()
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
    lines = data[:end].decode("ascii", "replace").split("\n") if end >= 0 else []
    if lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise ValueError("not a binary little-endian PLY file")
    codes = {kind: code for code, kind in _TYPES.items()}
    header_words = [line.split() for line in lines]
    count = next(int(w[2]) for w in header_words if w[:2] == ["element", "vertex"])
    dtype: np.dtype[Any] = np.dtype([(w[2], "<" + codes[w[1]]) for w in header_words if w and w[0] == "property"])
    start = end + len(b"end_header\n")
    if len(data) - start < count * dtype.itemsize:
        raise ValueError(f"ends after {len(data):,} bytes, {count:,} points were promised")
    table = np.frombuffer(data, dtype=dtype, count=count, offset=start)
    return {name: table[name].copy() for name in dtype.names or ()}


def with_comments(ply: bytes, comments: tuple[str, ...]) -> bytes:
    """Return the PLY with further comments at the end of those in its header."""
    position = ply.index(b"element vertex")
    return b"".join([ply[:position], *(f"comment {comment}\n".encode() for comment in comments), memoryview(ply)[position:]])
