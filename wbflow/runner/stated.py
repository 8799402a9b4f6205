"""What the site file says of cameras and of the ground, as inputs; and whose result an input is."""

from __future__ import annotations

from ..pipeline.rows import FromReference, FromStage, SiteValue, Stage, Which
from ..pipeline.site_types import SITE_TYPES
from ..site.models import Camera, Site, plain
from ..task import Subject, Task
from .spec import Joined, Value


def stated(camera: Camera, what: SiteValue) -> Value:
    """What the site file says of a camera: `LENS`, `PRIVACY` or `PLACEMENT`."""
    if what is SiteValue.PRIVACY:
        return Value(SITE_TYPES[what], plain(camera.privacy))
    return Value(SITE_TYPES[what], plain(camera.lens if what is SiteValue.LENS else camera.placement))


def stated_of_site(site: Site, what: SiteValue) -> Value | Joined:
    """The same of all cameras, by id; or the `SURVEY`."""
    if what is SiteValue.SURVEY:
        return Value(SITE_TYPES[what], plain(site.survey))
    return Joined({(camera.id,): stated(camera, what) for camera in site.views})


def side(need: FromStage | FromReference, task: Task) -> Subject:
    """The left or right camera of a pair, where one of them is meant."""
    return {Which.LEFT: task.subject[:1], Which.RIGHT: task.subject[1:]}.get(need.which, ())


def subject_of(origin: Stage, need: FromStage | FromReference, task: Task) -> Subject:
    """Of which subject an input is that is not joined."""
    if origin.scope == "site":
        return ()
    return task.subject if need.which is Which.SAME else side(need, task)
