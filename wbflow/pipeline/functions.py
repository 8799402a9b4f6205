"""Signatures and code fingerprints of a site's functions, read from source files and remembered until one of these changes.

A function takes inputs by name, and parameters with defaults and types.  A default that is not a literal is left to the function;
the cache key contains its source text.  Types are checked only as far as they consist of `typing` and built-in names: any other
class accepts every value, and the function has to check it.
"""

from __future__ import annotations

import ast
import builtins
import json
import sys
import typing
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cache.fingerprint import Code, FunctionError, Modules, assigned, origin_of, read_code, statements
from ..cache.memo import Memo, file_stamp
from .signature import Argument, Parameter, Signature

_FORMAT = f"3, Python {sys.version_info.major}.{sys.version_info.minor}"
"""Version of the memo's format; a memo with another version is ignored."""

_TYPING_MODULES = {"typing", "typing_extensions", "collections.abc"}
_MOST_DEPTH = 10  # limit of the chain of modules through which an imported name is followed


class FunctionReader(Memo):
    """Reads functions from source, and keeps the results in a memo file as long as none of the source files changes.

    Nothing is imported: importing all stages with their libraries takes 1.6 CPU seconds and 250 MB, reading them 0.8 seconds.
    """

    def __init__(self, memo: Path | None = None, folder: Path | None = None) -> None:
        """folder: the site file's folder, which may contain modules that are not installed."""
        super().__init__(memo, "signatures of functions", "functions are read again")
        self.modules = Modules(folder)
        files = self.entries.get("files", {})
        if self.entries.get("form") != _FORMAT or any(file_stamp(file) != stamp for file, stamp in files.items()):
            self.entries = {"form": _FORMAT, "files": {}, "known": {}}

    def code(self, dotted: str, table: str = "") -> str:
        """Return a fingerprint of all code that "package.module:function" runs.  Raises FunctionError if something is missing.

        table: dotted name of the table from which the function chooses its method; its contents do not enter the fingerprint.
        """
        table_module, _, own_table = table.partition(":")
        excluded = own_table if table_module == dotted.partition(":")[0] else ""

        def read() -> tuple[dict[str, Any], Iterable[Path]]:
            code = read_code(self.modules, dotted, excluded)
            return {"digest": code.digest, "libraries": code.libraries}, code.files

        entry = self._from_memo(f"code {excluded}", dotted, read)
        return Code(entry["digest"], tuple(entry["libraries"]), ()).fingerprint

    def signature(self, dotted: str) -> Signature:
        """Return the signature of "package.module:function".  Raises FunctionError if something is missing."""
        entry = self._from_memo("signature", dotted, lambda: _read_signature(self.modules, dotted))
        arguments = tuple(Argument(**argument) for argument in entry["arguments"])
        parameters = {name: Parameter(**parameter) for name, parameter in entry["parameters"].items()}
        return Signature(dotted, arguments, parameters, entry["takes_any"])

    def table(self, dotted: str) -> dict[str, str]:
        """Return a table of methods: method name -> dotted function name.  Raises FunctionError."""
        methods: dict[str, str] = self._from_memo("table", dotted, lambda: _read_table(self.modules, dotted))
        return methods

    def _from_memo(self, kind: str, dotted: str, read: Callable[[], tuple[Any, Iterable[Path]]]) -> Any:
        """Return the memo's entry for a dotted name; if there is none, read it and remember it with its source files."""
        name = f"{kind} {dotted} {self.modules.file(dotted.partition(':')[0])}"  # the same name in another file is another entry
        entries = self.entries["known"]
        if name not in entries:
            entries[name], files = read()
            self.entries["files"] |= {str(file): file_stamp(str(file)) for file in files}
            self._changed = True
        return entries[name]


def _read_signature(modules: Modules, dotted: str) -> tuple[dict[str, Any], set[Path]]:
    """Return the signature of "package.module:function" as plain data, and the source files it is from.  Raises FunctionError."""
    module, path, node = modules.function(dotted)
    scope = _Scope(modules, module, path)
    args = node.args
    positional = [*args.posonlyargs, *args.args]
    first_optional = len(positional) - len(args.defaults)
    arguments = tuple(Argument(arg.arg, k < first_optional, k >= len(args.posonlyargs)) for k, arg in enumerate(positional))
    parameters = {}
    for arg, default in zip(args.kwonlyargs, args.kw_defaults, strict=True):
        annotation = ast.unparse(_inlined(arg.annotation, scope)) if arg.annotation else "Any"
        value, source = None, ""
        try:
            value = scope.literal(default) if default else None
        except ValueError:
            source = ast.unparse(default) if default else ""
        parameters[arg.arg] = Parameter(arg.arg, value, source, default is None, annotation)
    return asdict(Signature(dotted, arguments, parameters, args.kwarg is not None)), scope.read


def _read_table(modules: Modules, dotted: str) -> tuple[dict[str, str], set[Path]]:
    """Return a table of methods, name -> "package.module:function", and the source files it is from.

    Raises FunctionError if there is no such dictionary literal.
    """
    module, _, name = dotted.partition(":")
    path = modules.file(module)
    if path is None:
        raise FunctionError(f"there is no module {module!r} to take the table {name} from")
    scope = _Scope(modules, module, path)
    try:
        table = scope.literal(ast.Name(name))
    except ValueError:
        table = None
    if not isinstance(table, dict) or not all(isinstance(v, str) for pair in table.items() for v in pair):
        raise FunctionError(f"{path} has no dictionary literal {name} of method names and dotted functions")
    return table, scope.read


