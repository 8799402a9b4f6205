"""A rendered scene, or nights of the yard, as the files of a demo: captures, a site file that works as it is, and the truth."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from wbflow_stages.types import Cloud

from .nights import CameraNights, Extent, NightsSite, yard_nights
from .render.cameras import VARIANTS
from .render.photograph import DemoCamera, DemoSite, Shots
from .render.sensor import jpeg, png
from .scenes import SCENES, render
from .script import FOREVER, Stay, date_of, event_of, hour_of, stays, weather_of


@dataclass(frozen=True)
class Points:
    """The content of a PLY file."""

    columns: Mapping[str, npt.NDArray[Any]]
    """(n,) arrays by name."""
    comments: tuple[str, ...] = ()
    """Lines for its header."""


@dataclass(frozen=True)
class DemoFiles:
    """A demo, before it is written."""

    manifest: Mapping[str, Any]
    """What was rendered (JSON data): demo.json holds it."""
    files: Iterator[tuple[str, bytes | Points]]
    """Name and content of every file."""


def demo_files(scene: str, *, small: bool = False, light: str = "day", seed: int = 0, **options: Any) -> DemoFiles:
    """Render a scene; the same arguments, which are those of `scenes.render`, give the same bytes."""
    site = render(scene, small=small, light=light, seed=seed, **options)
    kinds = {key: kind for key in ("lenses", "surfaces") if (kind := options.get(key, "standard")) != "standard"}
    which = ({} if scene == "yard" else {"scene": scene}) | kinds
    manifest = {**which, "light": light, "small": small, "captures": len(site.cameras[0].captures), "seed": seed}
    return DemoFiles(manifest, _files(site, scene, light, kinds.get("lenses", "standard")))


def _files(site: DemoSite, scene: str, light: str, lenses: str) -> Iterator[tuple[str, bytes | Points]]:
    """Yield name and content of every file of the demo."""
    for camera in site.cameras:
        for k, image in enumerate(camera.captures):
            yield f"captures/{camera.name}/{camera.times[k]:%Y-%m-%d}_{k + 1}.jpg", jpeg(image)
        yield f"masks/{camera.name}.png", png(camera.mask)
        truth = {"range" if camera.lens.model == "fisheye" else "depth": camera.depth}
        yield f"truth/depth/{camera.name}.npz", npz_bytes(**truth)
    yield from _cameras_and_reference(site.cameras, site.reference, site.voxel_m, {"light": light})
    row = SCENES[scene]
    words = {"about": row.about, "scene": "yard" if scene == "yard" else "scene", "lenses": VARIANTS[lenses]}
    readme = _README.format(**words, also=_LENSES.format(**words) if lenses != "standard" else "")
    yield "README.txt", readme.encode()
    about = _CAPTURES.format(night=f"{site.cameras[0].times[0]:%Y-%m-%d}")
    cameras = [camera.name for camera in site.cameras]
    file = site_file(scene, cameras, "{camera}/{date:%Y-%m-%d}_*.jpg", about, row.angles_deg)
    yield "site.yaml", (file + (_WHOLE_FIELD if lenses == "brown" else "")).encode()


def _cameras_and_reference(
    cameras: Sequence[DemoCamera], reference: Cloud, voxel_m: float, taken: dict[str, Any]
) -> Iterator[tuple[str, bytes | Points]]:
    """Yield the calibration, twice, and the reference cloud with its summary."""
    calibration = json_bytes({camera.name: calibration_of(camera) for camera in cameras})
    yield "cameras.json", calibration
    yield "truth/cameras.json", calibration
    yield "truth/reference.ply", reference_points(reference, voxel_m)
    summary = {"points": len(reference.points), "voxel_m": voxel_m, "seen_by_at_least": 2, "unit": "m"}
    yield "truth/reference.json", json_bytes(summary | taken)


def calibration_of(camera: DemoCamera) -> dict[str, Any]:
    """Return a camera's entry in cameras.json."""
    assert camera.lens.K is not None
    return {
        "width": camera.lens.width,
        "height": camera.lens.height,
        "K": camera.lens.K.tolist(),
        **({} if camera.lens.model == "brown" else {"model": camera.lens.model}),
        "distortion": camera.lens.distortion.tolist(),
        "R": camera.camera.R.tolist(),
        "C": camera.camera.C.tolist(),
    }


