"""A rendered scene as the files of a demo: captures, a site file that works as it is, and the truth beside them."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from wbflow_stages.types import Cloud

from .encode import jpeg, png
from .scenes import SCENES, render
from .shooting import DemoCamera, DemoSite
from .variants import VARIANTS


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

    told: Mapping[str, Any]
    """What was rendered (JSON data)."""
    files: Iterator[tuple[str, bytes | Points]]
    """Name and content of every file."""


def demo_files(
    scene: str,
    *,
    small: bool = False,
    light: str = "day",
    cameras: int | None = None,
    captures: int | None = None,
    seed: int = 0,
    lenses: str = "standard",
    surfaces: str = "standard",
) -> DemoFiles:
    """Render a scene; the same arguments give the same bytes.

    Parameters
    ----------
    scene : str
        A name of `SCENES`.
    small : bool
        320 x 180 pixels: rendered in seconds.
    light : str
        "day", "dusk", "night", or "dark": night without lamps.
    cameras, captures : int, optional
        How many cameras, and captures of each; the scene's own where not given.
    seed : int
        Of everything that is drawn at random.
    lenses : str
        A name of `variants.VARIANTS`.
    surfaces : str
        A name of `weak.SURFACES`.

    Raises
    ------
    ValueError
        An unknown scene, light, kind of lenses or surfaces, or impossible numbers.
    """
    kinds = {"lenses": lenses, "surfaces": surfaces}
    site = render(
        scene, small=small, cameras=cameras, captures=captures, seed=seed, light=light, lenses=lenses, surfaces=surfaces
    )
    which = ({} if scene == "yard" else {"scene": scene}) | {key: kind for key, kind in kinds.items() if kind != "standard"}
    told = {**which, "light": light, "small": small, "captures": len(site.cameras[0].captures), "seed": seed}
    return DemoFiles(told, _files(site, scene, light, lenses))


def _files(site: DemoSite, scene: str, light: str, lenses: str) -> Iterator[tuple[str, bytes | Points]]:
    """Name and content of every file of the demo."""
    for camera in site.cameras:
        for k, image in enumerate(camera.captures):
            yield f"captures/{camera.name}/{camera.times[k]:%Y-%m-%d}_{k + 1}.jpg", jpeg(image)
        yield f"masks/{camera.name}.png", png(camera.mask)
        truth = {"range" if camera.lens.model == "fisheye" else "depth": camera.depth}
        yield f"truth/depth/{camera.name}.npz", npz_bytes(**truth)
    calibration = json_bytes({camera.name: calibration_of(camera) for camera in site.cameras})
    yield "cameras.json", calibration
    yield "truth/cameras.json", calibration
    yield "truth/reference.ply", reference_points(site.reference, site.voxel_m)
    summary = {"points": len(site.reference.points), "voxel_m": site.voxel_m, "seen_by_at_least": 2, "unit": "m", "light": light}
    yield "truth/reference.json", json_bytes(summary)
    row = SCENES[scene]
    told = {"about": row.about, "scene": "yard" if scene == "yard" else "scene", "lenses": VARIANTS[lenses]}
    readme = _README.format(**told, also=_LENSES.format(**told) if lenses != "standard" else "")
    yield "README.txt", readme.encode()
    about = _CAPTURES.format(night=f"{site.cameras[0].times[0]:%Y-%m-%d}")
    cameras = [camera.name for camera in site.cameras]
    file = site_file(scene, cameras, "{camera}/{date:%Y-%m-%d}_*.jpg", about, row.angles_deg)
    yield "site.yaml", (file + (_WHOLE_FIELD if lenses == "brown" else "")).encode()


def calibration_of(camera: DemoCamera) -> dict[str, Any]:
    """A camera's entry in cameras.json."""
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
    """The content of truth/reference.ply."""
    columns = {
        **dict(zip(("x", "y", "z"), cloud.points.T, strict=True)),
        **dict(zip(("nx", "ny", "nz"), cloud.normals.T, strict=True)),
        **dict(zip(("red", "green", "blue"), cloud.colors.T, strict=True)),
        "views": cloud.views,
    }
    return Points(columns, (f"surfaces that at least two cameras see, one point per {voxel_m:g} m",))


def npz_bytes(**arrays: Any) -> bytes:
    """An npz file of arrays."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def json_bytes(data: dict[str, Any]) -> bytes:
    """A JSON file."""
    return (json.dumps(data, indent=1) + "\n").encode()


def site_file(scene: str, cameras: Sequence[str], pattern: str, about: str, angles_deg: tuple[float, float]) -> str:
    """The site file of a demo.

    Parameters
    ----------
    scene : str
        Its name.
    cameras : sequence of str
        Ids, in their order.
    pattern : str
        Of the captures' names.
    about : str
        Comment lines above the captures.
    angles_deg : (float, float)
        Between which angles views are worth matching, degrees.
    """
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
