"""An editing session of a site file: what the page shows of the file and its cameras, and how drawn marks are written to it."""

from __future__ import annotations

import threading
from codecs import BOM_UTF8
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from ..cache.atomic import write_atomic
from ..cache.checksum import content_digest
from ..cache.memo import Digests
from ..cache.ply import read_ply
from ..cache.untrusted import MOST_TEXT_BYTES, is_file, read_untrusted
from ..errors import ExitCode, Location, WbflowError
from ..plugins import load
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.captures import captures_of, expected, night
from ..site.geodesy import local_frame
from ..site.load import site_of
from ..site.models import Camera, Section, Site, Vector2, Vector3
from ..site.yaml_document import Problems, SiteError, parse_yaml
from .splice import NotEditable, append, put, remove

GROUND_SHARE = 0.1
"""The initial ground height for drawing zones is this quantile of the z coordinates of the last cloud."""
_FEWEST_PLACES = 3
"""Smallest number of control points, or of stated camera positions, that fixes the world to stated coordinates."""

Corners = list[Vector2]


class DrawnMark(Section):
    """A mark that may already be in the site file."""

    was: int | None = None
    """Its index in the site file's list; None if it is new."""


class PolygonMark(DrawnMark):
    """A privacy polygon."""

    corners: Corners


class MaskArea(Section):
    """A polygon that is painted over a camera's mask.  use: True marks its pixels as usable, False as left out."""

    use: bool
    corners: Annotated[Corners, Field(min_length=3)]


class ZoneMark(DrawnMark):
    """A zone."""

    name: str
    corners: Corners
    least_m: float = 0.0


class PointMark(DrawnMark):
    """A control point."""

    id: str = ""
    position: Vector3 | None = None
    """x, y, z, or latitude, longitude, height in a site with a geodetic system; None if not stated."""
    pixels: dict[str, Vector2] = Field(default_factory=dict)


class CameraMarks(Section):
    """The marks drawn in one camera's picture."""

    privacy: list[PolygonMark] = Field(default_factory=list)
    mask: list[MaskArea] = Field(default_factory=list)


class Marks(Section):
    """All marks of the page."""

    cameras: dict[str, CameraMarks] = Field(default_factory=dict)
    """By camera id; only cameras in whose pictures something was drawn."""
    zones: list[ZoneMark] = Field(default_factory=list)
    points: list[PointMark] = Field(default_factory=list)


class GuideRequest(Section):
    """A request for residuals, guides and zone outlines in one picture."""

    camera: str
    marks: Marks
    chosen: int | None = None
    """Index of the control point for which guides are shown."""
    ground: float = 0.0
    """The height (z) at which zones lie."""


class GroundRequest(Section):
    """A request for the place on the ground that a pixel shows."""

    camera: str
    pixel: Vector2
    ground: float = 0.0


class SaveRequest(Section):
    """A request to write the marks.  version: digest of the site file on which they were drawn."""

    marks: Marks
    version: str = Field(min_length=1)


class Refused(WbflowError):
    """A request cannot be carried out; the site file is unchanged."""

    exit_code = ExitCode.USAGE


