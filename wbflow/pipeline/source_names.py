"""What the names in a module stand for, as far as its source says: the values of constants, and the types in annotations.

Nothing is imported.  `inspect` would know more, but has to import a function's module, and with it numba, OpenCV and scipy.  For
the functions of all stages that costs 1.1 CPU seconds, 4.3 seconds where Python may not keep its bytecode, as in many
containers; and it runs a site's own modules in order to check a YAML file.  Reading costs 0.1 seconds.
"""

from __future__ import annotations

import ast
import builtins
import json
import types
import typing
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cache.fingerprint import Modules, assigned, origin_of, statements

_MOST_HOPS = 10
"""Limit of the chain of imports through which a name is followed: modules may import from each other."""
_TYPING_MODULES = {"typing", "typing_extensions", "collections.abc"}
_NO_TYPE = (TypeError, NameError, AttributeError, LookupError, ValueError, ArithmeticError, RecursionError, SyntaxError)
"""What evaluating an annotation may raise that is no type in Python either, or none that the source alone tells."""


@dataclass(frozen=True)
class SourceNames:
    """The names at the top level of a module."""

    modules: Modules
    module: str
    path: Path
    read: set[Path] = field(default_factory=set)
    """The source files that were read, of this and of imported modules."""
    hops: int = 0
    """Number of imports that have led to this module."""

    def literal(self, node: ast.expr) -> Any:
        """Return the value of a literal, or of a name that stands for one.  Raises ValueError, also if JSON cannot hold it."""
        if isinstance(node, ast.Name):
            return self._constant(node.id)
        try:
            value = ast.literal_eval(node)
        except (TypeError, SyntaxError) as error:
            raise ValueError(str(error)) from None
        # the memo, a JSON file, would change tuples, sets and nan
        if json.loads(json.dumps(value, default=str)) != value:
            raise ValueError(str(value))
        return value

    def type_text(self, annotation: ast.expr) -> str:
        """Return the type that an annotation states, written with names of `typing` and built-in types; other classes are Any."""
        kind = self._evaluated(annotation)
        if kind is None:
            return "None"
        is_class = isinstance(kind, type) and not typing.get_args(kind)
        return kind.__name__ if is_class else repr(kind)

    @cached_property
    def _tree(self) -> ast.Module:
        self.read.add(self.path)
        return self.modules.tree(self.path)

    @cached_property
    def _constants(self) -> dict[str, ast.expr]:
        """The value of each name that has the same everywhere: it is assigned once, and not in a branch or a loop."""
        definition = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
        assignments: Counter[str] = Counter()
        for node in self._tree.body:
            if not isinstance(node, definition):
                names = [inner for inner in ast.walk(node) if isinstance(inner, ast.Name)]
                assignments.update(name.id for name in names if not isinstance(name.ctx, ast.Load))
        for node in statements(self._tree.body):
            if isinstance(node, ast.Global):
                assignments.update(node.names)

        values: dict[str, ast.expr] = {}
        for node in self._tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value:
                values |= {name: node.value for name in assigned(node) if assignments[name] == 1}
            elif type(node).__name__ == "TypeAlias":  # Python 3.12: type Mode = ...
                values[node.name.id] = node.value  # type: ignore[attr-defined]
        return values

    @cached_property
    def _imported(self) -> dict[str, tuple[str, str]]:
        """By imported name: its module, and its name there ("" for a module itself); "*" is the key of a star import."""
        origins: dict[str, tuple[str, str]] = {}
        for node in statements(self._tree.body):
            if isinstance(node, ast.ImportFrom):
                origin = origin_of(node, self.module, self.path)
                origins |= {alias.asname or alias.name: (origin, alias.name) for alias in node.names}
            elif isinstance(node, ast.Import):
                origins |= {alias.asname or alias.name: (alias.name, "") for alias in node.names}
        return origins

    def _origin(self, name: str) -> tuple[str, str]:
        """The module that a name may be imported from ("" if there is none), and its name there."""
        if name in self._imported:
            return self._imported[name]
        module, _ = self._imported.get("*", ("", ""))
        return module, name

    def _other(self, module: str) -> SourceNames | None:
        """The names of a module that this one imports; None for a library."""
        if not module or self.hops == _MOST_HOPS or not self.modules.follows(module, self.module):
            return None
        path = self.modules.file(module)
        return SourceNames(self.modules, module, path, self.read, self.hops + 1) if path else None

    def _constant(self, name: str) -> Any:
        """The value that a name stands for.  Raises ValueError."""
        if name in self._constants:
            return self.literal(self._constants[name])
        module, original = self._origin(name)
        other = self._other(module)
        if other is None:
            raise ValueError(name)
        return other._constant(original)

    def _type(self, name: str) -> Any:
        """The type that a name stands for, Any if it is unknown; a module has its types as attributes."""
        if name in self._constants:
            return self._evaluated(self._constants[name])
        module, original = self._origin(name)
        if module in _TYPING_MODULES:
            return _TYPING.get(original, Any) if original else types.SimpleNamespace(**_TYPING)
        # the name of a module, or of something in one
        if imported_module := self._other(f"{module}.{original}" if original else module):
            return _Types(imported_module)
        if other := self._other(module):
            return other._type(original)
        found = getattr(builtins, name, Any)
        return found if isinstance(found, type) else Any

    def _evaluated(self, annotation: ast.expr) -> Any:
        """What Python makes of an annotation; Any if it fails."""
        try:
            if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
                annotation = ast.parse(annotation.value, mode="eval").body
            code = compile(ast.Expression(annotation), "<annotation>", "eval")
            return eval(code, {"__builtins__": {}}, _Types(self))
        except _NO_TYPE:
            return Any


class _Types(dict[str, Any]):
    """The types that the names in a module stand for: as items, for `eval`, and as attributes, for a module in an annotation."""

    def __init__(self, names: SourceNames) -> None:
        self._names = names

    def __missing__(self, name: str) -> Any:
        return self._names._type(name)

    def __getattr__(self, name: str) -> Any:
        return self._names._type(name)


class _Plain:
    """Stands for `typing.Annotated`: the type alone, without the remarks."""

    def __class_getitem__(cls, items: tuple[Any, ...]) -> Any:
        return items[0]


_TYPING = {**vars(typing), "Annotated": _Plain}
"""What the names of `typing` stand for in annotations."""
