"""What is known of a stage function without importing it: its parameters, and a fingerprint of all code that it runs.

The fingerprint covers the syntax tree (comments and docstrings stripped) of the function's module and of the modules of the
same package that it imports, directly or not, and the major.minor versions of the libraries they import.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from ..store.atomic import write_atomic

LIBRARIES = {
    "cv2": ("opencv-python-headless", "opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python"),
    "open3d": ("open3d-cpu", "open3d"),
    "maxflow": ("PyMaxflow",),
    **{name: (name,) for name in ("numpy", "scipy", "numba", "poselib", "pycolmap", "networkx")},
}
"""Import name -> distributions that provide it; the version of the installed one enters the fingerprint."""


class FunctionError(ValueError):
    """A dotted function name leads nowhere."""


@dataclass(frozen=True)
class Parameter:
    """A keyword-only parameter.  `kinds`: names of accepted types (empty: anything); `choices`: literal values, if restricted."""

    name: str
    default: Any
    kinds: tuple[str, ...] = ()
    choices: tuple[Any, ...] = ()

    def problem(self, value: Any) -> str | None:
        """What is wrong with a value from the site file, in words; None when it fits."""
        if value is None and "None" in self.kinds:
            return None
        if self.choices:
            return None if value in self.choices else f"{value!r} is not one of {', '.join(map(str, self.choices))}"
        wanted = {"int": (int,), "float": (int, float), "bool": (bool,), "str": (str,)}
        accepted = tuple(kind for name in self.kinds for kind in wanted.get(name, ()))
        if accepted and (not isinstance(value, accepted) or (isinstance(value, bool) and "bool" not in self.kinds)):
            return f"{value!r} is not of type {' or '.join(self.kinds)}"
        return None


@dataclass(frozen=True)
class FunctionInfo:
    """dotted: "package.module:function"; parameters by name; code: the fingerprint."""

    dotted: str
    parameters: dict[str, Parameter]
    code: str


@dataclass(frozen=True)
class _Module:
    digest: str
    imports: tuple[str, ...]
    libraries: tuple[str, ...]


@dataclass
class FunctionReader:
    """Reads functions and remembers, in the file `memo`, what it learnt of source files that have not changed since."""

    memo: Path | None = None
    _known: dict[str, Any] = field(default_factory=dict)
    _fresh: bool = False

    def __post_init__(self) -> None:
        if self.memo and self.memo.is_file():
            try:
                self._known = json.loads(self.memo.read_text())
            except ValueError:
                self._known = {}

    def read(self, dotted: str) -> FunctionInfo:
        """Parameters and fingerprint of a function.

        Raises
        ------
        FunctionError
            No such module or function, with what is missing.
        """
        module, _, name = dotted.partition(":")
        path = _module_file(module)
        if path is None or not name:
            raise FunctionError(
                f"there is no module {module!r} to take {name or 'a function'} from; write package.module:function"
            )
        modules = self._closure(module)
        stamp = self._stamp(path)
        known = self._known.setdefault("functions", {}).get(dotted)
        if known is None or known["stamp"] != stamp:
            known = {"stamp": stamp, "parameters": _parameters(path, module, name)}
            self._known["functions"][dotted] = known
            self._fresh = True
        parameters = {
            p["name"]: Parameter(p["name"], p["default"], tuple(p["kinds"]), tuple(p["choices"])) for p in known["parameters"]
        }
        versions = sorted({f"{library} {_version(library)}" for m in modules.values() for library in m.libraries})
        lines = [f"{m} {modules[m].digest}" for m in sorted(modules)] + versions
        return FunctionInfo(dotted, parameters, hashlib.sha256("\n".join(lines).encode()).hexdigest()[:32])

    def save(self) -> None:
        """Write what was learnt, for the next run."""
        if self.memo and self._fresh:
            write_atomic(self.memo, json.dumps(self._known).encode())
            self._fresh = False

    def _closure(self, module: str) -> dict[str, _Module]:
        found: dict[str, _Module] = {}
        waiting = [module]
        while waiting:
            name = waiting.pop()
            path = _module_file(name)
            if name in found or path is None:
                continue
            found[name] = self._module(name, path)
            waiting.extend(found[name].imports)
        return found

    def _module(self, name: str, path: Path) -> _Module:
        stamp = self._stamp(path)
        modules = self._known.setdefault("modules", {})
        known = modules.get(name)
        if known is None or known["stamp"] != stamp:
            tree = ast.parse(path.read_bytes(), filename=str(path))
            imports = sorted(_imports(tree, name, path))
            top = name.partition(".")[0]
            known = modules[name] = {
                "stamp": stamp,
                "imports": [i for i in imports if i.partition(".")[0] == top and i != name],
                "libraries": sorted({i.partition(".")[0] for i in imports} & set(LIBRARIES)),
                "digest": hashlib.sha256(ast.dump(_without_docstrings(tree)).encode()).hexdigest()[:32],
            }
            self._fresh = True
        return _Module(known["digest"], tuple(known["imports"]), tuple(known["libraries"]))

    @staticmethod
    def _stamp(path: Path) -> list[Any]:
        status = path.stat()
        return [str(path), status.st_mtime_ns, status.st_size]


def _module_file(module: str) -> Path | None:
    """Source file of a module, found without importing it or its parents (the top package's own location aside)."""
    top, *rest = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None or spec.origin is None:
        return None
    if not rest:
        return Path(spec.origin)
    for root in spec.submodule_search_locations or ():
        stem = Path(root, *rest)
        for candidate in (stem.with_suffix(".py"), stem / "__init__.py"):
            if candidate.is_file():
                return candidate
    return None


def _imports(tree: ast.AST, module: str, path: Path) -> set[str]:
    """Dotted names of everything imported anywhere in a module, relative imports resolved."""
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            origin = ".".join([*base, node.module] if node.module else base)
            found.add(origin)
            found |= {f"{origin}.{alias.name}" for alias in node.names}
    return found


def _without_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body
            if (
                body
                and isinstance(body[0], ast.Expr)
                and isinstance(body[0].value, ast.Constant)
                and isinstance(body[0].value.value, str)
            ):
                node.body = body[1:]
    return tree


def _parameters(path: Path, module: str, name: str) -> list[dict[str, Any]]:
    tree = ast.parse(path.read_bytes(), filename=str(path))
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    if name not in functions:
        raise FunctionError(f"module {module!r} has no function {name!r}; it has {', '.join(sorted(functions)) or 'none'}")
    aliases = {
        t.id: node.value for node in tree.body if isinstance(node, ast.Assign) for t in node.targets if isinstance(t, ast.Name)
    }
    arguments = functions[name].args
    found = []
    for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
        kinds, choices = _annotation(argument.annotation, aliases)
        value = _literal(default, aliases)
        found.append({"name": argument.arg, "default": value, "kinds": list(kinds), "choices": list(choices)})
    return found


def _literal(node: ast.expr | None, aliases: dict[str, ast.expr]) -> Any:
    if isinstance(node, ast.Name) and node.id in aliases:
        node = aliases[node.id]
    try:
        return ast.literal_eval(node) if node is not None else None
    except ValueError:
        return None


def _annotation(node: ast.expr | None, aliases: dict[str, ast.expr]) -> tuple[tuple[str, ...], tuple[Any, ...]]:
    """Accepted type names and literal choices of an annotation such as `int | None`, `Literal["a", "b"]` or an alias of it."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        left, right = _annotation(node.left, aliases), _annotation(node.right, aliases)
        return left[0] + right[0], left[1] + right[1]
    if isinstance(node, ast.Constant) and node.value is None:
        return ("None",), ()
    if isinstance(node, ast.Name):
        return _annotation(aliases[node.id], aliases) if node.id in aliases else ((node.id,), ())
    if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == "Literal":
        values: Iterable[ast.expr] = node.slice.elts if isinstance(node.slice, ast.Tuple) else (node.slice,)
        return (), tuple(ast.literal_eval(v) for v in values)
    return (), ()


def _version(library: str) -> str:
    for distribution in LIBRARIES[library]:
        try:
            return ".".join(metadata.version(distribution).split(".")[:2])
        except metadata.PackageNotFoundError:
            continue
    return "absent"
