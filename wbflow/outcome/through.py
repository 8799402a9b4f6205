"""A night from its plan to what is published of it."""

from __future__ import annotations

from collections.abc import Callable

from ..reference.create import prepare
from ..runner.context import Arrivals, open_night
from ..runner.journal import Costs, Journal
from ..runner.loop import work
from ..runner.options import Options
from ..site.models import Site
from .afterwards import afterwards
from .artifacts import FinishedRun
from .publish import publish


def through(
    run: str,
    site: Site,
    there: Arrivals,
    options: Options,
    journal: Journal,
    costs: Costs,
    tell: Callable[[FinishedRun], None],
) -> FinishedRun:
    """Plan a night, do its work, and publish it.

    Parameters
    ----------
    run : str
        The run's id.
    site : Site
        Whose night; the caller holds the lock of its work folder.
    there : Arrivals
        What has arrived.
    options : Options
        What else is asked.
    journal, costs : Journal, Costs
        Are told.
    tell : callable
        Tells people of the finished run.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    night = open_night(site, options.date, options.until, options.force, there)
    place = night.plan.cache.work
    prepare(night, journal)
    worked = work(night, options, journal, costs)
    finished = publish(run, place, night, worked, journal, costs, own_process=options.backend == "threading")
    afterwards(finished, site, journal)
    if not options.until and not worked.interrupted:
        tell(finished)
    return finished
