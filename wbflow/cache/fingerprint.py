"""A fingerprint of all code that a function runs, from source files alone.

It covers the syntax trees (without comments and docstrings) of the function's module and of all modules that it imports,
directly or indirectly, if they belong to the same package, to the stages or to the site's own folder; and the major.minor
versions of all other libraries that these modules import.  Module names and the function's own name do not enter: a function that
is renamed, or whose file is moved, keeps its fingerprint as long as its code is the same.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import ExitCode, WbflowError
from ..plugins import is_site_module
from .versions import installed_version

FOLLOWED = ("wbflow_stages",)
"""Packages whose modules enter the fingerprint whichever module imports them."""


class FunctionError(WbflowError, ValueError):
    """A dotted function name does not lead to a function whose source can be read."""

    exit_code = ExitCode.USAGE


@dataclass
class Modules:
    """The modules that a site's functions can come from: all that Python finds, and those in the site's own folder."""

    folder: Path | None = None
    """The folder of the site file; modules that Python finds elsewhere take precedence."""
    _files: dict[str, Path | None] = field(default_factory=dict)
    _codes: dict[Path, _ModuleCode] = field(default_factory=dict)
    _trees: dict[Path, ast.Module] = field(default_factory=dict)

    def code(self, module: str, path: Path) -> _ModuleCode:
        """Return the code of a module; it is read only once."""
        if path not in self._codes:
            self._codes[path] = _module_code(self, module, path)
        return self._codes[path]

    def file(self, module: str) -> Path | None:
        """Return the source file of a module, or None."""
        if module not in self._files:
            self._files[module] = self._find(module)
        return self._files[module]

    def follows(self, name: str, module: str) -> bool:
        """Is `name`, which `module` imports, code of the same package, the stages or the site, rather than a library?"""
        top = name.partition(".")[0]
        if top == module.partition(".")[0] or top in FOLLOWED:
            return True
        if self.folder is None:
            return False
        path = self.file(name)
        return path is not None and path.is_relative_to(self.folder)

    def tree(self, path: Path) -> ast.Module:
        """Return the syntax tree of a source file, shared by all callers: do not modify it.  Raises FunctionError."""
        if path not in self._trees:
            self._trees[path] = self.parsed(path)
        return self._trees[path]

    @staticmethod
    def parsed(path: Path) -> ast.Module:
        """Return a new syntax tree of a source file.  Raises FunctionError if the file cannot be read or is not Python."""
        try:
            return ast.parse(path.read_bytes(), filename=str(path))
        except SyntaxError as error:
            raise FunctionError(error.msg, where=f"{path}:{error.lineno}", remedy="correct the module") from None
        except (OSError, ValueError, RecursionError, MemoryError) as error:
            raise FunctionError(f"cannot be read: {error}", where=str(path), remedy="correct the module") from None

    def function(self, dotted: str) -> tuple[str, Path, ast.FunctionDef]:
        """Return module, source file and definition of "package.module:function".

        Raises FunctionError, which names what is missing.
        """
        module, _, name = dotted.partition(":")
        path = self.file(module)
        if path is None or not name:
            target = name or "a function"
            raise FunctionError(f"there is no module {module!r} to take {target} from")
        functions = {node.name: node for node in self.tree(path).body if isinstance(node, ast.FunctionDef)}
        if name not in functions:
            known = ", ".join(sorted(functions)) or "none"
            raise FunctionError(f"module {module!r} has no function {name!r}; it has {known}")
        return module, path, functions[name]

    def _find(self, module: str) -> Path | None:
        """The source file of a module, without importing it; None for built-in and compiled ones."""
        top, *rest = module.split(".")
        try:
            spec = importlib.util.find_spec(top)
        except (ImportError, ValueError):
            spec = None
        if spec is None or is_site_module(spec.origin or "/"):
            # nothing that Python finds by itself: it may be a module of the site
            if self.folder is None:
                return None
            return self._source_below([str(self.folder)], [top, *rest])
        if not rest:
            if spec.origin and spec.origin.endswith(".py"):
                return Path(spec.origin)
            return None
        # submodules are looked for as files, since finding their specs would import the packages above them
        return self._source_below(list(spec.submodule_search_locations or ()), rest)

    @staticmethod
    def _source_below(roots: list[str], steps: list[str]) -> Path | None:
        """The first source file of the module or package that lies at these steps below one of the folders."""
        for root in roots:
            stem = Path(root, *steps)
            for candidate in (stem.with_name(f"{stem.name}.py"), stem / "__init__.py"):
                if candidate.is_file():
                    return candidate
        return None


@dataclass(frozen=True)
class Code:
    """All code that a function runs."""

    digest: str
    """Digest of the syntax trees."""
    libraries: tuple[str, ...]
    """Import names of all libraries that the code imports."""
    files: tuple[Path, ...]

    @property
    def fingerprint(self) -> str:
        """Digest of the code and of the installed versions of its libraries."""
        versions = [f"{name} {installed_version(name)}" for name in self.libraries]
        return _digest("\n".join([self.digest, *versions]))


def read_code(modules: Modules, dotted: str, table: str = "") -> Code:
    """Read the code of a function.  Raises FunctionError.

    dotted: "package.module:function".  table: name of a dictionary of methods in the same module.  It is left out, because the
    chosen method has its own fingerprint.
    """
    first, path, function = modules.function(dotted)
    numbers = {first: 0}  # modules are numbered in the order in which they are met, so that their names do not enter
    texts: list[str] = []
    libraries: set[str] = set()
    queue = [(first, path)]
    for module, file in queue:  # grows while it is walked: breadth first
        if module == first:
            code = _module_code(modules, module, file, function.name, table)
        else:
            code = modules.code(module, file)
        libraries |= code.libraries
        for name in code.imports:
            if name in numbers:
                continue
            imported = modules.file(name)
            if imported is not None:
                numbers[name] = len(numbers)
                queue.append((name, imported))
        # a module's code, and which of the others it imports
        texts.append(f"{code.digest} {[numbers.get(name) for name in code.imports]}")
    return Code(_digest("\n".join(texts)), tuple(sorted(libraries)), tuple(file for _, file in queue))


@dataclass(frozen=True)
class _ModuleCode:
    """The code of one module."""

    digest: str
    """Digest of its syntax tree, without the names of the followed modules that it imports from."""
    imports: tuple[str, ...]
    """Imported modules that enter the fingerprint, in source order."""
    libraries: frozenset[str]


def _module_code(modules: Modules, module: str, path: Path, function: str = "", table: str = "") -> _ModuleCode:
    """Read a module, without the name of the given function and without the given table of methods."""
    tree = modules.parsed(path)
    stripper = _CodeStripper(modules, module, path)
    stripper.strip(tree.body)
    tree.body = [node for node in tree.body if table not in assigned(node)]
    # a function that is renamed keeps its fingerprint: its name is replaced in its definition and wherever it is used
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name == function:
            node.name = "<this function>"
    if function:
        for inner in ast.walk(tree):
            if isinstance(inner, ast.Name) and inner.id == function:
                inner.id = "<this function>"
    return _ModuleCode(_digest(ast.dump(tree)), tuple(stripper.imports), frozenset(stripper.libraries))


class _CodeStripper:
    """Strips a module of docstrings and of the names of followed modules in `from` imports, and collects what it imports.

    Expressions, which contain neither, are most of a module: they are not searched.
    """

    def __init__(self, modules: Modules, module: str, path: Path) -> None:
        self.modules = modules
        self.module = module
        self.path = path
        self.imports: dict[str, None] = {}
        """Imported modules that enter the fingerprint, in source order."""
        self.libraries: set[str] = set()

    def strip(self, block: list[ast.stmt]) -> None:
        """Strip a list of statements, and all lists in these."""
        kept: list[ast.stmt] = []
        for node in block:
            if isinstance(node, ast.Import):
                for alias in node.names:
                    self._add_import(alias.name)
            if isinstance(node, ast.ImportFrom):
                kept.append(self._without_origin(node))
            elif not _is_text(node):
                kept.append(node)
            for inner in blocks(node):
                self.strip(inner)
        block[:] = kept

    def _without_origin(self, node: ast.ImportFrom) -> ast.ImportFrom:
        """Record what a `from` import names, and return it without the module's name if that is followed."""
        origin = origin_of(node, self.module, self.path)
        if not self._add_import(origin):
            return node
        for alias in node.names:
            name = f"{origin}.{alias.name}"
            if self.modules.file(name) is not None:  # what is imported is itself a module
                self.imports[name] = None
        return ast.ImportFrom(module="", names=node.names, level=0)

    def _add_import(self, name: str) -> bool:
        """Record an imported module; return whether it enters the fingerprint."""
        top = name.partition(".")[0]
        followed = self.modules.follows(name, self.module)
        if followed and name != self.module:
            self.imports[name] = None
        elif not followed and top not in sys.stdlib_module_names:
            self.libraries.add(top)
        return followed