def reference_points(cloud: Cloud, voxel_m: float) -> Points:
    """Return the content of truth/reference.ply."""
    columns = {
        **dict(zip(("x", "y", "z"), cloud.points.T, strict=True)),
        **dict(zip(("nx", "ny", "nz"), cloud.normals.T, strict=True)),
        **dict(zip(("red", "green", "blue"), cloud.colors.T, strict=True)),
        "views": cloud.views,
    }
    return Points(columns, (f"surfaces that at least two cameras see, one point per {voxel_m:g} m",))


def npz_bytes(**arrays: Any) -> bytes:
    """Return an npz file of arrays."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def json_bytes(data: dict[str, Any]) -> bytes:
    """Return a JSON file."""
    return (json.dumps(data, indent=1) + "\n").encode()


def site_file(scene: str, cameras: Sequence[str], pattern: str, about: str, angles_deg: tuple[float, float]) -> str:
    """Return the site file of a demo."""
    rows = "\n".join(f"  - {{id: {camera}, mask: masks/{camera}.png}}" for camera in cameras)
    low, high = angles_deg
    return _SITE.format(scene=scene, cameras=rows, about=about, pattern=pattern, low=low, high=high)


_CAPTURES = """\
# One folder for each camera, several captures a night ({night}_1.jpg, ...): what moves between them is removed."""

_SITE = """\
# The demo {scene}.  Try:  wbflow check site.yaml   wbflow run site.yaml   wbflow status site.yaml
site: {scene}

{about}
captures:
  root: captures
  pattern: "{pattern}"

# Every camera burns a clock into its picture; the masks (black: ignore) keep it out.
cameras:
{cameras}

# Intrinsics, lens distortion and poses in metres.  Without R and C in it, poses are solved.
calibration: cameras.json

# Long side in pixels that stages work at; null: as captured.
resolution: null

# Which pairs are worth matching: angles in degrees between the views.
pairs: {{degree: 4, min_angle: {low:g}, max_angle: {high:g}}}
"""

_WHOLE_FIELD = """
# Frames as wide as the lenses see, rather than what has place with their own K.
stages: {frames: {whole_field: true}}
"""

_LENSES = """\
Its cameras: {lenses}.
Of a fisheye (k1 k2 k3 k4), truth/depth has the key 'range': metres along the ray of each pixel of a capture.

"""

_README = """\
The demo site of wbflow: {about}, rendered with exact truth.

site.yaml           the site description: wbflow run site.yaml
captures/           what the cameras wrote: lens distortion, sensor noise, a burned-in clock, people and vehicles
masks/              black where the clock is
cameras.json        intrinsics, distortion (k1 k2 p1 p2 k3) and poses: x ~ K R (X - C), metres, z up
truth/depth/        key 'depth': float32, metres along the optical axis, of the empty {scene} in the undistorted view with
                    the same K; 0: sky or water
truth/cameras.json  the same as cameras.json, for when you change that one
truth/reference.ply surfaces that at least two cameras see; truth/reference.json says how finely
demo.json           what was rendered, and the digest of every file

{also}Delete R and C in cameras.json to see the poses solved; compare with truth/cameras.json.
"""


NIGHT_SMALL, NIGHT_LARGE = (320, 180), (640, 360)


def demo_nights(nights: int, *, frames: int = 3, small: bool = False, cameras: int | None = None, seed: int = 0) -> DemoFiles:
    """Render nights of the yard, with so many frames of each camera and night; the same arguments give the same bytes.

    small: 320 x 180 pixels instead of 640 x 360, and 4 cameras.  Raises ValueError for impossible numbers.
    """
    count = cameras or (SCENES["yard"].small_cameras if small else None) or 8
    size = NIGHT_SMALL if small else NIGHT_LARGE
    site = yard_nights(nights, Shots(count, frames, size, seed))
    manifest = {"nights": nights, "frames": frames, "small": small, "cameras": count, "seed": seed}
    return DemoFiles(manifest, _night_files(site, nights))


def _night_files(site: NightsSite, nights: int) -> Iterator[tuple[str, bytes | Points]]:
    """Yield name and content of every file of demo nights."""
    for each in site.cameras:
        name = each.camera.name
        for night in each.nights:
            for time, data in night.frames:
                yield f"captures/{name}/{time:%Y-%m-%d_%H%M%S}.jpg", data
        yield f"masks/{name}.png", png(each.camera.mask)
        for epoch, depth in each.depths.items():
            yield f"{_depth_folder(epoch)}/{name}.npz", npz_bytes(depth=depth)
    yield from _cameras_and_reference([each.camera for each in site.cameras], site.reference, site.voxel_m, {"night": 1})
    width, height = site.cameras[0].camera.lens.width, site.cameras[0].camera.lens.height
    truth = [_night(site, number) for number in range(1, nights + 1)]
    yield "truth/nights.json", json_bytes({"unit": "m", "width": width, "height": height, "nights": truth})
    yield "README.txt", _NIGHTS_README.encode()
    cameras = [each.camera.name for each in site.cameras]
    pattern = "{camera}/{date:%Y-%m-%d}_*.jpg"
    yield "site.yaml", site_file("yard", cameras, pattern, _NIGHTS_CAPTURES, SCENES["yard"].angles_deg).encode()


