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
    stated = os.environ.get(THREADS, "")
    threads = min(max(int(stated), 1), _MOST_THREADS) if stated.isdecimal() else 1
    if threads == 1:
        yield from map(work, items)
        return
    remaining = iter(items)
    parallel = Parallel(n_jobs=threads, prefer="threads", return_as="generator")
    while chunk := list(islice(remaining, threads)):
        yield from parallel(delayed(work)(item) for item in chunk)
