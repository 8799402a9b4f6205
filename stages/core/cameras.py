"""Pinhole cameras: projection, rays, back-projection, relative poses, and transfer of pixels from one camera to another."""

from __future__ import annotations

import numpy as np

from ..types import Camera, Float64s, View


def scaled_intrinsics(K: Float64s, sx: float, sy: float) -> Float64s:
    """K of an image resized by (sx, sy); pixel centres stay at integers, so the principal point moves by half a pixel."""
    S = np.array([[sx, 0.0, 0.5 * sx - 0.5], [0.0, sy, 0.5 * sy - 0.5], [0.0, 0.0, 1.0]])
    return S @ K


def field_ratio(view1: View, view2: View) -> float:
    """Area that view 1 sees over the area that view 2 sees, at equal distance; 1 if the intrinsics of either are unknown."""
    if view1.K is None or view2.K is None:
        return 1.0
    area1 = view1.width * view1.height / float(view1.K[0, 0] * view1.K[1, 1])
    area2 = view2.width * view2.height / float(view2.K[0, 0] * view2.K[1, 1])
    return area1 / area2


def camera_of(view: View, K: Float64s, R: Float64s, C: Float64s) -> Camera:
    """The camera of a view.

    Parameters
    ----------
    view : gives the size, the captured size, the distortion and the lens.
    K, R : (3, 3) intrinsics in pixels, and rotation from world to camera axes.
    C : (3,) centre in the world.
    """
    return Camera(
        K,
        R,
        C,
        view.width,
        view.height,
        captured_width=view.captured_width or view.width,
        captured_height=view.captured_height or view.height,
        distortion=view.distortion,
        lens=view.lens,
    )


def same_camera(camera1: View | Camera, camera2: View | Camera) -> bool:
    """Are both of them views of the same physical camera, with the same position and the same captures?"""
    if camera1.lens is None or camera2.lens is None:
        return False
    # a lens whose camera is "" belongs to no other view
    return bool(camera1.lens.camera) and camera1.lens.camera == camera2.lens.camera


def camera_id(name: str, view: View | Camera) -> str:
    """Id of the camera to which a view belongs; the view's own name for most cameras, which have one view."""
    return (view.lens.camera if view.lens else "") or name


def relative_pose(camera1: Camera, camera2: Camera) -> tuple[Float64s, Float64s]:
    """`cam2_R_cam1` (3, 3) and `cam2_t_cam1` (3,) in world lengths: x_2 = R x_1 + t in camera axes."""
    return camera2.R @ camera1.R.T, camera2.R @ (camera1.C - camera2.C)


def transfer(camera: Camera, other: Camera) -> tuple[Float64s, Float64s]:
    """M (3, 3), b (3,): pixel p (homogeneous) of `camera` at depth z projects into `other` at z M p + b; third entry: depth."""
    R, t = relative_pose(camera, other)
    # x_other = R (z K^-1 p) + t, in pixels
    return other.K @ R @ np.linalg.inv(camera.K), other.K @ t


def project(camera: Camera, X: Float64s) -> tuple[Float64s, Float64s]:
    """Pixels (n, 2) and depth (n,) of world points (n, 3); pixels of points behind the camera are meaningless."""
    x = (X - camera.C) @ camera.R.T  # camera axes: the third coordinate is the depth
    p = x @ camera.K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return p[:, :2] / p[:, 2:], x[:, 2]


def rays(camera: Camera, x: Float64s) -> Float64s:
    """World directions (3, n) of the rays of pixels x (n, 2), scaled to depth 1."""
    A = camera.R.T @ np.linalg.inv(camera.K)
    return np.asarray(A[:, :2] @ x.T + A[:, 2:], dtype=np.float64)


def backproject(camera: Camera, x: Float64s, depth: Float64s) -> Float64s:
    """World points (n, 3) of pixels (n, 2) at depth (n,)."""
    directions = np.column_stack([x, np.ones(len(x))]) @ np.linalg.inv(camera.K).T
    return np.asarray((directions * depth[:, None]) @ camera.R + camera.C, dtype=np.float64)


def convergence_deg(camera1: Camera, camera2: Camera, x1: Float64s, x2: Float64s) -> float:
    """Median angle in degrees between the rays of matched pixels x1, x2 (n, 2); nan if there are none.

    Parameters
    ----------
    camera1, camera2 : in the same world.
    x1, x2 : (n, 2) matched pixels.
    """
    if len(x1) == 0:
        return float("nan")
    a = rays(camera1, x1)
    b = rays(camera2, x2)
    cosine = np.sum(a * b, axis=0) / np.sqrt(np.sum(a * a, axis=0) * np.sum(b * b, axis=0))
    angles = np.arccos(np.clip(cosine, -1, 1))  # rounding can carry a cosine beyond 1
    return float(np.degrees(np.median(angles)))


def ray_angles(a: Float64s, b: Float64s) -> Float64s:
    """(n,) angles in radians between directions a and b (n, 3) of any length; nan where either is nan or zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.einsum("ni,ni->n", a, b) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)), dtype=np.float64)
