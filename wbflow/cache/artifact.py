"""How a dataclass of arrays becomes bytes and back: a JSON header, then one zstd frame for each array.  No pickle, ever.

Layout: b"WBF1", length of the header (uint32, little-endian), header (JSON), array frames.  Equal objects give equal bytes.
The header alone rebuilds an object that holds no arrays, so small artifacts are read without importing numpy.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib
import json
import math
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import WbflowError
from .untrusted import open_outside

MAGIC = b"WBF1"
_SCALARS = (bool, int, float, str)  # `bool | int` would be made anew at each look
_MINE = threading.local()
"""Compressor and decompressor of each thread: making one takes ten times as long as a small array."""


class ArtifactError(WbflowError, ValueError):
    """The bytes are not an intact artifact."""


def encode(value: Any) -> bytes:
    """Bytes of a dataclass whose fields are arrays, scalars, strings, tuples, mappings or further dataclasses.

    Raises
    ------
    TypeError
        A field holds something else, and is not marked `transient` (such fields are left out).
    """
    frames: list[bytes] = []
    tree = _tree(value, frames)
    header = json.dumps(tree, separators=(",", ":"), sort_keys=False).encode()
    return b"".join([MAGIC, len(header).to_bytes(4, "little"), header, *frames])


def decode(data: bytes) -> Any:
    """The object that `encode` was given (arrays are writable copies).

    Raises
    ------
    ArtifactError
        The bytes are cut short or not an artifact.
    """
    tree, end = _header(data)
    return _untree(tree, _Frames(memoryview(data), end))


@dataclass
class Opened:
    """The bytes of an artifact of which parts are wanted, again and again: each is rebuilt on its own, for its caller."""

    data: bytes
    _places: dict[tuple[str, str | None], tuple[Any, int]] = dataclasses.field(default_factory=dict)
    """Header and first frame of each field, and of each entry of a field that is a mapping."""

    def __post_init__(self) -> None:
        tree, end = _header(self.data)
        position = end
        for name, node in tree["fields"].items():
            self._places[name, None] = node, position
            start = position
            for key, entry in node["map"] if isinstance(node, dict) and "map" in node else ():
                if isinstance(key, str):
                    self._places[name, key] = entry, start
                start += _frame_bytes(entry)
            position += _frame_bytes(node)

    def part(self, field: str, entry: str | None) -> Any:
        """A field, or an entry of one that is a mapping.  Raises ArtifactError, KeyError."""
        node, position = self._places[field, entry]
        return _untree(node, _Frames(memoryview(self.data), position))


def _frame_bytes(node: Any) -> int:
    """Bytes of all array frames below a node of the header."""
    if isinstance(node, list):
        return sum(map(_frame_bytes, node))
    if not isinstance(node, dict):
        return 0
    if "array" in node:
        return int(node["bytes"])
    if "map" in node:
        return sum(_frame_bytes(entry) for _, entry in node["map"])
    return _frame_bytes(node["tuple"]) if "tuple" in node else sum(map(_frame_bytes, node["fields"].values()))


def _header(data: bytes) -> tuple[Any, int]:
    """The header of an artifact, and where its frames begin.  Raises ArtifactError."""
    if data[:4] != MAGIC or len(data) < 8:
        raise ArtifactError("not a wbflow artifact")
    end = 8 + int.from_bytes(data[4:8], "little")
    try:
        return json.loads(data[8:end]), end
    except ValueError as error:
        raise ArtifactError(f"unreadable header: {error}") from error


def digest(data: bytes | bytearray | memoryview) -> str:
    """The content digest by which artifacts are compared: 32 hexadecimal digits of SHA-256."""
    return hashlib.sha256(data).hexdigest()[:32]


def file_digest(path: Path) -> str:
    """`digest` of a file from outside, read in pieces.  Raises OSError."""
    with os.fdopen(open_outside(path), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]


def parts(value: Any) -> dict[str, str]:
    """Digests of what can be needed on its own: each dataclass field, and each dataclass entry of a mapping field.

    A task that needs only `frames.view` or `poses.cameras[gate]` is not run again when something else in there changes.
    """
    found: dict[str, str] = {}
    for name in _kept(value):
        field = getattr(value, name)
        if dataclasses.is_dataclass(field):
            found[name] = digest(encode(field))
        elif isinstance(field, Mapping):
            found |= {f"{name}[{key}]": digest(encode(entry)) for key, entry in field.items() if dataclasses.is_dataclass(entry)}
            found[name] = digest(json.dumps([(_key(k), found.get(f"{name}[{k}]", "")) for k in field]).encode())
    return found


def figures(value: Any) -> dict[str, Any]:
    """Plain fields of a dataclass by name: scalars, tuples, small dataclasses, mappings and tuples of them; rows of its arrays as
    `<field>_count`.  A field whose metadata say `figure=False` is left out."""
    found: dict[str, Any] = {}
    left_out = {field.name for field in dataclasses.fields(value) if not field.metadata.get("figure", True)}
    for name in _kept(value):
        field = getattr(value, name)
        if name in left_out:
            continue
        if _is_plain(field):
            found[name] = field
        elif isinstance(field, tuple) and all(map(_is_small, field)):
            found[name] = [figures(entry) for entry in field]
        elif isinstance(field, Mapping) and all(map(_is_small, field.values())):
            found[name] = {key: figures(entry) for key, entry in field.items()}
        elif dataclasses.is_dataclass(field) and all(_is_plain(getattr(field, f.name)) for f in dataclasses.fields(field)):
            found[name] = figures(field)
        elif hasattr(field, "shape") and field.shape:
            found[f"{name}_count"] = int(field.shape[0])
    return found


def _kept(value: Any) -> tuple[str, ...]:
    """Names of a dataclass's fields, without those marked `transient`: they are found again where they are missing."""
    kind: Any = type(value)
    return _kept_of(kind)


