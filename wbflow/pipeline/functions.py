"""Signatures and code fingerprints of a site's functions, read from source files and remembered until one of these changes.

A function takes inputs by name, and parameters with defaults and types.  A default that is not a literal is left to the function;
the cache key contains its source text.  Types are checked only as far as they consist of `typing` and built-in names: any other
class accepts every value, and the function has to check it.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..cache.fingerprint import Code, FunctionError, Modules, read_code
from ..cache.memo import Memo, file_stamp
from .signature import Argument, Parameter, Signature
from .source_names import SourceNames

_FORMAT = f"4, Python {sys.version_info.major}.{sys.version_info.minor}"
"""Version of the memo's format; a memo with another version is ignored."""


class FunctionReader(Memo):
    """Reads functions from source, and keeps the results in a memo file as long as none of the source files changes."""

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
        return self._code(dotted, table).fingerprint

    def libraries(self, dotted: str) -> tuple[str, ...]:
        """Return the import names of all libraries that "package.module:function" imports.  Raises FunctionError."""
        return self._code(dotted).libraries

    def _code(self, dotted: str, table: str = "") -> Code:
        """All code of a function but the table, as `code` takes it; without the files."""
        table_module, _, own_table = table.partition(":")
        excluded = own_table if table_module == dotted.partition(":")[0] else ""

        def read() -> tuple[dict[str, Any], Iterable[Path]]:
            code = read_code(self.modules, dotted, excluded)
            return {"digest": code.digest, "libraries": code.libraries}, code.files

        entry = self._from_memo(f"code {excluded}", dotted, read)
        return Code(entry["digest"], tuple(entry["libraries"]), ())

    def signature(self, dotted: str) -> Signature:
        """Return the signature of "package.module:function".  Raises FunctionError if something is missing."""
        entry = self._from_memo("signature", dotted, lambda: _read_signature(self.modules, dotted))
        arguments = tuple(Argument(**argument) for argument in entry["arguments"])
        parameters = {name: Parameter(**parameter) for name, parameter in entry["parameters"].items()}
        return Signature(dotted, arguments, parameters, entry["takes_any"], entry["doc"])

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
    module, path, function = modules.function(dotted)
    names = SourceNames(modules, module, path, {path})
    args = function.args

    positional = [*args.posonlyargs, *args.args]
    first_optional = len(positional) - len(args.defaults)
    arguments = []
    for k, arg in enumerate(positional):
        arguments.append(Argument(arg.arg, required=k < first_optional, by_name=k >= len(args.posonlyargs)))

    parameters = {}
    for arg, default in zip(args.kwonlyargs, args.kw_defaults, strict=True):
        kind = names.type_text(arg.annotation) if arg.annotation else "Any"
        value, source = _default(default, names)
        parameters[arg.arg] = Parameter(arg.arg, value, source, default is None, kind)

    takes_any = args.kwarg is not None
    signature = Signature(dotted, tuple(arguments), parameters, takes_any, ast.get_docstring(function) or "")
    return asdict(signature), names.read


def _default(node: ast.expr | None, names: SourceNames) -> tuple[Any, str]:
    """The value of a default, if it is a literal, else None and its source text.  node: None if there is no default."""
    if node is None:
        return None, ""
    try:
        return names.literal(node), ""
    except (ValueError, RecursionError):
        return None, ast.unparse(node)


def _read_table(modules: Modules, dotted: str) -> tuple[dict[str, str], set[Path]]:
    """Return a table of methods, name -> "package.module:function", and the source files it is from.

    Raises FunctionError if there is no such dictionary literal.
    """
    module, _, name = dotted.partition(":")
    path = modules.file(module)
    if path is None:
        raise FunctionError(f"there is no module {module!r} to take the table {name} from")
    names = SourceNames(modules, module, path)
    try:
        table = names.literal(ast.Name(name))
    except ValueError:
        table = None
    if not isinstance(table, dict) or not all(isinstance(v, str) for pair in table.items() for v in pair):
        raise FunctionError(f"{path} has no dictionary literal {name} of method names and dotted functions")
    return table, names.read
