"""A synthetic run, with a ring of cameras around a bowl, for tests of its report page."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from wbflow.api import load_site
from wbflow.cache.checksum import content_digest
from wbflow.cache.layout import WorkFolder
from wbflow.cache.receipt import Preimage, Receipt
from wbflow.cache.store import Cache
from wbflow.pipeline.stages import CHANGES, FRAMES, FUSE, GEOMETRY, OBSERVED, STAGES
from wbflow.pipeline.summaries import CameraFigures, PairFigures, PosesSummary
from wbflow.records.events import Event, TaskEvent
from wbflow.records.findings import Finding, Verdict
from wbflow.records.record import CameraRecord, CloudRecord, PairRecord, RunRecord, Seconds, TaskCounts
from wbflow.records.run_folder import UnfinishedRun
from wbflow.report.data import ReportData
from wbflow.report.page import build_report
from wbflow.site.models import Site
from wbflow.task import Task
from wbflow_stages.contracts.camera_figures import Health
from wbflow_stages.exports.view import cloud_view
from wbflow_stages.types import Cloud

RUN = "20261210T031500Z"
KEY = "0" * 32
"""Cache key of every result of the night."""
_RADIUS = 12.0


def names(count: int) -> list[str]:
    return [f"cam-{k + 1}" for k in range(count)]


def cameras(ids: list[str]) -> dict[str, Any]:
    """Cameras on half a ring that look at its centre, in the format of cameras.json."""
    found = {}
    for k, name in enumerate(ids):
        angle = math.pi * (1 + k / max(1, len(ids) - 1))  # the southern half
        C = np.array([_RADIUS * math.cos(angle), _RADIUS * math.sin(angle), 5.0])
        ahead = -C / np.linalg.norm(C)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = [right.tolist(), np.cross(ahead, right).tolist(), ahead.tolist()]
        K = [[500.0, 0, 320.0], [0, 500.0, 180.0], [0, 0, 1.0]]
        found[name] = {"K": K, "R": R, "C": C.tolist(), "width": 640, "height": 360}
    return found


def bowl(points: int) -> Cloud:
    """A wavy disk with many colours."""
    rng = np.random.default_rng(7)
    r, a = 8 * np.sqrt(rng.random(points)), 2 * math.pi * rng.random(points)
    x, y = r * np.cos(a), r * np.sin(a)
    z = 0.02 * r**2 + 0.6 * np.sin(x) * np.cos(y)
    shades = np.stack([120 + 10 * x, 120 + 10 * y, 100 + 60 * z], axis=1).clip(0, 255).astype(np.uint8)
    up = np.tile(np.array([0, 0, 1], np.float32), (points, 1))
    share = (r / 8).astype(np.float32)
    sure = (1 - share / 2).astype(np.float32)
    return Cloud(np.stack([x, y, z], axis=1), up, shades, sure, (2 + 6 * share).astype(np.uint16), 5 + 20 * share)


def record(ids: list[str], run: str = RUN, date: str = "2026-12-09", **changes: Any) -> RunRecord:
    """A night on which the last camera shows another place, the one before it is lost, and one pair is rejected."""
    well = CameraFigures(brightness=110.0, sharpness=0.2, keypoints=6000, frames_used=3)
    reported = [CameraRecord(name, "ok", figures=well, health=Health("ok", "where it was")) for name in ids]
    reported[-1] = replace(reported[-1], health=Health("wrong-scene", "it shows another place", remedy="look at its picture"))
    reported[-2] = CameraRecord(ids[-2], "failed", "the capture ends after 1,000 bytes")
    figures = PairFigures(matches=400, inliers=500, angle_deg=12.0, epipolar_px=0.3, density=0.5)
    steps = (1, 2, 3)
    pairs = [PairRecord(a, ids[k + s], "ok", matched=True, figures=figures) for s in steps for k, a in enumerate(ids[:-s])]
    pairs[0] = PairRecord(pairs[0].left, pairs[0].right, "rejected", "12 inliers, 30 needed", figures=PairFigures(inliers=12))
    findings = (
        Finding("camera-wrong-scene", (ids[-1],), "it shows another place", remedy="look at its picture"),
        Finding("camera-lost", (ids[-2],), "the capture ends after 1,000 bytes; left out tonight"),
        Finding("fewer-points", (), "900 points, 50 % of the usual 1,800"),
    )
    base = RunRecord(
        run,
        "bowl",
        "0.1.0",
        date,
        f"{date}T03:15:00Z",
        f"{date}T03:25:00Z",
        3,
        TaskCounts(ran=len(ids)),
        Seconds(600.0, 900.0),
        400,
        tuple(reported),
        tuple(pairs),
        CloudRecord(900, ((-8.0, -8.0, -1.0), (8.0, 8.0, 2.0)), path="cloud.ply"),
        poses=PosesSummary(),
        verdict=Verdict("degraded", findings),
    )
    return replace(base, **changes)


def site(folder: Path, ids: list[str]) -> Site:
    """A site with as many cameras as there are ids; its site file names them c0, c1, ..."""
    (folder / "captures").mkdir(parents=True, exist_ok=True)
    plain = [f"c{k}" for k in range(len(ids))]
    reported = {"site": "bowl", "captures": {"root": "captures", "pattern": "{camera}.jpg"}, "cameras": plain}
    (folder / "site.yaml").write_text(json.dumps(reported))
    return load_site(folder / "site.yaml", folder / "work")


def page(
    folder: Path,
    night: RunRecord,
    points: int = 900,
    pictures: tuple[int, int] = (160, 90),
    nights: int = 2,
    changes: bytes = b"",
    crop: bytes = b"",
    track: bytes = b"",
) -> Path:
    """Publish a night and a few nights before it in the work folder; return the file of the night's page.

    Parameters
    ----------
    folder, night : Path, RunRecord
        Where, and what.
    points, pictures, nights : int, tuple of int, int
        Number of points of the cloud, size of the pictures, and number of nights before.
    changes, crop, track : bytes
        The stream of changed points, the picture of each change (JPEG), and the stream of a track; b"" for none.
    """
    ids = [camera.id for camera in night.cameras]
    described = site(folder, ids)
    work = described.work_folder
    events: list[Event] = []
    rng = np.random.default_rng(3)
    small = rng.integers(0, 255, (9, 16, 3), dtype=np.uint8)
    jpeg = cv2.imencode(".jpg", cv2.resize(small, pictures))[1].tobytes()
    subjects: dict[str, list[tuple[str, ...]]] = {
        "camera": [(name,) for name in ids],
        "pair": [(p.left, p.right) for p in night.pairs if p.ok],
    }
    corners = b"\0\0\0\0\xff\xff\xff\xff"
    shown = [(row, of) for row in STAGES if row.products.product_files for of in subjects.get(row.scope, ())]
    for k, (row, subject) in enumerate(shown):
        every = {"picture": jpeg + bytes([k % 256, k // 256]), "large": jpeg, "marks": corners}
        events += _made(work, Task(row.name, subject), {name: every[name] for name in row.products.product_files})
    if night.cloud:
        events += _made(work, Task(FUSE), {"view": cloud_view(bowl(points))})
    if changes:
        events += _made(work, Task(CHANGES), {"view": changes})
    if track:
        events += _made(work, Task(OBSERVED), {"view": track})
    for pair in (p for p in night.pairs if not p.ok):
        tried = Task(GEOMETRY, (pair.left, pair.right))
        events.append(TaskEvent(tried, "rejected", f"{night.date}T03:17:00+00:00", reason=pair.reason))
    if night.reference:
        _publish_reference(work, night, jpeg)
    for k in range(nights):
        before = replace(night, run=f"202611{k + 1:02}T031500Z", date=f"2026-11-{k + 1:02}", verdict=Verdict("good"))
        earlier = UnfinishedRun(work, before.run)
        earlier.write_cameras(cameras(ids))
        earlier.publish(before, [], "")
    unfinished = UnfinishedRun(work, night.run)
    placed = cameras(ids) if night.cloud else {}
    for result in night.results.values():
        for name in result.files if crop else ():
            unfinished.write(name, crop)
    reported = build_report(ReportData(Cache(work), night, tuple(events), placed, unfinished.paths.folder, described))
    return unfinished.publish(night, events, reported).paths.report


def _publish_reference(work: WorkFolder, night: RunRecord, jpeg: bytes) -> None:
    """Publish the run that a night is compared with: its cloud is 2 m lower at x > 4, its first camera turned by 2 degrees."""
    ids = [camera.id for camera in night.cameras]
    whole = bowl(20_000)
    low = replace(whole, points=whole.points - [0, 0, 2] * (whole.points[:, :1] > 4))
    events = _made(work, Task(FUSE), {"view": cloud_view(low)}, "1" * 32)
    for k, name in enumerate(ids):
        events += _made(work, Task(FRAMES, (name,)), {"picture": jpeg + bytes([k % 256, 255])}, "1" * 32)
    placed = cameras(ids)
    R, angle = np.array(placed[ids[0]]["R"]), math.radians(2.0)
    turn = np.array([[math.cos(angle), 0, -math.sin(angle)], [0, 1, 0], [math.sin(angle), 0, math.cos(angle)]])
    placed[ids[0]]["R"] = (turn @ R).tolist()
    unfinished = UnfinishedRun(work, str(night.reference))
    unfinished.write_cameras(placed)
    unfinished.publish(replace(night, run=str(night.reference), date="2026-10-31", reference=None), events, "")


def _made(work: WorkFolder, task: Task, product_files: dict[str, bytes], key: str = KEY) -> list[Event]:
    """Store the product files of a task's result, but not the result itself; return its events."""
    digests = {name: content_digest(data) for name, data in product_files.items()}
    receipt = Receipt(str(task), key, "ran", Preimage(*task, "", "", {}, {}), "", product_files=digests)
    Cache(work).write(receipt, None, product_files)
    return [TaskEvent(task, "ran", f"{RUN[:8]}T03:20:00+00:00", key=key)]
