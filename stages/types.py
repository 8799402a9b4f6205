"""What the stages hand to each other: frozen dataclasses of arrays.  Axes, units, order: see the package's docstring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from .reasons import Reason as Reason
from .reasons import Rejected as Rejected

Float64s = npt.NDArray[np.float64]
Float32s = npt.NDArray[np.float32]
Int64s = npt.NDArray[np.int64]
Int32s = npt.NDArray[np.int32]
Int16s = npt.NDArray[np.int16]
Uint32s = npt.NDArray[np.uint32]
Uint16s = npt.NDArray[np.uint16]
Uint8s = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]

Pair = tuple[str, str]
"""Ids of two cameras, in the order of the site file."""


@dataclass(frozen=True)
class Capture:
    """One image file as it lies on disk.  data: (n,) uint8, the encoded bytes."""

    name: str
    data: Uint8s


@dataclass(frozen=True)
class Lens:
    """Intrinsics as the site states them, for an image of `width` x `height` pixels (both 0: any size).

    K: (3, 3) float64 pixels, or None when unknown; `hfov_deg`: the horizontal field of view, used where K is None.
    distortion: (5,) float64 k1 k2 p1 p2 k3 (OpenCV's order and meaning), zeros for none.
    """

    K: Float64s | None = None
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))
    hfov_deg: float | None = None
    width: int = 0
    height: int = 0


@dataclass(frozen=True)
class Placement:
    """Where a camera is said to be.  R: (3, 3), C: (3,) float64, or None where unknown.

    sigma_m: standard deviation of C in metres, 0 where it is to be held; metric: C is in metres.
    """

    R: Float64s | None = None
    C: Float64s | None = None
    sigma_m: float = 0.0
    metric: bool = True


@dataclass(frozen=True)
class Survey:
    """What is known of a site besides its cameras' poses.  Cameras count by their position in the site file.

    distances: (n, 3) float64 rows of camera, camera, metres between their centres; points: (p, 3) float64 control points, metres;
    observations: (m, 4) float64 rows of control point, camera, x, y in pixels of the image as captured (upright);
    cameras: ids in the order of the site file; crs: the coordinate system of the world, "" where it is local.
    """

    cameras: tuple[str, ...] = ()
    distances: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    points: Float64s = field(default_factory=lambda: np.zeros((0, 3)))
    observations: Float64s = field(default_factory=lambda: np.zeros((0, 4)))
    crs: str = ""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera at working resolution.  K, R: (3, 3) float64; C: (3,) float64.

    component: cameras with the same number share a world; 0 is the main one; radial: k1 and k2 of the distortion that was
    found to be left in the frame where the lens was unknown (the frame is used as it is); captured_width, captured_height,
    distortion: of the capture, see `View`.
    """

    K: Float64s
    R: Float64s
    C: Float64s
    width: int
    height: int
    component: int = 0
    radial: tuple[float, float] = (0.0, 0.0)
    captured_width: int = 0
    captured_height: int = 0
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))


@dataclass(frozen=True)
class View:
    """The pinhole of a frame, without its pixels.

    K: (3, 3) float64 of the frame (working resolution, distortion removed), None when nothing is known;
    focal_known: False when K is only a guess, from a field of view; captured_width, captured_height: size of the capture
    (0: as the frame); distortion: (5,) float64 what was removed from the capture (see `Lens`).
    """

    width: int
    height: int
    K: Float64s | None = None
    focal_known: bool = True
    captured_width: int = 0
    captured_height: int = 0
    distortion: Float64s = field(default_factory=lambda: np.zeros(5))


@dataclass(frozen=True)
class Frame:
    """The night's clean view of one camera at working resolution: upright, undistorted, moving things removed.

    image: (h, w, 3) uint8 RGB; mask: (h, w) bool; notes: what the operator should know (frames left out, exposure).
    """

    image: Uint8s
    mask: Bools
    view: View
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Features:
    """Keypoints of one frame.

    xy: (n, 2) float64 pixels of the frame; frames: (n, 2, 2) float64, each keypoint's local frame s R(theta) (canonical patch
    to image; of a tilted view, mapped back into the frame); descriptors: (n, d) float32 of unit length (RootSIFT);
    responses: (n,) float32; tilts: (n,) uint8, 0 for the plain view, 1 for the view compressed by 2 in x. Rows of the plain
    view come first, each view's strongest keypoint first. lookalikes: (n,) float32, distance to the most similar descriptor of
    the plain view at least 6 px away: how distinctive a keypoint is in its own image (empty: unknown). keypoints: rows of the
    plain view; light: "plain" or "robust", how the image was prepared.
    """

    xy: Float64s
    frames: Float64s
    descriptors: Float32s
    responses: Float32s
    tilts: Uint8s
    view: View
    lookalikes: Float32s = field(default_factory=lambda: np.zeros(0, np.float32))
    plain_keypoints: int = 0
    preprocessing: str = "none"


PLAIN, TILTED = 0, 1
"""Values of `Features.tilts`."""


