"""Photographed and rendered pairs with known cameras, and measures of matches and geometries against this truth.

Matches are judged by laser depth in fountain, by exact depth in rendered scenes, and by true epipolar lines in entry (no depth).
"""

from __future__ import annotations

import json
import os
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from wbflow_stages.core.cameras import backproject, project, relative_pose, scaled_intrinsics
from wbflow_stages.core.epipolar import fundamental_from_cameras, symmetric_epipolar_distance
from wbflow_stages.features import detect
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Camera, Capture, Features, Float64s, Frame, Uint8s, View

if TYPE_CHECKING:
    from wbflow_demo.render.photograph import Daytime

DATA = Path(os.environ.get("WBFLOW_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
CORRECT_PX = 3.0
"""A match is correct within this many pixels of the truth, in an image 1536 pixels wide."""


@dataclass(frozen=True)
class TrueView:
    """A frame with its true camera; depth: (h, w) along the optical axis, 0 where unknown, None for a scene without depth."""

    scene: str
    name: str
    frame: Frame
    camera: Camera
    depth: Float64s | None = None
    depth_camera: Camera | None = None

    @cached_property
    def features(self) -> Features:
        found = detect(self.frame)
        if not isinstance(found, Features):
            raise SystemExit(f"{self.scene} {self.name}: {found.reason}")
        return found

    @cached_property
    def plain_sift(self) -> Features:
        """Keypoints and descriptors of OpenCV's SIFT with default settings: what a user has without this project."""
        grey = cv2.cvtColor(self.frame.image, cv2.COLOR_RGB2GRAY)
        found, descriptors = cv2.SIFT.create().detectAndCompute(grey, None)
        c, s = np.cos(np.radians([k.angle for k in found])), np.sin(np.radians([k.angle for k in found]))
        frames = np.array([k.size for k in found])[:, None, None] * np.array([[c, -s], [s, c]]).transpose(2, 0, 1)
        descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
        responses = np.array([k.response for k in found], np.float32)
        xy, tilts = np.array([k.pt for k in found], np.float64), np.zeros(len(found), np.uint8)
        return Features(xy, frames, descriptors, responses, tilts, self.frame.view, plain_keypoints=len(found))

    def without_lens(self) -> Features:
        """The same features for a camera with unknown intrinsics."""
        return replace(self.features, view=View(self.camera.width, self.camera.height))

    def depth_at(self, x: Float64s) -> Float64s:
        """(n,) depth at pixels x of the frame, nan where unknown."""
        assert self.depth is not None and self.depth_camera is not None
        h, w = self.depth.shape
        at = np.rint((x + 0.5) * (w / self.camera.width) - 0.5).astype(int)
        inside = ((at >= 0) & (at < [w, h])).all(axis=1)
        z = np.zeros(len(x))
        z[inside] = self.depth[at[inside, 1], at[inside, 0]]
        return np.where(z > 0, z, np.nan)


def on_one_thread() -> None:
    """Restart this program with one thread per library, since waiting threads spin and count as CPU seconds."""
    cv2.setNumThreads(1)
    if "OPENBLAS_NUM_THREADS" not in os.environ:
        os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.argv])


def photographed(scene: str, width: int, names: list[str] | None = None) -> dict[str, TrueView]:
    """The views of fountain or entry at a working width, by number."""
    folder = DATA / scene
    if not folder.exists():
        raise SystemExit(f"no {folder}: say where the photographs are in WBFLOW_DATA")
    cameras = json.loads((folder / "cameras.json").read_text())
    views = {}
    for file, c in sorted(cameras.items()):
        name = str(int(Path(file).stem))
        if names is None or name in names:
            views[name] = _photograph(scene, name, folder / "images" / file, c, width)
    return views


def read_rgb(file: Path) -> Uint8s:
    """The pixels (h, w, 3) of an image file."""
    pixels = cv2.imread(str(file))
    if pixels is None:
        raise SystemExit(f"{file} is not there, or no image")
    return np.ascontiguousarray(pixels[..., ::-1]).astype(np.uint8)


def _photograph(scene: str, name: str, file: Path, c: dict[str, list[float]], width: int) -> TrueView:
    pixels = read_rgb(file)
    s = width / pixels.shape[1]
    small = cv2.resize(pixels, None, fx=s, fy=s, interpolation=cv2.INTER_AREA)
    h, w = small.shape[:2]
    R, C = np.array(c["R"]), np.array(c["C"])
    K = scaled_intrinsics(np.array(c["K"]), s, s)
    depth_file = file.parents[1] / "depth" / f"{file.stem}.npz"
    depth = None
    if depth_file.exists():
        stored = np.load(depth_file)["depth"]
        half_step = np.spacing(stored) / 2  # the maps were truncated to half precision
        depth = np.where(stored > 0, stored.astype(np.float32) + half_step, 0)
    frame = Frame(small.astype(np.uint8), np.ones((h, w), bool), View(w, h, K))
    whole = Camera(np.array(c["K"]), R, C, pixels.shape[1], pixels.shape[0])
    return TrueView(scene, name, frame, Camera(K, R, C, w, h), depth, whole)


