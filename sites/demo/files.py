"""A rendered scene, or nights of the yard, as the files of a demo: captures, a site file ready to run, and the ground truth."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt

from wbflow_stages.types import Cloud, Float64s

from .nights import CameraNights, Extent, NightsSite, yard_nights
from .render.cameras import VARIANTS, choose_mounts
from .render.photograph import DemoCamera, DemoSite, Shots
from .render.sensor import jpeg, png
from .scenes import SCENES, render
from .script import CONDITIONS, FOREVER, Stay, date_of, event_of, stays, turned_axes, weather_of
from .walk import MOST_CLOCK_S, SECONDS, WALKS, lamp_places, walk_recordings
from .yard import yard_texel_m


@dataclass(frozen=True)
class Points:
    """The content of a PLY file."""

    columns: Mapping[str, npt.NDArray[Any]]
    """(n,) arrays by name."""
    comments: tuple[str, ...] = ()
    """Comment lines of its header."""


File = tuple[str, bytes | Points]
"""Name and content."""


@dataclass(frozen=True)
class DemoFiles:
    """The files of a demo, before they are written."""

    manifest: Mapping[str, Any]
    """What was rendered, as JSON data; written to demo.json."""
    files: Iterator[File]


def demo_files(
    scene: str, *, small: bool = False, light: str = "day", seed: int = 0, walk: bool = False, **options: Any
) -> DemoFiles:
    """Render a scene with the arguments of `scenes.render`; the same arguments give the same bytes.

    walk: with recordings of a walk through the yard, from which its poses can be found; the site file states none.  Raises
    ValueError for the walk of another scene, or with other lenses or surfaces.
    """
    kinds = {options.get(key, "standard") for key in ("lenses", "surfaces")}
    if walk and (scene != "yard" or kinds != {"standard"}):
        raise ValueError("a walk leads through the standard yard, with its own lenses and surfaces")
    site = render(scene, small=small, light=light, seed=seed, **options)
    # the manifest names only what differs from the standard yard
    manifest: dict[str, Any] = {}
    if scene != "yard":
        manifest["scene"] = scene
    for key in ("lenses", "surfaces"):
        kind = options.get(key, "standard")
        if kind != "standard":
            manifest[key] = kind
    manifest.update(light=light, small=small, captures=len(site.cameras[0].captures), seed=seed)
    files = scene_files(site, scene, light, options.get("lenses", "standard"), has_poses=not walk)
    if walk:
        manifest["walk"] = True
        size = (site.cameras[0].lens.width, site.cameras[0].lens.height)
        files = chain(files, _walk_files(Shots(len(site.cameras), 1, size, seed)))
    return DemoFiles(manifest, files)


def scene_files(site: DemoSite, scene: str, light: str, lenses: str, has_poses: bool = True) -> Iterator[File]:
    """Yield name and content of every file of the demo; `has_poses`: the site file states them."""
    for camera in site.cameras:
        for k, image in enumerate(camera.captures):
            yield f"captures/{camera.name}/{camera.times[k]:%Y-%m-%d}_{k + 1}.jpg", jpeg(image)
        yield f"masks/{camera.name}.png", png(camera.mask)
        # along the rays of a fisheye, not along its axis: a view may reach behind the camera
        array_name = "range" if camera.lens.model == "fisheye" else "depth"
        yield f"truth/depth/{camera.name}.npz", npz_bytes(**{array_name: camera.depth})
    yield from _cameras_and_reference(site.cameras, site, {"light": light}, has_poses)
    about_lenses = ""
    if lenses != "standard":
        about_lenses = _text("lenses", lenses=VARIANTS[lenses])
    words = {"about": SCENES[scene].about, "scene": "yard" if scene == "yard" else "scene", "also": about_lenses}
    readme = _text("readme", **words)
    if not has_poses:
        readme += _text("walk")
    yield "README.txt", readme.encode()
    site_file = _site_file(scene, site.cameras, f"{site.cameras[0].times[0]:%Y-%m-%d}_1.jpg")
    if lenses == "brown":
        site_file += _text("whole_field")
    yield "site.yaml", site_file.encode()


GPS_SIGMA_M = 0.02
"""Standard deviation of a coordinate of the receiver that is carried with the lamp."""
GPS_STEP = 5
"""Tenths of a second between its places."""


def _walk_files(shots: Shots) -> Iterator[File]:
    """Yield the recordings of a walk through the yard, and its truth."""
    truth: dict[str, Any] = {"unit": "m"}
    for light in WALKS:
        truth[light] = {"clock_s": {}}
    for recording in walk_recordings(shots, yard_texel_m(shots), choose_mounts(shots.cameras)):
        yield f"walk/{recording.light}/{recording.camera}.mp4", recording.video
        truth[recording.light]["clock_s"][recording.camera] = recording.clock_s
    times = np.arange(-MOST_CLOCK_S, SECONDS + MOST_CLOCK_S, 0.1)
    for k, light in enumerate(WALKS):
        rows = np.column_stack([times, lamp_places(times, light)])
        truth[light]["seconds_x_y_z"] = np.round(rows, 4).tolist()
        # the receiver on the lamp's pole
        measured = rows[:, 1:] + np.random.default_rng([shots.seed, 7, k]).normal(0, GPS_SIGMA_M, (len(rows), 3))
        yield f"walk/{light}.csv", _survey_table(times[::GPS_STEP], measured[::GPS_STEP])
    yield "truth/walk.json", json_bytes(truth)


def _survey_table(times: Float64s, places: Float64s) -> bytes:
    """Return a table for `survey:` of places (n, 3), metres, at times (n,), seconds."""
    lines = ["time,x,y,z,sigma"]
    for time, (x, y, z) in zip(times.tolist(), places.tolist(), strict=True):
        lines.append(f"{time:.1f},{x:.3f},{y:.3f},{z:.3f},{GPS_SIGMA_M}")
    return ("\n".join(lines) + "\n").encode()


def _cameras_and_reference(
    cameras: Sequence[DemoCamera], site: DemoSite | NightsSite, taken: dict[str, Any], has_poses: bool = True
) -> Iterator[File]:
    """Yield the calibration (of the site, perhaps without poses, and true), and the reference cloud with its summary."""
    truth = {camera.name: calibration_of(camera) for camera in cameras}
    stated = {}
    for name, entry in truth.items():
        stated[name] = {key: value for key, value in entry.items() if has_poses or key not in ("R", "C")}
    yield "cameras.json", json_bytes(stated)
    yield "truth/cameras.json", json_bytes(truth)
    yield "truth/reference.ply", reference_points(site.reference, site.voxel_m)
    summary = {"points": len(site.reference.points), "voxel_m": site.voxel_m, "seen_by_at_least": 2, "unit": "m"}
    yield "truth/reference.json", json_bytes(summary | taken)


def calibration_of(camera: DemoCamera) -> dict[str, Any]:
    """Return a camera's entry in cameras.json."""
    assert camera.lens.K is not None
    lens = camera.lens
    entry: dict[str, Any] = {"width": lens.width, "height": lens.height, "K": camera.lens.K.tolist()}
    if lens.model != "brown":
        entry["model"] = lens.model
    entry["distortion"] = lens.distortion.tolist()
    entry["R"] = camera.camera.R.tolist()
    entry["C"] = camera.camera.C.tolist()
    return entry