class PosedCameras:
    """The posed cameras of a site: as its last run solved them, else as the site file states them."""

    def __init__(self, site: Site) -> None:
        self.poses: dict[str, Mapping[str, Any]] = {}
        """Cameras by id, in the format of `cameras.json`."""
        for camera in site.cameras:
            if camera.stated and camera.lens.width and camera.lens.height:
                self.poses[camera.id] = {**vars(camera.lens), **vars(camera.placement)}
        self.ground = 0.0
        """The height (z) at which zones are drawn at first."""
        try:
            run = RunFolder.of(site.work_folder)
            self.poses |= run.cameras()
            cloud = run.record().cloud
            if cloud:
                # every 97th point: enough for a quantile, of a cloud of millions
                heights = sorted(read_ply(run.paths.folder / cloud.path)["z"][::97].tolist())
                self.ground = round(heights[int(GROUND_SHARE * len(heights))], 2)
        except (NoSuchRun, OSError, ValueError, LookupError):
            pass  # there is no run yet, or its files are gone
        self._frame = local_frame(site.settings, Problems(site.document))
        # The poses of a run are in the world of the site file only if something there determines that world.
        placed_count = sum(camera.placement.C is not None for camera in site.cameras)
        is_fixed = max(placed_count, len(site.settings.control_points)) >= _FEWEST_PLACES
        is_tied = site.has_stated_poses or bool(site.survey.crs) or is_fixed
        self._in_stated_frame = is_tied and all(entry.get("metric", True) for entry in self.poses.values())
        """Is the cameras' world the coordinate system of stated coordinates?  Stated distances alone fix only its scale."""
        self.upright = bool(self.poses) and all(entry["R"][1][2] < -0.5 for entry in self.poses.values())
        """Does the world's z axis point up in all cameras?  Otherwise zones have no place."""

    @cached_property
    def _sights(self) -> Any:
        return load("wbflow_stages.sighting:Sights")(self.poses)

    def guides(self, request: GuideRequest) -> dict[str, Any]:
        """Return residuals of the control points, and guides and zone outlines for one camera's picture."""
        points = request.marks.points
        places = [self._world(point.position) for point in points]
        pixels_and_places = [(point.pixels, place) for point, place in zip(points, places, strict=True)]
        residuals = self._sights.residuals(pixels_and_places)
        guide = {}
        chosen = request.chosen
        if chosen is not None and 0 <= chosen < len(places):
            guide = self._sights.guide(request.camera, points[chosen].pixels, places[chosen])
        zones = []
        if self.upright:
            zones = [self._sights.outline(request.camera, zone.corners, request.ground) for zone in request.marks.zones]
        return {"residuals": residuals, "guide": guide, "zones": zones}

    def on_ground(self, request: GroundRequest) -> list[float] | None:
        """Return x, y of the ground that a pixel shows; None above the horizon, or if the camera has no pose."""
        if request.camera not in self.poses or not self.upright:
            return None
        place: list[float] | None = self._sights.on_ground(request.camera, list(request.pixel), request.ground)
        return place

    def _world(self, position: Sequence[float] | None) -> list[float] | None:
        """Return stated coordinates in the cameras' world; None if not stated, or if that world is not tied to them."""
        if position is None or not self._in_stated_frame:
            return None
        if self._frame is None:
            return list(position)
        return self._frame.metres(*position)


