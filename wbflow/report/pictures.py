"""What the page shows of the night's results: pictures, points, layers of the map, and keypoints over the camera pictures.

All of it was drawn when the result was made, and lies beside the artifact; what is not there any more is left out.
"""

from __future__ import annotations

import base64
import functools
import json
import mimetypes
import os
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.untrusted import read_outside
from ..pipeline.stages import FRAMES, FUSE, STAGES, stage_named
from ..records.run_folder import NoSuchRun, RunFolder
from ..task import Task, camera_of, view_name
from .data import ReportData
from .map import Map
from .scene import Scene

ROOM = 6_000_000
"""Bytes of small pictures in a page; the page links to the files of the others."""


@dataclass(frozen=True)
class Picture:
    """A picture in the page."""

    id: str
    alt: str
    data: str = ""
    """A data URL; "" where the picture stands elsewhere in the page, or has no room."""
    link: str = ""
    """The file, seen from the report, where there is no room for it."""


@dataclass
class Pictures:
    """Hands out pictures in the order of the page; each is in the page once."""

    data: ReportData
    held: int = 0
    """Bytes handed out."""
    _ids: dict[Path, str] = field(default_factory=dict)

    def of_task(self, task: Task, alt: str) -> Picture | None:
        """Return the picture of a result of this run."""
        event = self.data.tasks.get(task)
        return self._of_result(task, event.key, alt) if event and event.key else None

    def _of_result(self, task: Task, key: str, alt: str) -> Picture | None:
        path = self.data.work.drawing(task, key, "picture")
        return self._of(path, alt, lambda: self.data.cache.drawing(task, key, "picture"))

    def of_frame(self, camera: str, alt: str) -> Picture | None:
        """Return what a camera saw this night."""
        return self.of_task(self._frame(camera), alt)

    def _frame(self, camera: str) -> Task:
        """Return the task of a camera's frame: of several views the first, which shows the middle."""
        whole, first = (Task(FRAMES, (name,)) for name in (camera, view_name(camera, 1)))
        return first if first in self.data.tasks else whole

    def of_last_good(self, camera: str) -> Picture | None:
        """Return what a camera saw when it was last as it should be."""
        good, task = self.data.last_good_of(camera), self._frame(camera)
        if good is None:
            return None
        try:
            event = RunFolder.of(self.data.work, good.run).tasks().get(task)
        except NoSuchRun:
            return None
        if event is None or not event.key or not self._has_same_privacy(task, event.key):
            return None
        return self._of_result(task, event.key, f"{camera} on {good.date}, when all was well")

    def _has_same_privacy(self, task: Task, key: str) -> bool:
        """Return whether an earlier picture left out what is private tonight."""
        stated = next((view for view in self.data.site.views if (view.id,) == task.subject), None)
        if stated is None or not stated.privacy.counts:
            return True
        cache, tonight = self.data.cache, self.data.tasks.get(task)
        then = cache.by_key(task, key)
        now = cache.by_key(task, tonight.key) if tonight and tonight.key else None
        private = [name for name, need in stage_named(FRAMES).inputs.items() if (need.kind, need.name) == ("site", "privacy")]
        if then is None or now is None:
            return False
        return all(then.preimage.inputs.get(name) == now.preimage.inputs.get(name) for name in private)

    def of_product(self, name: str, alt: str) -> Picture | None:
        """Return a picture that the run publishes."""
        path = self.data.files / name

        def read() -> bytes | None:
            try:
                return read_outside(path)
            except OSError:
                return None

        return self._of(path, alt, read)

    def _of(self, path: Path, alt: str, read: Callable[[], bytes | None]) -> Picture | None:
        """Return a picture by its file; None where there is none."""
        if path in self._ids:
            return Picture(self._ids[path], alt)
        content = read()
        if content is None:
            return None
        name = f"picture-{len(self._ids) + 1}"
        if self.held + len(content) > ROOM:
            return Picture(name, alt, link=os.path.relpath(path, self.data.work.run(self.data.record.run).folder))
        self._ids[path] = name
        self.held += len(content)
        kind = mimetypes.guess_type(path.name)[0] or "image/jpeg"
        return Picture(name, alt, f"data:{kind};base64,{base64.b64encode(content).decode()}")


@dataclass(frozen=True)
class Points:
    """A stream of points for the 3-D view: length of a JSON head (uint32, little-endian), the head, and packed columns."""

    stage: str
    head: Mapping[str, Any]
    data: bytes = field(repr=False)

    @property
    def kind(self) -> str:
        return "product" if self.stage == FUSE else "change"

    @property
    def base64(self) -> str:
        return base64.b64encode(self.data).decode()


