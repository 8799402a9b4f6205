"""What a function asks for, read from its source: the inputs it takes by name, and its parameters with defaults and types.

A default that is no literal is left to the function; the text of it stands for its value.  A type that the source does not tell
(`from x import *`) is asked of the function itself, which imports its module.
"""

from __future__ import annotations

import ast
import builtins
import importlib
import types
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..cache.fingerprint import FunctionError, Modules, Names
from ..cache.plugins import offer

_PLAIN = {"int": (int,), "float": (int, float), "bool": (bool,), "str": (str,)}
_TYPING = {"typing", "typing_extensions"}
_DEEPEST = 10  # modules that import a name from each other


@dataclass(frozen=True)
class Parameter:
    """A keyword-only parameter."""

    name: str
    default: Any = None
    source: str = ""
    """Text of a default that is no literal: what it is worth only the function knows."""
    required: bool = False
    """There is no default."""
    kinds: tuple[str, ...] = ()
    """Names of accepted types; where any of them is not a plain one, anything is accepted."""
    choices: tuple[Any, ...] = ()
    """Literal values that are accepted besides."""

    @property
    def shown(self) -> str:
        """The default in words."""
        return self.source or ("none: it must be given" if self.required else repr(self.default))

    def problem(self, value: Any) -> str | None:
        """What is wrong with a value from the site file, in words; None when it fits."""
        if any(value == choice and type(value) is type(choice) for choice in self.choices):
            return None
        if value is None and "None" in self.kinds:
            return None
        kinds = [kind for kind in self.kinds if kind != "None"]
        if not kinds and self.choices:
            return f"{value!r} is not one of {', '.join(map(str, self.choices))}"
        if not all(kind in _PLAIN for kind in kinds):
            return None
        accepted = tuple(kind for name in kinds for kind in _PLAIN[name])
        if accepted and (not isinstance(value, accepted) or (isinstance(value, bool) and "bool" not in kinds)):
            choices = f" or one of {', '.join(map(str, self.choices))}" if self.choices else ""
            return f"{value!r} is not of type {' or '.join(self.kinds)}{choices}"
        return None


@dataclass(frozen=True)
class Argument:
    """An argument that can be handed over by position or by name."""

    name: str
    required: bool
    by_name: bool = True
    """False where only a position will do."""


@dataclass(frozen=True)
class Signature:
    """What a function asks for."""

    arguments: tuple[Argument, ...]
    parameters: dict[str, Parameter]
    takes_any: bool
    """It has **something that swallows whatever else is handed over."""


def read_signature(modules: Modules, dotted: str) -> tuple[Signature, set[Path]]:
    """The signature of "package.module:function", and the source files that it was told from.

    Raises
    ------
    FunctionError
        No such module or function.
    """
    module, path, node = modules.function(dotted)
    scope = _Scope(modules, module, path, set())
    args = node.args
    first = len(args.posonlyargs) + len(args.args) - len(args.defaults)
    arguments = tuple(
        Argument(a.arg, k < first, k >= len(args.posonlyargs)) for k, a in enumerate([*args.posonlyargs, *args.args])
    )
    parameters = {}
    for argument, default in zip(args.kwonlyargs, args.kw_defaults, strict=True):
        kinds, choices = _annotation(argument, node, scope)
        try:
            value, source = (None, "") if default is None else (scope.value(default), "")
        except _Unclear:
            assert default is not None
            value, source = None, ast.unparse(default)
        parameters[argument.arg] = Parameter(argument.arg, value, source, default is None, kinds, choices)
    return Signature(arguments, parameters, args.kwarg is not None), scope.read


def read_table(modules: Modules, dotted: str) -> tuple[dict[str, str], Path]:
    """A table of methods: name -> "package.module:function"; and the file it is in.

    Raises
    ------
    FunctionError
        There is no such dictionary literal.
    """
    module, _, name = dotted.partition(":")
    path = modules.file(module)
    if path is None:
        raise FunctionError(f"there is no module {module!r} to take the table {name} from")
    try:
        table = _Scope(modules, module, path, set()).constant(name)
    except _Unclear:
        table = None
    if not isinstance(table, dict) or not all(isinstance(v, str) for pair in table.items() for v in pair):
        raise FunctionError(f"{path} has no dictionary literal {name} of method names and dotted functions")
    return table, path


class _Unclear(Exception):
    """The source does not tell."""


