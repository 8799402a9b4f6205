"""An editing session of a site file: what the page shows of the file and its cameras, and how drawn marks are written to it."""

from __future__ import annotations

import re
import threading
from codecs import BOM_UTF8
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
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
from ..site.geodesy import LocalFrame, origin_of
from ..site.load import load_site, site_of
from ..site.models import Camera, Section, Site, Vector2, Vector3
from ..site.yaml_document import Problem, SiteError, parse_yaml
from .merge import MergedList, merge
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
        origin = origin_of(site.survey.crs)
        self._frame: LocalFrame | None = None
        if origin is not None:
            self._frame = LocalFrame(*origin)
        # The poses of a run are in the world of the site file only if something there determines that world.
        placed_count = sum(camera.placement.C is not None for camera in site.cameras)
        is_fixed = max(placed_count, len(site.settings.control_points)) >= _FEWEST_PLACES
        has_surveyed_thing = site.thing_survey is not None and len(site.thing_survey.rows.thing) > 0
        is_tied = site.has_stated_poses or bool(site.survey.crs) or is_fixed or has_surveyed_thing
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
        """The masks as others made them: each save paints all areas over these, so that a removed area leaves no trace."""
        self._painted_cameras: set[str] = set()
        """Cameras whose masks this session has written."""
        self._versions: dict[str, Site] = {}
        """The site of each version of the file that a page has been drawn on, by the digest of the file."""
        self._take(site)

    def state(self) -> dict[str, Any]:
        """Return the content of the site file for the page, and which cameras have a pose."""
        cameras = [{"id": c.id, "posed": c.id in self.posed.poses, "privacy": c.privacy} for c in self.site.cameras]
        zones, points = _marks_of(self.site)
        return {
            "site": self.site.name,
            "file": str(self.site.file),
            "version": self.version,
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
        camera = _camera_of(self.site, name)
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
        mask = self._masks.get(_camera_of(self.site, name).id)
        if mask is None:
            raise Refused(f"{name} has no mask")
        try:
            return bytes(load("wbflow_stages.marking:mask_overlay")(name, mask))
        except ValueError as error:
            raise Refused(str(error)) from None

    def save(self, request: SaveRequest) -> dict[str, Any]:
        """Write the marks to the site file and to masks, and return the new state, with what is not saved and why.

        What somebody else has changed in the file since is kept.  A mark that would make the file invalid, or that was changed in
        both places, is left out, and so is one whose text cannot be changed.  Raises Refused if the file as it is now cannot be
        used; nothing is written then.
        """
        marks = request.marks
        with self._lock:  # the browser may send two requests at once, and each changes the text that the other has read
            # 1. The site as it was drawn on, and as it is now.
            opened = self._versions.get(request.version)
            if opened is None:
                raise Refused("this page is of another start of wbflow edit", remedy="open the page again in a new tab")
            site = self._site_on_disk()
            is_merged = site is not opened
            _check_drawn_on(marks, opened, site)
            is_merged |= self._read_changed_masks(site)
            # 2. New masks first: the site file is valid only if the masks that it names exist.
            masks = dict(self._new_masks(marks))
            files = {name: self._mask_file(_camera_of(site, name), site) for name in masks}
            added = [name for name, file in files.items() if file != _camera_of(site, name).mask]
            for name in added:
                write_atomic(files[name], masks[name])
            # 3. The site file with the marks, which is loaded as a run would load it.
            lists = _merged_lists(marks, opened, site)
            try:
                paths = {name: str(files[name].relative_to(site.folder)) for name in added}
                text, edited, lists, faults_of_masks = _edited_site(site, lists, paths)
            except Refused:
                for name in added:
                    files[name].unlink()
                raise
            for name in faults_of_masks:
                files.pop(name).unlink()
                del masks[name]
            # 4. All is valid: existing masks, and the site file last.
            for name, file in files.items():
                write_atomic(file, masks[name])
            write_atomic(site.file.resolve(), text)
            self._painted_cameras |= masks.keys()
            self._take(edited)
            if is_merged:
                self.posed = PosedCameras(edited)
            unsaved = [mark for part in lists for mark in part.unsaved_marks()]
            for name, why in faults_of_masks.items():
                unsaved.append({"kind": "mask", "camera": name, "drawn": None, "was": None, "why": why})
            return {**self.state(), "merged": is_merged, "unsaved": unsaved}

    def _take(self, site: Site) -> None:
        """Take a site whose file and masks were just read or written as the newest version."""
        self.site = site
        self.version = content_digest(read_untrusted(site.file, MOST_TEXT_BYTES))
        self._versions[self.version] = site
        self._mask_digests = _mask_digests(site)

    def _site_on_disk(self) -> Site:
        """Return the site as its file is now.  Raises Refused if the file is gone or invalid."""
        keeps = "then save again: what is drawn here is kept"
        try:
            if content_digest(read_untrusted(self.site.file, MOST_TEXT_BYTES)) == self.version:
                return self.site
            return load_site(self.site.file, self.site.work_folder.root)
        except SiteError as error:
            raise Refused(f"{error}\n  the file was changed meanwhile: mend it, {keeps}") from None
        except OSError as error:
            raise Refused(f"{self.site.file}: {error}\n  put it back, {keeps}") from None

    def _read_changed_masks(self, site: Site) -> bool:
        """Take masks that somebody else has changed as the ones to paint over; return whether there are any.  Raises Refused."""
        digests = _mask_digests(site)
        changed = {name for name, digest in digests.items() if digest != self._mask_digests.get(name)}
        for camera in site.cameras:
            if camera.id not in changed or camera.mask is None:
                continue
            try:
                self._masks[camera.id] = read_untrusted(camera.mask)
            except OSError as error:
                remedy = "put it back, then save again: what is drawn here is kept"
                raise Refused(f"the mask of {camera.id}: {error}", where=str(camera.mask), remedy=remedy) from None
        for name in self._mask_digests.keys() - digests.keys():
            del self._masks[name]
            changed.add(name)
        return bool(changed)

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

    def _mask_file(self, camera: Camera, site: Site) -> Path:
        """Return where to write a camera's mask: its own file if that is a PNG of this camera alone, else a new file."""
        other_masks = {other.mask for other in site.cameras if other.id != camera.id}
        if camera.mask and camera.mask.suffix.lower() == ".png" and camera.mask not in other_masks:
            return camera.mask
        folder = site.folder / "masks"
        file = folder / f"{camera.id}.png"
        number = 1
        while file.exists():
            number += 1
            file = folder / f"{camera.id}-{number}.png"
        return file


@dataclass(frozen=True)
class _EditedList:
    """A list of the site file in which something may be drawn, merged with what the file has now."""

    kind: str
    """privacy, zone or point."""
    camera: str
    """The camera of privacy polygons; else ""."""
    location: Location
    file_items: Sequence[Any]
    merged: MergedList

    @property
    def where(self) -> str:
        """The location as problems name it: `cameras[3].privacy`."""
        return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in self.location).removeprefix(".")

    def with_faults(self, problems: Sequence[Problem]) -> _EditedList:
        """Return the list without drawn items that problems of the edited file are about."""
        faults: dict[int, str] = {}
        for problem in problems:
            found = re.match(rf"{re.escape(self.where)}\[(\d+)\]", problem.where)
            if found and self.merged.entries[int(found[1])].drawn is not None:
                faults.setdefault(int(found[1]), problem.what)
        return replace(self, merged=self.merged.without(faults, self.file_items))

    def unsaved_marks(self) -> Iterable[dict[str, Any]]:
        """Yield what is not saved, for the page: `was` is the index in the saved file of the item that stays instead."""
        now = {entry.was: k for k, entry in enumerate(self.merged.entries) if entry.was is not None}
        for item in self.merged.unsaved:
            was = None if item.was is None else now.get(item.was)
            yield {"kind": self.kind, "camera": self.camera, "drawn": item.drawn, "was": was, "why": item.why}


