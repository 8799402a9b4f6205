"""One night of a site made ready: captures found, work folder known, plan made.  What `run`, `status` and `check` start from."""

from __future__ import annotations

import datetime
import functools
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..cache.digests import Digests, Seen
from ..cache.layout import WorkFolder
from ..cache.store import Cache
from ..records.events import ArrivalsEvent, Watcher
from ..records.record import Health
from ..records.reference_folder import BadReference, Reference, read_reference
from ..site.models import Site
from .captures import (
    ANSWER_SECONDS,
    LATER_SECONDS,
    CaptureFile,
    answered,
    expected,
    find_captures,
    find_named,
    look_again,
    night,
)
from .planner import Plan
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


@dataclass
class Night:
    """A site on one night: its plan, and what is to be kept of the search for captures."""

    site: Site
    date: datetime.date
    """The captures' date."""
    captures: dict[str, list[CaptureFile]]
    digests: Digests
    """To be saved by a run."""
    seen: Seen
    """To be saved by a run that comes to its end."""
    notes: dict[str, str]
    """What is to be said of a camera's captures."""
    plan: Plan
    replaced: set[Path] = field(default_factory=set)
    """Files that were found changed after their digests had been taken."""

    def remember(self) -> None:
        """Keep what was learnt of files, for the next run.  Raises OSError."""
        self.digests.save()
        self.seen.save()
        self.site.reader.save()

    def look_again(self, path: Path) -> None:
        """A file has changed since its digest was taken: what it holds now is what the plan goes on with."""
        self.replaced.add(path)
        self.digests.forget(path)
        self.plan.look_again()
        for files in self.captures.values():
            files[:] = [_now(file, self.digests) if file.path == path else file for file in files]
        for name, file in self.plan.named.items():
            if file.path == path:
                self.plan.named[name] = _now(file, self.digests)

    def captures_in_motion(self) -> dict[str, list[str]]:
        """Captures that were replaced, or grew, since the run began: their names, by camera."""
        found: dict[str, list[str]] = {}
        seconds = ANSWER_SECONDS
        for camera, files in self.captures.items():
            try:
                moved = answered(functools.partial(self._in_motion, files), seconds)
            except TimeoutError:  # the mount has died since
                seconds, moved = LATER_SECONDS, []
            if moved:
                found[camera] = moved
        return found

    def _in_motion(self, files: Iterable[CaptureFile]) -> list[str]:
        return [f.name for f in files if f.digest and (f.path in self.replaced or _now(f, self.digests).digest != f.digest)]


def _now(file: CaptureFile, digests: Digests) -> CaptureFile:
    try:
        return replace(file, digest=digests.of(file.path))
    except OSError:  # gone since
        return replace(file, digest="")


def open_night(
    site: Site,
    date: datetime.date | None = None,
    until: str | None = None,
    force: tuple[str, ...] = (),
    arrived: Arrivals | None = None,
) -> Night:
    """Find a night's captures and plan its work; nothing is written.

    Parameters
    ----------
    site : Site
        Whose captures.
    date : date, optional
        The night; the newest that has captures, if not given.
    until : str, optional
        Stop after this stage.
    force : tuple of str
        Stages or tasks to be done again.
    arrived : Arrivals, optional
        What there is for that night, where somebody has looked already.
    """
    work, there = site.work_folder, arrived or arrivals(site, date)
    captures = there.captures
    lost = [camera for camera in site.cameras if not captures[camera.id]]
    missing = {camera.id: expected(site, camera, there.date).replace(f"{site.root}/", "") for camera in lost}
    reference, misfit = _reference(site, work)
    plan = Plan(
        site,
        captures,
        str(there.date),
        Cache(work),
        there.named,
        missing,
        until,
        frozenset(force),
        reference=reference,
        misfit=misfit,
        stale=there.stale,
        night_given=date is not None,
    )
    return Night(site, there.date, captures, there.digests, there.seen, there.notes, plan)


def _reference(site: Site, work: WorkFolder) -> tuple[Reference | None, str]:
    """The reference, and why there is none where there should be."""
    try:
        return (read_reference(work) if site.pin != "none" else None), ""
    except BadReference as error:
        return None, error.what
