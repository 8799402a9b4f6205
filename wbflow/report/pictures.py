"""Drawings of the night's results for the page: pictures, points, layers of the map, and keypoints over the camera pictures.

All were drawn when the result was made, and are stored with its artifact; product files that no longer exist are left out.
"""

from __future__ import annotations

import base64
import json
import mimetypes
import struct
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cache.untrusted import read_untrusted
from ..pipeline.stages import CHANGES, FEATURES, FRAMES, FUSE, GEOMETRY, OBSERVED
from ..plugins import load
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.calibration.calibrated import product
from ..task import Task
from .data import ReportData, state_of

Matrix = Sequence[Sequence[float]]

_LEAST_SHIFT = 5e-4
"""Pictures of two nights whose corners differ by less than this share of their size are overlaid without a homography."""
MOST_PICTURE_BYTES = 6_000_000
"""Largest total size of small pictures in a page; further pictures are links to their files."""


@dataclass(frozen=True)
class Picture:
    """A picture in the page."""

    id: str
    alt: str
    data: str = ""
    """A data URL; "" if the picture is already elsewhere in the page, or exceeds `MOST_PICTURE_BYTES`."""
    link: str = ""
    """Path to the file, relative to the report, if the picture exceeds `MOST_PICTURE_BYTES`; else ""."""


def other_night(data: ReportData, run: str | None) -> ReportData | None:
    """Return a run to compare with the page's own; None if `run` is None, cannot be read, or is the page's own."""
    if run is None or run == data.record.run:
        return None
    try:
        folder = RunFolder.of(data.work, run)
        return replace(
            data,
            record=folder.record(),
            events=tuple(folder.events()),
            cameras=folder.cameras(),
            files=folder.paths.folder,
        )
    except NoSuchRun:
        return None


def _is_as_private(data: ReportData, other: ReportData, frame: Task) -> bool:
    """Return whether a camera's picture of another night hides what is private now: same polygons, or none any more."""
    has_polygons = any(view.privacy for view in data.site.views if (view.id,) == frame.subject)
    if not has_polygons:
        return True
    old = other.receipt(frame)
    new = data.receipt(frame)
    if old is None or new is None or frame not in data.keys:
        # what was hidden then, or is now, is not known any more
        return False
    return old.preimage.inputs.get("privacy") == new.preimage.inputs.get("privacy")


def _homography(old: Mapping[str, Any] | None, new: Mapping[str, Any] | None) -> str:
    """Return the homography of the unit square, row by row, that maps a camera's picture of another night onto this night's.

    old, new: its entries in cameras.json.  "" if the camera has not turned, or its poses are unknown.
    """
    if not old or not new or not all(entry.get("R") and entry.get("K") for entry in (old, new)):
        return ""
    # A camera that turns at its place maps pixels by K_new R_new R_old^T K_old^-1 (Hartley and Zisserman, 2nd ed., section 8.4).
    new_R_old = product(new["R"], list(zip(*old["R"], strict=True)))
    matrix = product(product(_to_unit(new), new_R_old), _from_unit(old))
    values = []
    for row in matrix:
        for value in row:
            values.append(value / matrix[2][2])
    if _largest_shift(values) < _LEAST_SHIFT:
        return ""
    return " ".join(f"{value:.7g}" for value in values)


def _largest_shift(homography: Sequence[float]) -> float:
    """Return by how much a homography (9 values, row by row) moves a corner of the unit square, at most, along an axis."""
    a, b, c, d, e, f, g, h, i = homography
    largest = 0.0
    for x, y in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)):
        w = g * x + h * y + i
        u = (a * x + b * y + c) / w
        v = (d * x + e * y + f) / w
        largest = max(largest, abs(u - x), abs(v - y))
    return largest


