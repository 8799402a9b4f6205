"""The start of a run: the captures of its night, and its plan.  `run`, `status` and `check` begin here."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.memo import Digests, EarlierCaptures
from ..cache.store import Cache
from ..records.reference_folder import BadReference, read_reference
from ..site.captures import changes_of, expected, find_captures, find_named, list_store, night, when_complete, with_current_digest
from ..site.models import Site
from ..site.stale_cameras import find_stale
from .options import Options
from .plan import Plan


@dataclass
class RunContext:
    """A site on one night: the plan for its captures, and the memos about these."""

    date: datetime.date
    digests: Digests
    """Saved at the end of a run."""
    earlier_captures: EarlierCaptures
    """Saved at the end of a run."""
    notes: dict[str, str]
    """Remarks about captures, by camera."""
    plan: Plan
    replaced: set[Path] = field(default_factory=set)
    """Files that were found to have changed after their digests were taken."""
    growing: frozenset[Path] = frozenset()
    """Captures that were still being written when the run began."""

    def reread(self, path: Path) -> None:
        """Take a new digest of a file that has changed; the plan continues with its present content."""
        self.replaced.add(path)
        self.digests.forget(path)
        self.plan.relist()
        for files in self.plan.captures.values():
            files[:] = [with_current_digest(file, self.digests) if file.path == path else file for file in files]
        for name, file in self.plan.named_files.items():
            if file.path == path:
                self.plan.named_files[name] = with_current_digest(file, self.digests)

    def captures_in_motion(self) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
        """Captures that have changed since the run began, by camera: first harmful changes, then harmless ones.

        If the names of captures contain no date, a camera overwrites the same file again and again.  A file is read as a whole,
        so overwriting it is harmless if it was complete when the run began.
        """
        changed = changes_of(self.plan.captures, self.replaced, self.digests)
        if self.plan.site.captures.dated:
            return changed, {}
        unfinished = {file.name for files in self.plan.captures.values() for file in files if file.path in self.growing}
        harmful = {camera: [name for name in names if name in unfinished] for camera, names in changed.items()}
        harmless = {camera: [name for name in names if name not in unfinished] for camera, names in changed.items()}
        return harmful, harmless


def plan_run(site: Site, options: Options) -> RunContext:
    """Find a night's captures and plan its tasks; nothing is written."""
    work = site.work_folder
    digests, earlier_captures = Digests(work.captures_memo), EarlierCaptures(work.delivered_memo)
    list_store(site)
    run_date = night(site, options.date)
    captures, growing = when_complete(find_captures(site, run_date, digests), digests)
    fresh = find_stale(site, run_date, captures, digests, earlier_captures)
    missing = [camera for camera in site.cameras if not fresh.captures[camera.id]]
    expected_names = {camera.id: expected(site, camera, run_date).replace(f"{site.captures.root}/", "") for camera in missing}
    reference, incompatible = None, ""
    try:
        reference = read_reference(work) if site.settings.pin != "none" else None
    except BadReference as error:
        incompatible = error.what
    plan = Plan(
        site,
        fresh.captures,
        str(run_date),
        Cache(work),
        find_named(site, digests),
        {camera.id: options.not_captured.get(camera.id) or f"there is no file {expected_names[camera.id]}" for camera in missing},
        options.until,
        frozenset(options.force),
        reference=reference,
        incompatible=incompatible,
        stale=fresh.stale,
        night_given=options.date is not None,
    )
    return RunContext(run_date, digests, earlier_captures, fresh.notes, plan, growing=growing)
