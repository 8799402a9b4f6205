"""A night from its plan to what is published of it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from ..config.remembered import remember as remember_site
from ..config.site import Site
from ..night.arrivals import Arrivals
from ..night.journal import Costs, Journal
from ..night.night import open_night
from ..night.options import Options
from ..night.pin import prepare
from ..night.run import work
from ..store.intact import Intact
from .afterwards import afterwards
from .again import Basis, remember
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
    basis: Basis,
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
    basis : Basis
        Of the site at the beginning.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    night = open_night(site, options.date, options.until, options.force, there)
    place = night.plan.cache.work
    prepare(night, journal)
    intact = Intact(place)
    worked = work(night, options, journal, costs, intact)
    finished = publish(run, place, night, worked, journal, costs, intact, own_process=options.backend == "threading")
    afterwards(finished, site, journal)
    if not options.until and not worked.interrupted:
        tell(finished)
    if options.plain and not worked.interrupted:
        with contextlib.suppress(OSError):  # it costs planning the next night
            remember_site(site)
            remember(finished, night, basis, journal)
    return finished
