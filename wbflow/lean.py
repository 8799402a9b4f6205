"""Data classes that cost next to nothing before they are used, for a program that is started often.

The standard library compiles five or six methods for each class when its module is imported, which took a fifth of a run that
finds nothing to do.  Here `__init__` is compiled when the first object is made, and the other methods are shared, not compiled.
What stands for the fields is the standard library's own: `fields`, `replace`, `asdict` work as ever.
"""

from __future__ import annotations

import dataclasses
import operator
import reprlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls: type | None = None, /, *, frozen: bool = False) -> Any:
        """Make a data class; frozen: its objects cannot be changed, and can be keys."""
        return (lambda given: _made(given, frozen)) if cls is None else _made(cls, frozen)


def _made(cls: Any, frozen: bool) -> Any:
    own = vars(cls)
    methods: dict[str, Any] = {"__repr__": _repr(cls), "__eq__": _eq(cls)}
    if frozen:
        methods |= {"__setattr__": _refusal(cls, "assign to"), "__delattr__": _refusal(cls, "delete")}
    given = {name for name in methods if name in own}
    if "__eq__" not in given or "__hash__" not in own:
        methods["__hash__"] = _hash(cls) if frozen else None
    if own.get("__hash__") is not None:
        given.add("__hash__")
    dataclasses.dataclass(init=False, repr=False, eq=False)(cls)
    if "__init__" not in own:
        cls.__init__ = _first_init(cls, frozen)
    for name, method in methods.items():
        if name not in given:
            setattr(cls, name, method)
    return cls


def _first_init(cls: Any, frozen: bool) -> Callable[..., None]:
    """An `__init__` that makes the real one."""

    def __init__(self: Any, *args: Any, **named: Any) -> None:
        cls.__init__ = _init(cls, frozen)
        cls.__init__(self, *args, **named)

    return __init__


def _init(cls: Any, frozen: bool) -> Callable[..., None]:
    """Sets every field, then lets the class look at them."""
    known: dict[str, Any] = {"_set": object.__setattr__, "_none": dataclasses.MISSING}
    arguments, lines = ["self"], []
    for field in dataclasses.fields(cls):
        name, value = field.name, field.name
        if field.default_factory is not dataclasses.MISSING:
            known[f"_new_{name}"] = field.default_factory
            value = f"_new_{name}() if {name} is _none else {name}" if field.init else f"_new_{name}()"
            arguments += [f"{name}=_none"] if field.init else []
        elif field.default is not dataclasses.MISSING:
            known[f"_old_{name}"] = field.default
            arguments += [f"{name}=_old_{name}"] if field.init else []
        elif field.init:
            arguments.append(name)
        if field.init or field.default_factory is not dataclasses.MISSING:
            lines.append(f"_set(self, {name!r}, {value})" if frozen else f"self.{name} = {value}")
    if hasattr(cls, "__post_init__"):
        lines.append("self.__post_init__()")
    exec(f"def __init__({', '.join(arguments)}):\n " + "\n ".join(lines or ["pass"]), known)
    made: Callable[..., None] = known["__init__"]
    made.__qualname__ = f"{cls.__qualname__}.__init__"
    return made


def _compared(cls: Any) -> Callable[[Any], tuple[Any, ...]]:
    """Gives what counts when two objects are compared."""
    names = [field.name for field in dataclasses.fields(cls) if field.compare]
    if len(names) > 1:
        return operator.attrgetter(*names)
    return lambda one: tuple(getattr(one, name) for name in names)


def _eq(cls: Any) -> Callable[[Any, object], Any]:
    compared: Callable[[Any], tuple[Any, ...]] | None = None

    def __eq__(self: Any, other: object) -> Any:
        nonlocal compared
        if other.__class__ is not self.__class__:
            return NotImplemented
        compared = compared or _compared(cls)
        return compared(self) == compared(other)

    return __eq__


def _hash(cls: Any) -> Callable[[Any], int]:
    compared: Callable[[Any], tuple[Any, ...]] | None = None

    def __hash__(self: Any) -> int:
        nonlocal compared
        compared = compared or _compared(cls)
        return hash(compared(self))

    return __hash__


def _repr(cls: Any) -> Callable[[Any], str]:
    named: list[tuple[str, str]] | None = None

    @reprlib.recursive_repr()
    def __repr__(self: Any) -> str:
        nonlocal named
        if named is None:
            named = [(field.name, f"{field.name}=") for field in dataclasses.fields(cls) if field.repr]
        told = ", ".join([start + repr(getattr(self, name)) for name, start in named])
        return f"{self.__class__.__qualname__}({told})"

    return __repr__


def _refusal(cls: Any, what: str) -> Callable[..., None]:
    """Nobody changes a frozen object."""

    def refuse(self: Any, name: str, *value: Any) -> None:
        if type(self) is cls or name in cls.__dataclass_fields__:
            raise dataclasses.FrozenInstanceError(f"cannot {what} field {name!r}")
        getattr(super(cls, self), "__setattr__" if value else "__delattr__")(name, *value)

    return refuse
