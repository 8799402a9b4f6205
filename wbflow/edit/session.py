"""A site file that is being edited: what the page shows of it, and how what is drawn gets into it."""

from __future__ import annotations

import threading
from codecs import BOM_UTF8
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..cache.digests import content_digest
from ..cache.memo import Digests
from ..cache.plugins import load
from ..cache.untrusted import MOST_TEXT_BYTES, is_file, read_outside
from ..errors import ExitCode, WbflowError
from ..pipeline.exports import MASK_SHADE, PAINTED_MASK, PICTURE_TO_DRAW_ON
from ..site.captures import captures_of, expected, night
from ..site.load import site_of
from ..site.locations import SiteError, parse_yaml
from ..site.models import Camera, Site
from .marks import Marks, PointMark, ZoneMark, edited
from .scene import Scene
from .splice import NotEditable


class Refused(WbflowError):
    """What was asked for cannot be done; the site file is as it was."""

    exit_code = ExitCode.USAGE


class Session:
    """One site file, from the start of `wbflow edit` to its end."""

    def __init__(self, site: Site) -> None:
        self.site = site
        self.scene = Scene(site)
        self._night = night(site, None)
        self._lock = threading.Lock()
        self._sizes: dict[str, tuple[int, int]] = {}
        """Width and height of the captures of cameras that were shown."""
        self._masks = {camera.id: read_outside(camera.mask) for camera in site.cameras if camera.mask}
        """As they were at first: areas are painted over these, however often they are saved."""
        self._painted: set[str] = set()
        """Cameras whose masks were written."""
        self._known = self._digests()

    def state(self) -> dict[str, Any]:
        """What the site file says, and which cameras have a pose."""
        file = self.site.settings
        cameras = [{"id": c.id, "posed": c.id in self.scene.poses, "privacy": c.privacy} for c in self.site.cameras]
        zones = [ZoneMark(was=k, name=z.name, corners=z.polygon, least_m=z.least_m) for k, z in enumerate(file.zones or ())]
        points = [
            PointMark(was=k, id=p.id or "", position=list(p.geodetic or p.position or ()), pixels=p.pixels)
            for k, p in enumerate(file.control_points)
        ]
        return {
            "site": self.site.name,
            "file": str(self.site.file),
            "version": self._known[self.site.file],
            "night": str(self._night),
            "geodetic": bool(self.site.survey.crs),
            "ground": self.scene.ground,
            "upright": self.scene.upright,
            "cameras": cameras,
            "zones": [zone.model_dump() for zone in zones],
            "points": [point.model_dump() for point in points],
        }

    def picture(self, name: str) -> tuple[dict[str, Any], bytes]:
        """Width, height and file name of a capture of a camera, and a JPEG of it to draw on.  Raises Refused."""
        camera = self._camera(name)
        files = captures_of(self.site, camera, self._night, Digests(None))
        usable = [file for file in files if file.digest]
        if not usable:
            words = f"{files[0].name} {files[0].fault}" if files else f"no capture: {expected(self.site, camera, self._night)}"
            raise Refused(words)
        file = usable[len(usable) // 2]
        try:
            width, height, jpeg = load(PICTURE_TO_DRAW_ON)(file.name, read_outside(file.path))
        except (ValueError, OSError) as error:
            raise Refused(str(error)) from None
        self._sizes[name] = width, height
        return {"width": width, "height": height, "name": file.name, "masked": name in self._masks}, jpeg

    def shade(self, name: str) -> bytes:
        """A picture of what a camera's mask leaves out.  Raises Refused where it has none, or it cannot be read."""
        if (mask := self._masks.get(self._camera(name).id)) is None:
            raise Refused(f"{name} has no mask")
        try:
            return bytes(load(MASK_SHADE)(name, mask))
        except ValueError as error:
            raise Refused(str(error)) from None

    def save(self, marks: Marks, version: str) -> dict[str, Any]:
        """Write what is drawn, and return the new state.

        version: of the state that was drawn on.

        Raises
        ------
        Refused
            The file would be invalid, or was changed meanwhile.
        """
        with self._lock:
            if version != self._known[self.site.file] or self._known != self._digests():
                remedy = "open the page again: what is drawn there now is not in the file"
                raise Refused("was changed on disk meanwhile; nothing was written", where=str(self.site.file), remedy=remedy)
            masks = dict(self._new_masks(marks))
            files = {name: self._mask_file(self._camera(name)) for name in masks}
            added = [name for name, file in files.items() if file != self._camera(name).mask]
            for name in added:  # a mask that the site file names must be there
                write_atomic(files[name], masks[name])
            try:
                text, site = self._edited(marks, {name: str(files[name].relative_to(self.site.folder)) for name in added})
            except Refused:
                for name in added:
                    files[name].unlink()
                raise
            for name, file in files.items():
                write_atomic(file, masks[name])
            write_atomic(self.site.file.resolve(), text)
            self.site, self._painted = site, self._painted | masks.keys()
            self._known = self._digests()
            return self.state()

    def _new_masks(self, marks: Marks) -> Iterable[tuple[str, bytes]]:
        """The masks that areas are painted over, or were."""
        for name, drawn in marks.cameras.items():
            if not drawn.mask and name not in self._painted:
                continue
            if name not in self._sizes:
                self.picture(name)
            areas = [(area.use, area.corners) for area in drawn.mask]
            try:
                yield name, load(PAINTED_MASK)(name, self._masks.get(name), self._sizes[name], areas)
            except ValueError as error:
                raise Refused(str(error)) from None

    def _edited(self, marks: Marks, masks: dict[str, str]) -> tuple[bytes, Site]:
        """The bytes of the site file with what is drawn, and what it says.  Raises Refused."""
        raw = read_outside(self.site.file, MOST_TEXT_BYTES)
        before, mark = raw.decode("utf-8-sig"), BOM_UTF8 if raw.startswith(BOM_UTF8) else b""
        ends = "\r\n" if "\r\n" in before else "\n"
        try:
            text = edited(before.replace("\r\n", "\n"), self.site, marks, masks)
            site = site_of(parse_yaml(text, self.site.file), self.site.work_folder.root)
        except NotEditable as error:
            raise Refused(str(error), where=str(self.site.file), remedy="change this by hand") from None
        except SiteError as error:
            raise Refused(str(error)) from None
        return mark + text.replace("\n", ends).encode(), site

    def _mask_file(self, camera: Camera) -> Path:
        """Where a camera's mask is written: over its own, where that is a PNG, else in a new file."""
        others = {other.mask for other in self.site.cameras if other.id != camera.id}
        if camera.mask and camera.mask.suffix.lower() == ".png" and camera.mask not in others:
            return camera.mask
        folder, number = self.site.folder / "masks", 1
        while (file := folder / f"{camera.id}{f'-{number}' if number > 1 else ''}.png").exists():
            number += 1
        return file

    def _camera(self, name: str) -> Camera:
        camera = next((camera for camera in self.site.cameras if camera.id == name), None)
        if camera is None:
            raise Refused(f"the site has no camera {name!r}")
        return camera

    def _digests(self) -> dict[Path, str]:
        """What is in the site file and in the masks now."""
        files = [self.site.file, *(camera.mask for camera in self.site.cameras if camera.mask)]
        return {file: content_digest(read_outside(file)) if is_file(file) else "" for file in files}
