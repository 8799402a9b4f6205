"""Short reprs of dataclasses of arrays: dtype and shape instead of values; long sequences and texts are cut."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

_MOST_CHARACTERS, _MOST_ENTRIES = 80, 6


class Record:
    """Base of dataclasses whose repr is one line, such as `Matches(x1=float64 (812, 2), ..., matcher='mutual')`.

    Fields that hold their default value, or are declared with `repr=False`, are not shown.
    """

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.__repr__ = _record_repr  # type: ignore[method-assign]


def _record_repr(self: Any) -> str:
    parts = [f"{f.name}={_short(getattr(self, f.name))}" for f in dataclasses.fields(self) if f.repr and not _is_default(self, f)]
    return f"{type(self).__name__}({', '.join(parts)})"


def _is_default(record: Any, field: dataclasses.Field[Any]) -> bool:
    value = getattr(record, field.name)
    if hasattr(value, "shape"):
        return False
    default = field.default_factory() if field.default_factory is not dataclasses.MISSING else field.default
    return bool(type(value) is type(default) and (value is default or value == default or value != value))


def _short(value: Any) -> str:
    if hasattr(value, "shape") and hasattr(value, "dtype"):
        return f"{value.dtype} {tuple(value.shape)}" if value.shape else repr(value.item())
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return f"{{{_joined([f'{key!r}: {_short(entry)}' for key, entry in value.items()])}}}"
    if isinstance(value, tuple | list):
        return f"({_joined([_short(entry) for entry in value])})"
    text = repr(value)
    return text if len(text) <= _MOST_CHARACTERS or dataclasses.is_dataclass(value) else f"{text[: _MOST_CHARACTERS - 3]}..."


def _joined(entries: list[str]) -> str:
    left_out = len(entries) - _MOST_ENTRIES
    return ", ".join(entries if left_out <= 0 else [*entries[:_MOST_ENTRIES], f"... {left_out} more"])
