"""The pages: HTML from the templates in `assets`."""

from __future__ import annotations

import contextlib
from importlib.resources import files
from typing import Any


def render(template: str, **content: Any) -> str:
    """Return the page made from a template in `assets`; all inserted content is escaped, except the assets."""
    from jinja2 import Environment, FileSystemBytecodeCache, FunctionLoader, StrictUndefined  # here: only pages need it
    from markupsafe import Markup

    template_cache = None
    with contextlib.suppress(RuntimeError, OSError):  # without a cache folder, templates are compiled each time
        template_cache = FileSystemBytecodeCache()
    environment = Environment(
        loader=FunctionLoader(_asset), autoescape=True, bytecode_cache=template_cache, undefined=StrictUndefined, trim_blocks=True
    )
    environment.globals["asset"] = lambda name: Markup(_asset(name))
    return environment.get_template(template).render(content)


def _asset(name: str) -> str:
    return (files(__package__) / "assets" / name).read_text(encoding="utf-8")
