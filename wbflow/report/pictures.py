"""Drawings of the night's results for the page: pictures, points, layers of the map, and keypoints over the camera pictures.

All were drawn when the result was made, and are stored with its artifact; drawings that no longer exist are left out.
"""

from __future__ import annotations

import base64
import json
import mimetypes
import struct
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.untrusted import read_untrusted
from ..pipeline.stages import FRAMES, FUSE, STAGES, stage_named
from ..plugins import load
from ..records.run_folder import NoSuchRun, RunFolder
from ..site.calibration.calibrated import product
from ..task import Task
from .data import ReportData

Matrix = Sequence[Sequence[float]]

_LEAST_SHIFT = 5e-4
"""Pictures of two nights whose corners differ by less than this share of their size are overlaid without a homography."""
MOST_PICTURE_BYTES = 6_000_000
"""Largest total size of small pictures in a page; further pictures are links to their files."""

OTHER = "other"
"""Used instead of a stage's name for the points of another night."""


@dataclass(frozen=True)
class Picture:
    """A picture in the page."""

    id: str
    alt: str
    data: str = ""
    """A data URL; "" if the picture is already elsewhere in the page, or exceeds `MOST_PICTURE_BYTES`."""
    link: str = ""
    """Path to the file, relative to the report, if the picture exceeds `MOST_PICTURE_BYTES`; else ""."""


