"""Where lanes are done: in worker processes here, in threads, or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

from ..cache.store import Cache
from ..records.costs import read_past
from ..task import Task
from . import machine
from .limits import Limits
from .mounts import Mount
from .options import Options
from .spec import TaskSpec
from .supervisor import Report, Supervisor


class Executor(Protocol):
    """Does lanes."""

    def submit(self, lanes: list[list[TaskSpec]]) -> None:
        """Lanes to be done."""

    def reports(self) -> Iterator[Report]:
        """What becomes of tasks, as it happens; ends when a lane has ended and no other is queued behind it."""

    def close(self) -> None:
        """Stop, whatever is still at work."""


def executor(
    options: Options, cache: Cache, warn: Callable[[str, Task], None], begun: Callable[[Task], None] = lambda task: None
) -> Executor:
    """An executor as a run asks for it.

    Parameters
    ----------
    options : Options
        Where, how many at once, under which limits.
    cache : Cache
        Where results go.
    warn : callable
        Told of what was survived, and of which task it happened to.
    begun : callable
        Told of each task that a worker process takes in hand.

    Raises
    ------
    WbflowError
        There is no cluster.
    """
    if options.backend == "threading":
        from .elsewhere import Threads

        return Threads(options.jobs, cache)
    if options.backend == "dask":
        from .elsewhere import Cluster

        return Cluster(options.scheduler or "", cache, [Mount.parse(root) for root in options.worker_roots])
    memory = options.memory or machine.memory()
    limits = Limits(memory, options.time_limit, read_past(cache.work), options.stop_at)
    return Supervisor(options.jobs, cache, limits, warn, begun)
