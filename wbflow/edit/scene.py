"""Where the cameras of a site stand, as far as that is known, and what is seen where: guides and residuals for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from ..cache.plugins import load
from ..cache.ply import read_ply
from ..pipeline.exports import SIGHTS
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.geodesy import local_frame
from ..site.locations import Problems
from ..site.models import Site

if TYPE_CHECKING:
    from .session import Look, OnGround

GROUND_SHARE = 0.1
"""Of the last cloud's points, so many lie lower than the ground that zones are drawn on at first."""
_FEWEST_PLACES = 3
"""Control points or positions that tie a world to stated coordinates."""


class Scene:
    """The posed cameras of a site: those of its last run, else as the site file states them."""

    def __init__(self, site: Site) -> None:
        self.poses: Mapping[str, Mapping[str, Any]] = _stated(site)
        """Cameras as `cameras.json` has them, by id."""
        self.ground = 0.0
        """The height at which zones lie."""
        try:
            run = RunFolder.of(site.work_folder)
            self.poses = {**self.poses, **run.cameras()}
            if cloud := run.record().cloud:
                heights = sorted(read_ply(run.paths.folder / cloud.path)["z"][::97].tolist())
                self.ground = round(heights[int(GROUND_SHARE * len(heights))], 2)
        except (NoSuchRun, OSError, ValueError, LookupError):
            pass  # there is no run yet, or what it made is gone
        self._frame = local_frame(site.settings, Problems(site.document))
        self._tied = _is_tied(site) and all(entry.get("metric", True) for entry in self.poses.values())
        self.upright = bool(self.poses) and all(entry["R"][1][2] < -0.5 for entry in self.poses.values())
        """z points up: zones have a place."""

    @cached_property
    def _sights(self) -> Any:
        return load(SIGHTS)(self.poses)

    def look(self, asked: Look) -> dict[str, Any]:
        """What is to be shown of points and zones in one camera's picture."""
        camera, marks, chosen = asked.camera, asked.marks, asked.chosen
        stated = [self._world(point.position) for point in marks.points]
        residuals = self._sights.residuals([(p.pixels, where) for p, where in zip(marks.points, stated, strict=True)])
        guide = {}
        if chosen is not None and 0 <= chosen < len(stated):
            guide = self._sights.guide(camera, marks.points[chosen].pixels, stated[chosen])
        zones = [self._sights.outline(camera, zone.corners, asked.ground) for zone in marks.zones] if self.upright else []
        return {"residuals": residuals, "guide": guide, "zones": zones}

    def on_ground(self, asked: OnGround) -> list[float] | None:
        """x, y of what a pixel shows of the ground; None above the horizon, and where poses are unknown."""
        if asked.camera not in self.poses or not self.upright:
            return None
        found: list[float] | None = self._sights.on_ground(asked.camera, list(asked.pixel), asked.ground)
        return found

    def _world(self, position: Sequence[float] | None) -> list[float] | None:
        """Stated coordinates in the world of the cameras; None where there are none, or that world is another one."""
        if position is None or not self._tied:
            return None
        return list(position) if self._frame is None else self._frame.metres(*position)


def _stated(site: Site) -> dict[str, dict[str, Any]]:
    """Cameras of which the site file, or a calibration, gives lens and pose."""
    return {
        camera.id: {
            "K": camera.lens.K,
            "distortion": camera.lens.distortion,
            "model": camera.lens.model,
            "width": camera.lens.width,
            "height": camera.lens.height,
            "R": camera.placement.R,
            "C": camera.placement.C,
            "metric": camera.placement.metric,
        }
        for camera in site.cameras
        if camera.given and camera.lens.width and camera.lens.height
    }


def _is_tied(site: Site) -> bool:
    """Are coordinates that are stated those of the cameras' world?  Distances alone leave it where it is."""
    placed = sum(camera.placement.C is not None for camera in site.cameras)
    return site.some_given or bool(site.survey.crs) or max(placed, len(site.settings.control_points)) >= _FEWEST_PLACES
