"""How much disk space a night takes."""

from __future__ import annotations

from collections.abc import Iterable

from ..cache.untrusted import Unreadable, read_untrusted
from ..pipeline.stages import FRAMES
from ..plugins import load
from .night import Night

BYTES_PER_PIXEL = 35
"""Space that a night takes in the work folder, for each pixel of each camera at working resolution: images, depths, the cloud.
Measured 30 to 45 on the demo at 320 and 640 pixels and on photographs at 768."""
BYTES_PER_CAMERA = 1_500_000
"""Further space for each camera, whatever its resolution: keypoints with their descriptors, pictures for the report."""
UNKNOWN_SIZE = (1920, 1080)
"""Width and height that are assumed for captures whose headers do not tell: videos, damaged files."""


def bytes_of_sizes(sizes: Iterable[tuple[int, int]], resolution: int | None) -> int:
    """Space in bytes that a night takes, from the width and height of each camera's captures.

    resolution: long side in pixels at which the stages work; None: as captured.
    """
    total = 0
    for width, height in sizes:
        scale = 1.0
        if resolution:
            scale = min(1.0, resolution / max(width, height))  # captures are never enlarged
        total += BYTES_PER_CAMERA + round(BYTES_PER_PIXEL * scale * width * scale * height)
    return total


def night_bytes(night: Night) -> int:
    """Space in bytes that a night takes, from the headers of its captures."""
    sizes = [_captured_size(night, camera) for camera, files in night.files.captures.items() if files]
    resolution = night.site.stages[FRAMES].parameters.get("resolution", night.site.settings.resolution)
    return bytes_of_sizes(sizes, resolution)


def _captured_size(night: Night, camera: str) -> tuple[int, int]:
    """Width and height of a camera's newest readable capture."""
    picture_size = load("wbflow_stages.io.image_headers:picture_size")
    for file in reversed(night.files.captures[camera]):
        try:
            size: tuple[int, int] | None = picture_size(bytes(read_untrusted(file.path)))
        except Unreadable:
            continue
        if size:
            return size
    return UNKNOWN_SIZE
