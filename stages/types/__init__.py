"""Data that the stages pass to each other: frozen dataclasses of arrays.  Axes, units, order: see the package's docstring."""

from ..contracts.ground_figures import Change, CutFill
from ..contracts.pose_figures import CalibrationCheck, PairCheck, PoseCheck, PoseIssue
from ..contracts.reasons import Reason, Rejected
from ..contracts.stated import Survey
from .arrays import Bools, Float32s, Float64s, Int16s, Int32s, Int64s, Pair, Uint8s, Uint16s, Uint32s, Uint64s
from .captured import Capture, Lens, Placement, Privacy
from .dense import INVALID, MOST_PARTNERS, Cloud, DepthMap, Disparity, GroundOfPair, PolarRows, Rectification, RowMatches
from .ground import NEW, SAME, UNKNOWN, VANISHED, Changes, Coverage, GroundGrid
from .health import CameraHealth, ShiftHistory
from .observations import Observations, ObservedPoses, Sightings, ThingSurvey
from .pairs import Geometry, Matches, Overlap, at_rows
from .places import Hull, KnownPlace
from .site import LensSigma, Poses, Scene
from .views import LEARNED, PLAIN, TILTED, Camera, Features, Frame, View

__all__ = [
    "INVALID",
    "LEARNED",
    "MOST_PARTNERS",
    "NEW",
    "PLAIN",
    "SAME",
    "TILTED",
    "UNKNOWN",
    "VANISHED",
    "Bools",
    "CalibrationCheck",
    "Camera",
    "CameraHealth",
    "Capture",
    "Change",
    "Changes",
    "Cloud",
    "Coverage",
    "CutFill",
    "DepthMap",
    "Disparity",
    "Features",
    "Float32s",
    "Float64s",
    "Frame",
    "Geometry",
    "GroundGrid",
    "GroundOfPair",
    "Hull",
    "Int16s",
    "Int32s",
    "Int64s",
    "KnownPlace",
    "Lens",
    "LensSigma",
    "Matches",
    "Observations",
    "ObservedPoses",
    "Overlap",
    "Pair",
    "PairCheck",
    "Placement",
    "PolarRows",
    "PoseCheck",
    "PoseIssue",
    "Poses",
    "Privacy",
    "Reason",
    "Rectification",
    "Rejected",
    "RowMatches",
    "Scene",
    "ShiftHistory",
    "Sightings",
    "Survey",
    "ThingSurvey",
    "Uint8s",
    "Uint16s",
    "Uint32s",
    "Uint64s",
    "View",
    "at_rows",
]