def blocks(node: ast.AST) -> Iterator[list[ast.stmt]]:
    """Yield the lists of statements that a compound statement holds, in source order."""
    for name in ("body", "handlers", "cases", "orelse", "finalbody"):
        inner = getattr(node, name, [])
        if name in ("handlers", "cases"):
            yield from (part.body for part in inner)
        elif inner:
            yield inner


def statements(block: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield each statement of a list, and those that it holds, in source order."""
    for node in block:
        yield node
        for inner in blocks(node):
            yield from statements(inner)


def _is_text(node: ast.stmt) -> bool:
    """Is it a string that nothing uses, such as a docstring?"""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def assigned(node: ast.stmt) -> Iterator[str]:
    """Yield the names that a statement assigns to."""
    targets: list[ast.expr] = []
    if isinstance(node, ast.Assign):
        targets = node.targets
    elif isinstance(node, ast.AnnAssign):
        targets = [node.target]
    for target in targets:
        if isinstance(target, ast.Name):
            yield target.id


def origin_of(node: ast.ImportFrom, module: str, path: Path) -> str:
    """Return the full name of the module in a `from ... import` statement."""
    if not node.level:
        return node.module or ""
    # a package's own module counts as one level: `from . import x` in it means the package itself
    package = module.split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    origin = package[: len(package) - node.level + 1]
    if node.module:
        origin.append(node.module)
    return ".".join(origin)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:32]
