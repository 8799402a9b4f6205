"""What the vision reports of the cameras together: how their poses were found, and what contradicts them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .short_repr import Record


@dataclass(frozen=True)
class PoseCheck(Record):
    """How the images agree with a camera's known pose."""

    pairs: int = 0
    """Number of pairs that could check it."""
    inliers: int = 0
    """Number of inliers of these pairs together."""
    epipolar_px: float | None = None
    """Median over its pairs of the median distance to the epipolar lines of the known poses; None if it has none."""
    moved: bool = False
    """The images contradict the pose, and the camera was solved anew."""
    off_m: float | None = None
    """Distance of the solved from the known position, world lengths; None if not moved, or unknown."""
    off_deg: float | None = None
    """Angle between the solved and the known rotation in degrees; None if not moved, or unknown."""
    verified: bool = False
    """Enough of its pairs and triplets agree with the pose in use; see `orientation.pose_check.verified`."""


@dataclass(frozen=True)
class PairCheck(Record):
    """How one pair agrees with the cameras of the whole site.  Figures are None if there is nothing to compare."""

    kept: bool = True
    """The pair agrees with the cameras, or they provide no evidence about it."""
    reason: str = ""
    """Why the pair is not kept."""
    code: str = ""
    """Code of the `Reason` if the pair is not kept."""
    estimated_px: float | None = None
    """Median epipolar distance of its inliers to its own F."""
    adjusted_px: float | None = None
    """Median epipolar distance of its inliers to the F of the adjusted cameras."""
    rotation_off_deg: float | None = None
    """Angle between its own relative rotation and that of the cameras."""
    known: str = ""
    """Where the relative pose in use comes from: "stated" or "solved", "" if there is none."""


@dataclass(frozen=True)
class CalibrationCheck(Record):
    """How the stated calibration as a whole agrees with the matches (`orientation.calibration_check`)."""

    matches: int = 0
    """Number of matches compared, sampled evenly from the pairs."""
    pairs: int = 0
    confirmed: bool = False
    """Third cameras confirm these matches.  For row offsets: at least as many pairs as cameras connect all cameras."""
    misfit: float = 0.0
    """Mean robust squared distance to the epipolar lines of the stated cameras, divided by that to the lines of the pairs' own
    fundamental matrices: about one if the calibration is right."""
    contradicted: bool = False
    cause: str = ""
    """The likeliest cause, "" for none.  About all cameras: "focal-lengths", "pixel-shape", "pixel-height", "distortion",
    "distortion-factor", "focal-lengths-and-distortion", "principal-points", "principal-points-corner", "headings", "rolls",
    "captures-exchanged", a name of `CONVENTIONS` or of `STRETCHED`; about one: "focal-length", "distortion-of-one",
    "turned", "moved", "mirrored-frames", "upside-down"; about two: a name of `EXCHANGED`."""
    cameras: tuple[str, ...] = ()
    """Ids of the cameras that the cause is about; () for all."""
    amount: tuple[float, ...] = ()
    """Size of the cause, depending on its kind: logarithm of the factor of focal lengths or positions, k1, factor of the
    distortion, shares of the width, radians, shares of the baseline."""
    better: float = 1.0
    """Factor by which the misfit would shrink if the cause were corrected."""
    off_px: float = 0.0
    """Median motion of points along and across the epipolar line if the cause were corrected, pixels."""
    sigmas: float = 0.0
    """For row offsets from dense matching: square root of the squared standard deviations that the likeliest cause removes,
    whether the calibration is contradicted or not."""


@dataclass(frozen=True)
class PoseIssue(Record):
    """A doubt about the pose or the lens of a camera."""

    kind: str = ""
    """"moved": the images contradict the known pose.
    "unverified": all contradictions between known poses involve this camera; the pose stays in use.
    "contradicted": known poses contradict each other, or the model of the others; which is wrong is open, and they stay in use.
    "uncertain": the images determine the known pose no better than stated, which is not enough to match along rows.
    "inconsistent": all matches together place the camera differently from those confirmed by a third camera, and it is solved
    from the latter alone (`orientation.triplet_consistency`); or its pairs contradict each other.
    "lens-undetermined": the lens was solved, but the images do not determine it."""
    camera: str = ""
    """Id of the camera, or of the control point in doubt."""
    text: str = ""
    """For "moved", "unverified" and "contradicted": the message, with the size of the contradiction."""
    triplets: bool = False
    """For "unverified" and "contradicted": triplets or the solved cameras' model contradict it, too; pairs don't settle that."""
    row_px: float | None = None
    """For "uncertain": standard deviation of the rows of the camera's best pair, pixels."""
    strain: float | None = None
    """For "inconsistent": loss that confirmed matches would save with cameras of their own, sigma^2 per degree of freedom."""
    excess_px: float | None = None
    """For "inconsistent": how much better its pairs fit relative poses of their own, epipolar distance in pixels."""
    focal: float | None = None
    """For "lens-undetermined": standard deviation of the focal length, relative to it."""
    border_px: float | None = None
    """For "lens-undetermined": standard deviation of pixels at the border of the frame."""


@dataclass(frozen=True, kw_only=True)
class PosesFigures(Record):
    """How the poses of the cameras were found; the cameras themselves are in `types.Poses`."""

    unsolved: Mapping[str, str] = field(default_factory=dict)
    """Reason why a camera is unsolved, by id."""
    dropped: Mapping[str, str] = field(default_factory=dict)
    """Reason by "left--right" of each pair that contradicts the others."""
    metric: bool = True
    """Whether lengths are metres."""
    source: str = ""
    """"calibration", "solved" or "mixed"."""
    pair_checks: Mapping[str, PairCheck] = field(default_factory=dict)
    """Checks by "left--right" of every pair that was examined."""
    issues: tuple[PoseIssue, ...] = ()
    """Doubts about poses and lenses, one entry for each camera and kind."""
    distances_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Stated distances (by "left--right") that the cameras contradict: stated distance and that between the cameras, metres."""
    points_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Control points by name that the cameras contradict: error and tolerance, metres."""
    units_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """"nearest": median distance of cameras to their nearest neighbour and its limit, metres, if no site is so small or large."""
    focals: tuple[str, ...] = ()
    """Ids of cameras whose focal length was solved."""
    components: tuple[tuple[str, ...], ...] = ()
    """Ids of cameras that share a world, the main one first (a camera's `component` is its position here)."""
    joins: tuple[str, ...] = ()
    """For each component but the first, the pair that could best join it to the main one."""
    scale: str = ""
    """Where the scale comes from."""
    crs: str = ""
    """Coordinate system of the main component, "" if it is local."""
    notes: tuple[str, ...] = ()
    """Notes for the operator."""
    points: int = 0
    """Number of scene points from which the cameras are determined."""
    reprojection_px: float | None = None
    """Median reprojection error of these points; None if there are none."""
    pose_checks: Mapping[str, PoseCheck] = field(default_factory=dict)
    """Checks of the cameras with known poses, by id."""
    calibration: CalibrationCheck | None = None
    """Check of the stated cameras as a whole against the matches; None if nothing is stated, or too little is matched."""
    sources: Mapping[str, str] = field(default_factory=dict)
    """By id, source of the pose in use: "stated", "observed" (from things that moved), "refined" (within its standard deviation),
    "solved" or "corrected" (turned)."""

    def issues_of(self, kind: str) -> dict[str, PoseIssue]:
        """Return the issues of one kind by camera."""
        return {issue.camera: issue for issue in self.issues if issue.kind == kind}
