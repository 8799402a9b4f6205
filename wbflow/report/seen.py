"""What a camera saw, as large as it is, with what was found in it: shown on a click, for as many cameras as there is room for.

Places come as `pipeline.rows.Stage.marks` makes them: two unsigned 16-bit numbers each, shares of the picture's width and height;
those of a pair are the left picture's, then as many of the right one.
"""

from __future__ import annotations

import base64
import functools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from ..pipeline.rows import Role
from ..pipeline.stages import STAGES, stage_with
from ..task import Task, camera_of, view_name
from .made import Maker
from .sources import Sources


@dataclass(frozen=True)
class Seen:
    """A camera's picture and what lies over it."""

    number: int
    """Of the camera in the page, from 1."""
    data: str
    """Base64, three words: JPEG, places of points, places of those that pairs agree on; "-" for what there is nothing of."""
    note: str
    """Where the places are not of this night."""


def seen(maker: Maker, sources: Sources, keys: Mapping[Task, str], room: int) -> list[Seen]:
    """Pictures of the night in the order of the site file; cameras that a finding is about go first where there is no room.

    Parameters
    ----------
    maker : Maker
        Makes pictures and marks of results.
    sources : Sources
        What the page is made of.
    keys : mapping
        Key of the result of each task.
    room : int
        Bytes that they may take in the page.
    """
    record = sources.record

    @functools.cache  # those of a pair are asked for by both of its cameras
    def marks_of(dotted: str, task: Task) -> bytes:
        return maker.made(dotted, task, keys[task]) or b"" if task in keys else b""

    told = {name for finding in record.verdict.findings for name in finding.subject} if record.verdict else set()
    numbers = {camera.id: k for k, camera in enumerate(record.cameras, 1)}
    found: list[Seen] = []
    for camera in sorted(numbers, key=lambda name: (name not in told, numbers[name])):
        first, whole = (Task(stage_with(Role.FRAME).name, (view,)) for view in (view_name(camera, 1), camera))
        frame = first if first in keys else whole
        picture = maker.made(stage_with(Role.FRAME).large, frame, keys[frame]) if frame in keys else None
        if not picture:
            continue
        view = frame.subject[0]
        marks = b"".join(_of_camera(marks_of, view)), b"".join(_of_pairs(marks_of, sources, view))
        data = " ".join(base64.b64encode(part).decode() or "-" for part in (picture, *marks))
        if len(data) > room:
            break
        room -= len(data)
        found.append(Seen(numbers[camera], data, _note(sources, keys, view) if any(marks) else ""))
    return sorted(found, key=lambda one: one.number)


def _note(sources: Sources, keys: Mapping[Task, str], camera: str) -> str:
    """A camera that stands as it did keeps the points of the reference: they were found in its picture of then."""
    cache, frame = sources.cache, Task(stage_with(Role.FRAME).name, (camera,))
    shown = cache.by_key(frame, keys[frame])
    for stage in STAGES:
        task = Task(stage.name, (camera,))
        made = cache.by_key(task, keys[task]) if stage.marks and task in keys else None
        if made and shown and shown.digest not in made.preimage.inputs.values():
            when = f" of {sources.reference.date}" if sources.reference else ""
            return f"found in the reference's picture{when}: the camera stands as it did"
    return ""


def _of_camera(marks_of: Callable[[str, Task], bytes], camera: str) -> Iterator[bytes]:
    for stage in STAGES:
        if stage.marks and stage.scope == "camera":
            yield marks_of(stage.marks, Task(stage.name, (camera,)))


def _of_pairs(marks_of: Callable[[str, Task], bytes], sources: Sources, camera: str) -> Iterator[bytes]:
    for stage in STAGES:
        for pair in sources.record.pairs_of(camera_of(camera)) if stage.marks and stage.scope == "pair" else ():
            if camera not in {pair.left, pair.right}:
                continue  # of another view of the camera
            task = Task(stage.name, (pair.left, pair.right))
            if both := marks_of(stage.marks, task):
                half = len(both) // 2
                yield both[:half] if pair.left == camera else both[half:]
