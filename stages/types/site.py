"""All cameras together: their poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..core.short_repr import Record
from .arrays import Float64s
from .views import Camera


@dataclass(frozen=True)
class PoseCheck(Record):
    """How the images agree with a camera's known pose."""

    pairs: int
    """How many could check it."""
    inliers: int
    """Of these pairs together."""
    epipolar_px: float
    """Median of its pairs' median distances to the epipolar lines of the known poses."""
    moved: bool = False
    """The pose is contradicted, the camera has been solved anew."""
    off_m: float = float("nan")
    """How far that is from the known pose, world lengths; nan where not moved, or unknown."""
    off_deg: float = float("nan")
    """The same in degrees."""
    verified: bool = False
    """Enough of its pairs and triplets agree with the pose in use; see `orientation.pose_check.verified`."""


@dataclass(frozen=True)
class PairCheck(Record):
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
    known: str = ""
    """How the relative pose is known that counts: "stated" or "solved", "" where it is not."""


@dataclass(frozen=True)
class CalibrationCheck(Record):
    """How the stated calibration as a whole agrees with the matches (`orientation.calibration_check`)."""

    matches: int
    """How many were compared, sampled evenly from the pairs."""
    pairs: int
    confirmed: bool
    """Third cameras confirm these matches; otherwise they are those of pairs alone, which may show look-alikes."""
    misfit: float
    """Mean robust squared distance to the epipolar lines of the stated cameras over that to the lines of the pairs' own
    fundamental matrices: about one where the calibration is right."""
    contradicted: bool = False
    cause: str = ""
    """What would explain it, "" for nothing: of all cameras "focal-lengths", "pixel-shape", "pixel-height", "distortion",
    "distortion-factor", "focal-lengths-and-distortion", "principal-points", "principal-points-corner", "captures-exchanged",
    "poses", a name of `CONVENTIONS` or of `STRETCHED`; of one "focal-length", "distortion-of-one", "turned", "moved",
    "mirrored-frames", "upside-down"; of two a name of `EXCHANGED`."""
    cameras: tuple[str, ...] = ()
    """Those that it is about; () for all."""
    amount: tuple[float, ...] = ()
    """By how much: logarithm of the factor of focal lengths or positions, k1, how many times more distortion, shares of the
    width, radians, shares of the baseline."""
    better: float = 1.0
    """So many times smaller the misfit would be."""
    off_px: float = 0.0
    """How far points move along and across the epipolar line then (median, pixels)."""
    sigmas: float = 0.0
    """Of what dense matching finds beside its rows: root of the squared standard deviations that the likeliest cause takes away,
    contradicted or not."""


@dataclass(frozen=True)
class LensSigma(Record):
    """Standard deviations of what was solved of a lens."""

    focal: float
    """Of the focal length, as a share of it."""
    border_px: float
    """Of pixels at the border of the frame, but for what a turn of the camera undoes."""


@dataclass(frozen=True)
class PoseIssue(Record):
    """A doubt about the pose or the lens of a camera."""

    kind: str
    """"moved": the images contradict the known pose.
    "unverified": all contradictions between known poses have this camera in common; the pose stays in use.
    "contradicted": known poses contradict each other, or the model of the others; which is wrong is open, and they stay in use.
    "uncertain": the images tell the known pose no better than it is stated, which is too little to match along rows.
    "inconsistent": all matches would place the camera otherwise than those that a third camera confirms, from which alone it is
    solved (`orientation.triplet_consistency`).
    "lens-undetermined": the lens was solved, and the images do not determine it."""
    camera: str
    """Its id, or the control point that is in doubt."""
    text: str = ""
    """Of "moved", "unverified" and "contradicted": by how much, and by what."""
    triplets: bool = False
    """Of "unverified" and "contradicted": three cameras contradict it, too, which no pair answers."""
    row_px: float = float("nan")
    """Of "uncertain": standard deviation of the rows of the camera's best pair, pixels."""
    strain: float = float("nan")
    """Of "inconsistent": what the confirmed matches would lose, squared standard deviations for each degree of freedom."""
    focal: float = float("nan")
    """Of "lens-undetermined": standard deviation of the focal length, as a share of it..."""
    border_px: float = float("nan")
    """...and of pixels at the border of the frame."""


@dataclass(frozen=True)
class Scene(Record):
    """Where the things that the cameras look at are expected, in the world of the cameras."""

    box: Float64s | None = None
    """(2, 3) lowest and highest corner of all that matters, world lengths."""
    ground: Float64s | None = None
    """(4,) plane n, d with n X + d = 0, n of unit length and pointing up: where most of it stands."""


@dataclass(frozen=True)
class Poses(Record):
    """Cameras in one frame."""

    cameras: Mapping[str, Camera]
    """Solved cameras by id."""
    unsolved: Mapping[str, str]
    """Reason by id."""
    dropped: Mapping[str, str]
    """Reason by "left--right" of pairs that contradict the rest."""
    metric: bool
    """Lengths are metres."""
    source: str
    """"calibration", "solved" or "mixed"."""
    pair_checks: Mapping[str, PairCheck] = field(default_factory=dict)
    """By "left--right", of every pair that was looked at."""
    issues: tuple[PoseIssue, ...] = ()
    """What is doubtful about poses and lenses, one entry for each camera and kind."""
    distances_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Stated distances ("left--right") that the cameras contradict: as stated, and between the cameras; metres."""
    points_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Control points by name that the cameras contradict: how far off they are, and what is tolerated; metres."""
    units_off: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """"nearest": metres from a camera to the nearest other one (median) and the limit, where no site is so small or so large."""
    focals: tuple[str, ...] = ()
    """Ids of cameras whose focal length was solved."""
    components: tuple[tuple[str, ...], ...] = ()
    """Ids that share a world, the main one first (a camera's `component` is its place here)."""
    joins: tuple[str, ...] = ()
    """For each component but the first, the pair that would join it best."""
    scale: str = ""
    """What the scale comes from."""
    crs: str = ""
    """Coordinate system of the main component, "" for a local one."""
    notes: tuple[str, ...] = ()
    """What the operator should know."""
    points: int = 0
    """Scene points that the cameras rest on."""
    reprojection_px: float = float("nan")
    """Their median error."""
    pose_checks: Mapping[str, PoseCheck] = field(default_factory=dict)
    """By id, of the cameras with known poses."""
    calibration: CalibrationCheck | None = None
    """The stated cameras as a whole, held against the matches; None where nothing is stated, or too little is matched."""
    sources: Mapping[str, str] = field(default_factory=dict)
    """By id, how the pose in use is known: "stated", "refined" (within what is stated of it) or "solved"."""

    def main_cameras(self) -> dict[str, Camera]:
        """Those of the main component, by id."""
        return {name: camera for name, camera in self.cameras.items() if camera.component == 0}

    def issues_of(self, kind: str) -> dict[str, PoseIssue]:
        """Return the issues of one kind by camera."""
        return {issue.camera: issue for issue in self.issues if issue.kind == kind}