@dataclass
class Pictures:
    """Provides pictures in the order of the page, and embeds each file only once."""

    data: ReportData
    embedded_bytes: int = 0
    _ids: dict[Path, str] = field(default_factory=dict)

    def of_task(self, task: Task, alt: str) -> Picture | None:
        """Return the picture of a result of this run."""
        event = self.data.tasks.get(task)
        if event is None or not event.key:
            return None
        return self._from_result(task, event.key, alt)

    def of_last_good(self, camera: str) -> Picture | None:
        """Return a camera's picture of the last night on which it was in good state."""
        for record in self.data.earlier:
            # not every night has the camera: it may have been added later
            was_good = any(entry.id == camera and state_of(entry, record) == "good" for entry in record.cameras)
            if not was_good:
                continue
            night = other_night(self.data, record.run)
            if night is None:
                return None
            return self.of_other_night(night, camera, f"{camera} on {record.date}, when it was well")
        return None

    def of_other_night(self, other: ReportData, camera: str, alt: str) -> Picture | None:
        """Return a camera's picture of another night."""
        # polygons that were drawn since hide nothing in an old picture: it is left out then
        task = self.data.frame(camera)
        key = other.keys.get(task)
        if not key or not _is_as_private(self.data, other, task):
            return None
        return self._from_result(task, key, alt)

    def of_product(self, name: str, alt: str) -> Picture | None:
        """Return a picture that the run publishes."""
        path = self.data.files / name
        return self._from_file(path, alt, lambda: read_untrusted(path), link=name)

    def _from_result(self, task: Task, key: str, alt: str) -> Picture | None:
        path = self.data.work.product_file(task, key, "picture")
        return self._from_file(path, alt, lambda: self.data.cache.product_file(task, key, "picture"))

    def _from_file(self, path: Path, alt: str, read: Callable[[], bytes | None], link: str = "") -> Picture | None:
        """Return the picture in a file; None if there is none.  link: path to a product, relative to the report."""
        # it is embedded where it comes first; elsewhere a script of the page copies it
        if path in self._ids:
            return Picture(self._ids[path], alt)
        name = f"picture-{len(self._ids) + 1}"
        try:
            # what has no room stays outside, and the page leads to it
            if self.embedded_bytes + path.stat().st_size > MOST_PICTURE_BYTES:
                return Picture(name, alt, link=link or f"../../{path.relative_to(self.data.work.root)}")
            content = read()
        except OSError:
            return None
        if content is None:
            return None
        self._ids[path] = name
        self.embedded_bytes += len(content)
        return Picture(name, alt, data_url(content, mimetypes.guess_type(path.name)[0] or "image/jpeg"))


def other_pictures(album: Pictures, other: ReportData) -> dict[str, tuple[Picture, str]]:
    """Return, by camera, its picture of another night, and the homography that maps it onto the picture of this night."""
    pictures = {}
    for camera in album.data.record.cameras:
        name = camera.id
        picture = album.of_other_night(other, name, f"{name} on {other.record.date}")
        # a picture that has no room cannot be laid over this night's
        if picture and not picture.link:
            pictures[name] = picture, _homography(other.cameras.get(name), album.data.cameras.get(name))
    return pictures


def data_url(content: bytes, kind: str = "image/jpeg") -> str:
    """Return a file's content as a data URL.  kind: its MIME type."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


@dataclass(frozen=True)
class Points:
    """A stream of points for the 3-D view: length of a JSON head (uint32, little-endian), the head, and packed columns."""

    kind: str
    """product: the night's cloud; then: that of another night; change: what has changed; track: things that placed cameras."""
    data: bytes = field(repr=False)

    @cached_property
    def head(self) -> dict[str, Any]:
        return split(self.data)[0]

    @property
    def base64(self) -> str:
        return base64.b64encode(self.data).decode()


MOST_POINTS = 300_000
"""Most points of another night's cloud in a page: it is only shown in alternation with the page's own cloud."""


def points_of_other(data: ReportData, other: ReportData) -> Points | None:
    """Return at most `MOST_POINTS` points of another night's cloud; None if it is gone, or might show what is private now."""
    stream = other.product_file(Task(FUSE), "view")
    if stream is None:
        return None
    for frame in other.keys:
        # a point may be from any of its pictures
        if frame.stage == FRAMES and not _is_as_private(data, other, frame):
            return None
    if split(stream)[0]["n"] > MOST_POINTS:
        stream = load("wbflow_stages.exports.view:thinned_view")(stream, MOST_POINTS)
    return Points("then", stream)


