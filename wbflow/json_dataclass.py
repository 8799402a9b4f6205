"""Dataclasses that are read from JSON and written to it; unknown keys are ignored."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Self, TypeVar

from pydantic import TypeAdapter, model_serializer, model_validator

_T = TypeVar("_T")

DIGITS = 4
"""Decimal places of numbers in JSON."""


class JsonDataclass:
    """Base of dataclasses that convert to and from JSON."""

    def to_json(self) -> dict[str, Any]:
        """Return its fields by name, numbers rounded."""
        kind: Any = type(self)
        data: dict[str, Any] = rounded(_adapter(kind).dump_python(self))
        return data

    @classmethod
    def from_json(cls, data: Any) -> Self:
        """Return the dataclass with these fields.  Raises ValueError if the data does not fit."""
        return read_json(cls, data)


class FlatJsonDataclass(JsonDataclass):
    """Base of dataclasses whose `figures` are written to JSON flat, alongside the other fields."""

    @model_validator(mode="before")
    @classmethod
    def _nest(cls, data: Any) -> Any:
        return {**data, "figures": data} if isinstance(data, Mapping) else data

    @model_serializer(mode="wrap")
    def _flatten(self, write: Any) -> dict[str, Any]:
        data = write(self)
        return {**data.pop("figures"), **data}


def read_json(kind: type[_T], data: Any) -> _T:
    """Return the dataclass of this type with these fields.  Raises ValueError if the data does not fit."""
    any_kind: Any = kind
    result: _T = _adapter(any_kind).validate_python(data)
    return result


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def rounded(value: Any) -> Any:
    """Return a value with floats rounded to `DIGITS`, also in mappings; numbers in lists (corners of boxes) stay as they are."""
    if isinstance(value, Mapping):
        return {key: rounded(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(entry) if isinstance(entry, Mapping) else entry for entry in value]
    return round(value, DIGITS) if isinstance(value, float) else value