@dataclass(frozen=True)
class Matches:
    """Point correspondences of a pair, before any geometry.

    x1, x2: (n, 2) float64; i1, i2: (n,) int32 rows in the two `Features`, None where the points are no keypoints of these;
    probability: (n,) float32;
    affine: (n, 2, 2) float64, the local map of image 1 onto image 2 as the two keypoints' frames tell it, None without keypoints;
    matcher: who found them; tilted: the views compressed in x were used too;
    searched: what the matcher searched and geometry may use again; no part of the artifact, and found again where it is missing.
    """

    x1: Float64s
    x2: Float64s
    i1: Int32s | None
    i2: Int32s | None
    probability: Float32s
    affine: Float64s | None
    view1: View
    view2: View
    matcher: str = ""
    tilted: bool = False
    searched: tuple[object, ...] = field(default=(), compare=False, repr=False, metadata={"transient": True})


@dataclass(frozen=True)
class Geometry:
    """Two-view geometry of a pair and what supports it.

    F: (3, 3) float64; x1, x2, i1, i2, probability: the inliers (guided matches), as in `Matches`;
    cam2_R_cam1 (3, 3), cam2_t_cam1 (3,) of unit length: relative pose where both K are known (x_2 ~ R x_1 + t), else None;
    matches: how many there were before geometry; inliers: how many support F; model: "F" or "E", what was kept;
    epipolar_px: median symmetric epipolar distance of the inliers; angle_deg: median angle between the rays of the inliers,
    nan without relative pose; homography_share: share of the inliers that one homography explains too;
    score (log odds) and good_probability: is the pair to be believed (see `verdict`), from distinct_cells: cells of a 12x8 grid
    with distinctive matches, distinct_share: share of the inliers without a look-alike in their own image, agreement: share of
    the clear matches found without geometry that F explains, half_rotation_deg: angle between the rotations that the two halves
    of the inliers tell (nan without K), stretch: median log ratio of the axes of the local affine maps;
    noise_px: (n,) float32, standard deviation of the distance of each inlier to its epipolar line, None where nobody knows;
    lens1, lens2: (3, 3) intrinsics that go with F where they had to be guessed, else None; implausibility: how far these are from
    what cameras have, in squared standard deviations, nan where they are known;
    warnings: named degenerate cases that did not reject the pair.
    """

    F: Float64s
    x1: Float64s
    x2: Float64s
    i1: Int32s | None
    i2: Int32s | None
    probability: Float32s
    view1: View
    view2: View
    cam2_R_cam1: Float64s | None
    cam2_t_cam1: Float64s | None
    matches: int
    inliers: int
    model: str
    epipolar_px: float
    angle_deg: float
    homography_share: float
    score: float
    good_probability: float
    distinct_cells: int = 0
    distinct_share: float = 0.0
    agreement: float = 0.0
    half_rotation_deg: float = float("nan")
    stretch: float = 0.0
    noise_px: Float32s | None = None
    lens1: Float64s | None = None
    lens2: Float64s | None = None
    implausibility: float = float("nan")
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Overlap:
    """Evidence that two views share ground: one row for each pair of cameras, left before right.

    pairs: (m, 2) int32 positions in `cameras`; angle_deg: (m,) float64 convergence angle, nan when poses are unknown;
    shared: (m,) float64, 0 to 1: share of one view that the other sees (poses), or similarity of appearance;
    source: "poses" or "appearance".
    """

    cameras: tuple[str, ...]
    pairs: Int32s
    angle_deg: Float64s
    shared: Float64s
    source: str


@dataclass(frozen=True)
class PairCheck:
    """What the cameras of a whole site say of one pair.  Figures are nan where there is nothing to compare."""

    kept: bool
    """The pair agrees with the cameras, or they say nothing of it."""
    reason: str = ""
    """Why it is not kept, or what is to be known of it."""
    code: str = ""
    """Of a pair that is not kept: which `Reason`."""
    estimated_px: float = float("nan")
    """Median epipolar distance of its inliers to its own F..."""
    adjusted_px: float = float("nan")
    """...and to the F of the adjusted cameras."""
    rotation_off_deg: float = float("nan")
    """Between its own relative rotation and that of the cameras."""
    flagged: bool = False
    """The adjusted F is noticeably worse than the pair's own."""


@dataclass(frozen=True)
class PoseCheck:
    """How tonight's images agree with a camera's known pose.

    pairs, inliers: what could check it; epipolar_px: median of its pairs' median distances to the epipolar lines of the known
    poses; moved: the pose is contradicted, the camera has been solved anew; off_m, off_deg: how far that is from where it is said
    to be (world lengths and degrees; nan where not moved, or not to be told).
    """

    pairs: int
    inliers: int
    epipolar_px: float
    moved: bool = False
    off_m: float = float("nan")
    off_deg: float = float("nan")


