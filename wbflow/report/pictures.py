"""What the page shows of the night's results: pictures, points, layers of the map, and keypoints over the camera pictures.

Pictures are files beside the artifacts.  The rest is made from an artifact by a function of the vision, and kept beside it.
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

from ..cache.codec import result_of
from ..cache.previews import Shown
from ..cache.untrusted import read_outside
from ..errors import WbflowError
from ..outcome.artifacts import function
from ..pipeline.stages import FRAMES, FUSE, STAGES, stage_named
from ..records.run_folder import NoSuchRun, RunFolder
from ..task import Task, camera_of, view_name
from .data import ReportData
from .map import Map
from .scene import Scene

ROOM = 6_000_000
"""Bytes of small pictures in a page; the page links to the files of the others."""
_EXPECTED = (WbflowError, ValueError, LookupError, TypeError, ArithmeticError, AttributeError, ImportError, OSError, MemoryError)


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
        return self.of_file(self.data.work.picture(task, event.key), alt) if event and event.key else None

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
        return self.of_file(self.data.work.picture(task, event.key), f"{camera} on {good.date}, when all was well")

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
        return self.of_file(self.data.files / name, alt)

    def of_file(self, path: Path, alt: str) -> Picture | None:
        """Return a picture by its file; None where there is none."""
        if path in self._ids:
            return Picture(self._ids[path], alt)
        try:
            content = read_outside(path)
        except OSError:
            return None
        name = f"picture-{len(self._ids) + 1}"
        if self.held + len(content) > ROOM:
            return Picture(name, alt, link=os.path.relpath(path, self.data.work.run(self.data.record.run).folder))
        self._ids[path] = name
        self.held += len(content)
        kind = mimetypes.guess_type(path.name)[0] or "image/jpeg"
        return Picture(name, alt, f"data:{kind};base64,{base64.b64encode(content).decode()}")


class Extracts:
    """What functions of the vision make of results for the page; made once, and kept in the cache."""

    def __init__(self, data: ReportData) -> None:
        self._data = data
        self._code = functools.cache(lambda dotted: data.site.reader.read(dotted).code)

    def of(self, task: Task, dotted: str) -> bytes | None:
        """Return what a function makes of a task's result; None where the result is gone, or the function fails."""
        key, cache = self._data.keys.get(task), self._data.cache
        if not key or not dotted:
            return None
        kept = Shown(cache.work, task, key, self._code(dotted))
        if (made := kept.kept()) is not None:
            return made
        try:
            receipt = cache.by_key(task, key)
            if receipt is None or receipt.file is None:
                return None
            result = result_of(cache.read(task, cache.path(receipt), receipt.digest), stage_named(task.stage).table)
            made = bytes(function(dotted)(result))
            kept.keep(made)
            return made
        except _EXPECTED:
            return None  # the page does without


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


def points_of(extracts: Extracts) -> list[Points]:
    """Return the points of the night's results, the product's first."""
    found = ((stage.name, extracts.of(Task(stage.name), stage.products.view)) for stage in STAGES)
    return [Points(name, _split(data)[0], data) for name, data in found if data]


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


def layers_of(extracts: Extracts, scene: Scene, drawn: Map) -> list[Layer]:
    """Return the pictures on the map; the head of each names its top left, top right and bottom left corner in the world."""
    found = []
    for stage in STAGES:
        if data := extracts.of(Task(stage.name), stage.products.layer):
            head, picture = _split(data)
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


def large_pictures(extracts: Extracts, data: ReportData, room: int) -> list[LargePicture]:
    """Return the night's pictures in the order of the site file; cameras with a finding come first where room runs out.

    Keypoints are pairs of unsigned 16-bit numbers, shares of width and height; those of a pair are the left picture's, then as
    many of the right one.  room: bytes that all may take in the page.
    """
    record = data.record
    marks_of = functools.cache(lambda task, dotted: extracts.of(task, dotted) or b"")  # both cameras need those of a pair
    in_findings = {name for finding in record.verdict.findings for name in finding.subject} if record.verdict else set()
    numbers = {camera.id: k for k, camera in enumerate(record.cameras, 1)}
    found: list[LargePicture] = []
    for camera in sorted(numbers, key=lambda name: (name not in in_findings, numbers[name])):
        first, whole = (Task(FRAMES, (view,)) for view in (view_name(camera, 1), camera))
        frame = first if first in data.keys else whole
        picture = extracts.of(frame, stage_named(FRAMES).products.large)
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


def _keypoints(marks_of: Callable[[Task, str], bytes], camera: str) -> Iterator[bytes]:
    for stage in STAGES:
        if stage.products.marks and stage.scope == "camera":
            yield marks_of(Task(stage.name, (camera,)), stage.products.marks)


def _inliers(marks_of: Callable[[Task, str], bytes], data: ReportData, view: str) -> Iterator[bytes]:
    for stage in STAGES:
        for pair in data.record.pairs_of(camera_of(view)) if stage.products.marks and stage.scope == "pair" else ():
            both = (
                marks_of(Task(stage.name, (pair.left, pair.right)), stage.products.marks)
                if view in {pair.left, pair.right}
                else b""
            )
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
