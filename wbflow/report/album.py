"""Pictures of a report: each is in the page once, as far as there is room; the others are led to where they lie."""

from __future__ import annotations

import base64
import mimetypes
import os
from dataclasses import dataclass, field
from pathlib import Path

from ..cache.untrusted import read_outside
from ..pipeline.rows import FromSite, Role, SiteValue
from ..pipeline.stages import stage_with
from ..records.run_folder import NoSuchRun, RunFolder
from ..task import Task, view_name
from .sources import Sources

ROOM = 6_000_000
"""Bytes of pictures that a page holds at most: what it is all about are points and words."""

_PRIVATE = FromSite(SiteValue.PRIVACY, optional=True)


@dataclass(frozen=True)
class Shown:
    """A picture in the page."""

    id: str
    alt: str
    data: str = ""
    """A data URL; "" where the picture stands elsewhere in the page, or has no room."""
    link: str = ""
    """Where the file lies, seen from the report, where there was no room for it."""


@dataclass
class Album:
    """Hands out pictures in the order in which the page shows them."""

    sources: Sources
    _held: dict[Path, str] = field(default_factory=dict)
    _bytes: int = 0

    @property
    def held(self) -> int:
        """Bytes of the pictures that it has handed out."""
        return self._bytes

    def of_task(self, task: Task, alt: str) -> Shown | None:
        """The picture of a result of this run."""
        event = self.sources.tasks.get(task)
        return self.of_file(self.sources.work.picture(task, event.key), alt) if event and event.key else None

    def of_frame(self, camera: str, alt: str) -> Shown | None:
        """What a camera saw this night: of several views in the first, which shows its middle."""
        return self.of_task(self._frame(camera), alt)

    def _frame(self, camera: str) -> Task:
        """The task that made a camera's frame."""
        whole, first = (Task(stage_with(Role.FRAME).name, (name,)) for name in (camera, view_name(camera, 1)))
        return first if first in self.sources.tasks else whole

    def of_last_good(self, camera: str) -> Shown | None:
        """What a camera saw when it was last as it should be."""
        good = self.sources.last_good(camera)
        task = self._frame(camera)
        if good is None:
            return None
        try:
            event = RunFolder.of(self.sources.work, good.run).tasks().get(task)
        except NoSuchRun:
            return None
        if event is None or not event.key or not self._may_be_seen(task, event.key):
            return None
        return self.of_file(self.sources.work.picture(task, event.key), f"{camera} on {good.date}, when all was well")

    def _may_be_seen(self, task: Task, key: str) -> bool:
        """Was an earlier picture made with what is private now left out?"""
        stated = next((view for view in self.sources.site.views if (view.id,) == task.subject), None)
        if stated is None or not stated.privacy.counts:
            return True
        cache, tonight = self.sources.cache, self.sources.tasks.get(task)
        then = cache.by_key(task, key)
        now = cache.by_key(task, tonight.key) if tonight and tonight.key else None
        private = [name for name, need in stage_with(Role.FRAME).needs.items() if need == _PRIVATE]
        if then is None or now is None:
            return False
        return all(then.preimage.inputs.get(name) == now.preimage.inputs.get(name) for name in private)

    def of_product(self, name: str, alt: str) -> Shown | None:
        """A picture that the run publishes."""
        return self.of_file(self.sources.files / name, alt)

    def of_file(self, path: Path, alt: str) -> Shown | None:
        """A picture by its file; None where there is none."""
        if path in self._held:
            return Shown(self._held[path], alt)
        try:
            data = read_outside(path)
        except OSError:
            return None
        name = f"picture-{len(self._held) + 1}"
        if self._bytes + len(data) > ROOM:
            return Shown(name, alt, link=os.path.relpath(path, self.sources.work.run(self.sources.record.run).folder))
        self._held[path] = name
        self._bytes += len(data)
        kind = mimetypes.guess_type(path.name)[0] or "image/jpeg"
        return Shown(name, alt, f"data:{kind};base64,{base64.b64encode(data).decode()}")
