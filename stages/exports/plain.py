"""Dataclasses of arrays as ordinary files, and back without loss: images as PNG, tables as CSV, other arrays as npy, and JSON
for everything else, which also names the files."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ..core.on_demand import OnDemand
from ..types import Capture

MOST_INLINE = 64
"""Arrays of at most this many numbers are stored in the JSON itself."""
MOST_COLUMNS = 16
"""Largest number of columns of a CSV table; images have more."""
MOST_ROWS = 20_000
"""Largest number of rows of a CSV table, for people to read; larger arrays are npy."""
_FORMATS = {"f8": "%.17g", "f4": "%.9g"}
"""Formats with enough digits to distinguish all numbers of a type."""

Array = npt.NDArray[Any]


def write(value: Any, folder: Path, stem: str) -> Any:
    """Write a dataclass, an array, a number, a string, None, or a mapping or sequence of these; returns JSON data for `read`.

    folder: where the files go; stem: prefix of their names, to which fields and entries are appended with dots.
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return _write_array(np.asarray(value), folder, stem)
    if isinstance(value, Capture):
        file = f"{stem}.{Path(value.name).name}"
        (folder / file).write_bytes(value.data.tobytes())
        return {"capture": value.name, "file": file}
    if dataclasses.is_dataclass(value):
        fields = {}
        for field in dataclasses.fields(value):
            if field.metadata.get("transient"):  # recomputed by the reader
                continue
            fields[field.name] = write(getattr(value, field.name), folder, f"{stem}.{field.name}")
        return {"type": f"{type(value).__module__}:{type(value).__qualname__}", "fields": fields}
    if isinstance(value, Mapping):
        entries = []
        for key in value:
            if isinstance(key, tuple):
                name = "--".join(map(str, key))
                stored_key: Any = list(key)
            else:
                name = key
                stored_key = key
            entries.append([stored_key, write(value[key], folder, f"{stem}.{name}")])
        return {"map": entries}
    if isinstance(value, tuple | list):
        items = [write(item, folder, f"{stem}.{i}") for i, item in enumerate(value)]
        return {type(value).__name__: items}
    raise TypeError(f"{type(value).__name__} cannot be written as files")


def read(node: Any, folder: Path) -> Any:
    """The value that was given to `write`.  Entries of a mapping are read on access."""
    if not isinstance(node, dict):
        return node
    if "dtype" in node:
        return _read_array(node, folder)
    if "capture" in node:
        return Capture(node["capture"], np.fromfile(folder / node["file"], dtype=np.uint8))
    if "map" in node:
        nodes = {}
        for key, entry in node["map"]:
            nodes[tuple(key) if isinstance(key, list) else key] = entry  # JSON has no tuples
        return OnDemand(nodes, lambda key: read(nodes[key], folder))
    if "tuple" in node:
        return tuple(read(item, folder) for item in node["tuple"])
    if "list" in node:
        return [read(item, folder) for item in node["list"]]
    module, _, name = node["type"].partition(":")
    kind: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return kind(**{field: read(entry, folder) for field, entry in node["fields"].items()})


def _write_array(array: Array, folder: Path, stem: str) -> dict[str, Any]:
    """Write an array as the most readable file that holds it without loss; returns its JSON data."""
    node = {"dtype": array.dtype.str, "shape": list(array.shape)}
    if array.size <= MOST_INLINE:
        return node | {"values": array.ravel().tolist()}
    image = _png_image(array)
    if image is not None:
        file = f"{stem}.png"
        _, data = cv2.imencode(".png", image)
        (folder / file).write_bytes(data.tobytes())
    elif _is_table(array):
        file = f"{stem}.csv"
        np.savetxt(folder / file, array, _FORMATS.get(array.dtype.str[1:], "%d"), ",")
    else:
        file = f"{stem}.npy"
        np.save(folder / file, array, allow_pickle=False)
    return node | {"file": file}


def _is_table(array: Array) -> bool:
    """Is it a short list or a narrow table of numbers?"""
    if array.ndim > 2 or array.dtype.kind not in "fiub":
        return False
    return len(array) <= MOST_ROWS and array.size <= MOST_COLUMNS * len(array)


def _read_array(node: dict[str, Any], folder: Path) -> Array:
    """The array of which `_write_array` returned `node`."""
    dtype = np.dtype(node["dtype"])
    shape = tuple(node["shape"])
    if "values" in node:
        return np.array(node["values"], dtype=dtype).reshape(shape)
    path = folder / node["file"]
    if path.suffix == ".png":
        data: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if len(shape) == 3:
            data = data[..., ::-1]  # OpenCV's channels are blue, green, red
        return np.ascontiguousarray(data).astype(dtype).reshape(shape)
    if path.suffix == ".csv":
        parsed_type = np.float64 if dtype.kind == "f" else np.int64
        return np.loadtxt(path, dtype=parsed_type, delimiter=",", ndmin=1).astype(dtype).reshape(shape)
    loaded: Array = np.load(path, allow_pickle=False)
    return loaded


def _png_image(array: Array) -> Any:
    """An array in OpenCV's channel order and type if PNG can store it without loss as an image, else None."""
    if array.ndim == 3 and array.shape[2] == 3 and array.dtype == np.uint8:
        return array[..., ::-1]
    if array.ndim == 2 and min(array.shape) > MOST_COLUMNS:
        if array.dtype == bool:
            return array.astype(np.uint8) * 255
        if array.dtype in {np.dtype(np.uint8), np.dtype(np.uint16)}:
            return array
    return None