def _depth_folder(epoch: int) -> str:
    return "truth/depth" if epoch == 1 else f"truth/depth-from-{epoch}"


def _night(site: NightsSite, number: int) -> dict[str, Any]:
    """Return the truth of a night, for truth/nights.json."""
    epoch = max(first for first in site.cameras[0].depths if first <= number)
    return {
        "night": number,
        "date": date_of(number).isoformat(),
        "light": weather_of(number),
        "rain": hour_of(weather_of(number)).rain,
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
"""The state that a camera should be found in, by what happened to it."""


def _camera(each: CameraNights, number: int) -> dict[str, Any]:
    """Return the truth of a camera's night."""
    event, turn = event_of(number, each.camera.name), each.nights[number - 1].turn
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) if event.what in ("turned", "nudged") else 0.0
    # where the point that the axis met is seen now
    ahead = turn @ np.array([0, 0, 1.0])
    K = each.camera.camera.K
    shift = [round(float(K[k, k] * ahead[k] / ahead[2]), 4) for k in range(2)]
    return {
        "event": event.what,
        "state": STATES[event.what],
        "angle_deg": round(float(angle), 6),
        "pan_deg": round(float(np.degrees(np.arctan2(-ahead[0], ahead[2]))), 6) + 0.0,
        "tilt_deg": round(float(np.degrees(np.arctan2(ahead[1], np.hypot(ahead[0], ahead[2])))), 6) + 0.0,
        "shift_px": [value + 0.0 for value in shift],
        "R": (turn @ each.camera.camera.R).tolist(),
    }


def _changes(number: int, extents: dict[str, Extent]) -> Iterator[dict[str, Any]]:
    """Yield the differences of a night's yard to that of the first, besides what moves from frame to frame."""
    before, now = stays(1), stays(number)
    for name, extent in extents.items():
        old, new = before.get(name), now.get(name)
        if old == new:
            continue
        kind = "appeared" if old is None else "vanished" if new is None else "moved"
        since = new.first if new else 1 + max(night for night in range(1, number) if name in stays(night))
        yield {
            "name": name,
            "kind": kind,
            "since": since,
            "size": [round(value, 3) for value in extent.size],
            "volume_m3": round(extent.volume_m3, 3),
            **({"from": _place(old, extent)} if old else {}),
            **({"to": _place(new, extent)} if new else {}),
        }


def _place(stay: Stay, extent: Extent) -> dict[str, Any]:
    return {
        "position": [*stay.at, round(extent.size[2] / 2, 3)],
        "yaw_deg": round(float(np.degrees(stay.yaw)), 3),
        "nights": [stay.first, None if stay.last == FOREVER else stay.last],
    }


_NIGHTS_CAPTURES = """\
# One folder for each camera, several captures a night (2026-11-10_140211.jpg, ...): what moves between them is removed."""

_NIGHTS_README = """\
The demo nights of wbflow: a harbour yard, rendered with exact truth, night after night.

site.yaml           the site description: wbflow run site.yaml --since 2026-11-10
captures/           what the cameras wrote: other light every night, people and vehicles, lens distortion, noise, a clock
masks/              black where the clock is
cameras.json        intrinsics, distortion (k1 k2 p1 p2 k3) and poses as they should be: x ~ K R (X - C), metres, z up
truth/nights.json   for every night: light; of every camera its event, the state that it ought to be found in, and its true R;
                    `changes` against the first night: boxes that appeared, vanished or moved. position: the middle of the
                    box; size: length, width, height at yaw_deg; volume_m3: under what is seen from above, to the ground.
                    pan_deg: to the right, tilt_deg: upward; shift_px: by which the picture moved at the principal point
truth/depth*/       key 'depth': float32, metres along the optical axis, of the empty yard in the undistorted view with the
                    same K and the pose of cameras.json; 0: sky or water. depth-from-7: from the seventh night on
truth/reference.ply surfaces that at least two cameras see in the first night
demo.json           what was rendered, and the digest of every file
"""
