"""COLMAP's models, as text (cameras.txt and images.txt) or binary (.bin), with all of COLMAP's camera models.

References
----------
https://colmap.github.io/format.html, https://colmap.github.io/cameras.html
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...cache.untrusted import Unreadable, is_file, read_untrusted
from ...words import printable
from ..yaml_document import Problem, SiteError, read_text
from .calibrated import Calibrated, calibrated, centre, quaternion_rotation

_LAYOUTS: dict[str, tuple[str, int, int]] = {
    "SIMPLE_PINHOLE": ("pinhole", 1, 0),
    "PINHOLE": ("pinhole", 2, 0),
    "SIMPLE_RADIAL": ("brown", 1, 1),
    "RADIAL": ("brown", 1, 2),
    "OPENCV": ("brown", 2, 4),
    "OPENCV_FISHEYE": ("fisheye", 2, 4),
    "FULL_OPENCV": ("rational", 2, 8),
    "FOV": ("fov", 2, 1),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", 1, 1),
    "RADIAL_FISHEYE": ("fisheye", 1, 2),
    "THIN_PRISM_FISHEYE": ("thin-prism-fisheye", 2, 8),
    "RAD_TAN_THIN_PRISM_FISHEYE": ("rad-tan-thin-prism-fisheye", 2, 12),
    "SIMPLE_DIVISION": ("division", 1, 1),
    "DIVISION": ("division", 2, 1),
    "SIMPLE_FISHEYE": ("fisheye", 1, 0),
    "FISHEYE": ("fisheye", 2, 0),
    "EUCM": ("eucm", 2, 2),
    "EQUIRECTANGULAR": ("equirectangular", 0, 0),
}
"""By COLMAP's camera model: our lens model, the number of focal lengths, and of coefficients after the principal point.

A model's position in this table is its COLMAP id, which binary models contain.
"""


def is_colmap(folder: Path) -> bool:
    """Does a folder contain a COLMAP model, or a part of one?"""
    for name in ("cameras.txt", "cameras.bin", "images.txt", "images.bin"):
        if is_file(folder / name):
            return True
    return False


def read_colmap(folder: Path) -> dict[str, Calibrated]:
    """Cameras by image name; a text model takes precedence over a binary one.  Raises SiteError."""
    suffix = _model_suffix(folder)
    camera_file = folder / f"cameras.{suffix}"
    image_file = folder / f"images.{suffix}"
    if suffix == "txt":
        cameras = _text_cameras(camera_file)
        images = _text_images(image_file)
    else:
        cameras = _binary_cameras(camera_file)
        images = _binary_images(image_file)
    # 1. the lenses: images share them
    lenses: dict[str, dict[str, Any]] = {}
    for camera in cameras:
        if camera.id in lenses:
            raise _refused(camera_file, f"{camera.label}camera {camera.id} is there twice", camera.line)
        try:
            lenses[camera.id] = _lens(camera)
            calibrated(lenses[camera.id])  # a fault is that of the camera, and not of each of its images
        except (IndexError, ValueError) as error:
            reason = "it lacks numbers" if isinstance(error, IndexError) else str(error)
            raise _refused(camera_file, f"{camera.label}{reason}", camera.line) from None
    # 2. the images, each with a pose and the lens of its camera
    by_image: dict[str, Calibrated] = {}
    for image in images:
        if image.name in by_image:
            raise _refused(image_file, f"{image.label}: {image.name} is there twice", image.line)
        if image.camera not in lenses:
            what = f"{image.label} is of camera {image.camera}, which {camera_file.name} lacks"
            raise _refused(image_file, what, image.line)
        try:
            R = quaternion_rotation(image.pose[:4])
            by_image[image.name] = calibrated({**lenses[image.camera], "R": R, "C": centre(R, image.pose[4:])})
        except (TypeError, IndexError, ValueError) as error:
            raise _refused(image_file, f"{image.label}: {error}", image.line) from None
    return by_image


def _model_suffix(folder: Path) -> str:
    """The suffix of a whole model in a folder: txt or bin.  Raises SiteError if there is none."""
    for suffix in ("txt", "bin"):
        if is_file(folder / f"cameras.{suffix}") and is_file(folder / f"images.{suffix}"):
            return suffix
    what = "must hold cameras.txt and images.txt, or cameras.bin and images.bin (COLMAP's text or binary model)"
    # COLMAP writes each model into a numbered folder: often the one around them is named
    inner = sorted(path for path in folder.iterdir() if path.is_dir() and is_colmap(path))
    if inner:
        raise SiteError(Problem(folder, what, f"name the folder of the model: {printable(inner[0])}"))
    raise _refused(folder, what)


@dataclass(frozen=True)
class _Camera:
    """A camera of a model.  line: in the text model; 0 in the binary one.  label: what messages about it begin with."""

    line: int
    label: str
    id: str
    model: str
    width: int
    height: int
    parameters: list[float]


@dataclass(frozen=True)
class _Image:
    """An image of a model, with the id of its camera and its pose (qw qx qy qz and t); line and label as for a camera."""

    line: int
    label: str
    name: str
    camera: str
    pose: list[float]


def _refused(path: Path, what: str, line: int = 0) -> SiteError:
    return SiteError(Problem(path, what, "have COLMAP write the model again: model_converter --output_type TXT", line))


def _text_cameras(path: Path) -> Iterator[_Camera]:
    """The cameras of a text model.  Raises SiteError."""
    for line, text in _lines(path):
        if not text.strip():
            continue
        try:
            number, model, width, height, *parameters = text.split()
            yield _Camera(line, "", number, model, int(width), int(height), [*map(float, parameters)])
        except ValueError:
            raise _refused(path, "not a camera line of COLMAP's text model", line) from None


def _text_images(path: Path) -> Iterator[_Image]:
    """The images of a text model.

    Each image takes two lines; the second, with its 2-D points, is not needed.  It may be empty, and some programs leave empty
    lines out, so it is recognised by what it holds.
    """
    label = "not an image line of COLMAP's text model"
    points_may_follow = False
    for line, text in _lines(path):
        if not text.strip() or (points_may_follow and _is_points_line(text)):
            points_may_follow = False
            continue
        try:
            _, *pose, number, name = text.split(maxsplit=9)
            yield _Image(line, label, name.strip(), number, [*map(float, pose)])
        except ValueError:
            raise _refused(path, label, line) from None
        points_may_follow = True


def _is_points_line(text: str) -> bool:
    """Is this a list of points: x, y and the number of a 3-D point, or -1, for each?"""
    words = text.split()
    if len(words) % 3:
        return False
    try:
        for start in range(0, len(words), 3):
            float(words[start])
            float(words[start + 1])
            int(words[start + 2])
    except ValueError:
        return False
    return True


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines of a file that are not comments, with their numbers."""
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if not line.startswith("#"):
            yield number, line