def _check_drawn_on(marks: Marks, opened: Site, site: Site) -> None:
    """Raise Refused if the site is now without a camera on which somebody drew, or has other coordinates."""
    cameras = {camera.id for camera in site.cameras}
    for name, drawn in marks.cameras.items():
        before = _camera_of(opened, name)
        is_drawn_on = drawn.mask or [list(mark.corners) for mark in drawn.privacy] != before.privacy
        if is_drawn_on and name not in cameras:
            remedy = "put it back, then save again: what is drawn here is kept"
            raise Refused(f"camera {name!r}, on which you drew, is no longer in the file", where=str(site.file), remedy=remedy)
    if opened.survey.crs != site.survey.crs:
        remedy = "put it back, then save again: what is drawn here is kept"
        raise Refused("the coordinate system was changed meanwhile", where=str(site.file), remedy=remedy)


def _merged_lists(marks: Marks, opened: Site, site: Site) -> list[_EditedList]:
    """Return the lists of the site file with what is drawn, and with what was changed in the file since the page was opened."""
    lists: list[_EditedList] = []
    for k, camera in enumerate(site.cameras):
        drawn = marks.cameras.get(camera.id)
        if drawn is None:
            continue
        polygons = [(mark.was, mark.corners) for mark in drawn.privacy]
        before = _camera_of(opened, camera.id).privacy
        merged = merge(before, polygons, camera.privacy, lambda polygon: None)
        lists.append(_EditedList("privacy", camera.id, ("cameras", k, "privacy"), camera.privacy, merged))

    geodetic = bool(site.survey.crs)
    zones_before, points_before = _marks_of(opened)
    zones_in_file, points_in_file = _marks_of(site)

    zones = [_zone_entry(mark) for mark in zones_in_file]
    drawn_zones = [(mark.was, _zone_entry(mark)) for mark in marks.zones]
    merged = merge([_zone_entry(mark) for mark in zones_before], drawn_zones, zones, lambda zone: zone["name"])
    lists.append(_EditedList("zone", "", ("zones",), zones, merged))

    points = [_point_entry(mark, geodetic) for mark in points_in_file]
    drawn_points = [(mark.was, _point_entry(mark, geodetic)) for mark in marks.points]
    merged = merge([_point_entry(mark, geodetic) for mark in points_before], drawn_points, points, lambda point: point.get("id"))
    # a point without coordinates is unfinished, wherever it was written
    is_placed = {"position", "latitude"}
    unplaced = {k: "its coordinates are missing" for k, entry in enumerate(merged.entries) if not is_placed & entry.value.keys()}
    lists.append(_EditedList("point", "", ("control_points",), points, merged.without(unplaced, points)))
    return lists