@dataclass(frozen=True)
class _Scope:
    """The names at the top level of a module."""

    modules: Modules
    module: str
    path: Path
    read: set[Path] = field(default_factory=set)
    depth: int = 0

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree of the module."""
        self.read.add(self.path)
        return self.modules.tree(self.path)

    @cached_property
    def statements(self) -> list[ast.stmt]:
        """All statements of the module."""
        return list(statements(self.tree.body))

    @cached_property
    def defined(self) -> dict[str, ast.expr]:
        """Value of each name that is assigned once, at the top level."""
        definition = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
        top = [inner for node in self.tree.body if not isinstance(node, definition) for inner in ast.walk(node)]
        store_counts = Counter(n.id for n in top if isinstance(n, ast.Name) and not isinstance(n.ctx, ast.Load))
        store_counts.update(name for node in self.statements if isinstance(node, ast.Global) for name in node.names)
        values = [(node, getattr(node, "value", None)) for node in self.tree.body]
        definitions = {name: value for node, value in values if value for name in assigned(node) if store_counts[name] == 1}
        # Python 3.12: type Mode = ...
        return definitions | {node.name.id: node.value for node in self.tree.body if type(node).__name__ == "TypeAlias"}  # type: ignore[attr-defined]

    @cached_property
    def imported(self) -> dict[str, tuple[str, str]]:
        """By imported name: its module and its name there, "" for a module itself; "*" is the key of a star import."""
        origins: dict[str, tuple[str, str]] = {}
        for node in self.statements:
            if isinstance(node, ast.ImportFrom):
                origin = origin_of(node, self.module, self.path)
                origins |= {alias.asname or alias.name: (origin, alias.name) for alias in node.names}
            elif isinstance(node, ast.Import):
                origins |= {alias.asname or alias.name: (alias.name, "") for alias in node.names}
        return origins

    def literal(self, node: ast.expr) -> Any:
        """Return the value of a literal, or of a name bound to one.  Raises ValueError, also if JSON cannot represent it."""
        if isinstance(node, ast.Name):
            definition = self.find(node.id)
            if isinstance(definition, str):
                raise ValueError(node.id)
            value, scope = definition
            return scope.literal(value)
        try:
            value = ast.literal_eval(node)
        except (TypeError, SyntaxError) as error:
            raise ValueError(str(error)) from None
        if json.loads(json.dumps(value, default=str)) != value:  # tuples, sets and nan: the memo, a JSON file, would change them
            raise ValueError(str(value))
        return value

    def find(self, name: str) -> tuple[ast.expr, _Scope] | str:
        """Return the definition of a name and the scope it is in; for a name from `typing`, its name there; "" if unknown."""
        if name in self.defined:
            return self.defined[name], self
        origin, original = self.imported.get(name) or self.imported.get("*", ("", ""))
        return self.within(origin, name if original == "*" else original) if original else ""

    def within(self, origin: str, name: str) -> tuple[ast.expr, _Scope] | str:
        """Return what `find` returns, for a name in the module `origin`."""
        if origin in _TYPING_MODULES:
            return name
        path = self.modules.file(origin) if origin and self.modules.follows(origin, self.module) else None
        if path is None or self.depth > _MOST_DEPTH:
            return ""
        return _Scope(self.modules, origin, path, self.read, self.depth + 1).find(name)


_ANY = ast.Name("Any", ast.Load())


def _inlined(node: ast.expr, scope: _Scope) -> ast.expr:
    """An annotation with names of `typing` and built-ins only: type aliases are replaced by their definitions, all other names by
    Any."""
    definition: tuple[ast.expr, _Scope] | str
    match node:
        case ast.Constant(value=str(text)):
            try:
                return _inlined(ast.parse(text, mode="eval").body, scope)
            except SyntaxError:
                return _ANY
        case ast.Constant():
            return node
        case ast.BinOp(left=left, op=op, right=right):
            return ast.BinOp(_inlined(left, scope), op, _inlined(right, scope))
        case ast.Tuple(elts=elements) | ast.List(elts=elements):
            return type(node)([_inlined(element, scope) for element in elements], ast.Load())
        case ast.Subscript(value=head, slice=inner):
            head = _inlined(head, scope)
            name = head.id if isinstance(head, ast.Name) else "Any"
            if name in {"Annotated", "Final"}:
                return _inlined(inner.elts[0] if isinstance(inner, ast.Tuple) else inner, scope)
            return (
                _ANY if name == "Any" else ast.Subscript(head, inner if name == "Literal" else _inlined(inner, scope), ast.Load())
            )
        case ast.Name(id=name):
            definition = scope.find(name)
            if not definition and hasattr(builtins, name):
                return node
        case ast.Attribute(value=ast.Name(id=module), attr=name):
            origin, original = scope.imported.get(module, ("", ""))
            definition = scope.within(f"{origin}.{original}" if original else origin, name)
        case _:
            return _ANY
    if isinstance(definition, tuple):
        return _inlined(*definition)
    return ast.Name(definition, ast.Load()) if hasattr(typing, definition) else _ANY
