"""Cameras: their poses, their lenses, and the rays of their (distorted) pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from wbflow_stages.core.jit import kernel
from wbflow_stages.core.lenses import lens_pixels
from wbflow_stages.types import Camera, Float32s, Float64s, Lens

from . import Place

CENTRE = (20.0, 18.0)
"""Centre of the half ring of cameras, metres east and north."""


@dataclass(frozen=True)
class Viewpoint:
    """A fixed camera."""

    name: str
    centre: Place
    target: Place
    """The point that it looks at."""
    hfov_deg: float
    distortion: tuple[float, ...]
    """Coefficients of the lens: k1 k2 p1 p2 k3 for "brown", k1 k2 k3 k4 for "fisheye"."""
    roll_deg: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    """Offset of the principal point from the image centre, in units of 0.6 % of the width."""
    model: Literal["brown", "fisheye"] = "brown"
    scale: float = 1.0
    """Factor on the size of its images."""
    whole_picture: bool = False
    """Whether `hfov_deg` is the field of view of the (distorted) image instead of the pinhole with the same K."""

    def size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return (width, height) of its images; `size`: (width, height) for a `scale` of 1."""
        return round(self.scale * size[0]), round(self.scale * size[1])


def principal_shift(k: int) -> tuple[float, float]:
    """Return the `shift` of a scene's k-th camera: principal points are a little off the image centre, as in real cameras."""
    return float(np.sin(k + 0.5)), float(np.cos(1.7 * k))


def viewpoint_on_post(k: int, name: str, centre: Place, target: Place, hfov_deg: float, barrel: float) -> Viewpoint:
    """Return a scene's k-th camera, named `name`-(k+1), with a lens that differs slightly from others', and not quite level."""
    shift = principal_shift(k)
    distortion = (barrel - 0.01 * (k % 3), 0.03, 0.0002, 0.0003, 0.0)
    return Viewpoint(f"{name}-{k + 1}", centre, target, hfov_deg, distortion, 0.8 * shift[0], shift)


def _mounted(
    name: str, bearing_deg: float, distance: float, height: float, target: Place, hfov_deg: float, distortion: tuple[float, ...]
) -> Viewpoint:
    """Return a camera of the yard at a `distance` in metres from CENTRE, in direction `bearing_deg` east of south."""
    bearing = np.deg2rad(bearing_deg)
    centre = (float(CENTRE[0] + distance * np.sin(bearing)), float(CENTRE[1] - distance * np.cos(bearing)), height)
    # principal points are a little off the image centre, and no camera is quite level, as in reality
    right, down = np.sin(np.array([1.0, 2.0]) * (bearing_deg + 7.0))
    roll_deg = 1.2 * float(np.sin(bearing_deg))
    return Viewpoint(name, centre, target, hfov_deg, distortion, roll_deg, (float(right), float(down)))


# Distortions are as large as those of real surveillance lenses: barrel, with a little decentring.
MOUNTS = (
    _mounted("gate", -71.0, 19.5, 6.2, (21.0, 20.5, 1.2), 70.0, (-0.21, 0.055, 0.0004, -0.0003, -0.008)),
    _mounted("mast-1", -50.0, 20.0, 7.6, (20.5, 21.5, 1.4), 66.0, (-0.16, 0.032, -0.0005, 0.0002, 0.0)),
    _mounted("crane-1", -30.5, 19.0, 9.4, (20.0, 22.0, 1.0), 68.0, (-0.19, 0.046, 0.0002, 0.0004, -0.005)),
    _mounted("mast-2", -10.0, 19.5, 7.0, (20.5, 22.5, 1.8), 67.0, (-0.17, 0.035, 0.0, -0.0004, 0.0)),
    _mounted("mast-3", 10.5, 19.0, 8.2, (19.5, 22.5, 1.5), 65.0, (-0.15, 0.028, 0.0003, 0.0003, 0.0)),
    _mounted("crane-2", 30.0, 20.0, 9.0, (20.0, 22.0, 1.2), 69.0, (-0.20, 0.050, -0.0002, -0.0003, -0.006)),
    _mounted("quay", 50.0, 19.5, 6.6, (19.5, 21.5, 1.5), 66.0, (-0.16, 0.030, 0.0004, 0.0002, 0.0)),
    _mounted("roof", 70.0, 19.8, 7.4, (19.0, 20.5, 1.0), 70.0, (-0.22, 0.060, -0.0003, 0.0004, -0.009)),
)


def choose_mounts(cameras: int) -> tuple[Viewpoint, ...]:
    """Return `cameras` neighbouring viewpoints from the middle of the half ring."""
    first = (len(MOUNTS) - cameras) // 2
    return MOUNTS[first : first + cameras]


