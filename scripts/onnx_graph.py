"""Shared by the scripts that write networks as ONNX files: weights read without PyTorch, and a graph that collects nodes."""

from __future__ import annotations

import io
import pickle
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import helper, numpy_helper

Array = NDArray[Any]
Weights = Mapping[str, Array]

_STORAGES = {"FloatStorage": np.float32, "LongStorage": np.int64}
"""Type of the numbers in each kind of storage of PyTorch."""


def state_dict(path: Path) -> Weights:
    """The arrays of a PyTorch state dict by name, read without PyTorch: a ZIP archive of a pickle and one file per storage."""
    with zipfile.ZipFile(path) as archive:
        pickled = next(name for name in archive.namelist() if name.endswith("data.pkl"))
        folder = pickled.removesuffix("data.pkl")

        def storage(key: str, kind: str) -> Array:
            return np.frombuffer(archive.read(f"{folder}data/{key}"), _STORAGES[kind])

        weights: Weights = _Unpickler(archive.read(pickled), storage).load()
    return weights


class _Unpickler(pickle.Unpickler):
    """Reads tensors as arrays; refuses every other kind of object."""

    def __init__(self, data: bytes, storage: Callable[[str, str], Array]) -> None:
        super().__init__(io.BytesIO(data))
        self._storage = storage

    def find_class(self, module: str, name: str) -> Any:
        if name in _STORAGES:
            return name
        if name == "OrderedDict":
            return OrderedDict
        if name == "_rebuild_tensor_v2":
            return _tensor
        raise pickle.UnpicklingError(f"{module}.{name} is no part of a state dict")

    def persistent_load(self, pid: Any) -> Array:
        _, kind, key, *_ = pid
        return self._storage(key, kind)


def _tensor(storage: Array, offset: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any) -> Array:
    """A tensor from its storage; strides count elements."""
    strides = [step * storage.itemsize for step in stride]
    return np.array(np.lib.stride_tricks.as_strided(storage[offset:], size, strides))


class Graph:
    """Collects the nodes and constants of a model; each method adds one node and returns the name of its output."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self._names: dict[tuple[bytes, str, tuple[int, ...]], str] = {}

    def add(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Add a node of this kind."""
        output = f"{kind.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [output], **attributes))
        return output

    def constant(self, value: Any, kind: Any = np.float32) -> str:
        """Add an array as a constant; equal ones are stored once."""
        array = np.asarray(value, kind)
        key = (array.tobytes(), array.dtype.str, array.shape)
        if key not in self._names:
            self._names[key] = f"constant_{len(self.constants)}"
            self.constants.append(numpy_helper.from_array(np.ascontiguousarray(array).reshape(array.shape), self._names[key]))
        return self._names[key]

    def integers(self, *values: int) -> str:
        """Add a vector of int64: a shape, axes, starts or ends."""
        return self.constant(values, np.int64)

    def name_outputs(self, outputs: Mapping[str, str]) -> None:
        """Give outputs of nodes the names that the model's interface has; outputs: the node's output by this name."""
        for name, output in outputs.items():
            self.nodes.append(helper.make_node("Identity", [output], [name]))
