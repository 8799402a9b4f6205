"""Rules for the source code: imports run one way, each thing has one owner, and functions stay short enough to be read."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import networkx
import pytest

ROOT = Path(__file__).resolve().parent.parent
ENGINE, VISION, DEMO = ROOT / "wbflow", ROOT / "stages", ROOT / "sites" / "demo"
SOURCES = sorted(file for folder in (ENGINE, VISION, DEMO) for file in folder.glob("**/*.py"))
ENGINE_FILES = [file for file in SOURCES if file.is_relative_to(ENGINE)]
EVERY_FILE = sorted([*SOURCES, *ROOT.glob("scripts/*.py"), *ROOT.glob("tests/**/*.py")])

VISION_LAYERS = [
    {"contracts"},
    {"types", "core"},
    {"twoview", "matching", "io"},
    {"capture", "rectification", "stereo", "sfm", "orientation", "observed", "mvs", "fusion", "change", "sighted"},
    {"stages"},
    {"exports"},
]
"""Packages of the vision code in layers, lowest first: each imports only from its own and lower ones.  "stages": stage files."""

ENGINE_LAYERS = (
    {"errors", "task", "words", "json_dataclass", "plugins"},
    {"cache", "records", "pipeline", "remote"},
    {"site"},
    {"runner", "reference", "verdict", "report", "capture"},
    {"edit", "commands"},
    {"api"},
    {"cli"},
)
"""Packages and modules of the engine in layers, lowest first: each imports only from its own layer and lower ones."""
CONTRACTS = "wbflow_stages.contracts"
"""The only package of the vision code that the engine imports."""
LAYER_OF = {room: layer for layer, rooms in enumerate(ENGINE_LAYERS) for room in rooms}
PATHS = r"""(?x)^(
    cache | runs | latest | latest-good | reference\.json | quarantine | lock | \.writing | \.wbflow
    | run\.json | metrics\.prom | notified\.json
    | log\.jsonl | cameras\.json | report\.html | ledger\.sqlite.* | captures\.json | functions\.json
    | cloud.*\.ply | .*\.tmp | \.?jpg)$"""
LAYOUT = ENGINE / "cache" / "layout.py"
OTHERS = {
    ENGINE / "commands" / "init.py": {".jpg"},  # photographs
    ENGINE / "commands" / "demo.py": {"cameras.json"},  # in the demo's own folder
    ENGINE / "cache" / "atomic.py": {".tmp"},
}
"""Strings that look like a path of the work folder but are none, by file."""


def name_of(file: Path) -> str:
    """The dotted name of a source file; for an `__init__.py`, that of its folder."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def installed(name: str) -> str:
    """The name that a module, named by its folders, has when it is installed."""
    return re.sub(r"^sites\.demo\b", "wbflow_demo", re.sub(r"^stages\b", "wbflow_stages", name))


NAMES = {name_of(file): file for file in SOURCES}


@cache
def parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text())


def for_types_alone(tree: ast.Module) -> set[ast.AST]:
    """Nodes below `if TYPE_CHECKING`."""
    found: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            found |= {inner for statement in node.body for inner in ast.walk(statement)}
    return found


def imports(file: Path, types_too: bool = False) -> Iterator[str]:
    """Dotted names that a file imports when it runs; types_too: also those for type checking.  Other packages are included."""
    package = name_of(file).split(".") if file.name == "__init__.py" else name_of(file).split(".")[:-1]
    passed = set() if types_too else for_types_alone(parsed(file))
    for node in ast.walk(parsed(file)):
        if node in passed:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            path = ".".join([*base, *([node.module] if node.module else [])])
            # `from . import x` names the module x
            yield from (f"{path}.{alias.name}" if f"{path}.{alias.name}" in NAMES else path for alias in node.names)


def layer(name: str) -> int | None:
    """Layer of a module of the vision code; None for the package itself, which may import anything, and for other modules."""
    package, _, rest = name.partition(".")
    if package != "stages" or not rest:
        return None
    room = rest.split(".")[0]
    return next(
        k for k, rooms in enumerate(VISION_LAYERS) if (room if any(room in r for r in VISION_LAYERS) else "stages") in rooms
    )


def test_every_package_is_listed_for_installation() -> None:
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    folders = {name_of(file) for file in SOURCES if file.name == "__init__.py"}
    assert listed == {installed(folder) for folder in folders}


@pytest.mark.parametrize("file", SOURCES, ids=name_of)
def test_engine_vision_and_demo_have_no_forbidden_imports(file: Path) -> None:
    pixels = {"cv2", "open3d", "numba", "poselib", "pycolmap"}
    banned = {
        ENGINE: {*pixels, "wbflow_stages", "wbflow_demo"},  # but see `CONTRACTS`
        VISION: {"wbflow", "wbflow_stages", "wbflow_demo"},
        DEMO: {"wbflow"},
    }
    (folder,) = (folder for folder in banned if file.is_relative_to(folder))
    imported = {name for name in imports(file) if not (folder == ENGINE and name.startswith(CONTRACTS))}
    assert not {name.split(".")[0] for name in imported} & banned[folder]


def test_no_module_imports_a_pickle_library() -> None:
    banned = {"pickle", "shelve", "marshal", "dill", "cloudpickle"}
    assert not [file for file in SOURCES if {name.split(".")[0] for name in imports(file)} & banned]