@dataclass(frozen=True)
class OtherNight:
    """A run of another night to compare with the page's own: its points, and its pictures, overlaid on those of this night."""

    date: str
    keys: Mapping[Task, str] = field(repr=False)
    cameras: Mapping[str, Any] = field(repr=False)
    """The cache key of each result, and the cameras as cameras.json has them."""
    page: ReportData = field(repr=False)

    def points(self) -> bytes | None:
        """Return the stream of its cloud; None if it is gone, or might show areas that are private now."""
        task = Task(FUSE)
        stream = self.page.cache.drawing(task, self.keys[task], "view") if task in self.keys else None
        return stream if all(self.is_as_private(frame) for frame in self.keys if frame.stage == FRAMES) else None

    def is_as_private(self, frame: Task) -> bool:
        """Return whether a camera's picture of that night hides what is private now: same polygons, or none any more."""
        site_view = next((view for view in self.page.site.views if (view.id,) == frame.subject), None)
        if site_view is None or not site_view.privacy:
            return True
        frame_keys = self.keys.get(frame), self.page.keys.get(frame)
        old, new = (self.page.cache.by_key(frame, key) if key else None for key in frame_keys)
        private = [name for name, need in stage_named(FRAMES).inputs.items() if (need.kind, need.name) == ("site", "privacy")]
        if old is None or new is None:
            return False
        return all(old.preimage.inputs.get(name) == new.preimage.inputs.get(name) for name in private)

    def homography_to_page(self, camera: str) -> str:
        """Return the homography of the unit square, row by row, that maps a camera's picture of that night onto this night's.

        "" if the camera has not turned, or its poses are unknown.
        """
        old, new = self.cameras.get(camera), self.page.cameras.get(camera)
        if not old or not new or not all(entry.get("R") and entry.get("K") for entry in (old, new)):
            return ""
        rotation = product(new["R"], list(zip(*old["R"], strict=True)))
        matrix = product(product(_to_unit(new), rotation), _from_unit(old))
        rows = [[value / matrix[2][2] for value in row] for row in matrix]
        corners = [_project(rows, x, y) for x, y in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0))]
        is_still = all(abs(x - k % 2) < _LEAST_SHIFT and abs(y - k // 2) < _LEAST_SHIFT for k, (x, y) in enumerate(corners))
        return "" if is_still else " ".join(f"{value:.7g}" for row in rows for value in row)


def other_night(data: ReportData, run: str | None) -> OtherNight | None:
    """Return a run to compare with the page's own; None if `run` is None, cannot be read, or is the page's own."""
    if run is None or run == data.record.run:
        return None
    try:
        folder = RunFolder.of(data.work, run)
        keys = {task: event.key for task, event in folder.tasks().items() if event.usable and event.key}
        return OtherNight(folder.record().date, keys, folder.cameras(), data)
    except NoSuchRun:
        return None


@dataclass
class Pictures:
    """Provides pictures in the order of the page, and embeds each file only once."""

    data: ReportData
    embedded_bytes: int = 0
    _ids: dict[Path, str] = field(default_factory=dict)

    def of_task(self, task: Task, alt: str) -> Picture | None:
        """Return the picture of a result of this run."""
        event = self.data.tasks.get(task)
        return self._from_result(task, event.key, alt) if event and event.key else None

    def of_frame(self, camera: str, alt: str) -> Picture | None:
        """Return a camera's picture of this night."""
        return self.of_task(self.data.frame(camera), alt)

    def of_last_good(self, camera: str) -> Picture | None:
        """Return a camera's picture of the last night on which it was in good state."""
        good = self.data.last_good_of(camera)
        night = other_night(self.data, good.run) if good else None
        return self.of_other_night(night, camera, f"{camera} on {good.date}, when it was well") if good and night else None

    def of_other_night(self, night: OtherNight, camera: str, alt: str) -> Picture | None:
        """Return a camera's picture of another night."""
        task = self.data.frame(camera)
        key = night.keys.get(task)
        return self._from_result(task, key, alt) if key and night.is_as_private(task) else None

    def of_product(self, name: str, alt: str) -> Picture | None:
        """Return a picture that the run publishes."""
        path = self.data.files / name
        return self._from_file(path, alt, lambda: read_untrusted(path), link=name)

    def _from_result(self, task: Task, key: str, alt: str) -> Picture | None:
        path, cache = self.data.work.drawing(task, key, "picture"), self.data.cache
        return self._from_file(path, alt, lambda: cache.drawing(task, key, "picture"))

    def _from_file(self, path: Path, alt: str, read: Callable[[], bytes | None], link: str = "") -> Picture | None:
        """Return the picture in a file; None if there is none.  link: path to a product, relative to the report."""
        if path in self._ids:
            return Picture(self._ids[path], alt)
        name = f"picture-{len(self._ids) + 1}"
        try:
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


def other_pictures(data: ReportData, album: Pictures, night: OtherNight) -> dict[str, tuple[Picture, str]]:
    """Return, by camera, its picture of another night, and the homography that maps it onto the picture of this night."""
    ids = [camera.id for camera in data.record.cameras]
    pictures = {name: album.of_other_night(night, name, f"{name} on {night.date}") for name in ids}
    return {name: (picture, night.homography_to_page(name)) for name, picture in pictures.items() if picture and not picture.link}


def data_url(content: bytes, kind: str = "image/jpeg") -> str:
    """Return a file's content as a data URL.  kind: its MIME type."""
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


@dataclass(frozen=True)
class Points:
    """A stream of points for the 3-D view: length of a JSON head (uint32, little-endian), the head, and packed columns."""

    stage: str
    head: Mapping[str, Any]
    data: bytes = field(repr=False)

    @property
    def kind(self) -> str:
        return {FUSE: "product", OTHER: "then"}.get(self.stage, "change")

    @property
    def base64(self) -> str:
        return base64.b64encode(self.data).decode()


MOST_POINTS = 300_000
"""Most points of another night's cloud in a page: it is only shown in alternation with the page's own cloud."""


def points_of_other(night: OtherNight) -> list[Points]:
    """Return at most `MOST_POINTS` points of another night's cloud; none if it is gone."""
    stream = night.points()
    if stream is None:
        return []
    if split(stream)[0]["n"] > MOST_POINTS:
        stream = load("wbflow_stages.exports.view:thinned_view")(stream, MOST_POINTS)
    return [Points(OTHER, split(stream)[0], stream)]


def points_of(data: ReportData) -> list[Points]:
    """Return the points of the night's results, in the order of the stages: the product's come first."""
    streams = ((stage.name, data.drawing(Task(stage.name), "view")) for stage in STAGES)
    return [Points(name, split(stream)[0], stream) for name, stream in streams if stream]


def split(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON head of a stream, and the bytes after it."""
    (length,) = struct.unpack_from("<I", data)
    return json.loads(data[4 : 4 + length]), data[4 + length :]


def large_pictures(data: ReportData, bytes_left: int) -> list[tuple[int, str, str]]:
    """Return the night's pictures at full size: the camera's number in the page, their data, and a note about the keypoints.

    The data are three words of Base64 ("-" for none): the JPEG, keypoints, and inliers; points are pairs of unsigned 16-bit
    numbers, as shares of width and height.  `bytes_left` limits their size in bytes; cameras with a finding have priority.
    """
    record = data.record
    in_findings = {name for finding in record.verdict.findings for name in finding.subject} if record.verdict else set()
    numbers = {camera.id: k for k, camera in enumerate(record.cameras, 1)}
    inliers = _inliers(data)
    pictures: list[tuple[int, str, str]] = []
    for camera in sorted(numbers, key=lambda name: (name not in in_findings, numbers[name])):
        frame = data.frame(camera)
        if picture := data.drawing(frame, "large"):
            view = frame.subject[0]
            marks = _keypoints(data, view), inliers.get(view, b"")
            encoded = " ".join(base64.b64encode(part).decode() or "-" for part in (picture, *marks))
            if len(encoded) > bytes_left:
                break
            bytes_left -= len(encoded)
            pictures.append((numbers[camera], encoded, _keypoint_note(data, frame) if any(marks) else ""))
    return sorted(pictures)


def _keypoints(data: ReportData, view: str) -> bytes:
    drawings = (
        data.drawing(Task(stage.name, (view,)), "marks")
        for stage in STAGES
        if "marks" in stage.products.drawings and stage.scope == "camera"
    )
    return b"".join(filter(None, drawings))


def _inliers(data: ReportData) -> Mapping[str, bytes]:
    """Return the inliers of each view; the first half of a pair's inliers is in the left image, the second in the right one."""
    inliers: dict[str, bytes] = defaultdict(bytes)
    for stage in (stage for stage in STAGES if "marks" in stage.products.drawings and stage.scope == "pair"):
        for pair in data.record.pairs:
            pair_inliers = data.drawing(Task(stage.name, (pair.left, pair.right)), "marks") or b""
            inliers[pair.left] += pair_inliers[: len(pair_inliers) // 2]
            inliers[pair.right] += pair_inliers[len(pair_inliers) // 2 :]
    return inliers


def _keypoint_note(data: ReportData, frame: Task) -> str:
    """Return a note if the keypoints come from the reference's picture, as they do for a camera that has not moved; else ""."""
    cache = data.cache
    frame_receipt = cache.by_key(frame, data.keys[frame])
    for stage in STAGES:
        task = Task(stage.name, frame.subject)
        receipt = cache.by_key(task, data.keys[task]) if "marks" in stage.products.drawings and task in data.keys else None
        if receipt and frame_receipt and frame_receipt.digest not in receipt.preimage.inputs.values():
            night_note = f" of {data.reference_date}" if data.reference_date else ""
            return f"found in the reference's picture{night_note}: the camera has not moved"
    return ""


def _to_unit(camera: Mapping[str, Any]) -> Matrix:
    K, width, height = camera["K"], camera["width"], camera["height"]
    return [[value / width for value in K[0]], [value / height for value in K[1]], [0.0, 0.0, 1.0]]


def _from_unit(camera: Mapping[str, Any]) -> Matrix:
    K, width, height = camera["K"], camera["width"], camera["height"]
    return [[width / K[0][0], 0.0, -K[0][2] / K[0][0]], [0.0, height / K[1][1], -K[1][2] / K[1][1]], [0.0, 0.0, 1.0]]


def _project(rows: Matrix, x: float, y: float) -> tuple[float, float]:
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in rows)
    return u / w, v / w