def look_at(centre: Float64s, target: Float64s, roll_deg: float = 0.0) -> Float64s:
    """Return R (3, 3), world to camera axes, of a camera at `centre` that looks at `target` with z up."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    # a roll turns the axes of the picture about the optical axis
    c = np.cos(np.deg2rad(roll_deg))
    s = np.sin(np.deg2rad(roll_deg))
    return np.array([c * right + s * down, -s * right + c * down, forward])


def camera_at(viewpoint: Viewpoint, size: tuple[int, int]) -> tuple[Camera, Lens]:
    """Return the pinhole camera without distortion, and the lens with distortion, for images of `size` = (width, height) pixels.

    For a fisheye, the first has its pose, size and K, but is not a pinhole.
    """
    width, height = size
    angle = np.deg2rad(viewpoint.hfov_deg) / 2
    # half the picture's width at a focal length of 1: that of a pinhole, or where the lens takes the ray at this angle
    half_width = float(np.tan(angle))
    if viewpoint.model == "fisheye" or viewpoint.whole_picture:
        lens = Lens(K=np.eye(3), distortion=np.array(viewpoint.distortion), model=viewpoint.model)
        half_width = float(lens_pixels(lens, np.array([[np.sin(angle), 0.0, np.cos(angle)]]))[0, 0])
    focal = 0.5 * width / half_width
    shift = 0.006 * width * np.array(viewpoint.shift)
    K = np.array([[focal, 0, (width - 1) / 2 + shift[0]], [0, focal, (height - 1) / 2 + shift[1]], [0, 0, 1.0]])
    centre = np.array(viewpoint.centre)
    R = look_at(centre, np.array(viewpoint.target), roll_deg=viewpoint.roll_deg)
    lens = Lens(K=K, distortion=np.array(viewpoint.distortion), width=width, height=height, model=viewpoint.model)
    return Camera(K, R, centre, width, height), lens


@kernel
def _brown_rays(rays: Float64s, x: Float64s, y: Float64s, K: Float64s, distortion: Float64s) -> None:
    """Fill in ray directions (x, y, 1) of distorted pixels, by fixed-point steps on Brown's model to 1e-12."""
    k1, k2, p1, p2, k3 = distortion
    for k in range(x.shape[0]):
        u = (x[k] - K[0, 2]) / K[0, 0]
        v = (y[k] - K[1, 2]) / K[1, 1]
        # start undistorted; then divide by the radial factor, after subtracting the decentring, at the last position
        a = u
        b = v
        for _ in range(60):
            r2 = a * a + b * b
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            da = 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
            db = p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
            before_a = a
            before_b = b
            a = (u - da) / radial
            b = (v - db) / radial
            if abs(a - before_a) + abs(b - before_b) < 1e-12:
                break
        rays[k, 0] = a
        rays[k, 1] = b
        rays[k, 2] = 1.0


@kernel
def _fisheye_rays(rays: Float64s, x: Float64s, y: Float64s, K: Float64s, distortion: Float64s) -> None:
    """Fill in unit ray directions of a fisheye's pixels, by Newton steps on Kannala and Brandt's polynomial."""
    k1, k2, k3, k4 = distortion
    for k in range(x.shape[0]):
        u = (x[k] - K[0, 2]) / K[0, 0]
        v = (y[k] - K[1, 2]) / K[1, 1]
        radius = np.sqrt(u * u + v * v)
        angle = radius  # nearly right: the lens is nearly equidistant
        for _ in range(30):
            t2 = angle * angle
            off = angle * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) - radius
            step = off / (1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4))))
            angle -= step
            if abs(step) < 1e-13:
                break
        # the ray leaves the axis by this angle, in the direction of the pixel
        across = np.sin(angle) / radius if radius > 0 else 0.0
        rays[k, 0] = across * u
        rays[k, 1] = across * v
        rays[k, 2] = np.cos(angle)


def pixel_rays(camera: Camera, lens: Lens | None, x: Float64s, y: Float64s) -> Float32s:
    """Return unit world directions (n, 3) float32 of pixels x, y (n,) of a lens (None: of the pinhole without distortion)."""
    rays = np.empty((len(x), 3))
    if lens is not None and lens.model == "fisheye":
        _fisheye_rays(rays, x, y, camera.K, lens.distortion)
    else:
        _brown_rays(rays, x, y, camera.K, np.zeros(5) if lens is None else lens.distortion)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return np.asarray(rays @ camera.R, dtype=np.float32)


def distort(lens: Lens, x: Float64s) -> Float64s:
    """Return the distorted positions (n, 2) of pixels of the undistorted view with the same K (Brown's model, OpenCV's order)."""
    assert lens.K is not None
    K = lens.K
    k1, k2, p1, p2, k3 = lens.distortion
    a = (x[:, 0] - K[0, 2]) / K[0, 0]
    b = (x[:, 1] - K[1, 2]) / K[1, 1]
    r2 = a * a + b * b
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
    v = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
    return np.column_stack([K[0, 0] * u + K[0, 2], K[1, 1] * v + K[1, 2]])


VARIANTS = {
    "standard": "as the scene has them",
    "fisheye": "every second camera sees 180 degrees, with twice the pixels along each side",
    "brown": "all see 100 degrees with half as many pixels again along each side, and bend lines strongly",
    "mixed": "every second camera has four times the pixels of its neighbours along each side",
}
"""Description of each kind of lenses."""

_FISHEYE = {"model": "fisheye", "distortion": (-0.012, 0.004, -0.0011, 0.0001), "hfov_deg": 180.0, "scale": 2.0}
"""Nearly equidistant."""
_BARREL = {"distortion": (-0.15, 0.02, 0.0004, -0.0003, 0.0), "hfov_deg": 100.0, "whole_picture": True, "scale": 1.5}
_CHANGES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "standard": ({}, {}),
    "fisheye": ({}, _FISHEYE),
    "brown": (_BARREL, _BARREL),
    "mixed": ({"scale": 0.5}, {"scale": 2.0}),
}
"""Changes to a scene's first, third, ... camera, and to its second, fourth, ... camera."""


def with_lenses(viewpoint: Viewpoint, k: int, lenses: str) -> Viewpoint:
    """Return a scene's k-th camera with a kind of `lenses` from `VARIANTS`.  Raises ValueError for an unknown kind."""
    if lenses not in VARIANTS:
        raise ValueError(f"lenses are {', '.join(VARIANTS)}, not {lenses!r}")
    return replace(viewpoint, **_CHANGES[lenses][k % 2])
