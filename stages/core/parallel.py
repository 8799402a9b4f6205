"""Work of one stage in threads: the same results in the same order, however many threads there are.

Kernels and most of numpy release the GIL.  The environment says how many threads a stage may have; in a notebook it has one.
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
"""The environment variable that says how many threads a stage may have."""
_MOST = 4
"""More would hold too much at once: each has results of its own in memory."""


def parallel_map(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield `work` of each item, in order; no more results are ahead of the consumer than there are threads."""
    stated = os.environ.get(THREADS, "")
    threads = min(max(int(stated), 1), _MOST) if stated.isdecimal() else 1
    if threads == 1:
        yield from map(work, items)
        return
    waiting = iter(items)
    parallel = Parallel(n_jobs=threads, prefer="threads", return_as="generator")
    while chunk := list(islice(waiting, threads)):
        yield from parallel(delayed(work)(item) for item in chunk)