def test_vision_code_imports_only_from_its_own_and_lower_layers() -> None:
    upward = []
    for name, file in NAMES.items():
        here = layer(name)
        for other in imports(file) if here is not None else ():
            there = layer(other)
            if here is not None and there is not None and there > here:
                upward.append(f"{name} imports {other}")
    assert not upward


def rooms(file: Path) -> set[str]:
    """Packages and modules of the engine that a file imports from."""
    parts = [name.split(".") for name in imports(file, types_too=True)]
    return {name[1] for name in parts if name[0] == "wbflow" and len(name) > 1}


@pytest.mark.parametrize("file", [f for f in ENGINE_FILES if f.parent != ENGINE or f.stem in LAYER_OF], ids=name_of)
def test_the_engine_imports_only_from_its_own_and_lower_layers(file: Path) -> None:
    room = file.relative_to(ENGINE).parts[0].removesuffix(".py")
    assert [name for name in rooms(file) & LAYER_OF.keys() if LAYER_OF[name] > LAYER_OF[room]] == []


def test_there_are_no_circular_imports() -> None:
    graph = networkx.DiGraph()
    modules = {name for name, file in NAMES.items() if file.name != "__init__.py"}  # packages import lazily
    for name in modules:
        graph.add_edges_from(
            (name, other) for other in imports(NAMES[name], types_too=True) if other in modules and other != name
        )
    assert not [sorted(circle) for circle in networkx.strongly_connected_components(graph) if len(circle) > 1]


MOST_MODULES_IN_A_CHAIN = 12


@pytest.mark.parametrize("half", ["wbflow", "stages"])
def test_the_longest_chain_of_imports_is_short(half: str) -> None:
    """Imports for type checking count, too: a reader follows them as well."""
    graph = networkx.DiGraph()
    modules = {name for name, file in NAMES.items() if file.name != "__init__.py" and name.partition(".")[0] == half}
    for name in modules:
        graph.add_edges_from(
            (name, other) for other in imports(NAMES[name], types_too=True) if other in modules and other != name
        )
    chain = networkx.dag_longest_path(graph)
    assert len(chain) <= MOST_MODULES_IN_A_CHAIN, " > ".join(chain)


def literals(tree: ast.Module) -> Iterator[str]:
    """Strings in a module, without docstrings."""
    docstrings = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            docstrings.add(node.value)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in docstrings:
            yield node.value


def spelled(source: str) -> set[str]:
    """Paths of the work folder in a module's strings, alone or as parts of longer paths."""
    parts = (part for text in literals(ast.parse(source)) if " " not in text for part in text.split("/"))
    return {part for part in parts if re.match(PATHS, part)}


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("x = work / 'runs' / name", {"runs"}),
        ("open(f'{folder}/log.jsonl')", {"log.jsonl"}),
        ("p.glob('runs/*/run.json')", {"runs", "run.json"}),
        ("'''of runs'''\nx = 'the cache of runs'", set()),
    ],
)
def test_paths_spelled_in_source_are_found(source: str, found: set[str]) -> None:
    assert spelled(source) == found


def test_only_the_layout_module_spells_paths_of_the_work_folder() -> None:
    assert len(spelled(LAYOUT.read_text())) > 10
    elsewhere = {
        file.relative_to(ENGINE): found
        for file in ENGINE_FILES
        if file != LAYOUT and (found := spelled(file.read_text()) - OTHERS.get(file, set()))
    }
    assert elsewhere == {}


def test_only_a_few_places_catch_all_exceptions() -> None:
    """All exceptions are caught only around a task, its picture, the report, libraries of object stores (their errors have no
    common base class), one of several sites, and the whole command line."""
    broad = [
        str(file.relative_to(ENGINE))
        for file in ENGINE_FILES
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ExceptHandler) and (node.type is None or ast.unparse(node.type) in {"Exception", "BaseException"})
    ]
    # one removes its temporary file and raises again, the other raises in the thread that waits for the answer
    broad = [name for name in broad if name not in {"cache/atomic.py", "site/hanging_disks.py"}]
    assert sorted(broad) == [
        "cli/main.py",
        "cli/run.py",
        "remote.py",
        "runner/life.py",
        "runner/worker.py",
        "runner/worker.py",
    ]


def public_functions(body: list[ast.stmt], owner: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Public functions, and public methods of public classes, by dotted name."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node.body, f"{node.name}.")
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield f"{owner}{node.name}", node


def test_functions_with_more_than_three_parameters_document_them() -> None:
    """Exempt are kernels (their file explains them), commands (their options do), and the demo (its scenes share parameters)."""
    silent = []
    for file in (file for file in SOURCES if not file.is_relative_to(DEMO)):
        for name, node in public_functions(parsed(file).body):
            arguments = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            decorators = [ast.unparse(d) for d in node.decorator_list]
            if len({*arguments} - {"self", "cls"}) > 3 and not any(d == "kernel" or d.startswith("click.") for d in decorators):
                silent += [] if "Parameters\n" in (ast.get_docstring(node) or "") else [f"{file.relative_to(ROOT)}: {name}"]
    assert silent == []


def test_every_usage_error_has_a_remedy() -> None:
    raised = [
        (file, node.lineno, {word.arg for word in node.keywords})
        for file in ENGINE_FILES
        for node in ast.walk(parsed(file))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "UsageError"
    ]
    assert len(raised) > 20
    assert [(str(file.relative_to(ROOT)), line) for file, line, words in raised if "remedy" not in words] == []