def points_of(data: ReportData) -> list[Points]:
    """Return the points of the night's results: the product's come first."""
    points = []
    for stage, kind in ((FUSE, "product"), (CHANGES, "change"), (OBSERVED, "track")):
        stream = data.product_file(Task(stage), "view")
        if stream:
            points.append(Points(kind, stream))
    return points


def split(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON head of a stream, and the bytes after it."""
    (length,) = struct.unpack_from("<I", data)
    return json.loads(data[4 : 4 + length]), data[4 + length :]


def large_pictures(data: ReportData, bytes_left: int) -> list[tuple[int, str, str]]:
    """Return the night's pictures at full size: the camera's number in the page, their data, and a note about the keypoints.

    The data are three words of Base64 ("-" for none): the JPEG, keypoints, and inliers; points are pairs of unsigned 16-bit
    numbers, as shares of width and height.  `bytes_left` limits their size in bytes; cameras with a finding have priority.
    """
    numbers = data.numbers
    in_findings: set[str] = set()
    if data.record.verdict:
        for finding in data.record.verdict.findings:
            in_findings.update(finding.subject)
    inliers_of = _inliers(data)
    pictures: list[tuple[int, str, str]] = []
    for camera in sorted(numbers, key=lambda name: (name not in in_findings, numbers[name])):
        frame = data.frame(camera)
        picture = data.product_file(frame, "large")
        if not picture:
            continue
        keypoints = data.product_file(Task(FEATURES, frame.subject), "marks") or b""
        inliers = inliers_of[frame.subject[0]]
        encoded = f"{_encoded(picture)} {_encoded(keypoints)} {_encoded(inliers)}"
        # what comes first has priority: no smaller one further on takes its room
        if len(encoded) > bytes_left:
            break
        bytes_left -= len(encoded)
        note = _keypoint_note(data, frame) if keypoints or inliers else ""
        pictures.append((numbers[camera], encoded, note))
    return sorted(pictures)


def _encoded(content: bytes) -> str:
    return base64.b64encode(content).decode() or "-"


def _inliers(data: ReportData) -> defaultdict[str, bytes]:
    """Return the inliers of each view; the first half of a pair's inliers is in the left image, the second in the right one."""
    inliers = defaultdict[str, bytes](bytes)
    for pair in data.record.pairs:
        pair_inliers = data.product_file(Task(GEOMETRY, (pair.left, pair.right)), "marks") or b""
        middle = len(pair_inliers) // 2
        inliers[pair.left] += pair_inliers[:middle]
        inliers[pair.right] += pair_inliers[middle:]
    return inliers


def _keypoint_note(data: ReportData, frame: Task) -> str:
    """Return a note if the keypoints come from the reference's picture, as they do for a camera that has not moved; else ""."""
    frame_receipt = data.receipt(frame)
    receipt = data.receipt(Task(FEATURES, frame.subject))
    if not receipt or not frame_receipt or frame_receipt.digest in receipt.preimage.inputs.values():
        return ""
    night = ""
    if data.reference:
        night = f" of {data.reference.date}"
    return f"found in the reference's picture{night}: the camera has not moved"


def _to_unit(camera: Mapping[str, Any]) -> Matrix:
    """Return the matrix from rays of a camera to its picture as the unit square: K, with rows divided by width and height."""
    K = camera["K"]
    width = camera["width"]
    height = camera["height"]
    return [
        [K[0][0] / width, K[0][1] / width, K[0][2] / width],
        [K[1][0] / height, K[1][1] / height, K[1][2] / height],
        [0.0, 0.0, 1.0],
    ]


def _from_unit(camera: Mapping[str, Any]) -> Matrix:
    """Return the matrix from a camera's picture as the unit square to its rays (K without skew)."""
    K = camera["K"]
    width = camera["width"]
    height = camera["height"]
    return [
        [width / K[0][0], 0.0, -K[0][2] / K[0][0]],
        [0.0, height / K[1][1], -K[1][2] / K[1][1]],
        [0.0, 0.0, 1.0],
    ]
