"""What has arrived for a night: its captures, masks and models by digest, and which cameras deliver what is not of tonight."""

from __future__ import annotations

import datetime
from dataclasses import dataclass

from ..cache.digests import Digests
from ..cache.seen import Seen
from ..records.events import ArrivalsEvent, Watcher
from ..records.record import Health
from ..site.models import Site
from .captures import CaptureFile, find_captures, find_named, look_again, night
from .staleness import look_at


@dataclass
class Arrivals:
    """What is there for one night, before anything is planned."""

    date: datetime.date
    """The captures' date."""
    captures: dict[str, list[CaptureFile]]
    """By camera."""
    named: dict[str, CaptureFile]
    """What the site file names: masks by camera, and files of stages."""
    digests: Digests
    """To be saved by a run."""
    seen: Seen
    """To be saved by a run that comes to its end."""
    stale: dict[str, Health]
    """Cameras whose captures are not of tonight."""
    notes: dict[str, str]
    """What is to be said of a camera's captures."""


def arrivals(site: Site, date: datetime.date | None = None, watch: Watcher | None = None) -> Arrivals:
    """Look at what there is for a night; nothing is written.

    Parameters
    ----------
    site : Site
        Whose.
    date : date, optional
        The newest that has captures, if not given.
    watch : callable, optional
        Is told how far it is.
    """
    work = site.work_folder
    digests, seen = Digests(work.captures_memo), Seen(work.seen_memo)
    look_again(site)
    date = night(site, date)
    all_cameras = len(site.cameras)
    tell = (lambda cameras: watch(ArrivalsEvent(cameras, all_cameras))) if watch else None
    delivered = look_at(site, date, find_captures(site, date, digests, tell), digests, seen)
    return Arrivals(date, delivered.captures, find_named(site, digests), digests, seen, delivered.stale, delivered.notes)