def points_of(data: ReportData) -> list[Points]:
    """Return the points of the night's results, the product's first."""
    found = ((stage.name, data.drawing(Task(stage.name), "view")) for stage in STAGES)
    return [Points(name, _split(stream)[0], stream) for name, stream in found if stream]


@dataclass(frozen=True)
class Layer:
    """A picture on the map."""

    name: str
    """Of the stage."""
    words: str
    legend: tuple[tuple[str, str], ...]
    """Meaning of each colour."""
    data: str
    """A data URL."""
    matrix: tuple[float, ...]
    """From the unit square to the drawing, as CSS has it: a, b, c, d, e, f."""


def layers_of(data: ReportData, scene: Scene, drawn: Map) -> list[Layer]:
    """Return the pictures on the map; the head of each names its top left, top right and bottom left corner in the world."""
    found = []
    for stage in STAGES:
        if layer := data.drawing(Task(stage.name), "layer"):
            head, picture = _split(layer)
            url = f"data:image/png;base64,{base64.b64encode(picture).decode()}"
            (x, y), right, down = (drawn.spot(scene.to(corner)) for corner in head["corners"])
            matrix = (right[0] - x, right[1] - y, down[0] - x, down[1] - y, x, y)
            found.append(Layer(stage.name, head["words"], tuple(map(tuple, head["legend"])), url, matrix))
    return found


def _split(data: bytes) -> tuple[dict[str, Any], bytes]:
    (length,) = struct.unpack_from("<I", data)
    return json.loads(data[4 : 4 + length]), data[4 + length :]


@dataclass(frozen=True)
class LargePicture:
    """A camera's picture at full size, and the keypoints over it."""

    number: int
    """Of the camera in the page, from 1."""
    data: str
    """Three words of Base64: JPEG, keypoints, inliers; "-" for none."""
    note: str
    """Where the keypoints are not of this night."""


def large_pictures(data: ReportData, room: int) -> list[LargePicture]:
    """Return the night's pictures in the order of the site file; cameras with a finding come first where room runs out.

    Keypoints are pairs of unsigned 16-bit numbers, shares of width and height; those of a pair are the left picture's, then as
    many of the right one.  room: bytes that all may take in the page.
    """
    record = data.record
    marks_of = functools.cache(lambda task: data.drawing(task, "marks") or b"")  # both cameras need those of a pair
    in_findings = {name for finding in record.verdict.findings for name in finding.subject} if record.verdict else set()
    numbers = {camera.id: k for k, camera in enumerate(record.cameras, 1)}
    found: list[LargePicture] = []
    for camera in sorted(numbers, key=lambda name: (name not in in_findings, numbers[name])):
        first, whole = (Task(FRAMES, (view,)) for view in (view_name(camera, 1), camera))
        frame = first if first in data.keys else whole
        picture = data.drawing(frame, "large")
        if not picture:
            continue
        view = frame.subject[0]
        marks = b"".join(_keypoints(marks_of, view)), b"".join(_inliers(marks_of, data, view))
        words = " ".join(base64.b64encode(part).decode() or "-" for part in (picture, *marks))
        if len(words) > room:
            break
        room -= len(words)
        found.append(LargePicture(numbers[camera], words, _keypoint_note(data, view) if any(marks) else ""))
    return sorted(found, key=lambda one: one.number)


def _keypoints(marks_of: Callable[[Task], bytes], camera: str) -> Iterator[bytes]:
    for stage in STAGES:
        if stage.products.marks and stage.scope == "camera":
            yield marks_of(Task(stage.name, (camera,)))


def _inliers(marks_of: Callable[[Task], bytes], data: ReportData, view: str) -> Iterator[bytes]:
    for stage in STAGES:
        for pair in data.record.pairs_of(camera_of(view)) if stage.products.marks and stage.scope == "pair" else ():
            both = marks_of(Task(stage.name, (pair.left, pair.right))) if view in {pair.left, pair.right} else b""
            half = len(both) // 2
            yield both[:half] if pair.left == view else both[half:]


def _keypoint_note(data: ReportData, view: str) -> str:
    """A camera that has not moved keeps the keypoints of the reference's picture."""
    cache, frame = data.cache, Task(FRAMES, (view,))
    shown = cache.by_key(frame, data.keys[frame])
    for stage in STAGES:
        task = Task(stage.name, (view,))
        made = cache.by_key(task, data.keys[task]) if stage.products.marks and task in data.keys else None
        if made and shown and shown.digest not in made.preimage.inputs.values():
            when = f" of {data.reference_date}" if data.reference_date else ""
            return f"found in the reference's picture{when}: the camera has not moved"
    return ""