def rendered(light: Daytime, cache: Path, width: int = 1280) -> dict[str, TrueView]:
    """The demo yard by "day", "dusk" or "night"; rendered once (about 40 s) into `cache`."""
    return rendered_scene("yard", light, cache, width, captures=3)


def rendered_scene(scene: str, light: Daytime, cache: Path, width: int = 960, captures: int = 2) -> dict[str, TrueView]:
    """The views of all cameras of a demo scene, by name; rendered once (about 40 s) into `cache`."""
    import scenes  # noqa: F401  # adds the scenes that only benches use

    from wbflow_demo.scenes import render

    cache.mkdir(parents=True, exist_ok=True)
    views = {}
    file = cache / f"{scene}-{light}-{width}.npz"
    if not file.exists():
        arrays: dict[str, npt.NDArray[Any]] = {}
        for c in render(scene, light=light, size=(width, width * 9 // 16), captures=captures).cameras:
            frame = clean_frame([_png(i) for i in c.captures], c.lens, _png(c.mask.astype(np.uint8) * 255), resolution=None)
            arrays |= {
                f"{c.name} image": frame.image, f"{c.name} mask": frame.mask, f"{c.name} K": np.asarray(frame.view.K),
                f"{c.name} depth": c.depth, f"{c.name} K0": c.camera.K, f"{c.name} R": c.camera.R, f"{c.name} C": c.camera.C,
            }  # fmt: skip
        np.savez(file, allow_pickle=False, **arrays)
    stored = np.load(file)
    for name in dict.fromkeys(key.split(" ")[0] for key in stored.files if " " in key):
        image, mask, K, depth, K0, R, C = (stored[f"{name} {part}"] for part in ("image", "mask", "K", "depth", "K0", "R", "C"))
        h, w = mask.shape
        whole = Camera(K0, R, C, depth.shape[1], depth.shape[0])
        views[name] = TrueView(f"{scene}-{light}", name, Frame(image, mask, View(w, h, K)), Camera(K, R, C, w, h), depth, whole)
    return views


def _png(image: np.ndarray) -> Capture:
    data = cv2.imencode(".png", image[..., ::-1] if image.ndim == 3 else image)[1].ravel()
    return Capture("rendered.png", data)


def axes_angle_deg(left: Camera, right: Camera) -> float:
    """Angle between the optical axes."""
    return float(np.degrees(np.arccos(np.clip(left.R[2] @ right.R[2], -1, 1))))


def transfer_error(left: TrueView, right: TrueView, x1: Float64s, x2: Float64s) -> Float64s:
    """(n,) pixels between a match and the truth: the smaller error by either view's depth; nan where both are unknown."""
    errors = []
    for a, b, xa, xb in ((left, right, x1, x2), (right, left, x2, x1)):
        z = a.depth_at(xa)
        known = np.isfinite(z)
        error = np.full(len(xa), np.nan)
        image, ahead = project(b.camera, backproject(a.camera, xa[known], z[known]))
        error[known] = np.where(ahead > 0, np.linalg.norm(image - xb[known], axis=1), np.inf)
        errors.append(error)
    return np.asarray(np.fmin(*errors))


def correct(left: TrueView, right: TrueView, x1: Float64s, x2: Float64s) -> tuple[int, int]:
    """Number of correct matches, and number of matches that can be judged."""
    limit = CORRECT_PX * left.camera.width / 1536
    if left.depth is None:
        error = symmetric_epipolar_distance(fundamental_from_cameras(left.camera, right.camera), x1, x2)
    else:
        error = transfer_error(left, right, x1, x2)
        error = error[np.isfinite(error)]
    return int((error < limit).sum()), len(error)


def true_correspondences(left: TrueView, right: TrueView, columns: int = 96) -> tuple[Float64s, Float64s]:
    """Exact correspondences x1, x2 (n, 2) of points that both views see, on a pixel grid of the left view."""
    w, h = left.camera.width, left.camera.height
    step = w / columns
    gx, gy = np.meshgrid(np.arange(step / 2, w, step), np.arange(step / 2, h, step))
    x1 = np.rint(np.column_stack([gx.ravel(), gy.ravel()]))
    if left.depth is None:
        return _on_true_lines(left.camera, right.camera, x1)
    z = left.depth_at(x1)
    X = backproject(left.camera, x1, z)
    x2, ahead = project(right.camera, X)
    inside = np.isfinite(z) & (ahead > 0) & (x2 > 0).all(axis=1) & (x2 < [w - 1, h - 1]).all(axis=1)
    x1, x2, ahead = x1[inside], x2[inside], ahead[inside]
    seen = np.abs(right.depth_at(x2) / ahead - 1) < 0.01
    return x1[seen], x2[seen]


def _on_true_lines(left: Camera, right: Camera, x1: Float64s) -> tuple[Float64s, Float64s]:
    """Correspondences for a scene without depth: points at three depths along each ray that both cameras see."""
    scale = float(np.linalg.norm(left.C - right.C))
    points1, points2 = [], []
    for factor in (1.5, 3.0, 6.0):
        x2, ahead = project(right, backproject(left, x1, np.full(len(x1), factor * scale)))
        inside = (ahead > 0) & (x2 > 0).all(axis=1) & (x2 < [right.width - 1, right.height - 1]).all(axis=1)
        points1.append(x1[inside])
        points2.append(x2[inside])
    return np.concatenate(points1), np.concatenate(points2)


def pose_error_deg(left: Camera, right: Camera, R: Float64s | None, t: Float64s | None) -> tuple[float, float]:
    """Angle of the rotation error and between the translation directions, degrees; 180 where there is no pose."""
    if R is None or t is None:
        return 180.0, 180.0
    true_R, true_t = relative_pose(left, right)
    turn = np.linalg.norm(true_R.T @ R - np.eye(3)) / (2 * np.sqrt(2))  # = sin(angle / 2), exact for small angles
    shift = true_t @ t / np.linalg.norm(true_t) / np.linalg.norm(t)
    return float(np.degrees(2 * np.arcsin(min(turn, 1.0)))), float(np.degrees(np.arccos(np.clip(shift, -1, 1))))


WALLS = (
    # wall section, camera positions (x, y), and the point that they look at, in metres; all windows are alike
    ("north-a", ((2.5, 19.0), (5.5, 18.0), (9.5, 19.5)), (5.0, 30.0)),
    ("north-b", ((12.0, 22.0), (14.5, 21.5), (17.0, 22.5)), (14.5, 30.0)),
    ("north-c", ((24.0, 21.5), (26.5, 20.5), (29.0, 21.5)), (26.0, 30.0)),
    ("north-d", ((32.0, 26.0), (35.0, 25.0), (37.0, 26.0)), (36.5, 30.0)),
    ("east", ((30.0, 18.5), (29.0, 21.0), (31.0, 23.0)), (40.0, 20.5)),
    ("west", ((10.0, 17.5), (9.0, 20.0), (11.0, 23.0)), (0.0, 21.0)),
)


def walls(cache: Path, width: int = 960) -> dict[str, TrueView]:
    """Close views of the demo yard's walls, three of each section; the sections look alike but do not overlap."""
    from wbflow_demo.render.cameras import look_at
    from wbflow_demo.render.light import light_of
    from wbflow_demo.render.photograph import render_view, true_depth
    from wbflow_demo.render.renderer import PreparedScene, build_atlas
    from wbflow_demo.render.sensor import develop, sensor_of
    from wbflow_demo.yard import LAMPS, static_yard

    cache.mkdir(parents=True, exist_ok=True)
    height = width * 9 // 16
    K = np.array([[1.1 * width, 0, (width - 1) / 2], [0, 1.1 * width, (height - 1) / 2], [0, 0, 1]])
    file = cache / f"walls-{width}.npz"
    arrays = dict(np.load(file)) if file.exists() else {}
    prepared = None
    if not arrays:
        scene = static_yard(np.random.default_rng([0, 1]), 0.0098)
        prepared = PreparedScene(scene, light_of("day", LAMPS), build_atlas(scene.textures))
    views = {}
    for section, places, target in WALLS:
        for k, place in enumerate(places):
            name = f"{section}-{k}"
            C = np.array([*place, 4.5 + 0.4 * k])
            camera = Camera(K, look_at(C, np.array([*target, 4.6])), C, width, height)
            if prepared is not None:
                rng = np.random.default_rng([7, len(arrays)])
                arrays[f"{name} image"] = develop(render_view(prepared, camera, None), sensor_of(rng, "day"), 1.0, rng)
                arrays[f"{name} depth"] = true_depth(prepared, camera)[0]
            frame = Frame(arrays[f"{name} image"], np.ones((height, width), bool), View(width, height, K))
            views[name] = TrueView("walls", name, frame, camera, arrays[f"{name} depth"], camera)
    if prepared is not None:
        np.savez(file, **arrays)
    return views
