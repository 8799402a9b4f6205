"""The demo nights as files: captures of every night, a site file that works as it is, and what happened in truth/nights.json."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .encode import png
from .files import DemoFiles, Points, calibration_of, json_bytes, npz_bytes, reference_points, site_file
from .nights import CameraNights, NightsSite, yard_nights
from .scenes import SCENES
from .script import FOREVER, Stay, date_of, event_of, hour_of, stays, weather_of
from .shots import Shots
from .things import Extent

SMALL, LARGE = (320, 180), (640, 360)


def demo_nights(nights: int, *, frames: int = 3, small: bool = False, cameras: int | None = None, seed: int = 0) -> DemoFiles:
    """Render nights of the yard; the same arguments give the same bytes.

    Parameters
    ----------
    nights : int
        How many.
    frames : int
        Of each camera and night.
    small : bool
        320 x 180 pixels instead of 640 x 360, and 4 cameras.
    cameras : int, optional
        How many, 1 to 8.
    seed : int
        Of everything that is drawn at random.

    Raises
    ------
    ValueError
        Impossible numbers.
    """
    count = cameras or (SCENES["yard"].small_cameras if small else None) or 8
    size = SMALL if small else LARGE
    site = yard_nights(nights, Shots(count, frames, size, seed))
    told = {"nights": nights, "frames": frames, "small": small, "cameras": count, "seed": seed}
    return DemoFiles(told, _files(site, nights))


def _files(site: NightsSite, nights: int) -> Iterator[tuple[str, bytes | Points]]:
    for each in site.cameras:
        name = each.camera.name
        for night in each.nights:
            for time, data in night.frames:
                yield f"captures/{name}/{time:%Y-%m-%d_%H%M%S}.jpg", data
        yield f"masks/{name}.png", png(each.camera.mask)
        for epoch, depth in each.depths.items():
            yield f"{_depth_folder(epoch)}/{name}.npz", npz_bytes(depth=depth)
    calibration = json_bytes({each.camera.name: calibration_of(each.camera) for each in site.cameras})
    yield "cameras.json", calibration
    yield "truth/cameras.json", calibration
    yield "truth/reference.ply", reference_points(site.reference, site.voxel_m)
    summary = {"points": len(site.reference.points), "voxel_m": site.voxel_m, "seen_by_at_least": 2, "unit": "m", "night": 1}
    yield "truth/reference.json", json_bytes(summary)
    width, height = site.cameras[0].camera.lens.width, site.cameras[0].camera.lens.height
    told = [_night(site, number) for number in range(1, nights + 1)]
    yield "truth/nights.json", json_bytes({"unit": "m", "width": width, "height": height, "nights": told})
    yield "README.txt", _README.encode()
    cameras = [each.camera.name for each in site.cameras]
    pattern = "{camera}/{date:%Y-%m-%d}_*.jpg"
    yield "site.yaml", site_file("yard", cameras, pattern, _CAPTURES, SCENES["yard"].angles_deg).encode()


def _depth_folder(epoch: int) -> str:
    return "truth/depth" if epoch == 1 else f"truth/depth-from-{epoch}"


def _night(site: NightsSite, number: int) -> dict[str, Any]:
    """What is true of a night."""
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


STATES = {"none": "ok", "turned": "moved", "nudged": "nudged", "covered": "blind", "frozen": "stale", "foreign": "foreign"}
"""What a watched camera ought to be called."""


def _camera(each: CameraNights, number: int) -> dict[str, Any]:
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
    """In what the yard of a night differs from that of the first, besides what moves from frame to frame."""
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


_CAPTURES = """\
# One folder for each camera, several captures a night (2026-11-10_140211.jpg, ...): what moves between them is removed."""

_README = """\
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