def _binary_cameras(path: Path) -> Iterator[_Camera]:
    """The cameras of a binary model.  Raises SiteError.

    How many parameters a camera has follows from its model: with an unknown one, nothing after it can be read.
    """
    file = _Binary(path)
    for _ in range(file.values("<Q")[0]):
        number, model, width, height = file.values("<IiQQ")
        name = f"number {model}"  # `_lens` refuses it
        parameter_count = 0
        if 0 <= model < len(_LAYOUTS):
            name = list(_LAYOUTS)[model]
            _, focals, coefficients = _LAYOUTS[name]
            parameter_count = focals + 2 + coefficients
        parameters = list(file.values(f"<{parameter_count}d"))
        yield _Camera(0, f"camera {number}: ", str(number), name, width, height, parameters)


def _binary_images(path: Path) -> Iterator[_Image]:
    """The images of a binary model.  Raises SiteError."""
    file = _Binary(path)
    for _ in range(file.values("<Q")[0]):
        number, *pose, camera = file.values("<I7dI")
        name = file.text()
        file.skip(24 * file.values("<Q")[0])  # the image's 2-D points: x, y, and the id of the 3-D point
        yield _Image(0, f"image {number}", name, str(camera), pose)


class _Binary:
    """Reads a file of COLMAP's binary model: little-endian numbers, each list preceded by its length."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.at = 0
        """Position of the next byte to read."""
        try:
            self.data = read_untrusted(path)
        except Unreadable as error:
            raise SiteError(Problem(path, error.what)) from None

    def values(self, layout: str) -> tuple[Any, ...]:
        """The next values, in a `struct` layout."""
        start = self.at
        self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.data, start)

    def text(self) -> str:
        """The text up to the next zero byte."""
        start = self.at
        end = self.data.find(b"\0", start)
        if end < 0:
            end = len(self.data)  # `skip` refuses it
        self.skip(end + 1 - start)
        return self.data[start:end].decode(errors="surrogateescape")

    def skip(self, count: int) -> None:
        """Skip bytes.  Raises SiteError if the file ends before."""
        self.at += count
        if self.at > len(self.data):
            raise _refused(self.path, "ends too early (COLMAP's binary model)")


def _lens(camera: _Camera) -> dict[str, Any]:
    """The lens of a camera.  COLMAP's origin is the *corner* of the top-left pixel, so 0.5 is subtracted from cx and cy."""
    if camera.model not in _LAYOUTS:
        raise ValueError(f"camera model {camera.model} is not supported; use one of {', '.join(_LAYOUTS)}")
    model, focals, count = _LAYOUTS[camera.model]
    width = camera.width
    height = camera.height
    parameters = camera.parameters
    if model == "equirectangular":
        # it has no parameters: the picture covers 360 x 180 degrees, so a pixel is a fixed angle
        parameters = [width / (2 * math.pi), height / math.pi, width / 2, height / 2]
        focals = 2
    fx = parameters[0]
    fy = parameters[focals - 1]  # one focal length serves both axes
    cx = parameters[focals]
    cy = parameters[focals + 1]
    if min(fx, fy) <= 0:
        raise ValueError("a focal length must be positive")
    K = [[fx, 0.0, cx - 0.5], [0.0, fy, cy - 0.5], [0.0, 0.0, 1.0]]
    coefficients = [parameters[focals + 2 + i] for i in range(count)]
    if model == "fisheye":  # coefficients that COLMAP's model lacks are 0
        coefficients += [0.0] * (4 - count)
    if model == "pinhole":
        model = "brown"  # with coefficients of 0
    return {"K": K, "width": width, "height": height, "distortion": coefficients, "model": model}
