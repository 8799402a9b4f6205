"""Threads within one stage: the same results in the same order, whatever the number of threads.

Kernels and most of numpy release the GIL.  An environment variable sets the number of threads of a stage; the default is one.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import TypeVar

from joblib import Parallel, delayed

Item = TypeVar("Item")
Result = TypeVar("Result")

THREADS = "STAGE_THREADS"
"""Environment variable with the number of threads that a stage may use; where it is not set, as in a notebook, it uses one."""
_MOST_THREADS = 4
"""Largest number of threads: each holds its own results in memory."""


def parallel_map(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield `work(item)` for each item, in order; at most as many results as there are threads are computed ahead."""
    threads = _thread_count()
    if threads == 1:
        yield from map(work, items)
        return
    remaining = iter(items)
    parallel = Parallel(n_jobs=threads, prefer="threads", return_as="generator")
    # in chunks: joblib alone would compute all results ahead of a slow reader, and keep them
    while True:
        chunk = list(islice(remaining, threads))
        if not chunk:
            return
        yield from parallel(delayed(work)(item) for item in chunk)


def _thread_count() -> int:
    """Number of threads that the environment states, within limits; one if it states none, or no number."""
    stated = os.environ.get(THREADS, "")
    if not stated.isdecimal():
        return 1
    return min(max(int(stated), 1), _MOST_THREADS)
