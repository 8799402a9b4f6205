"""Captures that change while they are used, and cameras that deliver the same image."""

from __future__ import annotations

from collections.abc import Iterator

from ..records.findings import Finding, finding
from ..records.record import RunRecord
from .facts import Facts
from .wording import listed

LEAST_CONTRAST = 2.0
"""Standard deviation of grey levels (of 255) up to which an image shows nothing: dark images may well be identical."""


def check_captures(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Did captures change during the run, and does each camera deliver images of its own?"""
    in_motion = {camera.id: camera.captures_in_motion for camera in record.cameras if camera.captures_in_motion}
    if in_motion:
        files: list[str] = []
        for names in in_motion.values():
            files += names
        yield finding("captures-in-motion", tuple(in_motion), {"captures": len(files)}, captures=listed(files))
    cameras_by_picture: dict[str, list[str]] = {}
    for camera in record.cameras:
        digest = camera.figures.picture_digest
        if digest and (camera.figures.contrast or 0.0) > LEAST_CONTRAST:
            cameras_by_picture.setdefault(digest, []).append(camera.id)
    for cameras in cameras_by_picture.values():
        if len(cameras) > 1:
            yield finding("cameras-alike", tuple(cameras), cameras=listed(cameras))
