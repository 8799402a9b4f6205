"""Is the code here the code there?  What two machines must have in common for one to do the other's tasks under its keys."""

from __future__ import annotations

import functools
import hashlib
import importlib.util
from collections.abc import Iterable
from pathlib import Path

from .. import __version__
from ..cache.fingerprint import FOLLOWED, LIBRARIES, installed_version
from ..cache.functions import FunctionReader
from ..cache.modules import FunctionError
from .spec import TaskSpec

_OURS = (__package__.partition(".")[0], *FOLLOWED)
"""Packages that are compared as a whole."""


def named_functions(lane: Iterable[TaskSpec]) -> tuple[str, ...]:
    """Functions that tasks name, as `use:` or as a method, from other packages than ours."""
    named = set()
    for spec in lane:
        named |= {spec.function, *(v for v in spec.parameters.values() if isinstance(v, str) and ":" in v)}
    return tuple(sorted(name for name in named if name.partition(":")[0].partition(".")[0] not in _OURS))


def code_here(functions: tuple[str, ...], folder: Path | None) -> dict[str, str]:
    """What is installed here, by name: our own packages, the libraries behind them, and fingerprints of other functions."""
    reader = FunctionReader(folder=folder)
    found = dict(_installed())
    for dotted in functions:
        try:
            found[dotted] = reader.read(dotted).code
        except FunctionError:
            found[dotted] = ""
    return found


@functools.cache
def _installed() -> tuple[tuple[str, str], ...]:
    versions = {name: installed_version(name) for name in LIBRARIES}
    return (*((name, _digest(name)) for name in _OURS), *versions.items())


def _digest(package: str) -> str:
    """Of all source files of a package."""
    spec = importlib.util.find_spec(package)
    digest = hashlib.sha256(__version__.encode())
    for root in map(Path, (spec.submodule_search_locations or ()) if spec else ()):
        for file in sorted(root.rglob("*.py")):
            digest.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:32]
