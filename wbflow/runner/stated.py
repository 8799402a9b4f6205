"""What the site file says of cameras and of the ground, as inputs; and whose result an input is."""

from __future__ import annotations

from ..pipeline.stages import SITE_TYPES, Source, Stage
from ..site.models import Camera, Site, plain
from ..task import Subject, Task
from .spec import Joined, Value


def stated(camera: Camera, what: str) -> Value:
    """What the site file says of a camera: its lens, privacy or placement."""
    if what == "privacy":
        return Value(SITE_TYPES[what], plain(camera.privacy))
    return Value(SITE_TYPES[what], plain(camera.lens if what == "lens" else camera.placement))


def stated_of_site(site: Site, what: str) -> Value | Joined:
    """The same of all cameras, by id; or the survey."""
    if what == "survey":
        return Value(SITE_TYPES[what], plain(site.survey))
    return Joined({(camera.id,): stated(camera, what) for camera in site.views})


def side(need: Source, task: Task) -> Subject:
    """The left or right camera of a pair, where one of them is meant."""
    return {"left": task.subject[:1], "right": task.subject[1:]}.get(need.of, ())


def subject_of(origin: Stage, need: Source, task: Task) -> Subject:
    """Of which subject an input is that is not joined."""
    if origin.scope == "site":
        return ()
    return task.subject if need.of == "own" else side(need, task)
