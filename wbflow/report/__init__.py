"""The pages: HTML from the templates in `assets`."""

from __future__ import annotations

import contextlib
import platform
from typing import Any

from ..cache.layout import WorkFolder


def place_of(work: WorkFolder) -> str:
    """Return where the page about all nights of a site is, for a person to whom one of its reports was sent."""
    if work.store:
        return f"{work.store}/{work.site_page.name}"
    return f"{work.site_page.absolute()} on {platform.node()}"


def render(template: str, **content: Any) -> str:
    """Return the page made from a template in `assets`; all inserted content is escaped, except the assets."""
    from jinja2 import Environment, FileSystemBytecodeCache, PackageLoader, StrictUndefined  # here: only pages need it
    from markupsafe import Markup

    assets = PackageLoader(__package__, "assets")
    compiled = None
    with contextlib.suppress(RuntimeError, OSError):  # without a cache folder, templates are compiled each time
        compiled = FileSystemBytecodeCache()
    environment = Environment(
        loader=assets, bytecode_cache=compiled, autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.globals["asset"] = lambda name: Markup(assets.get_source(environment, name)[0])
    return environment.get_template(template).render(content)