class Session:
    """The state of one `wbflow edit`, from its start to its end."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.posed = PosedCameras(site)
        self._night = night(site, None)
        self._lock = threading.Lock()
        self._sizes: dict[str, tuple[int, int]] = {}
        """Width and height of the captures, for cameras that were shown."""
        self._masks = {camera.id: read_untrusted(camera.mask) for camera in site.cameras if camera.mask}
        """The original masks: each save paints all areas over these, so that a removed area leaves no trace."""
        self._painted_cameras: set[str] = set()
        """Cameras whose masks this session has written."""
        self._last_digests = self._digests()

    def state(self) -> dict[str, Any]:
        """Return the content of the site file for the page, and which cameras have a pose."""
        cameras = [{"id": c.id, "posed": c.id in self.posed.poses, "privacy": c.privacy} for c in self.site.cameras]
        zones, points = _marks_of(self.site)
        return {
            "site": self.site.name,
            "file": str(self.site.file),
            "version": self._last_digests[self.site.file],
            "night": str(self._night),
            "geodetic": bool(self.site.survey.crs),
            "ground": self.posed.ground,
            "upright": self.posed.upright,
            "cameras": cameras,
            "zones": [zone.model_dump() for zone in zones],
            "points": [point.model_dump() for point in points],
        }

    def picture(self, name: str) -> tuple[dict[str, Any], bytes]:
        """Return width, height and file name of a camera's capture, and a JPEG of it to draw on.  Raises Refused."""
        camera = self._camera(name)
        files = captures_of(self.site, camera, self._night, Digests(None))
        usable = [file for file in files if file.digest]
        if not files:
            raise Refused(f"no capture: {expected(self.site, camera, self._night)}")
        if not usable:
            raise Refused(f"{files[0].name} {files[0].fault}")
        file = usable[len(usable) // 2]
        try:
            width, height, jpeg = load("wbflow_stages.marking:as_jpeg")(file.name, read_untrusted(file.path))
        except (ValueError, OSError) as error:
            raise Refused(str(error)) from None
        self._sizes[name] = width, height
        return {"width": width, "height": height, "name": file.name, "masked": name in self._masks}, jpeg

    def shade(self, name: str) -> bytes:
        """Return a PNG that shows what a camera's mask leaves out.  Raises Refused if there is no mask, or it cannot be read."""
        mask = self._masks.get(self._camera(name).id)
        if mask is None:
            raise Refused(f"{name} has no mask")
        try:
            return bytes(load("wbflow_stages.marking:mask_overlay")(name, mask))
        except ValueError as error:
            raise Refused(str(error)) from None

    def save(self, request: SaveRequest) -> dict[str, Any]:
        """Write the marks to the site file and to masks, and return the new state.

        Raises Refused if the file would be invalid, or has changed since.
        """
        marks = request.marks
        with self._lock:  # the browser may send two requests at once, and each changes the text that the other has read
            # 1. Nobody else has changed the files since the page was opened or saved.
            if request.version != self._last_digests[self.site.file] or self._last_digests != self._digests():
                remedy = "open the page again: what is drawn there now has not been saved"
                raise Refused("was changed on disk meanwhile; nothing was written", where=str(self.site.file), remedy=remedy)
            # 2. New masks first: the site file is valid only if the masks that it names exist.
            masks = dict(self._new_masks(marks))
            files = {name: self._mask_file(self._camera(name)) for name in masks}
            added = [name for name, file in files.items() if file != self._camera(name).mask]
            for name in added:
                write_atomic(files[name], masks[name])
            # 3. The site file with the marks, which is loaded as a run would load it.
            try:
                paths = {name: str(files[name].relative_to(self.site.folder)) for name in added}
                text, site = self._edited_site(marks, paths)
            except Refused:
                for name in added:
                    files[name].unlink()
                raise
            # 4. All is valid: existing masks, and the site file last.
            for name, file in files.items():
                write_atomic(file, masks[name])
            write_atomic(self.site.file.resolve(), text)
            self.site = site
            self._painted_cameras |= masks.keys()
            self._last_digests = self._digests()
            return self.state()

    def _new_masks(self, marks: Marks) -> Iterable[tuple[str, bytes]]:
        """The mask of each camera on which something is painted, or was in this session: its areas may all be gone again."""
        for name, drawn in marks.cameras.items():
            if not drawn.mask and name not in self._painted_cameras:
                continue
            if name not in self._sizes:
                self.picture(name)
            areas = [(area.use, area.corners) for area in drawn.mask]
            try:
                yield name, load("wbflow_stages.marking:paint_mask")(name, self._masks.get(name), self._sizes[name], areas)
            except ValueError as error:
                raise Refused(str(error)) from None

    def _edited_site(self, marks: Marks, masks: dict[str, str]) -> tuple[bytes, Site]:
        """Return the bytes of the site file with the marks, and the site loaded from them.  Raises Refused."""
        # byte-order mark and line ends stay as the user's editor wrote them
        raw = read_untrusted(self.site.file, MOST_TEXT_BYTES)
        old_text = raw.decode("utf-8-sig")
        bom = BOM_UTF8 if raw.startswith(BOM_UTF8) else b""
        line_end = "\r\n" if "\r\n" in old_text else "\n"
        try:
            text = _with_marks(old_text.replace("\r\n", "\n"), self.site, marks, masks)
            site = site_of(parse_yaml(text, self.site.file), self.site.work_folder.root)
        except NotEditable as error:
            raise Refused(str(error), where=str(self.site.file), remedy="change this by hand") from None
        except SiteError as error:
            raise Refused(str(error)) from None
        return bom + text.replace("\n", line_end).encode(), site

    def _mask_file(self, camera: Camera) -> Path:
        """Return where to write a camera's mask: its own file if that is a PNG of this camera alone, else a new file."""
        other_masks = {other.mask for other in self.site.cameras if other.id != camera.id}
        if camera.mask and camera.mask.suffix.lower() == ".png" and camera.mask not in other_masks:
            return camera.mask
        folder = self.site.folder / "masks"
        file = folder / f"{camera.id}.png"
        number = 1
        while file.exists():
            number += 1
            file = folder / f"{camera.id}-{number}.png"
        return file

    def _camera(self, name: str) -> Camera:
        for camera in self.site.cameras:
            if camera.id == name:
                return camera
        raise Refused(f"the site has no camera {name!r}")

    def _digests(self) -> dict[Path, str]:
        """The digests of the site file and of all masks; "" for a file that is gone."""
        files = [self.site.file]
        files += [camera.mask for camera in self.site.cameras if camera.mask]
        digests: dict[Path, str] = {}
        for file in files:
            digests[file] = content_digest(read_untrusted(file)) if is_file(file) else ""
        return digests


def _with_marks(text: str, site: Site, marks: Marks, masks: Mapping[str, str]) -> str:
    """Return the text of a site file with the marks.  masks: paths of new masks, by camera.  Raises NotEditable."""
    geodetic = bool(site.survey.crs)
    for k, camera in enumerate(site.settings.cameras):
        drawn = marks.cameras.get(camera.id)
        if drawn is None:
            continue
        location: Location = ("cameras", k)
        # a camera that is written as its id alone becomes a mapping as soon as it has keys
        is_id_alone = not isinstance(site.document.data["cameras"][k], dict)
        if is_id_alone and (drawn.privacy or camera.id in masks):
            text = put(text, location, {"id": camera.id})
        if camera.id in masks:
            text = put(text, (*location, "mask"), masks[camera.id])
        new_polygons = [(mark.was, mark.corners) for mark in drawn.privacy]
        text = _with_list(text, (*location, "privacy"), camera.privacy, new_polygons)
    zones, points = _marks_of(site)
    new_zones = [(mark.was, _zone_entry(mark)) for mark in marks.zones]
    text = _with_list(text, ("zones",), [_zone_entry(mark) for mark in zones], new_zones)
    new_points = [(mark.was, _point_entry(mark, geodetic)) for mark in marks.points]
    return _with_list(text, ("control_points",), [_point_entry(mark, geodetic) for mark in points], new_points)


def _marks_of(site: Site) -> tuple[list[ZoneMark], list[PointMark]]:
    """The zones and control points of the site file as marks."""
    zones: list[ZoneMark] = []
    for k, zone in enumerate(site.settings.zones or ()):
        zones.append(ZoneMark(was=k, name=zone.name, corners=zone.polygon, least_m=zone.least_m))
    points: list[PointMark] = []
    for k, point in enumerate(site.settings.control_points):
        position = list(point.geodetic) if point.geodetic else point.position
        points.append(PointMark(was=k, id=point.id or "", position=position, pixels=point.pixels))
    return zones, points


def _with_list(text: str, location: Location, old_items: Sequence[Any], new_items: Sequence[tuple[int | None, Any]]) -> str:
    """Return the text with a list changed to `new_items`: items that remain keep their text, except for values that differ."""
    # 1. Items that remain.
    kept_items = {was: value for was, value in new_items if was is not None and was < len(old_items)}
    for k, old_value in enumerate(old_items):
        if k in kept_items:
            text = _with_value(text, (*location, k), old_value, kept_items[k])
    # 2. Items that are gone; from the end, so that the others keep their places.
    for k in reversed(range(len(old_items))):
        if k not in kept_items:
            text = remove(text, (*location, k))
    # 3. New items at the end.
    added = [value for was, value in new_items if was is None or was >= len(old_items)]
    if added and not kept_items:
        return put(text, location, added)
    for value in added:
        text = append(text, location, value)
    return text


def _with_value(text: str, location: Location, old: Any, new: Any) -> str:
    if old == new:
        return text
    if isinstance(old, dict) and old.keys() <= new.keys():
        for key, value in new.items():
            text = _with_value(text, (*location, key), old.get(key), value)
        return text
    return put(text, location, new)


def _zone_entry(mark: ZoneMark) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": mark.name, "polygon": mark.corners}
    if mark.least_m:
        entry["least_m"] = mark.least_m
    return entry


def _point_entry(mark: PointMark, geodetic: bool) -> dict[str, Any]:
    entry: dict[str, Any] = {}
    if mark.id:
        entry["id"] = mark.id
    if mark.position is not None and geodetic:
        entry["latitude"], entry["longitude"], entry["height"] = mark.position
    elif mark.position is not None:
        entry["position"] = mark.position
    entry["pixels"] = mark.pixels
    return entry
