"""Source files of modules, found and read without importing them."""

from __future__ import annotations

import ast
import importlib.util
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec
from pathlib import Path

from ..errors import ExitCode, WbflowError
from .plugins import was_offered


class FunctionError(WbflowError, ValueError):
    """A dotted function name leads nowhere."""

    exit_code = ExitCode.USAGE


@dataclass(frozen=True)
class Names:
    """What the names at the top of a module stand for."""

    defined: dict[str, ast.AST]
    """Value of constants that are set once, and classes."""
    imported: dict[str, tuple[str, str]]
    """Module and name there ("" for the module itself)."""

    @staticmethod
    def of(tree: ast.Module, module: str, path: Path) -> Names:
        """Read a syntax tree."""
        stored = Counter(n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and not isinstance(n.ctx, ast.Load))
        defined: dict[str, ast.AST] = {}
        for node in tree.body:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
            value = getattr(node, "value", None)
            for target in targets:
                if isinstance(target, ast.Name) and stored[target.id] == 1 and value is not None:
                    defined[target.id] = value
            if isinstance(node, ast.ClassDef):
                defined[node.name] = node
            if type(node).__name__ == "TypeAlias" and value is not None:  # Python 3.12: type Mode = ...
                defined[node.name.id] = value  # type: ignore[attr-defined]
        found: dict[str, tuple[str, str]] = {}
        for step in ast.walk(tree):
            if isinstance(step, ast.ImportFrom):
                origin = origin_of(step, module, path)
                found |= {alias.asname or alias.name: (origin, alias.name) for alias in step.names}
            elif isinstance(step, ast.Import):
                found |= {alias.asname or alias.name: (alias.name, "") for alias in step.names}
        return Names(defined, {name: origin for name, origin in found.items() if name not in stored})


@dataclass
class Modules:
    """The modules that a site's functions can come from: all that Python finds, and those in a folder of the site's own."""

    folder: Path | None = None
    """Beside the site file; what Python finds elsewhere comes first."""
    told: dict[tuple[str, Path], list[str]] = field(default_factory=dict)
    """Statements of modules in which functions were looked up, as text (see `fingerprint`)."""
    _files: dict[str, Path | None] = field(default_factory=dict)
    _tops: dict[str, ModuleSpec | None] = field(default_factory=dict)
    """What Python finds by the first word of a module's name."""
    _trees: dict[Path, ast.Module] = field(default_factory=dict)
    _names: dict[Path, Names] = field(default_factory=dict)

    def file(self, module: str) -> Path | None:
        """Source file of a module; None where there is none."""
        if module not in self._files:
            self._files[module] = self._find(module)
        return self._files[module]

    def beside(self, module: str) -> bool:
        """Does a module lie in the site's own folder?"""
        path = self.file(module)
        return bool(path and self.folder and path.is_relative_to(self.folder))

    def tree(self, path: Path, keep: bool = True) -> ast.Module:
        """Syntax tree of a source file; nobody may change it.

        keep: it will be asked for again.  Raises FunctionError where the file is not Python.
        """
        tree = self._trees.get(path) or self._parsed(path)
        if keep:
            self._trees[path] = tree
        return tree

    @staticmethod
    def _parsed(path: Path) -> ast.Module:
        try:
            return ast.parse(path.read_bytes(), filename=str(path))
        except SyntaxError as error:
            raise FunctionError(error.msg, where=f"{path}:{error.lineno}", remedy="correct the module") from None
        except (OSError, ValueError, RecursionError, MemoryError) as error:
            raise FunctionError(f"cannot be read: {error}", where=str(path), remedy="correct the module") from None

    def names(self, module: str, path: Path) -> Names:
        """What the names at the top of a module stand for."""
        if path not in self._names:
            self._names[path] = Names.of(self.tree(path), module, path)
        return self._names[path]

    def function(self, dotted: str) -> tuple[str, Path, ast.FunctionDef]:
        """Module, source file and definition of "package.module:function".

        Raises
        ------
        FunctionError
            No such module or function, with what is missing.
        """
        module, _, name = dotted.partition(":")
        path = self.file(module)
        if path is None or not name:
            wanted = name or "a function"
            raise FunctionError(f"there is no module {module!r} to take {wanted} from; write package.module:function")
        functions = {node.name: node for node in self.tree(path).body if isinstance(node, ast.FunctionDef)}
        if name not in functions:
            known = ", ".join(sorted(functions)) or "none"
            raise FunctionError(f"module {module!r} has no function {name!r}; it has {known}")
        return module, path, functions[name]

    def _find(self, module: str) -> Path | None:
        top, *rest = module.split(".")
        if top not in self._tops:
            try:
                self._tops[top] = importlib.util.find_spec(top)
            except (ImportError, ValueError):
                self._tops[top] = None
        spec = self._tops[top]
        if spec is None or was_offered(spec.origin or "/"):
            return self._below([str(self.folder)], [top, *rest]) if self.folder else None
        if not rest:
            return Path(spec.origin) if spec.origin and spec.origin.endswith(".py") else None
        return self._below(list(spec.submodule_search_locations or ()), rest)

    @staticmethod
    def _below(roots: list[str], steps: list[str]) -> Path | None:
        for root in roots:
            stem = Path(root, *steps)
            for candidate in (stem.with_name(f"{stem.name}.py"), stem / "__init__.py"):
                if candidate.is_file():
                    return candidate
        return None


def origin_of(node: ast.ImportFrom, module: str, path: Path) -> str:
    """The module that a `from ... import` takes from, in full."""
    if not node.level:
        return node.module or ""
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    base = package[: len(package) - node.level + 1]
    return ".".join([*base, node.module] if node.module else base)


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All statements of a tree, and what holds them, in the order of `ast.walk`; most nodes of a tree are expressions."""
    waiting = deque([tree])
    while waiting:
        node = waiting.popleft()
        for block in node._fields:
            if block in _BLOCKS:
                waiting.extend(getattr(node, block))
        yield node


_BLOCKS = frozenset({"body", "handlers", "orelse", "finalbody", "cases"})


def imported(tree: ast.AST, module: str, path: Path) -> Iterator[tuple[str, bool]]:
    """Names of everything imported anywhere in a module, in the order of the text; whether a module is meant for certain."""
    for node in statements(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, True) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            origin = origin_of(node, module, path)
            yield origin, True
            yield from ((f"{origin}.{alias.name}", False) for alias in node.names)
