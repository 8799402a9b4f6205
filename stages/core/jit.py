"""How loops become machine code: one decorator around numba, with the flags that keep results the same everywhere.

A kernel's compiled form is kept on disk beside its source (or in NUMBA_CACHE_DIR).  numba looks only at that one file's time
stamp, so a kernel may call other kernels of *its own file* only.

No fast mathematics: with leave to reorder sums, code that had just been compiled and the same code read back from the disk gave
disparities that differed in the last bits, and so clouds of other bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile `function` at its first call; the compiled form releases the GIL and follows numpy's rules for division by zero."""
    options: Any = {"nogil": True, "error_model": "numpy"}
    try:
        return cast(Function, numba.njit(cache=True, **options)(function))
    except RuntimeError:  # nowhere to keep the compiled form: a read-only installation and no home, as under cron
        return cast(Function, numba.njit(**options)(function))