@functools.lru_cache
def _kept_of(kind: Any) -> tuple[str, ...]:
    return tuple(f.name for f in dataclasses.fields(kind) if not f.metadata.get("transient"))


@functools.lru_cache
def _names_of(kind: Any) -> frozenset[str]:
    return frozenset(f.name for f in dataclasses.fields(kind))


def _is_small(value: Any) -> bool:
    """A dataclass of nothing but scalars and words."""
    fields = [getattr(value, f.name) for f in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else [()]
    return all(isinstance(field, _SCALARS) for field in fields)


def _is_plain(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    if isinstance(value, Mapping):
        return all(isinstance(key, str) and _is_plain(entry) for key, entry in value.items())
    return value is None or isinstance(value, (bool, int, str)) or (isinstance(value, float) and math.isfinite(value))


def _tree(value: Any, frames: list[bytes]) -> Any:
    if value is None or isinstance(value, _SCALARS):
        return value
    if hasattr(value, "dtype"):
        return _array_tree(value, frames)
    if dataclasses.is_dataclass(value):
        kind = type(value)
        fields = {name: _tree(getattr(value, name), frames) for name in _kept(value)}
        return {"type": f"{kind.__module__}:{kind.__qualname__}", "fields": fields}
    if isinstance(value, Mapping):
        return {"map": [[_key(key), _tree(entry, frames)] for key, entry in value.items()]}
    if isinstance(value, tuple | list):
        return {"tuple": [_tree(item, frames) for item in value]}
    raise TypeError(f"{type(value).__name__} cannot be kept in an artifact")


def _key(key: Any) -> Any:
    return list(key) if isinstance(key, tuple) else key


def _array_tree(array: Any, frames: list[bytes]) -> Any:
    import numpy as np

    shape = list(array.shape)
    array = np.ascontiguousarray(array)
    if array.dtype.byteorder == ">":
        array = array.astype(array.dtype.newbyteorder("<"))
    if array.dtype.hasobject:
        raise TypeError("an array of Python objects cannot be kept in an artifact")
    frames.append(_compressor().compress(array.tobytes()))
    return {"array": array.dtype.str, "shape": shape, "bytes": len(frames[-1])}


def _compressor() -> Any:
    if not hasattr(_MINE, "compressor"):
        import zstandard

        _MINE.compressor = zstandard.ZstdCompressor(level=1)
    return _MINE.compressor


def _decompressor() -> Any:
    if not hasattr(_MINE, "decompressor"):
        import zstandard

        _MINE.decompressor = zstandard.ZstdDecompressor()
    return _MINE.decompressor


@dataclass
class _Frames:
    """The array frames of an artifact, which lie in the order in which the header names them."""

    data: memoryview
    position: int

    def next(self, size: int) -> memoryview:
        """The frame of an array."""
        self.position += size
        return self.data[self.position - size : self.position]


def _untree(node: Any, frames: _Frames) -> Any:
    """Rebuild depth first."""
    if not isinstance(node, dict):
        return node
    if "array" in node:
        return _array(node, frames.next(node["bytes"]))
    if "tuple" in node:
        return tuple(_untree(item, frames) for item in node["tuple"])
    if "map" in node:
        return {tuple(key) if isinstance(key, list) else key: _untree(entry, frames) for key, entry in node["map"]}
    kind = _dataclass(node["type"])
    fields = {name: _untree(tree, frames) for name, tree in node["fields"].items()}
    known = _names_of(kind)
    return kind(**{name: value for name, value in fields.items() if name in known})


def _array(node: dict[str, Any], frame: memoryview) -> Any:
    import numpy as np
    import zstandard

    try:
        raw = _decompressor().decompress(frame)
        return np.frombuffer(bytearray(raw), dtype=np.dtype(node["array"])).reshape(node["shape"])
    except (zstandard.ZstdError, ValueError) as error:
        raise ArtifactError(f"damaged array: {error}") from error


def _dataclass(name: str) -> Any:
    """By its name in an artifact: each time anew, since modules beside a site file are forgotten with it."""
    module, _, qualified = name.partition(":")
    kind: Any = importlib.import_module(module)
    for attribute in qualified.split("."):
        kind = getattr(kind, attribute)
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        raise ArtifactError(f"{name} is not a dataclass")
    return kind
