"""Compiled loops treat nan and division by zero as numpy does, and work where nothing can be written."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import wbflow_stages
from wbflow_stages.core.jit import kernel
from wbflow_stages.types import Float64s


@kernel
def _count_nan_and_zeros(values: Float64s) -> int:
    count = 0
    for value in values:
        if np.isnan(value) or np.isinf(1.0 / value):
            count += 1
    return count


def test_kernels_treat_nan_and_division_by_zero_as_numpy_does() -> None:
    assert _count_nan_and_zeros(np.array([1.0, np.nan, 0.0])) == 2


_READ_ONLY = """
import os, sys
import numpy as np


def disparity_without_speckles():
    from wbflow_stages.stereo.consistency import without_speckles
    return without_speckles(np.arange(60, dtype=np.float32).reshape(6, 10), 5)


expected = disparity_without_speckles()  # as installed: loads, and compiles with, all that is needed of other people's libraries
for name in [name for name in sys.modules if name.partition(".")[0] == "wbflow_stages"]:
    del sys.modules[name]
sys.path.insert(0, {folder!r})
os.environ["HOME"] = "/nonexistent"
if os.geteuid() == 0:  # root may write anywhere: become nobody
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
try:
    open({folder!r} + "/wbflow_stages/written", "w")
except OSError:
    pass
else:
    raise SystemExit("this process can write into the installation: the test says nothing")
found = disparity_without_speckles()
import wbflow_stages
assert wbflow_stages.__file__.startswith({folder!r}), wbflow_stages.__file__
np.testing.assert_array_equal(found, expected)
from wbflow_stages.stereo import consistency
assert not consistency._drop_speckles.stats.cache_path, "compiled code was kept on the disk"
"""


def test_stages_work_in_a_read_only_installation_without_a_home(tmp_path: Path) -> None:
    """As under cron: the process can write nowhere (root becomes `nobody`).  Libraries are loaded before that, since `nobody`
    may be unable to read them."""
    with tempfile.TemporaryDirectory() as name:  # not `tmp_path`, whose parents other users cannot enter
        folder = Path(name)
        package = folder / "wbflow_stages"
        shutil.copytree(Path(wbflow_stages.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
        folders = [folder, *(path for path in folder.rglob("*") if path.is_dir())]
        for path in folders:
            path.chmod(0o555)
        environment = {"PATH": os.environ["PATH"], "HOME": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
        code = _READ_ONLY.format(folder=str(folder))
        try:
            result = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
        finally:
            for path in folders:
                path.chmod(0o755)
    assert result.returncode == 0, result.stderr


_SLOW = """
import numpy as np
from wbflow_stages.core.jit import kernel

@kernel
def inner(x):
    return x + 1.0

@kernel
def outer(x):
    total = 0.0
    for k in range(x.shape[0]):
        total += inner(x[k]) ** 3
    return total
"""


_AT_ONCE = """
import slow, numpy
print("ready", flush=True)
input()
slow.outer(numpy.ones(3))
print(sum(slow.outer.stats.cache_misses.values()))
"""


def test_two_processes_compile_a_shared_kernel_only_once(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(_SLOW)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kernels"), "PYTHONPATH": str(tmp_path)}
    processes = [
        subprocess.Popen([sys.executable, "-c", _AT_ONCE], env=environment, stdout=-1, stdin=-1, text=True) for _ in range(2)
    ]
    for process in processes:
        assert process.stdout
        assert process.stdout.readline() == "ready\n"
    for process in processes:  # both are started before either is awaited
        assert process.stdin
        process.stdin.write("go\n")
        process.stdin.flush()
    reported = [process.communicate()[0].strip() for process in processes]
    assert sorted(reported) == ["0", "1"]


def test_no_kernel_uses_a_name_from_another_file_of_the_stages() -> None:
    """Whatever a kernel uses is compiled into it, but numba recompiles only if the kernel's own file has changed."""
    root = Path(wbflow_stages.__file__).parent
    sources = {path.relative_to(root).as_posix(): path.read_text() for path in sorted(root.rglob("*.py"))}
    assert sum(len(_kernels(ast.parse(source))) for source in sources.values()) > 50
    assert {name: found for name, source in sources.items() if (found := _foreign_in_kernels(source))} == {}


def test_a_kernel_that_uses_names_from_another_file_is_detected() -> None:
    source = (
        "from ..core.jit import kernel\nfrom ..types import Float64s\nfrom .other import LIMIT, inner, plain\n"
        "import wbflow_stages.core.ordering as sorting\n"
        "@kernel\ndef outer(x: Float64s) -> float:\n    y: Float64s = x\n    return inner(y) + LIMIT + sorting.network(3)\n"
        "def free(x):\n    return plain(x)\n"
    )
    assert _foreign_in_kernels(source) == ["outer uses LIMIT", "outer uses inner", "outer uses sorting"]