def _edited_site(
    site: Site, lists: list[_EditedList], masks: Mapping[str, str]
) -> tuple[bytes, Site, list[_EditedList], dict[str, str]]:
    """Return the bytes of the site file with the lists, the site loaded from them, the lists as written, and masks that are not.

    Drawn items that make the file invalid, or whose text cannot be changed, are left out.  Raises Refused if the file is still
    invalid then.

    Parameters
    ----------
    site : Site
        The site as its file is now.
    lists : list of _EditedList
        The lists that may differ from those in the file.
    masks : Mapping
        Paths of new masks, by camera; those that cannot be written come back with the reason.
    """
    # byte-order mark and line ends stay as the user's editor wrote them
    raw = read_untrusted(site.file, MOST_TEXT_BYTES)
    old_text = raw.decode("utf-8-sig")
    bom = BOM_UTF8 if raw.startswith(BOM_UTF8) else b""
    line_end = "\r\n" if "\r\n" in old_text else "\n"
    while True:
        text, lists, faults_of_masks = _with_lists(old_text.replace("\r\n", "\n"), site, lists, masks)
        try:
            edited = site_of(parse_yaml(text, site.file), site.work_folder.root)
            return bom + text.replace("\n", line_end).encode(), edited, lists, faults_of_masks
        except SiteError as error:
            without_faults = [part.with_faults(error.problems) for part in lists]
            if without_faults == lists:
                raise Refused(str(error)) from None
            # each round leaves out at least one drawn item, so this ends
            lists = without_faults


