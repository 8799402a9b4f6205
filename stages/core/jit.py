"""Compilation of loops to machine code: decorators around numba with flags that keep results identical everywhere.

A kernel's compiled form is cached on disk next to its source (or in NUMBA_CACHE_DIR).  numba checks the time stamp of that one
file only, so a kernel may call only kernels of *its own file*, and take only named tuples that it defines.

Processes that start at the same time compile each kernel only once: one compiles, the others wait and read the cached result.

Compilation takes most of a first run on a machine, so kernels are written to compile quickly: whole arrays are filled in loops
(numba's error message for mismatched shapes alone takes seconds to compile), and medians and the like are computed outside.

fastmath is off: with reordered sums, freshly compiled code and the same code read back from the disk gave disparities that
differed in the last bits, and therefore clouds with different bytes.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core.compiler_lock import global_compiler_lock

try:
    import fcntl
except ImportError:  # Windows: every process compiles on its own
    fcntl = None  # type: ignore[assignment]

Function = TypeVar("Function", bound=Callable[..., Any])
Scalar = np.float32
"""Scalar type of kernel arguments: numba would type a Python float as float64."""


def kernel(function: Function) -> Function:
    """Compile `function` at its first call; the compiled form releases the GIL and divides by zero as numpy does."""
    return _compile(function)


def helper(function: Function) -> Function:
    """Compile a function that only other kernels call, without the wrapper for calls from Python.  Compiling that wrapper takes
    about as long as a small kernel itself (14 instead of 33 ms with one number, 66 instead of 126 ms with six arrays).  Python
    must never call such a function; a test checks this."""
    return _compile(function, no_cpython_wrapper=True)


def _compile(function: Function, **extra_options: bool) -> Function:
    options: Any = {
        "nogil": True,
        "error_model": "numpy",  # x / 0 is infinity or nan, as in numpy, not an exception
        "no_cfunc_wrapper": True,  # never called from C
        **extra_options,
    }
    try:
        return cast(Function, _compile_once(numba.njit(cache=True, **options)(function)))
    except RuntimeError:  # no writable cache: a read-only installation and no home folder, as under cron
        return cast(Function, numba.njit(**options)(function))


def _compile_once(dispatcher: Any) -> Any:
    """Let only one process at a time compile a kernel, or read it from the disk.

    Each kernel has its own lock.  The locks of the kernels that it calls are taken while it holds its own; since kernels never
    call each other in a circle, this cannot deadlock.  Within a process, numba's own compiler lock is taken first.
    """
    compile_kernel = dispatcher.compile

    def compile_locked(signature: Any) -> Any:
        with global_compiler_lock, _locked(dispatcher), _without_gc():
            return compile_kernel(signature)

    dispatcher.compile = compile_locked
    return dispatcher


@contextmanager
def _without_gc() -> Iterator[None]:
    """Disable the garbage collector: scanning the many objects that a compiler keeps until it ends takes a tenth of its time."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@contextmanager
def _locked(dispatcher: Any) -> Iterator[None]:
    """Hold the kernel's lock file, so that no other process compiles it; without locking where files cannot be locked."""
    folder = dispatcher.stats.cache_path
    function = dispatcher.py_func
    # functions defined within others have `<locals>` in their names, which not every file system takes
    name = f"{function.__module__}.{function.__qualname__}.lock".replace("<locals>", "")
    try:
        file = (Path(folder) / name).open("wb") if folder and fcntl else None
    except OSError:
        file = None
    if file is None:
        yield
        return
    with file:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
