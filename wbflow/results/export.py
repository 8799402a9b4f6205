"""A finished run's results in the forms that other programs read; from the run's folder and the cache, nothing is run again."""

from __future__ import annotations

import datetime
import importlib.util
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..store import artifact
from ..store.atomic import write_atomic
from ..store.cache import Cache, Receipt
from ..store.ply import read_ply
from ..task import Task

FORMS = ("laz", "heights", "depth", "mesh", "colmap")
"""What can be asked for; the names of the command's options."""

EXTRAS = {"las": ("laspy", "lazrs", "pyproj"), "geo": ("rasterio", "pyproj")}
"""Packages of the extras that exports may need."""


class MissingExtra(Exception):
    """Packages that an export needs are not installed; the message says how to get them."""


class NothingToExport(Exception):
    """The run does not hold what was asked for; the message says what is missing."""


@dataclass(frozen=True)
class FinishedRun:
    """What a run left: its folder, its record, the cache, and the key of each task that gave a result."""

    folder: Path
    record: dict[str, Any]
    cache: Cache
    keys: dict[Task, str]

    @staticmethod
    def open(work: Path, folder: Path) -> FinishedRun:
        """The run in `folder`.  Raises OSError, ValueError."""
        record = json.loads((folder / "run.json").read_text())
        events = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
        useful = [e for e in events if e.get("event") == "task" and e["key"] and e["outcome"] in {"ran", "cached"}]
        keys = {Task(e["stage"], tuple(e["subject"])): str(e["key"]) for e in useful}
        return FinishedRun(folder, record, Cache(work / "cache"), keys)

    def receipt(self, task: Task) -> Receipt | None:
        """The receipt of a task that gave a result in this run, or None."""
        key = self.keys.get(task)
        receipt = self.cache.by_key(task.stage, task.subject, key) if key else None
        if key and receipt is None:
            raise NothingToExport(f"the cache no longer holds '{task}' of run {self.folder.name}: run the night again")
        return receipt if receipt and receipt.file else None

    def load(self, task: Task) -> Any:
        """The artifact of a task, or None where it gave none.  Raises NothingToExport, DamagedArtifact."""
        receipt = self.receipt(task)
        return receipt and artifact.decode(self.cache.read(str(task), self.cache.path(receipt), receipt.digest))

    def cloud(self) -> Any:
        """The cloud of the main component.  Raises NothingToExport."""
        from wbflow_stages.types import Cloud

        path = self.folder / "cloud.ply"
        if not path.is_file():
            raise NothingToExport(f"run {self.folder.name} made no cloud: {self.record.get('reason') or 'it was not asked to'}")
        try:
            columns = read_ply(path)
        except ValueError as error:
            raise NothingToExport(f"{error}: run the night again") from None
        xyz, normals = _columns(columns, "x", "y", "z"), _columns(columns, "nx", "ny", "nz")
        colors = _columns(columns, "red", "green", "blue")
        return Cloud(xyz, normals, colors, columns["confidence"], columns["views"], columns["sigma_mm"])


def export(work: Path, folder: Path, out: Path, forms: frozenset[str]) -> Iterator[Path]:
    """Write a run's results into `out` in the forms asked for; yields each file when it is there.

    Raises
    ------
    MissingExtra, NothingToExport
        Before a file of that form is written.
    DamagedArtifact
        The cache's disk has lost something; the next run makes it again.
    """
    run = FinishedRun.open(work, folder)
    poses = run.load(Task("poses", ()))
    if poses is None:
        raise NothingToExport(f"run {folder.name} solved no cameras: {run.record.get('reason') or 'it ended before'}")
    require(forms, georeferenced=bool(poses.crs))
    makers = {"laz": _laz, "heights": _heights, "depth": _depth, "mesh": _mesh, "colmap": _colmap}
    for form in FORMS:
        if form in forms:
            for name, data in makers[form](run, poses):
                write_atomic(out / name, data)
                yield out / name


