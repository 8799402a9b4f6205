"""What the engine knows of a function: its arguments and its parameters, whose types check the values of the site file."""

from __future__ import annotations

import builtins
import json
import types
import typing
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

from pydantic import ConfigDict, PydanticUserError, TypeAdapter, ValidationError


@dataclass(frozen=True)
class Parameter:
    """A keyword-only parameter."""

    name: str
    default: Any = None
    source: str = ""
    """Source text of a default that is not a literal: only the function can evaluate it."""
    required: bool = False
    """There is no default."""
    annotation: str = "Any"
    """The type, written only with names of `typing` and built-ins."""

    @property
    def shown(self) -> str:
        """The default as text for people."""
        return self.source or ("none: it must be given" if self.required else repr(self.default))

    @property
    def choices(self) -> tuple[Any, ...]:
        """The values that `Literal` types accept."""
        return tuple(value for kind in _alternatives(self._type) if isinstance(kind, _LITERAL) for value in typing.get_args(kind))

    def problem(self, value: Any) -> str | None:
        """Return what is wrong with a value from the site file, as text; None if it is valid."""
        try:
            # strict validation of JSON accepts a list for a tuple and an integer for a float, but no other conversion
            TypeAdapter(self._type, config=_STRICT).validate_json(json.dumps(value))
        except PydanticUserError:  # of a name in quotes within the annotation, which only the function's module knows
            return None
        except (ValidationError, TypeError):
            kinds = [_type_name(kind) for kind in _alternatives(self._type) if not isinstance(kind, _LITERAL)]
            choices = ", ".join(map(str, self.choices))
            if not set(kinds) - {"None"} and choices:
                return f"{value!r} is not one of {choices}"
            return f"{value!r} is not of type {' or '.join(kinds)}{f' or one of {choices}' if choices else ''}"
        return None

    @cached_property
    def _type(self) -> Any:
        try:
            return eval(self.annotation, {"__builtins__": builtins, "typing": typing, **vars(typing)})
        except (TypeError, NameError):  # not a valid type in Python either, such as list[int, int, int]
            return Any


_STRICT = ConfigDict(strict=True, arbitrary_types_allowed=True)
_LITERAL = type(typing.Literal[0])


def _alternatives(kind: Any) -> tuple[Any, ...]:
    return typing.get_args(kind) if typing.get_origin(kind) in {typing.Union, types.UnionType} else (kind,)


def _type_name(kind: Any) -> str:
    if kind is type(None):
        return "None"
    return kind.__name__ if isinstance(kind, type) and not typing.get_args(kind) else str(kind).replace("typing.", "")


@dataclass(frozen=True)
class Argument:
    """An argument that is not keyword-only."""

    name: str
    required: bool
    by_name: bool = True
    """False for a positional-only argument."""


@dataclass(frozen=True)
class Signature:
    """The arguments and parameters of a function."""

    dotted: str
    """Name of the function, package.module:function."""
    arguments: tuple[Argument, ...]
    parameters: dict[str, Parameter]
    takes_any: bool
    """It has a `**` argument, which accepts any further keyword."""
    doc: str
    """Its docstring."""

    @property
    def names(self) -> set[str]:
        """The names of all arguments and parameters."""
        return {argument.name for argument in self.arguments} | self.parameters.keys()


class Functions(Protocol):
    """Knows the functions that a site uses (`functions.FunctionReader`)."""

    damage: str | None
    """What was wrong with the memo of earlier reads, in words; None if it was intact."""

    def code(self, dotted: str, table: str = "") -> str:
        """The fingerprint of all code that a function runs."""

    def libraries(self, dotted: str) -> tuple[str, ...]:
        """The import names of all libraries that a function's code imports."""

    def signature(self, dotted: str) -> Signature:
        """The signature of a function."""

    def table(self, dotted: str) -> dict[str, str]:
        """A table of methods: method name -> dotted function name."""

    def save(self) -> None:
        """Keep what was read for the next run.  Raises OSError."""
