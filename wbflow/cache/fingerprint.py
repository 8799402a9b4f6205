"""A fingerprint of all code that a function runs, told from source files alone.

It covers the syntax trees (comments and docstrings stripped) of the function's module and of the modules that this one imports,
directly or not, as far as they belong to the same package, to the stages or to the site's own folder; and the major.minor
versions of the libraries they import.  Names of modules, and the function's own name, do not enter: a function that is renamed,
or whose file is moved, keeps its fingerprint as long as its code is the same.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import platform
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any

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


FOLLOWED = ("wbflow_stages",)
"""Packages whose modules are followed whoever imports them."""

LIBRARIES = {
    "cv2": ("opencv-python-headless", "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python"),
    "open3d": ("open3d-cpu", "open3d"),
    "maxflow": ("PyMaxflow",),
    **{name: (name,) for name in ("numpy", "scipy", "numba", "poselib", "pycolmap", "networkx")},
}
"""Import name -> distributions that provide it; the version of the installed one enters the fingerprint."""


@dataclass(frozen=True)
class ModuleCode:
    """What one module adds to a fingerprint."""

    digest: str
    """Of its syntax tree without the names of the modules that it imports from."""
    imports: tuple[str, ...]
    """Modules that are followed from here, in the order of the text."""
    libraries: tuple[str, ...]
    """Of `LIBRARIES`."""


def module_code(modules: Modules, module: str, path: Path) -> ModuleCode:
    """Read one module."""
    tree = modules.tree(path, keep=False)
    names = list(imported(tree, module, path))
    followed = [
        name
        for name, certain in names
        if name != module and _is_followed(modules, name, module) and (certain or modules.file(name) is not None)
    ]
    libraries = {name.partition(".")[0] for name, _ in names} & set(LIBRARIES)
    told = modules.told.get((module, path)) or _told(tree, modules, module, path)
    return ModuleCode(_digest(_joined(told)), tuple(dict.fromkeys(followed)), tuple(sorted(libraries)))


def function_digest(modules: Modules, module: str, path: Path, name: str, table: str = "") -> str:
    """Digest of a module as one of its functions sees it: the function has no name of its own.

    Parameters
    ----------
    modules : Modules
        Sources, read once.
    module : str
        Dotted name.
    path : Path
        Its file.
    name : str
        The function.
    table : str
        Name of a dictionary of methods in the same module, which is left out; the chosen method has its own fingerprint.
    """
    tree = modules.tree(path)
    if (module, path) not in modules.told:
        modules.told[module, path] = _told(tree, modules, module, path)
    nameless, found = "<this function>", []
    for node, text in zip(_not_texts(tree.body), modules.told[module, path], strict=True):
        if not (table and table in _assigned(node)):
            head = f"FunctionDef(name={name!r}" if isinstance(node, ast.FunctionDef) and node.name == name else ""
            own = f"FunctionDef(name={nameless!r}{text.removeprefix(head)}" if head else text
            found.append(own.replace(f"Name(id={name!r}", f"Name(id={nameless!r}"))
    return _digest(_joined(found))


def fingerprint(own: str, module: str, codes: Mapping[str, ModuleCode]) -> str:
    """The fingerprint of a function.

    Parameters
    ----------
    own : str
        Its `function_digest`.
    module : str
        Its module.
    codes : mapping of str to ModuleCode
        That module and all that are followed from it.
    """
    colours = {name: code.digest for name, code in codes.items()} | {module: own}
    # Each module takes in what it imports, until no two can be told apart that could not before (colour refinement): the same
    # tree with other imports is other code, and no name of a module is needed to say so.
    while True:
        finer = {
            name: _digest("\n".join([colours[name], *(colours.get(target, "nothing") for target in code.imports)]))
            for name, code in codes.items()
        }
        settled = len(set(finer.values())) == len(set(colours.values()))
        colours = finer
        if settled:
            break
    libraries = sorted({library for code in codes.values() for library in code.libraries})
    versions = [f"{library} {installed_version(library)}" for library in libraries]
    return _digest("\n".join([colours[module], *sorted(colours.values()), *versions]))


def _is_followed(modules: Modules, name: str, module: str) -> bool:
    top = name.partition(".")[0]
    return top == module.partition(".")[0] or top in FOLLOWED or modules.beside(name)


def _joined(statements: Iterable[str]) -> str:
    """A module of the statements at its top."""
    return f"Module(body=[{', '.join(statements)}], type_ignores=[])"


def _told(tree: ast.Module, modules: Modules, module: str, path: Path) -> list[str]:
    """The statements at the top of a module as `ast.dump` writes them (in half its time), without docstrings and the names of
    modules that are followed."""

    def told(node: ast.AST) -> str:
        kind: Any = type(node)
        if isinstance(node, ast.ImportFrom) and _is_followed(modules, origin_of(node, module, path), module):
            return f"ImportFrom(module='', names={listed(node.names)}, level=0)"
        texts = []
        for name, lead, optional in _fields_of(kind):
            value = getattr(node, name, None)
            if isinstance(value, ast.AST):
                texts.append(lead + told(value))
            elif value.__class__ is list:
                texts.append(lead + listed(_not_texts(value) if name in _STATEMENTS else value))
            elif value is not None or not optional:
                texts.append(lead + repr(value))
        return f"{kind.__name__}({', '.join(texts)})"

    def listed(values: list[Any]) -> str:
        return f"[{', '.join([told(value) if isinstance(value, ast.AST) else repr(value) for value in values])}]"

    return [told(node) for node in _not_texts(tree.body)]


@functools.cache
def _fields_of(kind: Any) -> tuple[tuple[str, str, bool], ...]:
    """Of a kind of node: name, what is written before the value, and whether there may be none."""
    return tuple((name, f"{name}=", getattr(kind, name, ...) is None) for name in kind._fields)


_STATEMENTS = frozenset({"body", "orelse", "finalbody"})
"""Where docstrings may stand."""


def _not_texts(nodes: list[Any]) -> list[Any]:
    return [node for node in nodes if not _is_text(node)]


def _is_text(node: ast.AST) -> bool:
    """A docstring of a module, class, function or attribute."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _assigned(node: ast.stmt) -> set[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return {target.id for target in targets if isinstance(target, ast.Name)}


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def installed_versions() -> dict[str, str]:
    """Python's version, and those of the libraries of `LIBRARIES` that are there, by name."""
    found = {name: installed_version(name) for name in LIBRARIES}
    return {"python": platform.python_version(), **{name: version for name, version in found.items() if version != "absent"}}


@functools.cache
def installed_version(library: str) -> str:
    """Major and minor version of a library of `LIBRARIES`, or "absent"."""
    from importlib import metadata  # here: a night on which no source file has changed asks for no version but once

    for distribution in LIBRARIES[library]:
        try:
            return ".".join(metadata.version(distribution).split(".")[:2])
        except metadata.PackageNotFoundError:
            continue
    return "absent"