@dataclass(frozen=True)
class _Scope:
    """The names of a module.  read: collects the files that were looked at."""

    modules: Modules
    module: str
    path: Path
    read: set[Path]
    depth: int = 0

    def __post_init__(self) -> None:
        self.read.add(self.path)

    def value(self, node: ast.expr) -> Any:
        """Value of a literal, of a name for one, or of a list of such; plain as JSON is, so that keeping it changes nothing."""
        if isinstance(node, ast.Name):
            return self.constant(node.id)
        try:
            value = ast.literal_eval(node)
        except (ValueError, TypeError, SyntaxError):
            raise _Unclear from None
        if not _is_plain(value):
            raise _Unclear
        return value

    def constant(self, name: str) -> Any:
        """Value of a module's constant that is set once."""
        node, scope = self.definition(name)
        if not isinstance(node, ast.expr):
            raise _Unclear
        return scope.value(node)

    def definition(self, name: str) -> tuple[ast.AST, _Scope]:
        """What a name stands for, followed through imports, and where.  Raises _Unclear."""
        if name in self._names.defined:
            return self._names.defined[name], self
        if name not in self._names.imported:
            raise _Unclear
        return self._within(*self._names.imported[name])

    def attribute(self, node: ast.Attribute) -> tuple[ast.AST, _Scope]:
        """What `module.name` stands for.  Raises _Unclear."""
        if not isinstance(node.value, ast.Name) or node.value.id not in self._names.imported:
            raise _Unclear
        origin, name = self._names.imported[node.value.id]
        return self._within(f"{origin}.{name}" if name else origin, node.attr)

    def of_typing(self, node: ast.expr) -> str:
        """The name that something of `typing` has there, whatever it is called here; "" for all else."""
        if isinstance(node, ast.Name):
            origin, name = self._names.imported.get(node.id, ("", ""))
            return name if origin in _TYPING else ""
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            origin, name = self._names.imported.get(node.value.id, ("", ""))
            return node.attr if origin in _TYPING and not name else ""
        return ""

    @property
    def _names(self) -> Names:
        return self.modules.names(self.module, self.path)

    def _within(self, module: str, name: str) -> tuple[ast.AST, _Scope]:
        path = self.modules.file(module)
        if path is None or self.depth > _DEEPEST:
            raise _Unclear
        return _Scope(self.modules, module, path, self.read, self.depth + 1).definition(name)


def _is_plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(isinstance(key, str) and _is_plain(item) for key, item in value.items())
    if isinstance(value, list):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, bool | int | float | str)


Kinds = tuple[tuple[str, ...], tuple[Any, ...]]
"""Names of accepted types, and literal choices."""


def _annotation(argument: ast.arg, function: ast.FunctionDef, scope: _Scope) -> Kinds:
    if argument.annotation is None:
        return (), ()
    try:
        return _kinds(argument.annotation, scope)
    except _Unclear:
        return _told_by_python(argument.arg, function.name, scope)


def _kinds(node: ast.AST, scope: _Scope) -> Kinds:
    """Kinds of an annotation such as `int | None`, `Literal["a", "b"]` or a name for one.  Raises _Unclear."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        return _together([node.left, node.right], scope)
    if isinstance(node, ast.Constant) and node.value is None:
        return ("None",), ()
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return _kinds(ast.parse(node.value, mode="eval").body, scope)
    if isinstance(node, ast.ClassDef):
        return (node.name,), ()
    if isinstance(node, ast.Subscript):
        inner = list(node.slice.elts) if isinstance(node.slice, ast.Tuple) else [node.slice]
        form = scope.of_typing(node.value)
        if form == "Literal":
            return (), tuple(ast.literal_eval(value) for value in inner)
        if form in {"Union", "Optional"}:
            kinds, choices = _together(inner, scope)
            return (*kinds, *(["None"] if form == "Optional" else [])), choices
        if form in {"Annotated", "Final"}:
            return _kinds(inner[0], scope)
        return (ast.unparse(node),), ()
    if isinstance(node, ast.Name):
        if node.id in _PLAIN or hasattr(builtins, node.id) or scope.of_typing(node):
            return (node.id,), ()
        return _kinds(*scope.definition(node.id))
    if isinstance(node, ast.Attribute):
        return ((ast.unparse(node),), ()) if scope.of_typing(node) else _kinds(*scope.attribute(node))
    raise _Unclear


def _together(nodes: list[ast.expr], scope: _Scope) -> Kinds:
    found = [_kinds(node, scope) for node in nodes]
    return tuple(k for kinds, _ in found for k in kinds), tuple(c for _, choices in found for c in choices)


def _told_by_python(parameter: str, function: str, scope: _Scope) -> Kinds:
    """The last resort: import the module.  Where that fails too, anything is accepted: the function will speak for itself."""
    offer(scope.modules.folder)
    try:
        hints = typing.get_type_hints(getattr(importlib.import_module(scope.module), function))
    except Exception:  # whatever a stranger's module does when it is imported
        return (), ()
    return _kinds_of_type(hints.get(parameter))


def _kinds_of_type(hint: Any) -> Kinds:
    origin = typing.get_origin(hint)
    if origin is typing.Literal:
        return (), typing.get_args(hint)
    if origin in {typing.Union, types.UnionType}:
        found = [_kinds_of_type(inner) for inner in typing.get_args(hint)]
        return tuple(k for kinds, _ in found for k in kinds), tuple(c for _, choices in found for c in choices)
    return ("None" if hint is type(None) else getattr(hint, "__name__", str(hint)),), ()