def test_no_python_code_calls_a_compiled_helper() -> None:
    """Helpers are compiled without a wrapper for calls from Python.  They are private, so it is enough to check the code of their
    own files, and what the stages and their tests import."""
    root = Path(wbflow_stages.__file__).parent
    sources = {path.relative_to(root).as_posix(): path.read_text() for path in sorted(root.rglob("*.py"))}
    assert {name: found for name, source in sources.items() if (found := _helpers_elsewhere(source))} == {}
    helpers_of = {
        Path(n).stem: {f.name for f in _kernels(ast.parse(s)) if _is_decorated_by(f, "helper")} for n, s in sources.items()
    }
    others = [ast.parse(path.read_text()) for folder in (root, Path(__file__).parents[1]) for path in folder.rglob("*.py")]
    imports = [node for tree in others for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    imported_names = [(str(node.module).split(".")[-1], alias.name) for node in imports for alias in node.names]
    assert [(stem, name) for stem, name in imported_names if name in helpers_of.get(stem, ())] == []


def test_a_helper_that_python_code_calls_is_detected() -> None:
    source = "@helper\ndef _a(): ...\n@helper\ndef _b(): ...\n@kernel\ndef _c(): _a()\ndef d(): _b()\n@helper\ndef e(): ...\n"
    assert _helpers_elsewhere(source) == ["_b", "e"]


def test_no_kernel_copies_an_array_into_a_slice() -> None:
    """Numba also compiles the case that shapes differ, which adds seconds to a first run; a loop adds none."""
    root = Path(wbflow_stages.__file__).parent
    trees = {path.relative_to(root).as_posix(): ast.parse(path.read_text()) for path in sorted(root.rglob("*.py"))}
    found = {f"{name}: {line}" for name, tree in trees.items() for kernel in _kernels(tree) for line in _copies(kernel)}
    assert found == set()


def test_a_kernel_that_copies_an_array_into_a_slice_is_detected() -> None:
    source = (
        "@kernel\ndef f(a: Float64s, n: int) -> None:\n    b = np.zeros(n)\n    a[:] = b\n"
        "    a[1:], n = b[0], 2\n    a[:n] = b[:n]\n"
        "    b[:] = 1 / a\n    a[:] = 0.0\n    a[:] = min(n, 3)\n    b[n] = a[n]\n"
    )
    (kernel,) = _kernels(ast.parse(source))
    assert _copies(kernel) == ["a[:] = b", "a[:n] = b[:n]", "b[:] = 1 / a"]


def _copies(function: ast.FunctionDef) -> list[str]:
    """Source lines that assign an array, a slice of one, or a value computed from these, to a slice."""
    arrays = {a.arg for a in function.args.args if a.annotation and ast.unparse(a.annotation).endswith("s")}
    lines = []
    for node in (n for n in ast.walk(function) if isinstance(n, ast.Assign) and len(n.targets) == 1):
        target, value = node.targets[0], node.value
        pairs = (
            zip(target.elts, value.elts, strict=True) if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple) else ()
        )
        for to, what in [*pairs, (target, value)]:
            if isinstance(to, ast.Name) and isinstance(what, ast.Call) and ast.unparse(what.func) in _MAKERS:
                arrays.add(to.id)
            sliced = isinstance(to, ast.Subscript) and any(isinstance(n, ast.Slice) for n in ast.walk(to.slice))
            if sliced and _holds_array(what, arrays):
                lines.append(ast.unparse(node))
    return lines


_MAKERS = {"np.zeros", "np.ones", "np.empty", "np.full"}


def _holds_array(value: ast.expr, arrays: set[str]) -> bool:
    """Does a value contain an array or a slice of one?  Single elements do not count."""
    if isinstance(value, ast.Name):
        return value.id in arrays
    if isinstance(value, ast.Subscript):
        return any(isinstance(n, ast.Slice) for n in ast.walk(value.slice))
    return any(_holds_array(child, arrays) for child in ast.iter_child_nodes(value) if isinstance(child, ast.expr))


def _kernels(tree: ast.Module) -> list[ast.FunctionDef]:
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    return [f for f in functions if _is_decorated_by(f, "kernel", "helper")]


def _is_decorated_by(function: ast.AST, *decorators: str) -> bool:
    made = function.decorator_list if isinstance(function, ast.FunctionDef) else []
    return any(isinstance(decorator, ast.Name) and decorator.id in decorators for decorator in made)


def _helpers_elsewhere(source: str) -> list[str]:
    """Helpers that code outside the kernels of their own file uses, or whose names are not private."""
    tree = ast.parse(source)
    helpers = {f.name for f in _kernels(tree) if _is_decorated_by(f, "helper")}
    free = [node for node in tree.body if not _is_decorated_by(node, "kernel", "helper")]
    named = {node.id for part in free for node in ast.walk(part) if isinstance(node, ast.Name)}
    return sorted(name for name in helpers if name in named or not name.startswith("_"))


def _foreign_in_kernels(source: str) -> list[str]:
    """Names imported from other files of the stages that the bodies of kernels use outside annotations."""
    tree = ast.parse(source)
    foreign = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.level > 0 or (node.module or "").startswith("wbflow_stages")):
            foreign |= {alias.asname or alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            ours = [alias for alias in node.names if alias.name.startswith("wbflow_stages")]
            foreign |= {alias.asname or "wbflow_stages" for alias in ours}
    found = set()
    for function in _kernels(tree):
        annotations = {id(n) for a in ast.walk(function) if isinstance(a, ast.AnnAssign) for n in ast.walk(a.annotation)}
        for statement in function.body:
            names = [n for n in ast.walk(statement) if isinstance(n, ast.Name) and id(n) not in annotations]
            found |= {f"{function.name} uses {n.id}" for n in names if n.id in foreign}
    return sorted(found)
