"""wbflow: a metric, coloured point cloud of a site every night, from fixed cameras with wide baselines.

From Python: `load_site`, `run` and `open_run` (see `wbflow.api`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .api import Run, load_site, open_run, run

__version__ = "0.1.0"

__all__ = ["Run", "__version__", "load_site", "open_run", "run"]


def __getattr__(name: str) -> Any:
    """Import the API on first use: the command line and the workers need little of it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return __all__
