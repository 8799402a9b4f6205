"""Functions by dotted name, also from modules in the folder of a site file (`use: my_module:my_function`)."""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


class _SiteFolder(str):
    """An entry of `sys.path` that was added for a site."""

    def __reduce__(self) -> tuple[type[str], tuple[str]]:  # worker processes get the path before they can import this
        return str, (str(self),)


def make_importable(folder: Path | None) -> None:
    """Append a folder to `sys.path`, after all other entries; unload the modules of another site, and remove its folder."""
    for old_folder in [entry for entry in sys.path if isinstance(entry, _SiteFolder) and entry != str(folder)]:
        sys.path.remove(old_folder)
        for name, module in list(sys.modules.items()):
            if Path(getattr(module, "__file__", None) or "/").is_relative_to(old_folder):
                del sys.modules[name]
    if folder and str(folder) not in sys.path:
        sys.path.append(_SiteFolder(folder))


def is_site_module(file: str) -> bool:
    """Is a source file in a folder that `make_importable` added, rather than installed?"""
    return any(Path(file).is_relative_to(entry) for entry in sys.path if isinstance(entry, _SiteFolder))


def load(dotted: str) -> Callable[..., Any]:
    """The function or class "package.module:name", looked up each time: modules of a site are unloaded with the site."""
    function: Callable[..., Any] = pkgutil.resolve_name(dotted)
    return function
