"""What an ONNX model takes and gives, read from its bytes: names and sizes of inputs and outputs, and nothing else.

OpenCV runs a model, but does not say what it asks for until it is given something else.  The fields are those of onnx.proto
(ModelProto.graph 7; GraphProto.initializer 5, input 11, output 12; ValueInfoProto.name 1, type 2; TypeProto.tensor_type 1;
TypeProto.Tensor.shape 2; TensorShapeProto.dim 1; Dimension.dim_value 1; TensorProto.name 8) in the wire format of Protocol
Buffers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

_VARINT, _EIGHT_BYTES, _BYTES, _FOUR_BYTES = 0, 1, 2, 5
"""Wire types."""


@dataclass(frozen=True)
class ModelInterface:
    """What a model takes and gives."""

    inputs: dict[str, tuple[int, ...]]
    """Sizes by name, 0 where any will do."""
    outputs: tuple[str, ...]


def read_interface(model: bytes) -> ModelInterface:
    """The interface of an ONNX model.  Raises ValueError for bytes that are none."""
    try:
        (graph,) = _parts(memoryview(model), 7)
        weights = {_text(tensor, 8) for tensor in _parts(graph, 5)}  # which old models list among their inputs
        inputs = {_text(value, 1): _sizes(value) for value in _parts(graph, 11)}
        outputs = tuple(_text(value, 1) for value in _parts(graph, 12))
    except (IndexError, ValueError):  # UnicodeDecodeError is one
        raise ValueError("is no ONNX model") from None
    return ModelInterface({name: sizes for name, sizes in inputs.items() if name not in weights}, outputs)


def _sizes(value: memoryview) -> tuple[int, ...]:
    """The sizes of an input, which need not be stated."""
    for kind in _parts(value, 2):
        for tensor in _parts(kind, 1):
            for shape in _parts(tensor, 2):
                return tuple(next((n for f, n in _fields(dim) if f == 1 and isinstance(n, int)), 0) for dim in _parts(shape, 1))
    return ()


def _text(message: memoryview, field: int) -> str:
    return next((bytes(part).decode() for part in _parts(message, field)), "")


def _parts(message: memoryview, field: int) -> list[memoryview]:
    """The texts, bytes or messages of a field."""
    return [value for number, value in _fields(message) if number == field and isinstance(value, memoryview)]


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of each field.  Raises IndexError or ValueError where the message is cut or none."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        if tag & 7 == _VARINT:
            value, at = _varint(message, at)
            yield tag >> 3, value
            continue
        length = {_EIGHT_BYTES: 8, _FOUR_BYTES: 4}.get(tag & 7, 0)
        if tag & 7 == _BYTES:
            length, at = _varint(message, at)
        elif not length:
            raise ValueError("no such wire type")
        if at + length > len(message):
            raise IndexError
        yield tag >> 3, message[at : at + length]
        at += length


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("no number")
