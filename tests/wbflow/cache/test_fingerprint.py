"""The fingerprint of a function depends on the code that it runs, not on names or the places of files."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path

import pytest

from wbflow.cache.fingerprint import Modules, read_code
from wbflow.cache.versions import installed_version
from wbflow.pipeline.functions import FunctionReader
from wbflow.plugins import load

STAGE = """\
from .helper import HALF

def work(left, *, n: int = 3):
    return HALF * n

def other(left, *, n: int = 4):
    return HALF * n
"""


class Package:
    """A package in a folder on Python's path."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def write(self, **files: str) -> None:
        (self.root / "__init__.py").touch()
        for name, text in files.items():
            path = self.root / f"{name.replace('__', '/')}.py"
            path.parent.mkdir(parents=True, exist_ok=True)
            (path.parent / "__init__.py").touch()
            path.write_text(text)

    def code(self, function: str, table: str = "") -> str:
        name = self.root.name
        return FunctionReader().code(f"{name}.{function}", f"{name}.{table}" if table else "")


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Package:
    root = tmp_path / f"pkg_{abs(hash(str(tmp_path)))}"
    root.mkdir()
    monkeypatch.syspath_prepend(str(tmp_path))
    found = Package(root)
    found.write(helper="HALF = 0.5\n", stage=STAGE)
    return found


def test_a_renamed_function_keeps_its_fingerprint(package: Package) -> None:
    before = package.code("stage:work")
    package.write(stage=STAGE.replace("def work", "def labour"))
    assert package.code("stage:labour") == before


def test_a_moved_file_keeps_the_fingerprints_of_its_functions(package: Package) -> None:
    before = package.code("stage:work")
    package.write(room__stage=STAGE.replace("from .helper", "from ..rooms.helper"), rooms__helper="HALF = 0.5\n")
    assert package.code("room.stage:work") == before


def test_two_functions_of_one_module_have_different_fingerprints(package: Package) -> None:
    assert package.code("stage:work") != package.code("stage:other")


def test_a_renamed_recursive_function_keeps_its_fingerprint(package: Package) -> None:
    text = "def down(n):\n    return down(n - 1) if n else 0\n"
    package.write(stage=text)
    before = package.code("stage:down")
    package.write(stage=text.replace("down", "under"))
    assert package.code("stage:under") == before


def test_importing_a_name_from_another_helper_changes_the_fingerprint(package: Package) -> None:
    package.write(quarter="HALF = 0.25\n", stage=STAGE + "from . import quarter\n")
    before = package.code("stage:work")
    package.write(stage=STAGE.replace("from .helper", "from .quarter") + "from . import quarter\nfrom .helper import HALF as H\n")
    assert package.code("stage:work") != before


def test_swapping_the_contents_of_two_helpers_changes_the_fingerprint(package: Package) -> None:
    text = "from .a import f as g\nfrom .b import f as h\n\ndef work(x):\n    return g(x) - h(x)\n"
    package.write(a="def f(x):\n    return x\n", b="def f(x):\n    return 2 * x\n", stage=text)
    before = package.code("stage:work")
    package.write(b="def f(x):\n    return x\n", a="def f(x):\n    return 2 * x\n")
    assert package.code("stage:work") != before


def test_a_change_in_a_circularly_imported_module_changes_the_fingerprint(package: Package) -> None:
    package.write(helper="from . import stage\nHALF = 0.5\n")
    before = package.code("stage:work")
    package.write(helper="from . import stage\nHALF = 0.6\n")
    assert package.code("stage:work") != before


def test_comments_and_attribute_docstrings_do_not_change_the_fingerprint(package: Package) -> None:
    before = package.code("stage:work")
    package.write(helper='HALF = 0.5\n"""Half of it."""\n# indeed\n')
    assert package.code("stage:work") == before


def test_a_method_added_to_the_table_does_not_change_the_fingerprint(package: Package) -> None:
    table = '\nTABLE = {"a": "m:f"}\n"""Methods."""\n'
    package.write(stage=STAGE + table)
    with_table, read = package.code("stage:work", "stage:TABLE"), package.code("stage:work")
    package.write(stage=STAGE + table.replace("}", ', "b": "m:g"}'))
    assert package.code("stage:work", "stage:TABLE") == with_table
    assert package.code("stage:work") != read


def test_modules_of_the_stages_that_a_function_imports_are_part_of_its_code(package: Package) -> None:
    package.write(
        stage="from wbflow_stages.matching.nearest_neighbour import match_mutual\n\ndef work(left):\n    return match_mutual\n"
    )
    files = read_code(Modules(), f"{package.root.name}.stage:work").files
    assert Modules().file("wbflow_stages.matching.nearest_neighbour") in files


@pytest.mark.parametrize(
    "block",
    [
        "if x:\n    pass\nelse:\n    {}",
        "for _ in x:\n    pass\nelse:\n    {}",
        "while x:\n    {}",
        "try:\n    pass\nexcept OSError:\n    {}",
        "try:\n    pass\nfinally:\n    {}",
        "with x:\n    {}",
        "match x:\n    case _:\n        {}",
        "class Inner:\n    def inner(self):\n        {}",
    ],
)
def test_an_import_in_any_block_is_part_of_the_code(block: str, package: Package) -> None:
    body = "\n    ".join(block.format("from .helper import HALF").splitlines())
    package.write(stage=f"def work(x):\n    {body}\n")
    before = package.code("stage:work")
    package.write(helper="HALF = 0.25\n")
    assert package.code("stage:work") != before


def test_the_fingerprint_depends_on_minor_versions_of_imported_libraries(
    package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This includes libraries that are imported by another name than their package's, and imports within a helper's functions."""

    def install(version: str) -> None:
        folder = tmp_path / "Deep_Nets-1.dist-info"
        folder.mkdir(exist_ok=True)
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: Deep-Nets\nVersion: {version}\n")
        (folder / "top_level.txt").write_text("deepnets\n")
        installed_version.cache_clear()
        monkeypatch.setattr("wbflow.cache.versions._provided", metadata.packages_distributions)

    package.write(helper="HALF = 0.5\ndef run():\n    import deepnets.functional as F\n    return F\n")
    code = read_code(Modules(), f"{package.root.name}.stage:work")
    assert code.libraries == ("deepnets",)
    found = {}
    for version in ("2.1.0", "2.1.7", "2.2.0"):
        install(version)
        found[version] = package.code("stage:work")
    installed_version.cache_clear()
    assert found["2.1.0"] == found["2.1.7"] != found["2.2.0"]


def test_the_standard_library_is_not_among_the_libraries_of_a_function(package: Package) -> None:
    package.write(stage="import json\nfrom os import path\n\ndef work(left):\n    return json, path\n")
    assert read_code(Modules(), f"{package.root.name}.stage:work").libraries == ()


def test_threads_that_load_from_one_module_wait_until_it_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "slow_to_import.py").write_text("import time\n\ntime.sleep(0.2)\n\n\ndef stage():\n    return 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with ThreadPoolExecutor(4) as threads:
        assert [f() for f in threads.map(load, ["slow_to_import:stage"] * 4)] == [1] * 4