@dataclass(frozen=True)
class Poses:
    """Cameras in one frame.

    cameras: solved cameras by id; unsolved: reason by id; dropped: reason by "left--right" of pairs that contradict the rest;
    metric: lengths are metres; source: "calibration", "solved" or "mixed".
    verdicts: by "left--right", of every pair that was looked at; suspects: known poses (by id) that the images contradict, and by
    how much; focals: ids of cameras whose focal length was solved; components: ids that share a world, the main one first (a
    camera's `component` is its place here); joins: for each component but the first, the pair that would join it best;
    scale: what the scale comes from; crs: coordinate system of the main component, "" for a local one;
    checks: by id, of the cameras with known poses;
    notes: what the operator should know; points: scene points that the cameras rest on; reprojection_px: their median error.
    """

    cameras: Mapping[str, Camera]
    unsolved: Mapping[str, str]
    dropped: Mapping[str, str]
    metric: bool
    source: str
    verdicts: Mapping[str, PairCheck] = field(default_factory=dict)
    suspects: Mapping[str, str] = field(default_factory=dict)
    focals: tuple[str, ...] = ()
    components: tuple[tuple[str, ...], ...] = ()
    joins: tuple[str, ...] = ()
    scale: str = ""
    crs: str = ""
    notes: tuple[str, ...] = ()
    points: int = 0
    reprojection_px: float = float("nan")
    checks: Mapping[str, PoseCheck] = field(default_factory=dict)


@dataclass(frozen=True)
class PolarRows:
    """Half epipolar lines of one image as the rows of a rectified image: row k is the ray at `angles[k]` from the epipole.

    epipole: (2,) float64 pixels of the frame, finite; angles: (rows,) float64 radians, strictly monotone;
    direction: 1 or -1; a point at distance r from the epipole has rectified x = direction * r - start_px.
    """

    epipole: Float64s
    angles: Float64s
    direction: int
    start_px: float


@dataclass(frozen=True)
class Rectification:
    """How the two images of a pair are resampled so that a point lies on the same row in both.

    method: "congruent", "hartley", "calibrated", "seed" or "polar"; reason: why this method;
    H1, H2: (3, 3) float64, frame pixels to rectified pixels (None for polar);
    size1, size2: (width, height) of the rectified images, heights equal;
    disparity_min_px, disparity_max_px: range to search, with margins;
    vertical_px, vertical_p95_px: mean and 95 % row difference of the inliers; angle_deg: convergence angle, nan if unknown;
    polar1, polar2: the rows of a polar rectification, else None; scale: rectified pixels for each pixel of the frames (median);
    anisotropy: longest over shortest side of a resampled pixel, 95 % over both images; kept1, kept2: share of each frame inside
    its rectified image; depth_resolution: median depth error of one pixel of disparity over depth, nan without cameras;
    warnings: what weakens the result without making it useless.
    Use `rectification.warping` to move points and images; nothing else asks which method it was.
    """

    method: str
    reason: str
    H1: Float64s | None
    H2: Float64s | None
    size1: tuple[int, int]
    size2: tuple[int, int]
    disparity_min_px: float
    disparity_max_px: float
    vertical_px: float
    vertical_p95_px: float
    angle_deg: float
    polar1: PolarRows | None = None
    polar2: PolarRows | None = None
    scale: float = 1.0
    anisotropy: float = 1.0
    kept1: float = 1.0
    kept2: float = 1.0
    depth_resolution: float = float("nan")
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Disparity:
    """Dense matches of a rectified pair, left-right checked; x2 = x1 - d on the same row.

    left: (h, w1) int16, sixteenths of a pixel relative to `offset_px`, on the rectified left image; INVALID where unknown;
    right: (h, w2) int16, the same on the rectified right image (x1 = x2 + d);
    confidence_left, confidence_right: uint8, 0 to 255; offset_px: integer; density: share of the common valid area with a value.
    """

    left: Int16s
    right: Int16s
    confidence_left: Uint8s
    confidence_right: Uint8s
    offset_px: int
    density: float


INVALID = -32768
"""The value of `Disparity.left` and `.right` where nothing is known."""


@dataclass(frozen=True)
class DepthMap:
    """Depth of one view, from all its pairs or refined over all views around it.

    depth, sigma: (h, w) float32, along the optical axis, in world lengths; nan where unknown;
    slope_x, slope_y: (h, w) float32, change of 1 / depth per pixel: the local plane;
    support: (h, w) uint32, bit k set where the pair with `partners[k]` supports the depth;
    sure: (h, w) bool, False where the depth must not be believed unless another view's depth agrees.
    """

    depth: Float32s
    sigma: Float32s
    slope_x: Float32s
    slope_y: Float32s
    support: Uint32s
    partners: tuple[str, ...]
    sure: Bools


@dataclass(frozen=True)
class Cloud:
    """points: (n, 3) float64; normals: (n, 3) float32, of unit length, toward the cameras; colors: (n, 3) uint8 RGB;
    confidence: (n,) float32, 0 to 1; views: (n,) uint16, cameras that support the point; sigma_mm: (n,) float32."""

    points: Float64s
    normals: Float32s
    colors: Uint8s
    confidence: Float32s
    views: Uint16s
    sigma_mm: Float32s
