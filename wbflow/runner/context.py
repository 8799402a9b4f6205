"""What a run starts from: the captures of its night, and its plan.  `run`, `status` and `check` begin here."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.layout import WorkFolder
from ..cache.memo import Digests, EarlierCaptures
from ..cache.store import Cache
from ..records.reference_folder import BadReference, Reference, read_reference
from ..site.captures import as_now, expected, find_captures, find_named, in_motion, list_store, night, when_complete
from ..site.models import Site
from ..site.stale_cameras import find_stale
from .options import Options
from .planner import Plan


@dataclass
class RunContext:
    """A site on one night: the plan of what is made of its captures, and what is remembered of these."""

    date: datetime.date
    digests: Digests
    """To be saved by a run."""
    earlier_captures: EarlierCaptures
    """To be saved by a run that comes to its end."""
    notes: dict[str, str]
    """Remarks about the captures of a camera."""
    plan: Plan
    replaced: set[Path] = field(default_factory=set)
    """Files that were found changed after their digests had been taken."""
    growing: frozenset[Path] = frozenset()
    """Captures that were still being written when the run began."""

    def reread(self, path: Path) -> None:
        """A file has changed since its digest was taken: the plan goes on with what it holds now."""
        self.replaced.add(path)
        self.digests.forget(path)
        self.plan.relist()
        for files in self.plan.captures.values():
            files[:] = [as_now(file, self.digests) if file.path == path else file for file in files]
        for name, file in self.plan.named.items():
            if file.path == path:
                self.plan.named[name] = as_now(file, self.digests)

    def captures_in_motion(self) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
        """Captures that have changed since the run began, by camera: those that should not have, and those that may.

        A camera whose captures' names say no date overwrites one and the same file: each is read as a whole, and once it is
        complete the next one harms nothing.
        """
        changed = in_motion(self.plan.captures, self.replaced, self.digests)
        if self.plan.site.captures.dated:
            return changed, {}
        unfinished = {file.name for files in self.plan.captures.values() for file in files if file.path in self.growing}
        harmful = {camera: [name for name in names if name in unfinished] for camera, names in changed.items()}
        harmless = {camera: [name for name in names if name not in unfinished] for camera, names in changed.items()}
        return harmful, harmless


def plan_run(site: Site, options: Options) -> RunContext:
    """Find a night's captures and plan its work; nothing is written."""
    work = site.work_folder
    digests, earlier_captures = Digests(work.captures_memo), EarlierCaptures(work.delivered_memo)
    list_store(site)
    found_date = night(site, options.date)
    found, growing = when_complete(find_captures(site, found_date, digests), digests)
    delivered = find_stale(site, found_date, found, digests, earlier_captures)
    lost = [camera for camera in site.cameras if not delivered.captures[camera.id]]
    named = {camera.id: expected(site, camera, found_date).replace(f"{site.captures.root}/", "") for camera in lost}
    reference, incompatible = _reference(site, work)
    plan = Plan(
        site,
        delivered.captures,
        str(found_date),
        Cache(work),
        find_named(site, digests),
        {camera.id: options.not_captured.get(camera.id) or f"there is no file {named[camera.id]}" for camera in lost},
        options.until,
        frozenset(options.force),
        reference=reference,
        incompatible=incompatible,
        stale=delivered.stale,
        night_given=options.date is not None,
    )
    return RunContext(found_date, digests, earlier_captures, delivered.notes, plan, growing=growing)


def _reference(site: Site, work: WorkFolder) -> tuple[Reference | None, str]:
    """The reference, and why there is none where there should be."""
    try:
        return (read_reference(work) if site.settings.pin != "none" else None), ""
    except BadReference as error:
        return None, error.what