def reference_points(cloud: Cloud, voxel_m: float) -> Points:
    """Return the content of truth/reference.ply."""
    names = ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "views")
    arrays = (*cloud.points.T, *cloud.normals.T, *cloud.colors.T, cloud.views)
    columns = dict(zip(names, arrays, strict=True))
    return Points(columns, (f"surfaces that at least two cameras see, one point per {voxel_m:g} m",))


def npz_bytes(**arrays: Any) -> bytes:
    """Return an npz file of arrays."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def json_bytes(data: dict[str, Any]) -> bytes:
    """Return a JSON file."""
    return (json.dumps(data, indent=1) + "\n").encode()


def _site_file(scene: str, cameras: Sequence[DemoCamera], example: str) -> str:
    """Return the site file of a demo; `example`: the name of a capture."""
    rows = "\n".join(f"  - {{id: {camera.name}, mask: masks/{camera.name}.png}}" for camera in cameras)
    low, high = SCENES[scene].angles_deg
    return _text("site", scene=scene, cameras=rows, example=example, low=low, high=high)


def _text(name: str, **words: Any) -> str:
    """Return a text of `texts/` with its placeholders filled in."""
    file = resources.files(__package__) / "texts" / f"{name}.txt"
    return file.read_text(encoding="utf-8").format(**words)


NIGHT_SMALL = (320, 180)
"""Width and height of the small captures of demo nights, pixels."""

NIGHT_LARGE = (640, 360)
"""Width and height of the usual ones."""


def demo_nights(nights: int, *, frames: int = 3, small: bool = False, cameras: int | None = None, seed: int = 0) -> DemoFiles:
    """Render nights of the yard, with `frames` captures per camera and night; the same arguments give the same bytes.

    small: 320 x 180 pixels instead of 640 x 360, and 4 cameras by default.  Raises ValueError for impossible numbers.
    """
    count = cameras or (SCENES["yard"].small_cameras if small else None) or 8
    size = NIGHT_SMALL if small else NIGHT_LARGE
    site = yard_nights(nights, Shots(count, frames, size, seed))
    manifest = {"nights": nights, "frames": frames, "small": small, "cameras": count, "seed": seed}
    return DemoFiles(manifest, _night_files(site, nights))


def _night_files(site: NightsSite, nights: int) -> Iterator[File]:
    """Yield name and content of every file of demo nights."""
    for each in site.cameras:
        name = each.camera.name
        for frames in each.frames:
            for time, data in frames:
                yield f"captures/{name}/{time:%Y-%m-%d_%H%M%S}.jpg", data
        yield f"masks/{name}.png", png(each.camera.mask)
        for epoch, depth in each.depths.items():
            yield f"{_depth_folder(epoch)}/{name}.npz", npz_bytes(depth=depth)
    cameras = [each.camera for each in site.cameras]
    yield from _cameras_and_reference(cameras, site, {"night": 1})
    truth = [_night(site, number) for number in range(1, nights + 1)]
    size = {"width": cameras[0].lens.width, "height": cameras[0].lens.height}
    yield "truth/nights.json", json_bytes({"unit": "m", **size, "nights": truth})
    yield "README.txt", _text("nights").encode()
    yield "site.yaml", _site_file("yard", cameras, "2026-11-10_140211.jpg").encode()


def _depth_folder(epoch: int) -> str:
    """Return the folder of the true depths that are valid from a night on."""
    return "truth/depth" if epoch == 1 else f"truth/depth-from-{epoch}"


def _night(site: NightsSite, number: int) -> dict[str, Any]:
    """Return the ground truth of a night, for truth/nights.json."""
    epoch = max(first for first in site.cameras[0].depths if first <= number)
    return {
        "night": number,
        "date": date_of(number).isoformat(),
        "light": weather_of(number),
        "rain": CONDITIONS[weather_of(number)].rain,
        "depth": _depth_folder(epoch),
        "cameras": {each.camera.name: _camera(each, number) for each in site.cameras},
        "changes": list(_changes(number, site.extents)),
    }


STATES = {
    "none": "ok",
    "turned": "moved",
    "nudged": "shifted",
    "covered": "obscured",
    "frozen": "stale",
    "foreign": "wrong-scene",
}
"""The state in which a camera should be found, by its event."""


def _camera(each: CameraNights, number: int) -> dict[str, Any]:
    """Return the ground truth of a camera on a night."""
    event = event_of(number, each.camera.name)
    K = each.camera.camera.K
    turn = turned_axes(event, float(K[0, 0]))
    # the nominal optical axis in the camera's present axes
    x, y, z = turn[:, 2].tolist()
    angles = {
        "angle_deg": np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)),
        "pan_deg": np.arctan2(-x, z),
        "tilt_deg": np.arctan2(y, np.hypot(x, z)),
    }
    return {
        "event": event.what,
        "state": STATES[event.what],
        **{name: round(float(np.degrees(angle)), 6) + 0.0 for name, angle in angles.items()},
        "shift_px": [round(float(K[0, 0] * x / z), 4) + 0.0, round(float(K[1, 1] * y / z), 4) + 0.0],
        "R": (turn @ each.camera.camera.R).tolist(),
    }


def _changes(number: int, extents: dict[str, Extent]) -> Iterator[dict[str, Any]]:
    """Yield the differences between the yard on a night and on the first night, without traffic."""
    before = stays(1)
    now = stays(number)
    for name, extent in extents.items():
        old = before.get(name)
        new = now.get(name)
        if old == new:
            continue
        if old is None:
            kind = "appeared"
        elif new is None:
            kind = "vanished"
        else:
            kind = "moved"
        if new:
            since = new.first
        else:
            last_seen = max(night for night in range(1, number) if name in stays(night))
            since = last_seen + 1
        change: dict[str, Any] = {
            "name": name,
            "kind": kind,
            "since": since,
            "size": [round(value, 3) for value in extent.size],
            "volume_m3": round(extent.volume_m3, 3),
        }
        if old:
            change["from"] = _place(old, extent)
        if new:
            change["to"] = _place(new, extent)
        yield change


def _place(stay: Stay, extent: Extent) -> dict[str, Any]:
    """Return where a thing is, by its middle, and for which nights."""
    return {
        "position": [*stay.at, round(extent.size[2] / 2, 3)],
        "yaw_deg": round(float(np.degrees(stay.yaw)), 3),
        "nights": [stay.first, None if stay.last == FOREVER else stay.last],
    }