def _with_lists(
    text: str, site: Site, lists: Sequence[_EditedList], masks: Mapping[str, str]
) -> tuple[str, list[_EditedList], dict[str, str]]:
    """Return the text of a site file with edited lists and new masks (paths by camera), the lists as far as they could be
    written, and why masks could not."""
    faults_of_masks: dict[str, str] = {}
    drawn_on = {part.camera for part in lists if part.merged.entries} | masks.keys()
    for k, camera in enumerate(site.cameras):
        # a camera that is written as its id alone becomes a mapping as soon as it has keys
        if camera.id in drawn_on and not isinstance(site.document.data["cameras"][k], dict):
            with suppress(NotEditable):  # what is put into it is at fault then, too
                text = put(text, ("cameras", k), {"id": camera.id})
        if camera.id in masks:
            try:
                text = put(text, ("cameras", k, "mask"), masks[camera.id])
            except NotEditable as error:
                faults_of_masks[camera.id] = _by_hand(error)
    written: list[_EditedList] = []
    for part in lists:
        text, part_written = _with_list(text, part)
        written.append(part_written)
    return text, written, faults_of_masks


def _camera_of(site: Site, name: str) -> Camera:
    for camera in site.cameras:
        if camera.id == name:
            return camera
    raise Refused(f"the site has no camera {name!r}")


def _mask_digests(site: Site) -> dict[str, str]:
    """Return the digest of each camera's mask; "" for a file that is gone."""
    digests: dict[str, str] = {}
    for camera in site.cameras:
        if camera.mask:
            digests[camera.id] = content_digest(read_untrusted(camera.mask)) if is_file(camera.mask) else ""
    return digests


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


def _with_list(text: str, edited: _EditedList) -> tuple[str, _EditedList]:
    """Return the text with a list changed as it was edited, and the list as far as it could be written.

    Items that remain keep their text, except for values that differ.
    """
    location = edited.location
    entries = edited.merged.entries
    faults: dict[int, str] = {}  # by index in the merged list
    faults_of_removals: dict[int, str] = {}  # by index in the file's list
    # 1. Items that remain.
    kept_items = {entry.was: (k, entry.value) for k, entry in enumerate(entries) if entry.was is not None}
    for was, file_item in enumerate(edited.file_items):
        if was not in kept_items:
            continue
        k, value = kept_items[was]
        try:
            text = _with_value(text, (*location, was), file_item, value)
        except NotEditable as error:
            faults[k] = _by_hand(error)
    # 2. Items that are gone; from the end, so that the others keep their places.
    for was in reversed(range(len(edited.file_items))):
        if was in kept_items:
            continue
        try:
            text = remove(text, (*location, was))
        except NotEditable as error:
            faults_of_removals[was] = _by_hand(error)
    # 3. New items at the end.
    has_items = bool(kept_items or faults_of_removals)
    for k, entry in enumerate(entries):
        if entry.was is not None:
            continue
        try:
            text = append(text, location, entry.value) if has_items else put(text, location, [entry.value])
        except NotEditable as error:
            faults[k] = _by_hand(error)
        else:
            has_items = True
    merged = edited.merged.without(faults, edited.file_items).keeping(faults_of_removals, edited.file_items)
    return text, replace(edited, merged=merged)


def _by_hand(error: NotEditable) -> str:
    return f"{error}: change this by hand"


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
