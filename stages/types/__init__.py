"""Data that the stages pass to each other: frozen dataclasses of arrays.  Axes, units, order: see the package's docstring."""

from ..contracts.reasons import Reason, Rejected
from ..contracts.stated import Survey
from .arrays import Bools, Float32s, Float64s, Int16s, Int32s, Int64s, Pair, Uint8s, Uint16s, Uint32s, Uint64s
from .captured import Capture, Lens, Placement, Privacy
from .dense import INVALID, MOST_PARTNERS, Cloud, DepthMap, Disparity, GroundOfPair, PolarRows, Rectification, RowMatches
from .ground import NEW, SAME, UNKNOWN, VANISHED, Change, Changes, Coverage, CutFill, GroundGrid
from .health import CameraHealth, Usual
from .pairs import Geometry, Matches, Overlap, at_rows
from .site import CalibrationCheck, LensSigma, PairCheck, PoseCheck, PoseIssue, Poses, Scene
from .views import PLAIN, TILTED, Camera, Features, Frame, View
