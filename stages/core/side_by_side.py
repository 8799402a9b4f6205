"""Work done in threads, for stages that a whole night waits for: the same results in the same order, however many there are.

Kernels and most of numpy let other threads work beside them.  Whoever runs a stage says how many it may have; nobody does in a
notebook, and it has one.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

THREADS = "STAGE_THREADS"
"""The variable of the environment that says how many threads a stage may have."""
_MOST = 4
"""More would hold too much at once: each has results of its own in hand."""


def side_by_side(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """`work` of each item, in order; no more results are ahead of whoever takes them than there are threads."""
    threads = _threads()
    if threads == 1:
        yield from map(work, items)
        return
    begun: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for item in items:
                begun.append(pool.submit(work, item))
                if len(begun) > threads:
                    yield begun.popleft().result()
            while begun:
                yield begun.popleft().result()
        finally:
            for one in begun:
                one.cancel()


def _threads() -> int:
    said = os.environ.get(THREADS, "")
    return min(max(int(said), 1), _MOST) if said.isdecimal() else 1