def require(forms: frozenset[str], *, georeferenced: bool) -> None:
    """See that the packages that these forms need are installed.  Raises MissingExtra."""
    needed = {"--laz": "las"} if "laz" in forms else {}
    needed |= {"--heights of a georeferenced site": "geo"} if "heights" in forms and georeferenced else {}
    for what, extra in needed.items():
        missing = [package for package in EXTRAS[extra] if importlib.util.find_spec(package) is None]
        if missing:
            raise MissingExtra(f"{what} needs {' and '.join(missing)}: pip install 'wbflow[{extra}]'")


def _laz(run: FinishedRun, poses: Any) -> Iterator[tuple[str, bytes]]:
    from wbflow_stages.exports.las import laz_bytes

    day = datetime.date.fromisoformat(run.record["date"])
    yield "cloud.laz", laz_bytes(run.cloud(), day, _georeference(poses))


def _heights(run: FinishedRun, poses: Any) -> Iterator[tuple[str, bytes]]:
    from wbflow_stages.exports.heights import geotiff, height_map, plain_files

    points = run.cloud().points.astype("f8")
    georeference = _georeference(poses)
    if georeference is not None:
        yield "heights.tif", geotiff(height_map(georeference.points(points)), georeference.epsg)
        return
    files, told = plain_files(height_map(points))
    yield from files.items()
    yield "heights.json", _json(told | {"unit": _unit(poses), "first_row": "largest y"})


def _depth(run: FinishedRun, poses: Any) -> Iterator[tuple[str, bytes]]:
    from wbflow_stages.exports.depthmaps import depth_files

    told = {}
    for name, camera in _main_cameras(poses).items():
        depth = run.load(Task("refine", (name,))) or run.load(Task("depth", (name,)))
        if depth is not None:
            files, steps = depth_files(depth)
            for suffix, data in files.items():
                yield f"depth/{name}{suffix}", data
            pinhole = {"K": camera.K.tolist(), "R": camera.R.tolist(), "C": camera.C.tolist()}
            told[name] = {"png_steps_per_unit": steps, "width": camera.width, "height": camera.height, **pinhole}
    if not told:
        raise NothingToExport(f"run {run.folder.name} made no depth of any camera")
    yield "depth/depth.json", _json({"unit": _unit(poses), "cameras": told})


def _mesh(run: FinishedRun, poses: Any) -> Iterator[tuple[str, bytes]]:
    from wbflow_stages.exports.mesh import mesh_bytes, poisson_mesh

    yield "mesh.ply", mesh_bytes(poisson_mesh(run.cloud()))


def _colmap(run: FinishedRun, poses: Any) -> Iterator[tuple[str, bytes]]:
    from wbflow_stages.exports.colmap import colmap_files
    from wbflow_stages.io.rasters import png

    cameras = _main_cameras(poses)
    for name, data in colmap_files(cameras, run.cloud()).items():
        yield f"colmap/sparse/{name}", data
    for name in cameras:
        frame = run.load(Task("frames", (name,)))
        if frame is None:
            raise NothingToExport(f"run {run.folder.name} has no frame of {name}")
        yield f"colmap/images/{name}.png", png(frame.image)


def _main_cameras(poses: Any) -> dict[str, Any]:
    return {name: camera for name, camera in poses.cameras.items() if camera.component == 0}


def _georeference(poses: Any) -> Any:
    """Where the site lies on the map, or None."""
    if not poses.crs:
        return None
    from wbflow_stages.exports.world import georeference

    try:
        return georeference(poses.crs)
    except ValueError as error:
        raise NothingToExport(str(error)) from None


def _unit(poses: Any) -> str:
    return "m" if poses.metric else "arbitrary"


def _columns(columns: Mapping[str, Any], *names: str) -> Any:
    import numpy as np

    return np.column_stack([columns[name] for name in names])


def _json(data: dict[str, Any]) -> bytes:
    return (json.dumps(data, indent=1) + "\n").encode()
