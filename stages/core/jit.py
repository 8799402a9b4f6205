"""How loops become machine code: one decorator around numba, with the flags that keep results the same everywhere.

A kernel's compiled form is kept on disk beside its source (or in NUMBA_CACHE_DIR).  numba looks only at that one file's time
stamp, so a kernel may call other kernels of *its own file* only.

Processes that start side by side compile each kernel once between them: who comes second waits, and reads what the first has
left.

Compiling is what a first run on a machine spends most on, so kernels are written to be compiled quickly: whole arrays are filled
in loops (what numba says of shapes that differ takes seconds to compile), medians and the like are taken outside.

No fast mathematics: with leave to reorder sums, code that had just been compiled and the same code read back from the disk gave
disparities that differed in the last bits, and so clouds of other bytes.
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
except ImportError:  # Windows: every process compiles for itself
    fcntl = None  # type: ignore[assignment]

Function = TypeVar("Function", bound=Callable[..., Any])
Scalar = np.float32
"""What kernels reckon with: numba takes a number of Python for a float64."""


def kernel(function: Function) -> Function:
    """Compile `function` at its first call; the compiled form releases the GIL and follows numpy's rules for division by zero."""
    return _compiled(function)


def helper(function: Function) -> Function:
    """The same for what kernels call and Python never does: how Python would call it is not compiled, which takes about as long
    as a small kernel itself (14 in place of 33 ms with a number, 66 in place of 126 with six arrays).  Python must not call it:
    a test looks for that."""
    return _compiled(function, no_cpython_wrapper=True)


def _compiled(function: Function, **more: bool) -> Function:
    options: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, **more}  # nobody calls one from C
    try:
        return cast(Function, _once_between_processes(numba.njit(cache=True, **options)(function)))
    except RuntimeError:  # nowhere to keep the compiled form: a read-only installation and no home, as under cron
        return cast(Function, numba.njit(**options)(function))


def _once_between_processes(dispatcher: Any) -> Any:
    """Let a kernel be compiled, or read from the disk, by one process at a time.

    A lock for each kernel: what it calls is locked within its own, and no kernel calls itself in a circle, so nobody waits for
    somebody who waits.  In one process numba's own lock, which it takes for every compilation, comes first.
    """
    compiled = dispatcher.compile

    def compiled_alone(signature: Any) -> Any:
        with global_compiler_lock, _alone(dispatcher), _without_collecting():
            return compiled(signature)

    dispatcher.compile = compiled_alone
    return dispatcher


@contextmanager
def _without_collecting() -> Iterator[None]:
    """A compiler makes very many objects that stay until it ends: looking for garbage among them takes a tenth of its time."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


@contextmanager
def _alone(dispatcher: Any) -> Iterator[None]:
    """While no other process compiles this kernel; where files cannot be locked, at once."""
    folder, function = dispatcher.stats.cache_path, dispatcher.py_func
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
