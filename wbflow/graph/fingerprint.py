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
import platform
from collections.abc import Mapping
from pathlib import Path

from ..lean import dataclass
from .modules import Modules, imported, origin_of, statements

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
    tree = modules.parse(path)
    names = list(imported(tree, module, path))
    followed = [
        name
        for name, certain in names
        if name != module and _is_followed(modules, name, module) and (certain or modules.file(name) is not None)
    ]
    libraries = {name.partition(".")[0] for name, _ in names} & set(LIBRARIES)
    digest = _digest(ast.dump(_bare(tree, modules, module, path)))
    return ModuleCode(digest, tuple(dict.fromkeys(followed)), tuple(sorted(libraries)))


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
    tree = _bare(modules.parse(path), modules, module, path)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name == name and node in tree.body:
            node.name = "<this function>"
        elif isinstance(node, ast.Name) and node.id == name:
            node.id = "<this function>"
    tree.body = [node for node in tree.body if not (table and table in _assigned(node))]
    return _digest(ast.dump(tree))


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


def _bare(tree: ast.Module, modules: Modules, module: str, path: Path) -> ast.Module:
    """The tree of a module, stripped of docstrings and of the names of modules that are followed."""
    for node in statements(tree):
        for block in ("body", "orelse", "finalbody"):
            if block in node._fields:
                setattr(node, block, [s for s in getattr(node, block) if not _is_text(s)])
        if isinstance(node, ast.ImportFrom):
            origin = origin_of(node, module, path)
            if _is_followed(modules, origin, module):
                node.module, node.level = "", 0
    return tree


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
