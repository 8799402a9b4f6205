"""A run's folder: put together under another name, then renamed; `runs/latest` never shows half a run."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..night.night import Night
from ..night.plan import Plan
from ..store import artifact
from ..store.atomic import sync_folder, write_atomic
from ..store.ply import with_comments
from ..task import Task


@dataclass(frozen=True)
class Publication:
    """The products of a run, read back from the cache and found intact: clouds (PLY, by file name) and cameras (JSON)."""

    clouds: dict[str, bytes] = field(default_factory=dict)
    cameras: str | None = None

    @staticmethod
    def collect(plan: Plan) -> Publication:
        """Raises DamagedArtifact."""
        clouds = {cloud_file(task): _bytes(plan, task) for task in plan.states if task.stage == "fuse"}
        found = {name: data for name, data in clouds.items() if data is not None}
        solved = _bytes(plan, Task("poses", ()))
        poses = None if solved is None else artifact.decode(solved)
        if poses is not None and poses.crs and "cloud.ply" in found:
            found["cloud.ply"] = with_comments(found["cloud.ply"], place_comments(poses.crs))
        return Publication(found, None if poses is None else cameras_json(poses))


def cloud_file(task: Task) -> str:
    """The file of a component's cloud in a run's folder: cloud.ply for the main one."""
    return f"cloud{''.join(f'-{name}' for name in task.subject)}.ply"


def place_comments(crs: str) -> tuple[str, ...]:
    """Where on Earth the coordinates of a cloud begin: its coordinate system as PROJ reads it, and the origin in words."""
    named = dict(word.lstrip("+").split("=", 1) for word in crs.split() if "=" in word)
    if not {"lat_0", "lon_0", "h_0"} <= set(named):
        return (f"crs {crs}",)
    origin = f"latitude {named['lat_0']} longitude {named['lon_0']} height {named['h_0']}"
    return f"crs {crs}", f"x y z are metres east, north and up of {origin} (WGS 84)"


def cameras_json(poses: Any) -> str:
    """Cameras of the main component in the form that `calibration:` reads, for captures as they are."""
    entries = {name: _entry(camera, poses.metric) for name, camera in poses.cameras.items() if camera.component == 0}
    return json.dumps(entries, indent=1)


def _entry(camera: Any, metric: bool) -> dict[str, Any]:
    """One camera: K and size of its captures, and the distortion that is in them, whether it was known or solved."""
    width, height = camera.captured_width or camera.width, camera.captured_height or camera.height
    K = camera.K.tolist()
    for row, scale in ((0, width / camera.width), (1, height / camera.height)):
        # pixel centres are whole numbers, so the principal point moves by half a pixel
        K[row] = [K[row][0] * scale, K[row][1] * scale, (K[row][2] + 0.5) * scale - 0.5]
    entry = {"K": K, "R": camera.R.tolist(), "C": camera.C.tolist(), "width": width, "height": height}
    distortion = camera.distortion.tolist()
    if not any(distortion):
        distortion = [*camera.radial, 0.0, 0.0, 0.0]
    return entry | ({"distortion": distortion} if any(distortion) else {}) | ({} if metric else {"metric": False})


def publish(night: Night, record: dict[str, Any], events: list[dict[str, Any]], products: Publication) -> Path:
    """Write runs/<id>/ and, when there is a cloud, point runs/latest at it."""
    runs = night.site.work / "runs"
    name = str(record["run"])
    folder, final = runs / f".{name}.tmp", runs / name
    folder.mkdir(parents=True)
    for cloud, data in products.clouds.items():
        write_atomic(folder / cloud, data)
    if products.cameras is not None:
        write_atomic(folder / "cameras.json", products.cameras.encode())
    write_atomic(folder / "log.jsonl", "".join(json.dumps(event) + "\n" for event in events).encode())
    write_atomic(folder / "run.json", json.dumps(record, indent=1).encode())
    try:
        from .report.page import build_report

        write_atomic(folder / "report.html", build_report(night.site.work, folder).encode())
    except Exception as error:  # the night's work is done: a report that cannot be drawn must not lose it
        write_atomic(folder / "report.html", f"<!doctype html><title>wbflow</title><p>No report: {error!r}".encode())
    folder.rename(final)
    sync_folder(runs)
    if "cloud.ply" in products.clouds:
        link = runs / ".latest.tmp"
        link.unlink(missing_ok=True)
        link.symlink_to(final.name)
        link.replace(runs / "latest")
        sync_folder(runs)
    (night.site.work / "cache" / ".writing").unlink(missing_ok=True)
    return final


def _bytes(plan: Plan, task: Task) -> bytes | None:
    state = plan.states.get(task)
    if state is None or not state.usable or state.receipt is None:
        return None
    return plan.cache.read(str(task), plan.cache.path(state.receipt), state.receipt.digest)
